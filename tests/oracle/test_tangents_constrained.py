"""Derivatives of steps with constraints: against differences of 30 digits, on the constraints."""

import numpy as np
import pytest
from support.cases import sweep
from support.tangents import carried, check_adjoint, check_parameters

import symsimpson as ss
from symsimpson.study.analysis.discrete_flow import DiscreteFlow

H, STEPS, DIGITS = 0.01, 2, 30
#: Its whole motion takes 0.03 s.
FINE = {"andrews_squeezer": 1e-4}


def case(name, scheme):
    system = getattr(ss.systems, name)()
    stepper, state = ss.compile(system, scheme), dict(system.reference_state)
    q0 = state.pop("q0")
    first = stepper.integrate(q0, **state, h=FINE.get(name, H), steps=1)
    values = stepper.program.named_values()
    start = np.concatenate([first.q[0], first.p[0]])
    return stepper, values, DiscreteFlow(stepper, values, DIGITS).project(start)


CASES = [
    ("cartesian_pendulum", "simpson"),
    ("four_bar", "gauss4"),
    ("quaternion_top", "midpoint"),
    ("jointed_bodies", "simpson"),
    ("slider_crank", "lobatto6"),
    ("tumbling_body", "gauss6"),
    ("andrews_squeezer", "simpson"),
]


@pytest.mark.slow
def test_tangent_and_adjoint_of_a_pendulum_in_many_digits():
    """The kernels themselves, without a compiler: on the constraint, and transposed."""
    system = ss.systems.cartesian_pendulum()
    stepper = ss.compile(system, "midpoint", precision=DIGITS)
    values = stepper.program.named_values()
    flow = DiscreteFlow(ss.compile(system, "midpoint"), values, DIGITS)
    z = flow.project([0.6, 0.0, -0.8, 0.4, 1.7, 0.3])
    of_end, of_start = flow.tangent(z, H)
    given = {"p0": z[3:], "h": H, "steps": 1}
    found = stepper.integrate(z[:3], **given, tangents=of_start).tangent[-1]
    assert np.abs(found - of_end).max() < 1e-18 * np.abs(of_end).max()
    run = stepper.integrate(z[:3], **given, tangents=6, sensitivities=("l", "g"))
    weights = np.arange(1, 7)
    names = ("x", "y", "z", "p_x", "p_y", "p_z")
    cost = "+".join(f"{w}*{name}" for w, name in zip(weights, names, strict=True))
    gradient = stepper.gradient(z[:3], **given, cost=cost, wrt=("q", "p", "l", "g")).gradient
    columns = [run.tangent[-1], *(run.sensitivity[name][-1][:, None] for name in ("l", "g"))]
    truth = weights @ np.concatenate(columns, axis=1)
    assert np.abs(gradient - truth).max() < 1e-25 * np.abs(truth).max()


@pytest.mark.plain
@pytest.mark.parametrize(("name", "scheme"), sweep(CASES, 0))
def test_derivatives_by_the_state(name, scheme):
    """And with their symplectic form: on the constraints it is kept."""
    stepper, values, z = case(name, scheme)
    h = FINE.get(name, H)
    of_end, of_start = DiscreteFlow(stepper, values, DIGITS).tangent(z, h, STEPS)
    of_end, of_start = of_end.astype(float), of_start.astype(float)
    found = carried(stepper, z, h, STEPS, tangents=of_start).tangent[-1]
    assert np.abs(found - of_end).max() < 1e-12 * np.abs(of_end).max()
    n = stepper.n
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    defect = found.T @ J @ found - of_start.T @ J @ of_start
    assert np.abs(defect).max() < 1e-13 * np.abs(found).max() ** 2


@pytest.mark.plain
@pytest.mark.parametrize(("name", "scheme"), sweep(CASES[:5], 0))
def test_derivatives_by_parameters(name, scheme):
    """Also by those of constraints, where the start must move with them."""
    stepper, values, z = case(name, scheme)
    check_parameters(stepper, values, z, H, STEPS, DIGITS)


@pytest.mark.plain
@pytest.mark.parametrize(("name", "scheme"), sweep(CASES[:5], 0))
def test_the_adjoint_is_the_transpose_of_the_tangent(name, scheme):
    """By the state, and by parameters of energies and of constraints."""
    stepper, _, z = case(name, scheme)
    check_adjoint(stepper, z, H, STEPS)


@pytest.mark.slow
def test_a_running_cost_of_a_motion_on_constraints():
    """Its derivative by gravity against differences of the cost."""
    system = ss.systems.cartesian_pendulum()
    stepper, state = ss.compile(system), dict(system.reference_state)
    q0 = state.pop("q0")
    x, *_, y = system.coordinates

    def gradient(g):
        return stepper.gradient(
            q0,
            **state,
            h=0.02,
            steps=50,
            parameters={"g": g},
            wrt="g",
            running=x.diff() ** 2 + x * y,
            samples={"p_x": [0.1] * 11},
            every=5,
        )

    values = [gradient(9.81 + number * 1e-2).value for number in (1, -1, 2, -2)]
    slope = (8 * (values[0] - values[1]) - (values[2] - values[3])) / 0.12
    assert abs(gradient(9.81).gradient[0] - slope) < 1e-8 * abs(slope)


@pytest.mark.plain
@pytest.mark.slow
def test_derivatives_in_bands_are_those_of_the_whole_matrix():
    """And the adjoint is the transpose of the tangent."""
    chain = ss.systems.hanging_chain(6)
    state = dict(chain.reference_state)
    q0 = state.pop("q0")
    banded, whole = (ss.compile(chain, "simpson", exploit=exploit) for exploit in ("all", ()))
    found, other = (
        one.integrate(q0, **state, h=H, steps=5, tangents=4, sensitivities=())
        for one in (banded, whole)
    )
    assert np.abs(found.tangent - other.tangent).max() < 1e-12 * np.abs(found.tangent).max()
    check_adjoint(banded, np.concatenate([found.q[-1], found.p[-1]]), H, STEPS)


@pytest.mark.slow
def test_a_motion_on_constraints_has_exponents_of_its_degrees_of_freedom():
    """Areas are kept on the constraints, and Euclidean ones but for a bounded factor."""
    links = ss.systems.hanging_chain(2)
    stepper = ss.compile(links, "simpson")
    state = dict(links.reference_state)
    q0 = state.pop("q0")
    chaos = stepper.lyapunov(q0, **state, h=0.01, t_end=200)
    assert len(chaos.exponents) == 2 * links.degrees_of_freedom
    assert abs(chaos.exponents.sum()) < 0.02
    with pytest.raises(ss.InputError, match="contains velocities"):
        stepper.gradient(q0, **state, h=0.01, steps=10, cost="v_x1", wrt="g")
