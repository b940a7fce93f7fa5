"""Members on which events act are the runs that they would be alone."""

import numpy as np
import pytest
from support.impacts import x

import symsimpson as ss


def test_reductions_of_members_see_the_state_that_ends_them():
    free = ss.MechanicalSystem("free", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0 * x)
    asked = {
        "h": 0.1,
        "t_end": 2,
        "events": [ss.Event(x - 1, name="goal", terminal=True)],
        "reduce": {"most": ("max", x), "mean": ("mean", x), "goals": ("count", "goal")},
    }
    stepper = ss.compile(free)
    speeds = np.array([[30.0], [3.0], [1.0], [0.1]])  # of the third it is a state of the grid
    many = stepper.ensemble([0.5], v0=speeds, **asked)
    assert many.reduced["mean"][:3] == pytest.approx([0.75, 2.3 / 3, 0.75], abs=1e-12)
    for member, v0 in enumerate(speeds):
        single = stepper.integrate([0.5], v0=v0, **asked).reduced
        for name, values in many.reduced.items():
            assert values[member] == pytest.approx(single[name], abs=1e-14)
