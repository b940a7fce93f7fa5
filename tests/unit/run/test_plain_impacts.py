"""Impacts that the compiled loop takes: the same as Python's, and which are left to Python."""

import numpy as np
import pytest
import sympy as sp
from support.impacts import BALL, PLANE, drop, floor, x, y, z

import symsimpson as ss
from symsimpson.run import event_run

th, om = ss.coordinates("th om")
PENDULUM = ss.systems.double_pendulum()
FIRST, SECOND = PENDULUM.coordinates
ARMS = ss.MechanicalSystem(
    "arms",
    coordinates=(th, om),
    kinetic=(th.diff() ** 2 * (2 + sp.cos(om)) + om.diff() ** 2 + th.diff() * om.diff()) / 2,
    potential=-sp.cos(th) - sp.cos(om) * sp.cos(th),
)
ELLIPSE = ss.Event(1 - x**2 / 4 - y**2, name="wall", action=ss.Impact())
MOVING = ss.Event(
    z - sp.sin(3 * ss.time) / 10, name="table", action=ss.Impact(sp.Rational(9, 10)), when=z + 5
)
STOPS = [
    ss.Event(sp.Rational(6, 5) - th, name="right", action=ss.Impact(0.7)),
    ss.Event(th + sp.Rational(6, 5), name="left", action=ss.Impact(0.9)),
]


@pytest.fixture
def split(monkeypatch):
    """Counts the steps that Python takes anew."""
    counted, real = [], event_run.EventRun._split_step

    def count(run, **how):
        counted.append(run.step)
        real(run, **how)

    monkeypatch.setattr(event_run.EventRun, "_split_step", count)
    return counted


