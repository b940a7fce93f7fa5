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


def test_a_member_has_its_own_events():
    free = ss.MechanicalSystem("free", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0 * x)
    wall = ss.Event(1 - x, name="wall", action=ss.Impact(0.5))
    asked = {"h": 0.1, "steps": 10, "events": [wall]}
    stepper = ss.compile(free)
    many = stepper.ensemble([0.5], v0=[[3.0], [0.1], [1.0]], every=1, **asked)
    for member, times in enumerate(([1 / 6], [], [0.5])):
        assert many[member].events("wall").t == pytest.approx(times, abs=1e-12)
    assert many[-1].events("wall").impulse.tolist() == [1.5]
    assert (many[1].steps, many[1].status) == (10, ss.Status.SUCCESS)
    with pytest.raises(ss.InputError, match=r"has no event 'wal'. Its events are wall"):
        many[0].events("wal")
    with pytest.raises(ss.InputError, match="Run a member of an ensemble alone"):
        many[0].at(0.5)
