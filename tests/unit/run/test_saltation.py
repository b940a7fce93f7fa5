"""Derivatives of runs in which events act, against differences of such runs."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.impacts import BALL, floor, g, k, x, y, z
from support.rods import ROD

import symsimpson as ss

c = sp.Symbol("c", positive=True)
#: A mass matrix that moves, a spring that hardens, and friction.
PLANE = ss.MechanicalSystem(
    "plane",
    coordinates=(x, y),
    kinetic=(x.diff() ** 2 + (1 + x**2 / 3) * y.diff() ** 2) / 2,
    potential=k * (x**2 + x**4 / 2 + 2 * y**2) / 2 - x * y / 3,
    dissipation=c * x.diff() ** 2 / 2,
    parameters={k: 1.5, c: 0.1},
)
DRIVEN = ss.MechanicalSystem(
    "driven",
    coordinates=(z,),
    kinetic=z.diff() ** 2 / 2,
    potential=g * z - z * sp.sin(3 * ss.time),
    parameters={g: 9.81},
)
WALL = ss.Event(x + sp.Rational(1, 4), name="wall", action=ss.Impact(0.8))


def differences(end, at, size=1e-3):
    """Differentiate by differences of order 8."""
    weights = [4 / 5, -1 / 5, 4 / 105, -1 / 280]
    columns = []
    for j in range(len(at)):
        way = np.eye(len(at))[j] * size
        pairs = enumerate(weights, start=1)
        columns.append(sum(w * (end(at + i * way) - end(at - i * way)) for i, w in pairs) / size)
    return np.array(columns).T


def compare(system, events, q0, p0, *, scheme="simpson", by=None, near=1e-9, **given):
    """Compare variations at the end with differences; return the run."""
    stepper, n = ss.compile(system, scheme), len(q0)
    given = {"h": 0.06, "steps": 40, "events": events} | given
    run = stepper.integrate(q0, p0=p0, tangents=2 * n, sensitivities=by, **given)

    def end(state):
        more = {"parameters": {by: state[2 * n]}} if by else {}
        found = stepper.integrate(state[:n], p0=state[n : 2 * n], **given, **more)
        assert len(found.records) == len(run.records)
        return np.concatenate([found.q[-1], found.p[-1]])

    at = np.concatenate([q0, p0, [system.parameters[sp.Symbol(by, positive=True)]] if by else []])
    right = differences(end, at)
    found = run.tangent[-1]
    if by:
        found = np.column_stack([found, run.sensitivity[by][-1]])
    assert np.abs(found - right).max() < near * np.abs(right).max()
    return run


@pytest.mark.parametrize("scheme", sweep(["midpoint", "lobatto6"]))
def test_impacts_with_a_mass_matrix_and_friction(scheme):
    run = compare(PLANE, [WALL], [0.5, 0.2], [0.1, 0.6], scheme=scheme, by="k")
    assert len(run.records) == 1
    # before it, and of steps without events, it is what it was
    plain = ss.compile(PLANE, scheme).integrate(
        [0.5, 0.2], p0=[0.1, 0.6], h=0.06, steps=5, tangents=4
    )
    assert np.abs(run.tangent[:6] - plain.tangent).max() < 1e-14


@pytest.mark.slow
def test_changes_conditions_and_splits():
    swap = ss.Event(
        y - x,
        name="swap",
        direction=1,
        when=x.diff() + 10,
        action=ss.Change(positions={x: y}, velocities={y: y.diff() - x / 5}),
    )
    push = ss.Event("energy - 1", name="push", action=ss.Change(momenta={y: "p_y * 1.1 + q"}))
    push = ss.Event(x * y, name="push", action=ss.Change(momenta={x: x.diff() * 1.2}))
    kink = ss.Event(x.diff(), name="kink", action=ss.Switch())
    run = compare(PLANE, [swap, kink], [0.5, 0.2], [0.1, 0.6], h=0.05)  # off the grid of times
    assert {len(run.events("swap")), len(run.events("kink"))} == {1}
    assert len(compare(PLANE, [push], [0.5, 0.2], [0.1, 0.6]).records) == 2


@pytest.mark.parametrize("timed", [False, True])
def test_parameters_may_be_called_as_a_step_is(timed):
    stiff, drive = sp.symbols("h t1", positive=True)
    lift = sp.sin(3 * ss.time) if timed else 1
    system = ss.MechanicalSystem(
        "named",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=stiff * x**2 / 2 + drive * y**2 / 2 + x * y / 3 + y * lift / 5,
        parameters={stiff: 1.5, drive: 0.7},
    )
    run = compare(system, [WALL], [0.5, 0.2], [0.1, 0.6], by="h", near=1e-8)
    assert len(run.records) == 1


def test_steps_are_not_differentiated_through_events():
    for by in ("h", "t"):
        with pytest.raises(ss.InputError, match=f"with events cannot be differentiated by {by}"):
            ss.compile(BALL).integrate(
                [1.0], v0=[0.0], h=0.06, steps=20, events=[floor()], sensitivities=by
            )
        with pytest.raises(ss.InputError, match=f"with events cannot be differentiated by {by}"):
            ss.compile(BALL).ensemble(
                [[1.0]], v0=[0.0], h=0.06, steps=20, events=[floor()], sensitivities=by
            )


@pytest.mark.parametrize("name", sweep([r"\epsilon", "lambda", "e'", "approach", "max"], 2))
def test_restitutions_of_parameters_of_any_name(name):
    e = sp.Symbol(name, positive=True)
    ball = ss.MechanicalSystem(
        "ball", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=9.81 * z, parameters={e: 0.8}
    )
    wall = ss.Event(z, name="floor", action=ss.Impact(e * (1 - ss.approach / 100)))
    stepper = ss.compile(ball)

    def end(value):
        return stepper.integrate(
            [1.0], v0=[0.0], h=0.05, steps=12, events=[wall], parameters={name: value}
        ).q[-1, 0]

    given = {"h": 0.05, "steps": 12, "events": [wall], "sensitivities": name}
    run = stepper.integrate([1.0], v0=[0.0], **given)
    speed = -run.events("floor").v[0, 0]
    assert run.events("floor").after.v[0, 0] == pytest.approx(0.8 * (1 - speed / 100) * speed)
    slope = (end(0.8 + 1e-4) - end(0.8 - 1e-4)) / 2e-4
    assert run.sensitivity[name][-1, 0] == pytest.approx(slope, rel=1e-6)


def test_a_wall_that_moves_and_a_system_that_depends_on_time():
    speed = 0.9 - ss.approach / 50
    table = ss.Event(z - sp.sin(7 * ss.time) / 20, name="table", action=ss.Impact(speed))
    run = compare(DRIVEN, [table], [0.5], [0.3], by="g", steps=10, near=1e-8)
    assert len(run.records) == 1


@pytest.mark.slow
def test_impacts_of_what_constraints_hold():
    """Along variations that these allow."""
    wall = ss.Event(x + sp.Rational(1, 2), name="wall", action=ss.Impact(0.7))
    stepper = ss.compile(ROD)

    def start(angle, rate):
        q = np.array([np.sin(angle), -np.cos(angle)])
        return q, rate * np.array([-q[1], q[0]])

    given = {"h": 0.02, "steps": 60, "events": [wall]}

    def end(at):
        q, v = start(*at)
        found = stepper.integrate(q, v0=v, **given)
        return np.concatenate([found.q[-1], found.p[-1]])

    at = np.array([0.9, -1.0])  # far from a time of the grid, where the run has a kink
    ways = differences(lambda at: np.concatenate(start(*at)), at)
    q, v = start(*at)
    run = stepper.integrate(q, p0=v, tangents=ways, **given)
    assert len(run.records) == 1
    right = differences(end, at, size=1e-3)
    assert np.abs(run.tangent[-1] - right).max() < 1e-8 * np.abs(right).max()


@pytest.mark.slow
def test_the_end_at_an_event_moves_with_its_time():
    """As the derivative of a map from one section to the next must have it."""
    last = ss.Event(z, name="down", terminal=True)
    run = compare(BALL, [last], [1.0], [0.2], by="g")
    assert len(run) == len(run.tangent)
    assert run.t[-1] < 0.5
    assert np.abs(run.tangent[-1][0]).max() < 1e-14  # it is at z = 0, wherever it began
    for every in (None, 4):
        other = ss.compile(BALL).integrate(
            [1.0], p0=[0.2], h=0.05, steps=40, events=[last], tangents=2, every=every
        )
        assert np.abs(other.tangent[-1] - run.tangent[-1]).max() < 1e-14


def test_a_start_on_a_wall():
    floor = ss.Event(z, name="floor", action=ss.Impact(0.5))
    run = ss.compile(BALL).integrate(
        [0.0], p0=[-1.0], h=0.01, steps=3, events=[floor], tangents=[[0.0], [1.0]]
    )
    assert run.tangent[0, 1, 0] == -0.5


def test_what_is_refused_and_what_is_warned_of():
    floor = ss.Event(z, name="floor", action=ss.Impact(1.0))
    stepper, given = ss.compile(BALL), {"h": 0.05, "steps": 60, "tangents": 2}
    top = 1 - 1e-12  # of the way up, which it reaches with a speed of 4e-6
    up = np.sqrt(2 * 9.81)
    roof = ss.Event(top - z, name="roof", action=ss.Impact())
    with pytest.warns(ss.ResolutionWarning, match="grazes 'roof' at t="):
        stepper.integrate([0.0], v0=[up], events=[roof], **given)
    u = sp.Symbol("u", real=True)
    pushed = ss.MechanicalSystem(
        "pushed",
        coordinates=(z,),
        kinetic=z.diff() ** 2 / 2,
        potential=g * z,
        forces={z: u},
        inputs=(u,),
        parameters={g: 9.81},
    )
    driven = ss.compile(pushed)
    ramps = {"u": np.linspace(0, 1, 180).reshape(60, 3)}
    with pytest.raises(ss.InputError, match="inputs that are constant over each step"):
        driven.integrate([1.0], v0=[0.0], events=[floor], inputs=ramps, **given)
    with pytest.raises(ss.InputError, match="inputs that are constant over each step"):
        driven.ensemble([[1.0], [2.0]], v0=[0.0], events=[floor], inputs=ramps, **given)
    held = {"u": np.linspace(0, 1, 60)}
    run = driven.integrate([1.0], v0=[0.0], events=[floor], inputs=held, sensitivities="u", **given)
    assert np.isfinite(run.sensitivity["u"]).all()


@pytest.mark.slow
def test_two_events_at_one_time_each_have_their_own():
    """Two balls that know nothing of each other, and one in a corner; in any order."""
    two = ss.MechanicalSystem(
        "two",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9 * (x + y),
    )
    floors = [ss.Event(a, name=str(a), action=ss.Impact(0.8)) for a in (x, y)]
    one = ss.compile(
        ss.MechanicalSystem("one", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=9 * x)
    ).integrate([1.0], p0=[0.0], h=0.01, steps=100, events=floors[:1], tangents=2)
    for events in (floors, floors[::-1]):
        run = ss.compile(two).integrate(
            [1.0, 1.0], p0=[0.0, 0.0], h=0.01, steps=100, events=events, tangents=4
        )
        right = np.kron(one.tangent[-1], np.eye(2))
        assert np.abs(run.tangent[-1] - right).max() < 1e-9


@pytest.mark.slow
def test_an_event_on_a_time_of_the_grid_moves_all_the_same():
    """Steps of free motion are exact: there is no kink."""
    free = ss.compile(
        ss.MechanicalSystem("free", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0)
    )
    wall = ss.Event(x, name="wall", action=ss.Impact())
    given = {"p0": [-1.0], "h": 0.125, "tangents": 2}
    run = free.integrate([0.5], steps=8, events=[wall], **given)
    assert np.abs(run.tangent[-1] - [[-1, -1], [0, -1]]).max() < 1e-9
    last = free.integrate([0.5], steps=4, events=[wall], **given)
    assert np.abs(last.tangent[-1] - [[-1, -0.5], [0, -1]]).max() < 1e-9
    end = free.integrate([0.5], steps=8, events=[ss.Event(x, name="e", terminal=True)], **given)
    assert np.abs(end.tangent[-1] - [[0, 0], [0, 1]]).max() < 1e-9
    begun = ss.compile(BALL).integrate(
        [0.0], p0=[-1.0], h=0.05, steps=1, tangents=2, events=[ss.Event(z, action=ss.Impact(0.8))]
    )
    right = [[-0.8 + 1.8 * 9.81 * 0.05, -0.8 * 0.05], [1.8 * 9.81, -0.8]]
    assert np.abs(begun.tangent[-1] - right).max() < 1e-7


def test_an_impact_behind_a_wall_comes_when_the_change_that_led_there_does():
    """It was given the time at which its gap would have been zero, and derivatives were others."""
    pushed = ss.Change(positions={x: x - 0.07})
    events = [WALL, ss.Event(x + y / 9 + 0.2, name="push", direction=-1, action=pushed)]
    run = compare(PLANE, events, [0.5, 0.2], [0.1, 0.6], h=0.07, steps=30)
    first, second = run.records[:2]
    assert first.t == second.t
    assert run.events("wall").q[0, 0] < -0.253
