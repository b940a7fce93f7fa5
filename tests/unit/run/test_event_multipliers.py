"""Events and reductions of multipliers of constraints."""

import numpy as np
import pytest
from support.friction import x, y

import symsimpson as ss


@pytest.fixture(scope="module")
def stepper():
    rod = ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        constraints={"rod": (x**2 + y**2 - 1) / 2},
    )
    return ss.compile(rod, "gauss6")


START = {"v0": [5.5, 0.0], "h": 0.05, "t_end": 1.2}


def test_a_string_goes_slack_where_its_force_vanishes(stepper):
    """The tension is v^2 + g cos = v0^2 - 2 g + 3 g cos, where cos is -y."""
    ends = ss.Event("lambda_rod", name="slack", terminal=True)
    run = stepper.integrate([0.0, -1.0], **START, events=[ends])
    assert run.ended_by == "slack"
    assert run["lambda_rod"][-1] == pytest.approx(0, abs=1e-12)
    assert run["y"][-1] == pytest.approx((5.5**2 - 2 * 9.81) / (3 * 9.81), abs=1e-6)


def test_multipliers_may_stand_beside_velocities(stepper):
    run = stepper.integrate([0.0, -1.0], **START, reduce={"most": ("max", "lambda_rod*v_x")})
    assert run.reduced["most"] == pytest.approx((run["lambda_rod"] * run["v_x"]).max())
    assert len(run.events("lambda_rod - 20")) == 2


def test_multipliers_exclude_the_energy(stepper):
    with pytest.raises(ss.InputError, match="both the energy and a multiplier"):
        stepper.integrate([0.0, -1.0], **START, events=[ss.Event("lambda_rod - energy")])
    with pytest.raises(ss.InputError, match="lambda_rod"):
        stepper.integrate([0.0, -1.0], **START, events=[ss.Event("lambda_rot")])


def test_constraints_keep_velocities_of_kernels(stepper):
    run = stepper.integrate([0.0, -1.0], **START)
    zeros = run.events("lambda_rod*0 + v_x")
    assert np.abs(zeros["v_x"]).max(initial=0) < 1e-9
