"""Members that events end: their times, and what depends on these."""

import numpy as np
import pytest

import symsimpson as ss

(z,) = ss.coordinates("z")
#: A mass that grows while it falls.
GROWING = ss.MechanicalSystem(
    "growing", coordinates=(z,), kinetic=(1 + ss.time) * z.diff() ** 2 / 2, potential=9.81 * z
)
FLOOR = ss.Event(z, name="floor", terminal=True)
HEIGHTS = [0.1, 1.0, 90.0]


def test_members_end_at_times_of_their_own():
    stepper = ss.compile(GROWING)
    how = {"v0": [0.0], "h": 0.05, "t_end": 1.0, "events": [FLOOR], "every": None}
    runs = [stepper.integrate([height], **how) for height in HEIGHTS]
    found = stepper.ensemble([[height] for height in HEIGHTS], **how)
    ends = [run.t[-1] for run in runs]
    assert found.ended_at.tolist() == found.t.tolist() == ends
    assert found.ended_at[-1] == pytest.approx(1.0, abs=1e-15)
    assert found.energy == pytest.approx([run.energy[-1] for run in runs], rel=1e-14)
    assert found.v[:, 0] == pytest.approx([run.v[-1, 0] for run in runs], rel=1e-14)
    assert found[1].t.tolist() == [ends[1]]


def test_times_of_stored_states_are_those_of_the_grid():
    stepper = ss.compile(GROWING)
    how = {"v0": [0.0], "h": 0.05, "t_end": 1.0, "events": [FLOOR]}
    found = stepper.ensemble([[height] for height in HEIGHTS], every=5, **how)
    assert found.t == pytest.approx(np.arange(5) / 4)
    assert found.ended_at == pytest.approx([0.1496594, 0.5218894, 1.0], abs=1e-6)
    plain = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.05, steps=4, every=2)
    assert plain.ended_at is None


def test_members_in_which_events_act_end_behind_all_steps():
    bounce = ss.Event(z, name="floor", action=ss.Impact(0.5))
    for every in (1, 7, 30, None):
        how = {"v0": [0.0], "h": 0.05, "steps": 20, "events": [bounce], "every": every}
        found = ss.compile(GROWING).ensemble([[1.0], [90.0]], **how)
        assert found.ended_at == pytest.approx([1.0, 1.0], abs=1e-15)


@pytest.mark.parametrize("every", [None, 3])
@pytest.mark.parametrize("terminal", [False, True])
def test_an_event_at_the_last_state_acts_as_it_does_in_a_run(every, terminal):
    halved = ss.Change(velocities={z: z.diff() / 2})
    events = [ss.Event(ss.time - 1, name="brake", action=halved, terminal=terminal)]
    how = {"v0": [0.0], "h": 0.125, "steps": 8, "events": events, "every": every}
    asked = {"reduce": {"times": ("count", "brake")}, **how}
    stepper = ss.compile(GROWING)
    run, found = stepper.integrate([1.0], **asked), stepper.ensemble([[1.0], [2.0]], **asked)
    assert found["times"].tolist() == [run.reduced["times"]] * 2 == [1.0, 1.0]
    assert found.ended_at.tolist() == [1.0, 1.0]
    if every is None:
        assert found.p[0].tolist() == run.p[0].tolist()
