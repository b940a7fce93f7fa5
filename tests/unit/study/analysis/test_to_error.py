"""Runs to a wanted error: the choice is kept, and asked for again where something changed."""

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.study.analysis import choose as choosing
from symsimpson.study.analysis.choose import select

PENDULUM = ss.systems.pendulum()
ASKED = {"v0": [0.0], "t_end": 5.0, "error": 1e-6, "schemes": ["simpson"]}


@pytest.fixture
def choices(monkeypatch, tmp_path):
    """Count how often a choice is made, with a folder of its own for what is kept."""
    made = []

    def choose(*asked, strict):
        made.append(asked)
        return select(*asked, strict=strict)

    monkeypatch.setattr(choosing, "select", choose)
    monkeypatch.setattr(
        "symsimpson.study.analysis.candidates.SCOUT_STEPS", 0
    )  # no run of many steps
    monkeypatch.setattr("symsimpson.program.cache.cache_folder", lambda: tmp_path)
    return made


def test_a_choice_is_made_once_for_the_same_question(choices, tmp_path):
    run = ss.integrate(PENDULUM, [1.0], **ASKED)
    assert run.success
    assert len(choices) == 1
    assert "simpson with h = " in run.message
    again = ss.integrate(PENDULUM, np.array([1.0]), **ASKED, t_eval=[1.0, 2.0])
    assert len(choices) == 1
    assert again.message == run.message
    assert again.h == run.h
    exact = ss.compile(PENDULUM, "gauss16").integrate([1.0], v0=[0.0], h=0.05, t_end=5.0)
    assert abs(run.q[-1] - exact.q[-1]).max() < 1e-6


@pytest.mark.parametrize(
    "other", sweep([{"error": 1e-5}, {"t_end": 6.0}, {"parameters": {"l": 0.5}}, {"on": "energy"}])
)
def test_another_question_is_another_choice(choices, other):
    ss.integrate(PENDULUM, [1.0], **ASKED)
    ss.integrate(PENDULUM, [1.0], **ASKED | other)
    assert len(choices) == 2


def test_files_are_not_trusted(choices, tmp_path):
    run = ss.integrate(PENDULUM, [1.0], **ASKED)
    (kept,) = (tmp_path / "choices").iterdir()
    for text in (
        "",
        "{}",
        "[]",
        kept.read_text().replace('"h": ', '"h": -'),
        '{"h": "x"}',
        kept.read_text().replace("simpson", "../simpson"),
    ):
        kept.write_text(text)
        before = len(choices)
        assert (ss.integrate(PENDULUM, [1.0], **ASKED).q == run.q).all()
        assert len(choices) == before + 1


def test_a_folder_that_cannot_be_written_keeps_nothing(choices, tmp_path):
    (tmp_path / "choices").write_text("a file")
    ss.integrate(PENDULUM, [1.0], **ASKED)
    assert ss.integrate(PENDULUM, [1.0], **ASKED).success
    assert len(choices) == 2
