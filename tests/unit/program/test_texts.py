"""Texts that are kept on disk: for the same declaration, and for no other."""

import json

import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.api import compiling as api
from symsimpson.program import cache

k = sp.Symbol("k", positive=True)
(x,) = ss.coordinates("x")


@pytest.fixture
def derived(monkeypatch, tmp_path):
    """Count derivations, all of which are kept, in a folder of their own."""
    made = []
    original = api.derive

    def derive(*given, **how):
        made.append(given)
        return original(*given, **how)

    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(cache, "BRIEF", 0.0)
    monkeypatch.setattr(api, "derive", derive)
    return made


def compiled(factor=1, scheme="simpson", value=2.0, **more):
    api._derive.cache_clear()  # as another process would
    system = ss.MechanicalSystem(
        "kept",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=factor * k * x**4,
        parameters={k: value},
    )
    return ss.compile(system, scheme, **more)


def test_the_same_declaration_is_derived_once(derived):
    first, second = compiled(), compiled()
    assert len(derived) == 1
    assert first.source == second.source
    assert list(second.report().seconds) == list(first.report().seconds)
    assert second.report().operations == first.report().operations


@pytest.mark.parametrize(
    "other", [{"factor": 3}, {"scheme": "midpoint"}, {"value": 2.5}, {"exploit": ()}]
)
def test_another_declaration_is_derived_anew(derived, other):
    first, second = compiled(), compiled(**other)
    assert len(derived) == 2
    assert first.source != second.source or other == {"exploit": ()}


@pytest.mark.parametrize("damage", ["cut", "edited", "empty"])
def test_what_is_damaged_is_derived_anew(derived, tmp_path, damage):
    source = compiled().source
    (place,) = (tmp_path / "texts").iterdir()
    content = json.loads(place.read_text())
    content["text"] = content["text"].replace('"order": 4', '"order": 5')
    place.write_text(
        {"cut": place.read_text()[:100], "edited": json.dumps(content), "empty": ""}[damage]
    )
    assert compiled().source == source
    assert len(derived) == 2


def test_a_folder_that_cannot_be_written_keeps_nothing(derived, tmp_path):
    (tmp_path / "texts").write_text("a file")
    compiled()
    assert compiled().integrate([0.1], v0=[0.0], h=0.1, steps=2).success
    assert len(derived) == 2
