"""Zeros that are rounded: at starts, at ends, where events act; what a run comes to at its end."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.impacts import BALL
from support.rods import rod_of

import symsimpson as ss

z, th, x, y = ss.coordinates("z th x y")
ROTOR = ss.MechanicalSystem("rotor", coordinates=(th,), kinetic=th.diff() ** 2 / 2, potential=0)
STAY = ss.Change(velocities={th: th.diff()})


def run_with(system, start, rate, *events, **how):
    return ss.compile(system).integrate([start], v0=[rate], events=[*events], **how)


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("action", sweep([STAY, None, ss.Switch()]))
@pytest.mark.parametrize(
    ("expression", "h", "end", "times"),
    [
        (sp.sin(sp.pi * ss.time), 0.05, 60.0, np.arange(1, 61)),
        (sp.sin(sp.pi * ss.time), 0.01, 100.0, np.arange(1, 101)),
        (sp.cos(2 * sp.pi * ss.time), 0.25, 20.1, np.arange(0.25, 20.1, 0.5)),
        (sp.sin(th), 0.05, 50.0, np.arange(1, 16) * np.pi - 0.1),
        (sp.sin(th) + sp.cos(th), 0.05, 40.0, np.arange(1, 14) * np.pi - np.pi / 4 - 0.1),
    ],
)
def test_a_zero_acts_once(action, expression, h, end, times):
    steps = round(end / h)
    event = ss.Event(expression, name="met", action=action)
    run = run_with(ROTOR, 0.1, 1.0, event, h=h, steps=steps)
    assert run.events("met").t == pytest.approx(times[times < end + 1e-9], abs=1e-11)


@pytest.mark.slow
@pytest.mark.plain
def test_a_kicked_rotor_is_the_standard_map():
    kick = ss.Change(velocities={th: th.diff() + sp.sin(th)})
    event = ss.Event(sp.sin(2 * sp.pi * ss.time), name="kick", direction=1, action=kick)
    run = run_with(ROTOR, 1.0, 0.3, event, h=0.05, t_end=29.6)
    q, v = 1.0, 0.3
    for _ in range(29):
        q += v
        v += np.sin(q)
    assert len(run.events("kick")) == 29
    assert run.q[-1, 0] == pytest.approx(q + 0.6 * v, abs=1e-4)  # it is chaotic
    assert run.q[200, 0] != pytest.approx(1.0 + 0.3 * 10, abs=0.1)


@pytest.mark.parametrize("t0", [1, 3, 10])
def test_a_zero_at_the_start_is_no_event(t0):
    kick = ss.Change(velocities={z: z.diff() + 3})
    event = ss.Event(sp.sin(sp.pi * ss.time), name="kick", action=kick)
    run = run_with(BALL, 1.0, 0.0, event, h=0.01, t0=t0, steps=50)
    assert len(run.events("kick")) == 0


@pytest.mark.parametrize(
    ("expression", "start"), [(sp.cos(th), np.pi / 2), (sp.sin(th), np.pi), (sp.tan(th), np.pi)]
)
@pytest.mark.parametrize("rate", [3.0, -3.0])
def test_a_run_that_begins_at_a_zero_ends_at_the_next_one(expression, start, rate):
    event = ss.Event(expression, name="end", terminal=True)
    run = run_with(ROTOR, start, rate, event, h=0.05, t_end=5)
    assert run.t[-1] == pytest.approx(np.pi / 3, abs=1e-13)


def test_a_gap_may_grow_as_it_likes():
    event = ss.Event(sp.exp(20 * z) - 1, name="floor", action=ss.Impact(0.8))
    run = run_with(BALL, 1.0, 0.0, event, h=0.01, t_end=2)
    first = np.sqrt(2 / 9.81)
    expected = first + 2 * 0.8 * first * np.array([0, 1, 1.8])
    assert run.events("floor").t == pytest.approx(expected, abs=1e-12)


def test_zeros_behind_a_pole_are_met():
    steps = {"h": np.sqrt(2 / 9.81) / 50, "steps": 220}
    floor = ss.Event(z, name="floor", action=ss.Impact(1))
    run = run_with(BALL, 1.0, 0.0, floor, ss.Event(1 / z - 2, name="half"), **steps)
    assert run.events("half").t == pytest.approx(run.events(1 / z - 2).t, abs=1e-9)
    assert len(run.events("half")) == 4


def test_a_start_just_behind_a_wall_is_told():
    event = ss.Event(z, name="floor", action=ss.Impact(0.8))
    with pytest.raises(ss.InputError, match="the initial state violates the gap 'floor'"):
        run_with(BALL, -0.9e-9, 1e-4, event, h=1e-7, steps=100)


def test_an_impact_does_not_depend_on_the_unit_of_its_gap():
    event = ss.Event(1e-12 * z, name="floor", action=ss.Impact(0.8))
    run = run_with(BALL, 1.0, 0.0, event, h=0.01, t_end=1)
    assert run.events("floor").t == pytest.approx([np.sqrt(2 / 9.81)], abs=1e-12)


def test_reductions_see_the_state_that_ends_a_run():
    event = ss.Event(z, name="floor", terminal=True)
    asked = {"low": ("min", "z"), "first": ("first", "0.003 - z"), "mean": ("mean", "z")}
    run = run_with(BALL, 0.1, 0.0, event, h=0.05, t_end=2, reduce=asked)
    assert run.reduced["low"] == run.q.min() == run.q[-1, 0]
    assert run.reduced["mean"] == pytest.approx(run.q.mean(), rel=1e-14)
    before, end = run.q[-2, 0], run.t[-1]
    share = (before - 0.003) / before
    assert run.reduced["first"] == pytest.approx(0.1 + (end - 0.1) * share, rel=1e-12)


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("both", [True, False])
def test_a_velocity_of_one_and_a_momentum_of_another_are_those_that_were_given(both):
    """With derivatives: those by differences of runs."""
    swing = ss.MechanicalSystem(
        "swing",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + sp.cos(x) * x.diff() * y.diff() + 2 * y.diff() ** 2) / 2,
        potential=x * y,
    )
    velocities = {x: 2 * y} if both else {x: 2 * y, y: x}
    change = ss.Change(velocities=velocities, momenta={y: 5 * x} if both else {})
    event = ss.Event(x - sp.Rational(1, 5), name="at", action=change)
    stepper = ss.compile(swing)

    def run(start, **more):
        return stepper.integrate(start, p0=[1.2, 1.0], h=0.1, steps=10, events=[event], **more)

    found = run([0.0, 1.0], tangents=2)
    after, q = found.events("at").after, found.events("at").q[0]
    assert after.v[0, 0] == pytest.approx(2 * q[1], rel=1e-12)
    if both:
        assert after.p[0, 1] == pytest.approx(5 * q[0], rel=1e-12)
    d = 1e-5
    moved = (run([d, 1.0]).q[-1] - run([-d, 1.0]).q[-1]) / (2 * d)
    assert found.tangent[-1, :2, 0] == pytest.approx(moved, abs=1e-7)


def test_a_change_without_a_value_is_named():
    event = ss.Event(z - 0.5, name="bad", action=ss.Change(velocities={z: 1 / (z - 0.5)}))
    told = r"The change of 'bad' is not finite at t=0\.319"
    with pytest.raises(ss.ConvergenceError, match=told) as raised:
        run_with(BALL, 1.0, 0.0, event, h=0.01, t_end=2)
    assert "iterations" not in str(raised.value)  # none was asked for


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (ss.Event("Hmax - z", name="top"), "the expression of the event 'top'"),
        (ss.Event("z", name="low", when="Hmax - z"), "the condition of the event 'low'"),
        (
            ss.Event("z", name="low", action=ss.Change(velocities={z: "Hmax"})),
            "the change of the event 'low'",
        ),
    ],
)
def test_what_of_which_event_makes_no_sense_is_told(event, message):
    with pytest.raises(ss.InputError, match=message):
        run_with(BALL, 1.0, 0.0, ss.Event(z - 5, name="other"), event, h=0.01, steps=5)


def test_names_of_events_are_proposed():
    floor = ss.Event(z, name="floor", action=ss.Impact())
    run = run_with(BALL, 1.0, 0.0, floor, h=0.01, steps=50)
    with pytest.raises(ss.InputError, match="Did you mean floor"):
        run.events("flor")


def test_changes_of_velocities_may_name_these():
    change = ss.Change(velocities={z.diff(): -z.diff()})
    run = run_with(BALL, 1.0, 0.0, ss.Event(z, name="floor", action=change), h=0.01, steps=50)
    assert run.events("floor").after.v[0, 0] == pytest.approx(np.sqrt(2 * 9.81), rel=1e-12)


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("unit", [1.0, 1e-9])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda unit: {"positions": {x: 2 * x}}, "its position violates .* 'rod'"),
        (lambda unit: {"velocities": {y: y.diff() + unit}}, "its velocity violates .*'rod'"),
    ],
)
def test_changes_that_constraints_do_not_allow_are_told(unit, change, message):
    event = ss.Event(y + unit / 2, name="low", action=ss.Change(**change(unit)))
    with pytest.raises(ss.ConvergenceError, match=message):
        ss.compile(rod_of(unit)).integrate(
            [unit, 0.0], v0=[0.0, 0.0], h=0.02, steps=60, events=[event]
        )


@pytest.mark.parametrize(
    ("rate", "action"), [(1.0, None), (1.0, ss.Impact(0)), (1.0, ss.Impact(0.5))]
)
def test_a_gap_may_start_at_zero_up_to_round_off(rate, action):
    event = ss.Event(z, name="floor", action=action, terminal=True)
    for start in (-1e-17, -1e-22, 0.0, 1e-22):
        run = run_with(BALL, start, rate, event, h=1e-3, t_end=1)
        assert run.ended_by == "floor"
        assert run.t[-1] == pytest.approx(2 * rate / 9.81, rel=1e-12)
