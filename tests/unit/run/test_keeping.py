"""What takes the states of a run piece by piece: nothing is lost, and little is kept."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.run.ended import StateSampler
from symsimpson.run.integrate import start_run
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import read_run

START = {"q0": [1.0], "v0": [0.0], "h": 0.01}


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(ss.systems.pendulum(), "midpoint")


def interrupt_at(monkeypatch, last):
    advance = Run.advance

    def interrupted(self, stop):
        advance(self, min(stop, last))
        if self.step == last:
            raise KeyboardInterrupt

    monkeypatch.setattr(Run, "advance", interrupted)


@pytest.mark.parametrize("last", [20, 35])
@pytest.mark.parametrize("how", [{"save": "q"}, {"t_eval": np.arange(50) * 0.01}], ids=str)
def test_ctrl_c_loses_no_chosen_states(monkeypatch, stepper, how, last):
    whole = stepper.integrate(**START, steps=50)
    monkeypatch.setattr("symsimpson.run.chosen.PIECE", 16)
    interrupt_at(monkeypatch, last)
    with pytest.raises(ss.Interrupted) as caught:
        stepper.integrate(**START, steps=50, **how)
    kept = caught.value.trajectory
    assert np.array_equal(kept.t, whole.t[: last + 1])
    assert np.abs(kept["q"] - whole.q[: last + 1]).max() < 1e-14


def test_a_run_that_fails_has_its_last_state(monkeypatch, stepper):
    whole = stepper.integrate(**START, steps=50)
    interrupt_at(monkeypatch, 20)
    how = {"steps": 50, "every": None, "save": ("q", "energy"), "on_failure": "return"}
    kept = stepper.integrate(**START, **how)
    assert kept.t.tolist() == [whole.t[20]]
    assert (kept["q"] == whole.q[20]).all()
    assert kept["energy"] == whole.energy[20]


def test_ctrl_c_loses_no_crossings(monkeypatch, stepper):
    whole = stepper.integrate(**START, steps=400).events("theta")
    interrupt_at(monkeypatch, 390)
    with pytest.raises(ss.Interrupted) as caught:
        stepper.poincare("theta", **START, steps=400)
    assert np.abs(caught.value.trajectory.t - whole.t).max() < 1e-13


@pytest.mark.parametrize("piece", [1, 7, 64])
def test_samples_stand_at_equal_strides_and_are_few(monkeypatch, stepper, piece):
    monkeypatch.setattr("symsimpson.run.ended.MOST_SAMPLES", 10)
    whole = stepper.integrate(**START, steps=200)
    program = stepper.program
    spec = read_run(program, Request(**START, steps=200, every=1))
    run = start_run(program, spec, 1, piece + 1)
    samples = StateSampler(run, 3)
    while run.step < 200:
        run.advance(min(200, run.room))
        samples.take()
        samples.take()  # nothing new
        run.discard_stored()
    kept = samples.states()
    assert kept.every == 24
    assert np.array_equal(kept.q, whole.q[::24])
    assert np.array_equal(kept.p, whole.p[::24])
    assert kept.iterations.sum() == whole.newton_iterations.sum()
