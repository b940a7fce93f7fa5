"""Bars: after a second, about anything, and never where they are not wanted."""

import threading
import time

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.api import compiling as api
from symsimpson.declare import system as system_module
from symsimpson.lower.pipeline import derive
from symsimpson.program import cache
from symsimpson.support import progress


@pytest.fixture
def told(monkeypatch):
    """What is shown, with no patience at all."""
    shown = []

    class Bar:
        total, n = 10, 0

        def __init__(self, **options):
            shown.append(options["desc"] or options["unit"])

        def update(self, count):
            pass

        def set_description_str(self, text, refresh):
            if text != shown[-1]:
                shown.append(text)

        refresh = close = lambda self: None

    import tqdm
    import tqdm.auto

    for module in (tqdm, tqdm.auto):
        monkeypatch.setattr(module, "tqdm", Bar)
    monkeypatch.setattr(progress, "DELAY", 0.01)
    monkeypatch.setattr(progress, "is_watched", lambda: True)
    return shown


def test_waiting_tells_what_for_and_only_once(told, monkeypatch):
    before = set(threading.enumerate())
    with progress.announce("the whole"):
        with progress.announce("a part of it"):
            time.sleep(0.1)
        while not told:
            time.sleep(0.01)
    assert told == ["the whole"]
    monkeypatch.setattr(progress, "DELAY", 60.0)
    with progress.announce("nothing long"):
        pass
    with progress.silence(), progress.announce("silence"):
        time.sleep(0.1)
    with pytest.raises(ZeroDivisionError), progress.announce("a failure"):
        raise ZeroDivisionError
    assert told == ["the whole"]
    assert not set(threading.enumerate()) - before


def test_trials_of_a_choice_are_counted(told, monkeypatch):
    with progress.announce("choosing") as texts:
        while not told:
            time.sleep(0.01)
        texts.append("choosing, trial 1 of at most 9")
        while len(told) < 2:
            time.sleep(0.01)
    assert told == ["choosing", "choosing, trial 1 of at most 9"]
    asked = {"q0": [1.0], "v0": [0.0], "t_end": 1.0, "error": 1e-3, "schemes": "midpoint"}
    motions = []
    monkeypatch.setattr(
        "symsimpson.study.analysis.choose.verify",
        lambda motion, *given: motions.append(motion) or 1 / 0,
    )
    with pytest.raises(ZeroDivisionError):
        ss.choose(ss.systems.pendulum(), **asked)
    shown = motions[0].labels
    assert shown[0] == "choosing a scheme and a step"
    assert shown[1] == "choosing a scheme and a step, trial 1 of at most 22"
    assert len(shown) <= 9


@pytest.mark.slow
def test_compiling_and_deriving_are_told_of(told, monkeypatch, tmp_path):
    monkeypatch.setenv("SYMSIMPSON_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_results", {})
    (x,) = ss.coordinates("x")
    given = {"coordinates": (x,), "kinetic": x.diff() ** 2 / 2, "parameters": {}}
    system = ss.MechanicalSystem("told", **given, potential=x**2 + x**6 / 7)
    stepper = ss.compile(system, "lobatto6")
    stepper.integrate([1.0], v0=[0.0], h=0.01, steps=3)
    assert "compiling, once for this machine" in told
    assert "deriving lobatto6 for told" in told
    told.clear()
    other = ss.MechanicalSystem("silent", **given, potential=x**2 + x**8 / 7)
    silent = ss.compile(other, "midpoint")
    told.clear()
    silent.integrate([1.0], v0=[0.0], h=0.01, steps=3, progress=False)
    assert told == []


def test_declarations_are_told_of(told, monkeypatch):
    slow = system_module.read_energies

    def slower(*given):
        time.sleep(0.2)
        return slow(*given)

    monkeypatch.setattr(system_module, "read_energies", slower)
    ss.systems.pendulum()
    assert told == ["reading: pendulum"]


def test_bars_are_drawn_one_at_a_time(told):
    with progress.Progress(10, True, "outer"):
        with progress.Progress(10, True, "inner") as inner:
            inner.add(3)
        watcher = progress.Watcher(10, None)
        time.sleep(0.02)
        watcher(5)
        watcher.close()
    with progress.Progress(10, True, "next"):
        pass
    assert told == ["outer", "next"]


@pytest.mark.slow
def test_nothing_is_drawn_into_files_unless_it_is_asked_for(told, monkeypatch):
    monkeypatch.setattr(progress, "is_watched", lambda: False)
    system = ss.systems.pendulum()
    with progress.announce("a file"):
        time.sleep(0.1)
    ss.compile(system, "gauss4").integrate([1.0], v0=[0.0], h=0.01, steps=30_000)
    assert told == []
    with progress.announce("asked for", True):
        while not told:
            time.sleep(0.01)
    ss.compile(system, "gauss4").integrate([1.0], v0=[0.0], h=0.01, steps=3, progress=True)
    assert told == ["asked for", "step"]


@pytest.mark.parametrize("wanted", [np.array([1, 2]), "yes"], ids=["array", "text"])
def test_what_is_no_truth_value_is_refused(wanted):
    stepper = ss.compile(ss.systems.pendulum())
    given = {"q0": [1.0], "v0": [0.0], "h": 0.1, "steps": 40, "progress": wanted}
    calls = [stepper.integrate, stepper.linearise, stepper.lyapunov]
    calls += [lambda **asked: stepper.gradient(cost="theta", wrt="q", **asked)]
    calls += [lambda **asked: ss.compile(ss.systems.pendulum(), progress=asked["progress"])]
    for call in calls:
        with pytest.raises(ss.InputError, match="progress is"):
            call(**given)


def test_compile_takes_progress(told, monkeypatch):
    monkeypatch.setattr(
        api, "derive", lambda *given, **how: time.sleep(0.2) or derive(*given, **how)
    )
    system = ss.systems.pendulum()
    told.clear()  # a slow machine may have told of reading it
    ss.compile(system, "gauss6", progress=False)
    assert told == []
    ss.compile(system, "gauss6", progress=True)
    assert told == ["deriving gauss6 for pendulum"]
