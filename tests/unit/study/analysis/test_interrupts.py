"""Ctrl-C in runs that the package makes itself: it is no step that failed."""

import os
import signal
from dataclasses import replace

import pytest

import symsimpson as ss
from symsimpson.api.stepper import Stepper
from symsimpson.run import integrate
from symsimpson.study.analysis import certify as certification
from symsimpson.study.analysis.stability import stress
from symsimpson.study.analysis.stability import stress_tests as stress_report
from symsimpson.support.interpreter import catch_interrupts

PENDULUM = ss.systems.pendulum()
STATE = {"q0": [1.0], "v0": [0.0]}


def stopped(*given, **named):
    raise ss.Interrupted("stopped", trajectory=None)


@pytest.fixture
def interrupted(monkeypatch):
    """Let each run that may fail be interrupted."""
    integrate = Stepper.integrate

    def run(self, *given, on_failure="raise", **named):
        if on_failure == "raise":
            return integrate(self, *given, **named)
        named |= {"steps": min(named["steps"], 4)}
        return replace(integrate(self, *given, **named), status=ss.Status.INTERRUPTED)

    monkeypatch.setattr(Stepper, "integrate", run)


def test_choices_end(interrupted):
    with pytest.raises(ss.Interrupted):
        ss.choose(PENDULUM, **STATE, t_end=1.0, error=1e-3, schemes="simpson")
    with pytest.raises(KeyboardInterrupt):
        ss.integrate(PENDULUM, **STATE, t_end=1.0, error=1e-3, schemes="simpson")


def test_stress_tests_end(interrupted, monkeypatch):
    monkeypatch.setattr(stress_report, "energy_drift", lambda *given, **named: "")
    monkeypatch.setattr(stress_report, "SHORT", 8)
    with pytest.raises(KeyboardInterrupt):
        list(stress(ss.compile(PENDULUM), h=0.01))


def test_certificates_end(monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        list(certification._catch_failure("order", stopped, None))


def test_comparisons_end(interrupted):
    with pytest.raises(KeyboardInterrupt):
        ss.work_precision(PENDULUM, "midpoint", peers=(), errors=1e-2, t_end=0.5, repeats=1)


def test_what_a_user_asks_to_be_returned_is_returned(monkeypatch):
    """Also where Ctrl-C comes when all steps are done: no state is lost."""
    monkeypatch.setattr(integrate, "judge_run", stopped)
    stepper = ss.compile(PENDULUM, "midpoint")
    given = {**STATE, "h": 0.1, "steps": 3, "progress": False}
    run = stepper.integrate(**given, on_failure="return")
    assert (run.status, run.steps, len(run)) == (ss.Status.INTERRUPTED, 3, 4)
    with pytest.raises(ss.Interrupted) as error:
        stepper.integrate(**given)
    assert error.value.trajectory.steps == 3


def test_an_inner_run_does_not_keep_an_interrupt_to_itself():
    with catch_interrupts() as outer:
        with catch_interrupts() as inner:
            os.kill(os.getpid(), signal.SIGINT)
            while not inner:
                pass
        assert outer == inner == [signal.SIGINT]
    with catch_interrupts() as heard:
        pass
    assert heard == []
