"""The step to begin with, where none is given."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.study.analysis.pilot import choose_step


def test_at_rest_the_first_step_will_do():
    """The path has no length that an error could be relative to."""
    stepper = ss.compile(ss.systems.pendulum())
    assert (
        choose_step(stepper, np.zeros(1), np.zeros(1), stepper.program.named_values(None), 64)
        == 4.0
    )


@pytest.mark.parametrize("start", [0.5, 2.0])
def test_friction_hides_no_error_of_the_path(start):
    """All paths end at rest; a step of 4 is beyond the limit of stability, 2.83, all the same."""
    system = ss.systems.damped_oscillator()
    stepper = ss.compile(system)
    h = choose_step(stepper, np.array([start]), np.zeros(1), stepper.program.named_values(None), 64)
    assert h <= 1.0


@pytest.mark.parametrize("second", [2.0**-70, 1.0, 2.0**23, 2.0**60])
def test_steps_do_not_depend_on_the_unit_of_time(second):
    system = ss.systems.pendulum()
    stepper = ss.compile(system)
    values = stepper.program.named_values(None) | {"g": 9.81 / second**2}
    p = np.array([0.3 / second])
    h = choose_step(stepper, np.ones(1), p, values, 64, longest=10.0 * second)
    plain = stepper.program.named_values(None) | {"g": 9.81}
    assert h == second * choose_step(stepper, np.ones(1), np.array([0.3]), plain, 64, longest=10.0)


def test_longer_steps_are_looked_at_where_a_run_is_long():
    """At rest any step will do; without an end the first one is taken."""
    stepper = ss.compile(ss.systems.pendulum())
    values = stepper.program.named_values(None)
    assert choose_step(stepper, np.zeros(1), np.zeros(1), values, 64, longest=40.0) == 32.0


@pytest.mark.filterwarnings("error")
def test_steps_that_are_tried_warn_of_nothing():
    """Long ones meet folds of linkages in which shorter ones do not stand."""
    system = ss.systems.slider_crank()
    stepper, state = ss.compile(system, "midpoint"), system.reference_state
    run = stepper.integrate(state["q0"], v0=3 * np.array(state["v0"]), h=1e-4, steps=0)
    values = stepper.program.named_values(None)
    assert choose_step(stepper, run.q[0], run.p[0], values, 64) < 0.01
