"""Bodies that a step turns too far."""

import warnings

import pytest

import symsimpson as ss
from symsimpson.analysis.stability.turning import fastest_turn

BODY = ss.RigidBody("b", inertia=(1, 2, 3))
SYSTEM = ss.MechanicalSystem(
    "body", coordinates=BODY.coordinates, kinetic=BODY.kinetic, potential=0,
    constraints=BODY.constraints,
)  # fmt: skip


def test_rates_are_those_of_the_body():
    _, v = BODY.state(angles=(0.3, 0.7, 1.1), angular_velocity=(3.0, 0.0, 4.0))
    assert abs(fastest_turn(SYSTEM, v) - 5) < 1e-14
    # a point on a rod turns nothing
    assert fastest_turn(ss.systems.cartesian_pendulum(), [1, 2, 3]) == 0


def test_a_step_that_turns_too_far_is_warned_of():
    stepper = ss.compile(SYSTEM)
    q, v = BODY.state(angular_velocity=(0.0, 0.0, 20.0))
    with pytest.warns(ss.StabilityWarning, match=r"turns a body by 2 rad(.|\n)*h below 0\.075"):
        stepper.integrate(q, v, h=0.1, steps=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stepper.integrate(q, v, h=0.05, steps=1)
