"""Gains along a solution, for momenta and for velocities."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

pytest.importorskip("casadi")

x, y = ss.coordinates("x y")
u, w = sp.symbols("u w", real=True)
#: Masses that depend on where it is, momenta that are no multiples of velocities.
SLIDE = ss.MechanicalSystem.from_lagrangian(
    "slide",
    (x.diff() ** 2 + (1 + x**2) * y.diff() ** 2) / 2 + x.diff() * y / 5 - (x**4 + y**2) / 2,
    (x, y),
    forces={x: u, y: w - y.diff() / 5},
    inputs=(u, w),
)


@pytest.fixture(scope="module")
def found():
    rest = {x.diff(): 0, y.diff(): 0}
    problem = ss.OptimalControl(
        SLIDE,
        cost=u**2 + w**2,
        start={x: 0.1, y: -0.2, **rest},
        end={x: 1.0, y: 0.8, **rest},
        duration=1.2,
    )
    return problem.solve("simpson", steps=6)


def maps(found, change):
    """Derivatives of each step's end by its start and inputs, by differences, in (q, v)."""
    stepper, run, n = found.layout.stepper, found.trajectory, 2
    for k, values in enumerate(found.input_values):
        state = np.concatenate([run.q[k], run.v[k], np.zeros(2)])
        columns = []
        for j in range(3 * n):
            ends = []
            for sign in (1, -1):
                z = state.copy()
                z[j] += sign * change
                inputs = {name: values[None, :, i] + z[4 + i] for i, name in enumerate("uw")}
                end = stepper.integrate(
                    z[:2], v0=z[2:4], h=run.h, steps=1, t0=run.t[k], inputs=inputs
                )
                ends.append(np.concatenate([end.q[-1], end.v[-1]]))
            columns.append((ends[0] - ends[1]) / (2 * change))
        yield np.transpose(columns)[:, :4], np.transpose(columns)[:, 4:]


@pytest.mark.slow
def test_gains_for_velocities_are_those_of_steps_in_velocities(found):
    Q, R = np.diag([1.0, 2.0, 3.0, 4.0]), np.eye(2) / 50
    gains, P = found.lqr(Q, R, of=("q", "v")), Q
    for k, (A, B) in reversed([*enumerate(maps(found, 1e-5))]):
        right = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        assert gains[k] == pytest.approx(right, abs=1e-7)
        P = Q + A.T @ P @ (A - B @ right)


@pytest.mark.slow
def test_gains_for_momenta_are_the_default(found):
    Q, R = np.eye(4), np.eye(2)
    assert (found.lqr(Q, R) == found.lqr(Q, R, of=("q", "p"))).all()
    assert not np.allclose(found.lqr(Q, R), found.lqr(Q, R, of=("q", "v")), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("of", ["qv", ("p", "q"), None, ("q",), ("q", "w")])
def test_states_of_gains_that_are_not_known(found, of):
    with pytest.raises(ss.InputError, match=r"of is .*\nPass \('q', 'p'\) or \('q', 'v'\)"):
        found.lqr(np.eye(4), np.eye(2), of=of)