@pytest.mark.parametrize(
    ("system", "scheme", "start", "events", "h"),
    [
        (BALL, "simpson", ([1.0], [0.0]), [floor(0.8)], 0.01),
        (BALL, "kahan_li8", ([1.0], [0.0]), [floor(0.9)], 0.05),
        (BALL, "simpson", ([1.0], [0.0]), [floor(1)], -0.02),
        (BALL, "midpoint", ([0.6], [0.0]), [MOVING], 0.01),
        (PLANE, "lobatto6", ([0.3, 0.2], [1.0, 0.37]), [ELLIPSE], 0.05),
        (ARMS, "gauss6", ([1.0, 0.4], [2.0, -1.0]), STOPS, 0.02),
    ],
)
def test_they_are_those_of_python(system, scheme, start, events, h, split, monkeypatch):
    stepper, (q0, v0) = ss.compile(system, scheme), start
    given = {"v0": v0, "h": h, "steps": 120, "events": events, "reduce": {"e": ("mean", "energy")}}
    run = stepper.integrate(q0, **given)
    assert not split
    monkeypatch.setattr(event_run, "read_plain_restitution", lambda *asked: None)
    other = stepper.integrate(q0, **given)
    assert split
    assert len(run.records) >= 2
    assert [one.event for one in run.records] == [one.event for one in other.records]
    for name in ("t", "step", "q", "p", "q_after", "p_after", "direction", "impulse"):
        mine, theirs = ([getattr(one, name) for one in each.records] for each in (run, other))
        np.testing.assert_allclose(mine, theirs, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(run.y, other.y, rtol=1e-10, atol=1e-11)
    assert run.newton_iterations.tolist() == other.newton_iterations.tolist()
    assert abs(run.reduced["e"] - other.reduced["e"]) < 1e-11


@pytest.mark.parametrize(
    "events",
    [
        [floor(1), ss.Event(z - 0 * ss.time, name="another", action=ss.Impact())],
        [ss.Event(z, name="floor", action=ss.Impact(), terminal=True)],
        [ss.Event(z, name="floor", action=ss.Impact(1 - ss.approach / 20))],
        [floor(1), ss.Event(z - 0.5, name="middle", action=ss.Switch())],
        [floor(0)],
    ],
)
def test_others_are_left_to_python(events, split):
    run = drop(*events, t_end=0.6, on_failure="return")
    assert run.records
    assert split


def test_a_bounce_within_a_step_is_seen():
    """The gap is positive at both ends: its rate tells where to look."""
    runs = [drop(floor(1), h=h, t_end=3.6) for h in (0.9, 0.01)]
    assert [len(run.records) for run in runs] == [4, 4]
    assert abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-10


@pytest.mark.parametrize(
    ("lift", "start", "names", "times"),
    [
        (0.0, ([0.6, 0.3], [1.0, -3.0]), ["floor", "wall"], [0.1, 0.4]),
        (9.81, ([0.8, 0.3], [2.0, -2.5]), ["wall", "floor"], [0.1, (2.5 - 0.364**0.5) / 9.81]),
    ],
)
def test_two_impacts_in_a_step(lift, start, names, times):
    """The first of two that both ends show; and one that neither shows, behind another."""
    system = ss.MechanicalSystem(
        "lifted", coordinates=(x, y), kinetic=PLANE.kinetic, potential=-lift * y
    )
    events = [
        ss.Event(gap, name=name, action=ss.Impact())
        for gap, name in ((y, "floor"), (1 - x, "wall"))
    ]
    q0, v0 = start
    run = ss.compile(system).integrate(q0, v0=v0, h=0.5, steps=1, events=events)
    assert [events[one.event].name for one in run.records] == names
    np.testing.assert_allclose([one.t for one in run.records], times, rtol=1e-12)
    wall = run.events("wall")
    np.testing.assert_allclose(wall.q[0, 0], 1, rtol=1e-14)
    np.testing.assert_allclose(run.events("floor").q[0, 1], 0, atol=1e-14)


def test_records_of_more_impacts_than_there_is_room_for(monkeypatch):
    monkeypatch.setattr("symsimpson.run.event_locator.ROOM", 3)
    run = drop(floor(1), h=0.05, t_end=20.0, every=7)
    monkeypatch.undo()
    whole = drop(floor(1), h=0.05, t_end=20.0)
    hits = run.events("floor")
    assert len(hits) > 20
    np.testing.assert_allclose(hits.t, whole.events("floor").t, rtol=1e-12)
    np.testing.assert_allclose(run.q, whole.q[::7], atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["simpson", "kahan_li8"])
def test_they_are_those_of_python_wherever_a_ball_begins(scheme, split, monkeypatch):
    """In a room with a round thing on its floor: edges, corners, several hits in a step."""
    room = ss.MechanicalSystem(
        "room",
        coordinates=(x, y, z),
        kinetic=(x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2,
        potential=9.81 * z,
    )
    gaps = [z, 1 - x, 1 + x, 1 - y, 1 + y, x**2 + y**2 + (z - sp.Rational(1, 2)) ** 2 - 0.1]
    restitution = [0.9, 1, 1, 1, 1, 1]
    events = [
        ss.Event(gap, name=f"g{k}", action=ss.Impact(e))
        for k, (gap, e) in enumerate(zip(gaps, restitution, strict=True))
    ]
    stepper, random, hits = ss.compile(room, scheme), np.random.default_rng(5), 0
    for h in (0.01, 0.05, 0.2) * 8:
        q0, v0 = [*random.uniform(-0.4, 0.4, 2), 1.2], random.uniform(-2, 2, 3)
        given = {"v0": v0, "h": h, "steps": 60, "events": events, "on_failure": "return"}
        run = stepper.integrate(q0, **given)
        hits += len(run.records)
        left = len(split)
        with monkeypatch.context() as patch:
            patch.setattr(event_run, "read_plain_restitution", lambda *asked: None)
            other = stepper.integrate(q0, **given)
        assert run.status is other.status
        assert [one.event for one in run.records] == [one.event for one in other.records]
        for one, two in zip(run.records[:10], other.records, strict=False):
            assert abs(one.t - two.t) < 1e-9
        del split[left:]
    assert hits > 10 * len(split)


def test_a_near_miss_leaves_the_steps_as_they_are(split):
    """A pendulum turns shortly before a wall, again and again."""
    stepper = ss.compile(ss.systems.pendulum())
    (angle,) = ss.systems.pendulum().coordinates
    given = {"v0": [0.0], "h": 0.1, "steps": 300, "reduce": {"e": ("mean", "energy")}}
    free = stepper.integrate([-0.5], **given)
    top = float(free.q.max())
    wall = ss.Event(top + 1e-3 - angle, name="wall", action=ss.Impact())
    run = stepper.integrate([-0.5], **given, events=[wall])
    assert not run.records
    assert not split
    assert np.array_equal(run.y, free.y)
    assert run.reduced == free.reduced
