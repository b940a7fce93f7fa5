"""Bodies that a step turns too far, and oscillations that it does not resolve."""

import warnings

import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.study.analysis.stability.frequency import fastest_turn, largest_frequency

BODY = ss.RigidBody("b", inertia=(1, 2, 3))
SYSTEM = ss.MechanicalSystem(
    "body",
    coordinates=BODY.coordinates,
    kinetic=BODY.kinetic,
    potential=0,
    constraints=BODY.constraints,
)


def test_rates_are_those_of_the_body():
    _, v = BODY.state(angles=(0.3, 0.7, 1.1), angular_velocity=(3.0, 0.0, 4.0))
    assert abs(fastest_turn(SYSTEM, v) - 5) < 1e-14
    # a point on a rod turns nothing
    assert fastest_turn(ss.systems.cartesian_pendulum(), [1, 2, 3]) == 0


@pytest.mark.slow
def test_a_step_that_turns_too_far_is_warned_of():
    stepper = ss.compile(SYSTEM)
    q, v = BODY.state(angular_velocity=(0.0, 0.0, 20.0))
    with pytest.warns(ss.StabilityWarning, match=r"turns a body by 2 rad(.|\n)*h below 0\.075"):
        stepper.integrate(q, v, h=0.1, steps=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stepper.integrate(q, v, h=0.05, steps=1)


@pytest.mark.slow
def test_oscillations_are_those_that_constraints_allow():
    """A stiff spring along a rod is none; what gravity makes of a pendulum is left."""
    x, y = ss.coordinates("x y")
    rod = ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=1e6 * (sp.sqrt(x**2 + y**2) - 1) ** 2 + 9.81 * y,
        constraints=[x**2 + y**2 - 1],
    )
    assert largest_frequency(rod, [0.0, -1.0], []) == pytest.approx(9.81**0.5, rel=1e-12)
    assert largest_frequency(rod, [0.0, 1.0], []) == 0
    with pytest.warns(ss.StabilityWarning, match=r"omega=3\.13(.|\n)*h below 0\.90"):
        ss.compile(rod).integrate([0.0, -1.0], [0.0, 0.0], h=1.0, steps=1)
