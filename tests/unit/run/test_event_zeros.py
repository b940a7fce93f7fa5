"""Zeros at states of the grid, changes that accumulate, and forces with a kink at an event."""

import re

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.stepping.run_events import read_events

x, z = ss.coordinates("x z")
ROTOR = ss.MechanicalSystem("rotor", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0 * x)
BALL = ss.MechanicalSystem("ball", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=z)
SINE, CUBE = sp.sin(sp.pi * ss.time), (ss.time - 3) ** 3


def ways(expression, direction, **how):
    """Yield times of zeros and their directions, as each call that looks for them gives them."""
    stepper, given = ss.compile(ROTOR), {"v0": [0.2], **how}
    for action in (None, ss.Switch(), ss.Change(velocities={x: x.diff() + 1})):
        event = ss.Event(expression, name="met", direction=direction, action=action)
        yield stepper.integrate([0.3], **given, events=[event]).events("met")
    yield stepper.integrate([0.3], **given).events(expression, direction=direction)
    yield stepper.poincare(expression, [0.3], **given, direction=direction)


def check(expression, h, t_end, right, t0=0.0, directions=(0, 1, -1)):
    right = np.array(right, dtype=float)
    values = sp.lambdify(ss.time, expression)
    signs = np.sign([values(t + 1e-3 * h) - values(t - 1e-3 * h) for t in right])
    for direction in directions:
        wanted = signs == direction if direction else np.full(len(right), True)
        for found in ways(expression, direction, h=h, t_end=t_end, t0=t0):
            assert found.t == pytest.approx(right[wanted], abs=1e-9)
            assert (found.direction == signs[wanted]).all()


@pytest.mark.slow
@pytest.mark.plain
def test_a_zero_at_both_ends_of_each_step_is_found_once():
    check(SINE, 1.0, 2.0, [1, 2], directions=(0,))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("expression", "h", "t_end", "right", "t0"),
    [
        (SINE, 0.5, 12, range(1, 13), 0.0),
        (SINE, 2.0, 12, range(1, 13), 0.0),
        (SINE, -1.0, -12, range(-1, -13, -1), 0.0),
        (sp.sin(2 * sp.pi * ss.time), 1.0, 6, np.arange(1, 13) / 2, 0.0),
        (1e-27 * SINE, 1.0, 12, range(1, 13), 0.0),
        (1e24 * SINE, 1.0, 12, range(1, 13), 0.0),
        (sp.exp(SINE) - 1, 1.0, 12, range(1, 13), 0.0),
        (SINE**3, 1.0, 12, range(1, 13), 0.0),
        (SINE**2, 1.0, 12, [], 0.0),
        (SINE, 1.0, 1e5 + 9, np.arange(1e5 + 1, 1e5 + 10), 1e5),
        ((ss.time - 3) * (ss.time - 4), 1.0, 7, [3, 4], 0.0),
        (CUBE, 1.0, 7, [3], 0.0),
        (CUBE / (ss.time - 3), 1.0, 7, [], 0.0),
        (sp.sin(x) ** 2 + sp.cos(x) ** 2 - 1, 0.5, 9, [], 0.0),
    ],
)
def test_zeros_at_states(expression, h, t_end, right, t0):
    check(expression, h, t_end, right, t0)


@pytest.mark.slow
def test_members_count_zeros_at_states():
    kick = ss.Event(SINE, name="kick", action=ss.Change(velocities={x: x.diff() + sp.sin(x) / 2}))
    given = {"h": 1.0, "t_end": 20.0, "events": [kick], "reduce": {"kicks": ("count", "kick")}}
    many = ss.compile(ROTOR).ensemble([[0.3], [0.4]], v0=[0.2], **given)
    for member, a in enumerate((0.3, 0.4)):
        q, v = a, 0.2
        for _ in range(20):
            q += v
            v += 0.5 * np.sin(q)
        assert many.q[member, 0] == pytest.approx(q, abs=1e-9)
    assert many.reduced["kicks"].tolist() == [20, 20]


def test_a_section_of_a_rotor_is_found_at_its_states():
    run = ss.compile(ROTOR).integrate([0.0], v0=[np.pi], h=1.0, steps=4)
    assert run.events(sp.sin(x)).t == pytest.approx([1, 2, 3, 4], abs=1e-12)
    assert run.events(sp.sin(x), direction=-1).t == pytest.approx([1, 3], abs=1e-12)


def bounce(floor, e, *, scheme="simpson", h=0.5, height=1.0, **how):
    change = ss.Change(velocities={z: -e * z.diff()})
    event = ss.Event(z - floor, name="floor", direction=-1, action=change)
    stepper, far = ss.compile(BALL, scheme), np.sign(h) * 60
    return stepper.integrate(
        [floor + height], v0=[0.0], h=h, t_end=far, events=[event], on_failure="return", **how
    )


