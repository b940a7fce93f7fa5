"""Steps and states in many digits, with each arithmetic that there may be."""

import importlib.util

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.study.analysis.discrete_flow import DiscreteFlow


@pytest.mark.parametrize("arithmetic", ["mpmath", "arb"])
def test_a_state_that_constraints_allow_is_placed_where_it_is(arithmetic, monkeypatch):
    if arithmetic == "mpmath":  # as where python-flint is not installed
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    else:
        pytest.importorskip("flint")
    system = ss.systems.cartesian_pendulum()
    stepper = ss.compile(system)
    start = system.reference_state
    run = stepper.integrate(**start, h=0.1, steps=0)
    z = np.concatenate([run.q[0], run.p[0]])
    placed = DiscreteFlow(stepper, stepper.program.free_values(None), 50).project(z)
    assert np.abs(placed.astype(float) - z).max() < 1e-15
