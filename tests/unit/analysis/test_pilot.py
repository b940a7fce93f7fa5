"""The step to begin with, where none is given."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.analysis.pilot import choose_step


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