def test_a_change_that_accumulates_ends_the_run():
    run = bounce(0, 0.1, height=0.125)
    assert run.status is ss.Status.EVENTS_ACCUMULATE
    assert run.events("floor").t[-1] == pytest.approx(0.5 * 1.1 / 0.9, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("e", [0.5, 0.9])
@pytest.mark.parametrize(
    ("floor", "how"),
    [
        (0, {"h": 1.0}),
        (0, {"h": -0.05}),
        (1, {"h": 0.05, "scheme": "gauss4"}),
        (-3.7, {"h": 0.05, "scheme": "lobatto6"}),
        (1e6, {"h": 0.05}),
        (0, {"h": 0.05, "height": 1e-27}),
    ],
)
def test_changes_accumulate_at_any_floor(floor, how, e):
    run, height = bounce(floor, e, **how), how.get("height", 1.0)
    assert run.status is ss.Status.EVENTS_ACCUMULATE
    assert run.q.min() >= floor
    limit = np.sqrt(2 * height) * (1 + e) / (1 - e)
    least = 1.0 if floor == 1e6 else 0.02  # of lower bounces nothing is seen
    assert abs(run.events("floor").t[-1]) == pytest.approx(limit, abs=least * abs(how["h"]))


@pytest.mark.slow
def test_tangents_and_loops_hear_of_changes_that_accumulate():
    assert bounce(0, 0.1, height=0.125, tangents=2).status is ss.Status.EVENTS_ACCUMULATE
    change = ss.Change(velocities={z: -z.diff() / 2})
    event = ss.Event(z, name="floor", direction=-1, action=change)
    loop = ss.compile(BALL).start([1.0], v0=[0.0], h=0.05, events=[event])
    for _ in range(84):
        loop.step()
    with pytest.raises(ss.ConvergenceError, match="acts ever faster up to t=4"):
        loop.step()
    counted = ss.Event(z, name="floor", direction=-1, action=change, terminal=5)
    ended = ss.compile(BALL).integrate([1.0], v0=[0.0], h=0.05, t_end=9, events=[counted])
    assert (ended.ended_by, len(ended.events("floor"))) == ("floor", 5)


def kinked(place):
    """Return a ball on springs: k = 1 below a place, 4 above it."""
    d = z - place
    V = d**2 / 2 + 3 * ((d + sp.sqrt(d**2)) / 2) ** 2 / 2
    return ss.MechanicalSystem("kinked", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=V)


def test_the_next_part_begins_behind_a_kink():
    kink = ss.Event(z - 1, name="kink", action=ss.Switch())
    run = ss.compile(kinked(1)).integrate([0.0], v0=[0.7], h=0.1, steps=12, events=[kink])
    (t,) = run.events("kink").t
    assert t == pytest.approx(np.arctan2(1, 0.7), abs=1e-5)
    (before,), (behind,) = run.events("kink").q[:, 0] - 1, run.events("kink").q_after[:, 0] - 1
    assert -1e-14 < before < 0 < behind < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("action", [None, ss.Switch()])
@pytest.mark.parametrize("scheme", ["lobatto2", "midpoint", "simpson", "lobatto6", "radau5"])
@pytest.mark.parametrize("place", [0, 1, 1e6])
def test_kinks_keep_the_order(place, scheme, action):
    t = 3.36
    swung = np.arctan2(1, 0.7)  # then half a turn above, with the rate 2
    rate = np.hypot(1, 0.7)
    right = -rate * np.sin(t - swung - np.pi / 2)
    stepper = ss.compile(kinked(place), scheme)
    kink = ss.Event(z - place, name="kink", action=action)
    errors = []
    for h in (0.08, 0.04, 0.02):
        run = stepper.integrate([place - 1.0], v0=[0.7], h=h, t_end=t, events=[kink])
        assert len(run.events("kink")) == 2
        errors.append(abs(run.q[-1, 0] - place - right))
    order = stepper.order
    noise = 1e-13 + 1e-15 * place
    assert errors[2] <= 1.3 * errors[0] * 4.0**-order + noise


@pytest.mark.parametrize("scheme", ["simpson", "gauss4"])
def test_a_state_of_the_grid_may_be_on_a_kink(scheme):
    d = z - 1
    V = ((d + sp.sqrt(d**2)) / 2) ** 2 / 2
    spring = ss.MechanicalSystem("spring", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=V)
    kink = ss.Event(d, name="kink", action=ss.Switch())
    run = ss.compile(spring, scheme).integrate([0.0], v0=[1.0], h=0.25, steps=18, events=[kink])
    assert run.events("kink").t == pytest.approx([1, 1 + np.pi], abs=1e-4)


@pytest.mark.slow
def test_a_switch_goes_with_tangents_members_and_runs_backwards():
    kink = ss.Event(z - 1, name="kink", action=ss.Switch())
    stepper, given = ss.compile(kinked(1), "lobatto6"), {"h": 0.06, "steps": 56, "events": [kink]}
    run = stepper.integrate([0.0], v0=[0.7], tangents=2, **given)
    ends = [
        stepper.integrate([1e-6 * a], v0=[0.7 + 1e-6 * b], **given).y[:, -1]
        for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    slopes = np.stack([(ends[0] - ends[1]) / 2e-6, (ends[2] - ends[3]) / 2e-6], axis=1)
    assert run.tangent[-1] == pytest.approx(slopes, abs=1e-8)
    many = stepper.ensemble([[0.0], [0.1]], v0=[0.7], **given, reduce={"n": ("count", "kink")})
    assert (many.q[0] == run.q[-1]).all()
    assert many.reduced["n"].tolist() == [2, 2]
    back = {**given, "h": -0.06, "t0": 3.36}
    start = stepper.integrate(run.q[-1], p0=run.p[-1], **back)
    assert start.y[:, -1] == pytest.approx([0.0, 0.7], abs=1e-13)


@pytest.mark.parametrize(("values", "rows"), [(False, {0, 1}), (True, {0, 1, 2})])
def test_a_step_writes_the_side_and_size_of_an_expression_alone(values, rows):
    """Only gaps and ensembles need values of the steps before."""
    program = ss.compile(ROTOR).integrate([0.3], v0=[0.2], h=0.1, steps=1).program
    events = read_events(program, [ss.Event(SINE, name="zero")])
    *_, watch = events.watchers(program.header, 1000, values=values)
    assert {int(row) - 1000 for row in re.findall(r"W\[(1\d\d\d), lane\]", watch.text)} == rows
