"""Derivatives of steps with constraints that roll or move: against differences, and adjoints."""

from functools import partial

import numpy as np
import pytest
from support.cases import sweep
from support.rolling import allowed_state, carried_by_time, moved_by_time
from support.tangents import carried, check_adjoint, check_parameters

import symsimpson as ss
from symsimpson.study.analysis.discrete_flow import DiscreteFlow

pytestmark = pytest.mark.plain
H, STEPS, DIGITS = 0.05, 2, 30
MADE = {
    "carried": carried_by_time,
    "moved": moved_by_time,
    "moved and carried": partial(moved_by_time, rolling=True),
}


def case(name, scheme):
    if name in MADE:
        system = MADE[name]()
        state = allowed_state(system)
    else:
        system = ss.systems.ROLLING[name]()
        state = dict(system.reference_state)
    stepper = ss.compile(system, scheme)
    values = stepper.program.named_values()
    first = stepper.integrate(state["q0"], v0=state["v0"], h=H, steps=0)
    z = DiscreteFlow(stepper, values, DIGITS).project(np.concatenate([first.q[0], first.p[0]]))
    return stepper, values, z


CASES = [
    ("carried", "simpson"),
    ("moved", "gauss4"),
    ("moved and carried", "simpson"),
    ("chaplygin_sleigh", "gauss4"),
    ("rolling_disc", "simpson"),
    ("snakeboard", "lobatto6"),
    ("ball_on_turntable", "simpson"),
    ("carried", "gauss6"),
    ("ball_on_turntable", "midpoint"),
]


@pytest.mark.parametrize(("name", "scheme"), sweep(CASES, 1))
def test_derivatives_by_the_state(name, scheme):
    stepper, values, z = case(name, scheme)
    of_end, of_start = DiscreteFlow(stepper, values, DIGITS).tangent(z, H, STEPS)
    of_end, of_start = of_end.astype(float), of_start.astype(float)
    found = carried(stepper, z, H, STEPS, tangents=of_start).tangent[-1]
    assert np.abs(found - of_end).max() < 1e-12 * np.abs(of_end).max()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scheme"), sweep(CASES, 1))
def test_derivatives_by_parameters(name, scheme):
    stepper, values, z = case(name, scheme)
    check_parameters(stepper, values, z, H, STEPS, DIGITS)


@pytest.mark.parametrize(("name", "scheme"), sweep(CASES, 1))
def test_derivatives_by_the_step(name, scheme):
    stepper, values, z = case(name, scheme)
    flow = DiscreteFlow(stepper, values, DIGITS)
    size, n, start = flow.small, stepper.n, z.astype(float)
    found = stepper.tangent(start[:n], p=start[n:], h=H, wrt=("h",))[2][:, 0]
    h = flow.context.mpf(H)
    ends = [flow.advance(z, h + sign * size) for sign in (1, -1)]
    truth = ((ends[0] - ends[1]) / (2 * size)).astype(float)
    assert np.abs(found - truth).max() < 1e-12 * np.abs(truth).max()


@pytest.mark.parametrize(("name", "scheme"), sweep(CASES, 1))
def test_the_adjoint_is_the_transpose_of_the_tangent(name, scheme):
    stepper, _, z = case(name, scheme)
    check_adjoint(stepper, z, H, STEPS)
