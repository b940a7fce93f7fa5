"""Messages of the package: none by default, and at INFO what was derived, compiled and retried."""

import logging
import subprocess
import sys

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.api.compiling import _derive
from symsimpson.program import cache
from symsimpson.program.cache import load_or_make

TOP = logging.getLogger("symsimpson")


@pytest.fixture
def messages(caplog, monkeypatch):
    """Messages as they come, in a list that can be emptied."""
    caplog.set_level(logging.INFO, logger="symsimpson")
    heard = []
    monkeypatch.setattr(caplog.handler, "emit", lambda record: heard.append(record.getMessage()))
    return heard


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_results", {})
    _derive.cache_clear()
    return cache.cache_folder()


@pytest.mark.slow
def test_nothing_is_printed_by_default():
    code = "import symsimpson as ss; ss.compile(ss.systems.pendulum(), 'midpoint')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert done.stdout == done.stderr == b""
    assert any(isinstance(x, logging.NullHandler) for x in TOP.handlers)
    assert TOP.level == logging.NOTSET


def test_the_cache_says_what_it_takes_makes_and_mends(folder, messages):
    key, use = "newton_" + "0" * 32, lambda module, keep: module.x
    entry = folder / key
    for expected in ("compiled", "machine code taken from the cache"):
        messages.clear()
        assert cache._load_or_build("x = 1\n", key, use) == 1
        assert [x.split(": /")[0].split(" /")[0] for x in messages] == [expected]
    (entry / "digests.json").write_text("{}")
    messages.clear()
    assert cache._load_or_build("x = 1\n", key, use) == 1
    assert f"machine code in the cache is damaged, and compiled again: {entry}" in messages
    assert any(x.startswith(f"compiled {entry} in") for x in messages)


def test_choices_that_are_remembered_are_told_of(folder, messages):
    def ask():
        messages.clear()
        assert load_or_make("choices", "which", float, lambda: 1.0, lambda x: x) == 1.0
        return [x.partition("/")[0] for x in messages]

    assert ask() == ["choices: remembered in "]
    assert ask() == ["choices: taken from the cache, "]
    next((folder / "choices").iterdir()).write_text("{")
    assert ask() == ["choices: ", "choices: remembered in "]
    assert ask() == ["choices: taken from the cache, "]


@pytest.mark.slow
def test_a_plain_run_logs_nothing_and_steps_that_fail_are_told_of(messages):
    stepper = ss.compile(ss.systems.pendulum(), "midpoint")
    for steps in (2, 2, 3):  # the first two load what short runs need
        messages.clear()
        stepper.integrate([0.8], v0=[0.0], h=0.01, steps=steps)
    assert messages == []
    stepper.integrate([2.8], v0=[8.0], h=3.0, steps=3, on_failure="return")
    assert "pendulum: step 2 is repeated or checked" in messages


@pytest.mark.slow
def test_other_kernels_are_told_of(messages):
    stepper = ss.compile(ss.systems.double_pendulum(), "midpoint")
    stepper.integrate([2.8, 3.0], v0=[8.0, -3.0], h=2.0, steps=3, on_failure="return")
    assert not any("kernels 'newton' replace kernels 'newton'" in x for x in messages)
    assert any("kernels 'robust' replace kernels 'newton'" in x for x in messages)


@pytest.mark.slow
def test_what_is_derived_and_members_that_are_run_again_are_told_of(folder, messages):
    stepper = ss.compile(ss.systems.henon_heiles(), "midpoint")
    assert any(x.startswith("derived midpoint for henon_heiles in") for x in messages)
    messages.clear()
    stepper.ensemble(np.array([[0.1, 0.1], [3.0, 9.0]]), v0=[0.0, 0.0], h=0.5, steps=30)
    assert [x for x in messages if "member" in x] == ["henon_heiles: member 1 runs again singly"]
