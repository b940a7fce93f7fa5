"""Conditions at the ends that follow from one another, or touch constraints."""

import dataclasses

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

pytest.importorskip("casadi")

x, y = ss.coordinates("x y")
u, w = sp.symbols("u w", real=True)
l = sp.Symbol("l", positive=True)
v_x, v_y = x.diff(), y.diff()
#: A bob that is pushed along its circle, and a body that is pushed along both axes.
ROD = ss.MechanicalSystem(
    "rod",
    coordinates=(x, y),
    kinetic=(v_x**2 + v_y**2) / 2,
    potential=9.81 * y,
    forces={x: -u * y / l, y: u * x / l},
    inputs=(u,),
    constraints={"circle": x**2 + y**2 - l**2},
    parameters={l: 1.0},
)
FLAT = ss.MechanicalSystem(
    "flat",
    coordinates=(x, y),
    kinetic=(v_x**2 + v_y**2) / 2,
    potential=0,
    forces={x: u, y: w},
    inputs=(u, w),
)
WAY = {x: sp.sin(sp.pi * ss.time / 2), y: -sp.cos(sp.pi * ss.time / 2)}


def lifted(start, end=None, **more):
    given = {"cost": u**2, "duration": 1, "start": start, "end": end or {x: 1, y: 0, v_y: 0}}
    return ss.OptimalControl(ROD, **{**given, **more})


def rows_of_the_circle(found):
    names = found.layout.names
    return [
        names.count(f"constraint 'circle'{end}") for end in ("", " at the start", " at the end")
    ]


@pytest.mark.parametrize(
    "start", [{x: 0, y: -l, v_x: 0}, {x: 0, y + l: 0, v_x: 0}, {x: 0, y: -l, v_x: 0, v_y: 0}]
)
def test_a_length_that_is_found_stands_in_what_follows(start):
    """With dependent rows the search ended at lengths from 0.67 to 0.93, at costs up to 37."""
    more = {"unknowns": {l: (0.5, 2)}, "final_cost": 10 * (l - sp.Rational(6, 5)) ** 2}
    more |= {"end": {y: 0, v_y: 0}, "bounds": {y: (-3, 3)}}
    found = lifted(start, **more).solve("lobatto6", steps=10, guess={**WAY, "l": 1.0})
    assert found.status is ss.ControlStatus.SOLVED
    assert found.unknowns["l"] == pytest.approx(0.5, abs=1e-9)
    assert found.cost == pytest.approx(28.597, abs=1e-3)
    assert rows_of_the_circle(found)[1] == 1 - (v_y in start)
    assert np.abs(found.q[0] - [0, -0.5]).max() < 1e-9


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (
            {"end": {x: 1, v_y: 0}},
            r"end is tangent to the constraint 'circle'.*\nAdd y = 0 to the end",
        ),
        (
            {"end": {x - y: sp.sqrt(2)}},
            r"end is tangent to .*\nAdd x = 0.707, y = -0.707 to the end",
        ),
        (
            {"end": {y: -l}, "unknowns": {l: (0.5, 2)}},
            r"end is tangent to .*\nAdd x = 0 to the end",
        ),
        (
            {"conditions": {y: y - 1}, "start": {y: 0}, "end": {v_x: 0}},
            r"\nAdd x = 0, y = -1 to the end",
        ),
    ],
)
def test_ends_that_touch_a_constraint_are_refused(more, told):
    problem = lifted(**{"start": {x: 0, v_x: 0}, "end": {v_y: 0}, **more})
    with pytest.raises(ss.InputError, match=told):
        problem.solve("gauss4", steps=4, guess=WAY)
    near = lifted({x: 0, v_x: 0}, {x: 0.99, v_y: 0})
    assert near.solve("gauss4", steps=10, guess=WAY).success


def test_states_that_are_given_but_for_one_number():
    """Constraints of positions and of rates follow from one another there, on a branch."""
    s, c = np.sin(1.0), np.cos(1.0)
    ends = [
        ({x: 0, v_x: 0}, {x: s, v_x: c / 2, v_y: s / 2}),
        ({x: 0, v_x: 0}, {x: s, y: -c, v_x: c / 2}),
    ]
    costs = [
        lifted(*both).solve("gauss4", steps=6, guess={x: sp.sin(ss.time), y: -sp.cos(ss.time)})
        for both in ends
    ]
    assert all(found.status is ss.ControlStatus.SOLVED for found in costs)
    assert costs[0].cost == pytest.approx(costs[1].cost, rel=1e-9)


def test_what_is_tied_is_held_at_one_end():
    again = {x - y: x - y, x + y: x + y, v_x - v_y: v_x - v_y, v_x + v_y: v_x + v_y}
    found = lifted({x: (0.2, 0.6)}, {x: (0.2, 0.6)}, cost=(u - 1) ** 2, conditions=again).solve(
        "simpson", steps=10, guess={x: 0.4, y: -0.9}
    )
    assert found.success
    assert rows_of_the_circle(found) == [19, 2, 0]
    fixed = {"end": {x: 0, y: -1, v_x: 0}, "conditions": {x: x, y: y, v_x: v_x}}
    still = lifted({x: 0, y: -1, v_x: 0}, **fixed).solve("simpson", steps=4)
    assert still.success
    assert not [name for name in still.layout.names if "both" in name]


@pytest.mark.parametrize("again", [{x: x}, {y: y}, {x: -x}, {v_y: v_y}])
def test_where_a_part_of_the_state_is_tied_constraints_hold_all_the_same(again):
    """Once they were left out: ends off the circle, with another rate than the one asked for."""
    end = {v_x: 1}
    found = lifted({x: 0.6, y: -0.8, v_x: 0.2}, end, conditions=again).solve("gauss4", steps=6)
    assert found.status is ss.ControlStatus.SOLVED
    q, v = found.q[-1], found.trajectory.v[-1]
    assert q @ q == pytest.approx(1, abs=1e-12)
    assert (v[0], q @ v) == pytest.approx((1, 0), abs=1e-9)
    ((at_end, of_start),) = again.items()
    state = {x: q[0], y: q[1], v_y: v[1]}, {x: 0.6, y: -0.8, v_y: 0.15}
    assert state[0][at_end] == pytest.approx(float(of_start.subs(state[1])), abs=1e-9)


@pytest.mark.parametrize("tied", [x, y])
def test_where_a_place_is_tied_a_blade_holds_all_the_same(tied):
    (th,) = ss.coordinates("th")
    sleigh = ss.MechanicalSystem(
        "sleigh",
        coordinates=(x, y, th),
        kinetic=(v_x**2 + v_y**2 + th.diff() ** 2) / 2,
        potential=0,
        forces={x: u * sp.cos(th), y: u * sp.sin(th), th: w},
        inputs=(u, w),
        velocity_constraints={"blade": sp.cos(th) * v_y - sp.sin(th) * v_x},
    )
    start = dict.fromkeys((x, y, th, v_x, th.diff()), 0)
    given = {"start": start, "end": {v_x: 1, th: 0.1}, "duration": 2, "conditions": {tied: tied}}
    found = ss.OptimalControl(sleigh, cost=u**2 + w**2, **given).solve("gauss4", steps=6)
    assert found.status is ss.ControlStatus.SOLVED
    assert found.trajectory.v[-1, :2] == pytest.approx([1, np.tan(0.1)], abs=1e-9)


@pytest.mark.parametrize(
    "end",
    [
        {x: 1, y: 0.5, x**2 + y**2: 1.25},
        {x * y: 0.5, x: 1, y: 0.5, v_x: (None, None)},
        {x + y: 1.5, 2 * x: 2, x: 1, y: 0.5},
    ],
)
def test_conditions_that_follow_from_others_are_left_out(end):
    given = {"cost": u**2 + w**2, "duration": 1, "start": {x: 0, y: 1, v_x: 0, v_y: 0}}
    problem = ss.OptimalControl(FLAT, **given, end=end)
    found = problem.solve("simpson", steps=5)
    assert found.status is ss.ControlStatus.SOLVED
    assert found.cost == pytest.approx(3.75, abs=1e-8)  # 3 (1 + 1/4)
    wrong = dataclasses.replace(problem, end={x: 1, y: 0.5, x + y: 1.6})
    assert not wrong.solve("simpson", steps=5).success


@pytest.mark.parametrize("steps", [10, 20])
def test_a_bound_that_says_what_an_end_says_does_no_harm(steps):
    """Multipliers of the three rows are rounding, and add up to that of one."""
    problem = lifted({x: 0, y: -1, v_x: 0, v_y: 0}, path=[x - 1, y])
    found = problem.solve("simpson", steps=steps, guess=WAY)
    assert found.status is ss.ControlStatus.SOLVED
    plain = dataclasses.replace(problem, path=()).solve("simpson", steps=steps, guess=WAY)
    assert found.cost == pytest.approx(plain.cost, rel=1e-8)


@pytest.mark.parametrize("scheme", ["lobatto6", "gauss4", "simpson"])
@pytest.mark.parametrize(
    ("more", "cost"),
    [
        ({"bounds": {x: (0, 1), y: (0, 1), v_x: (0, None), v_y: (0, None)}}, 24),
        ({"path": [x**2 + y**2 - 2, -x * y]}, 24),
        ({"path": [(0, x**2 - y**2, 0)]}, 24),
    ],
)
def test_ends_at_bounds(scheme, more, cost):
    """Rows of bounds that say what ends say have no room beside them: they are left out."""
    rest = {v_x: 0, v_y: 0}
    ends = {"start": {x: 0, y: 0, **rest}, "end": {x: 1, y: 1, **rest}}
    problem = ss.OptimalControl(FLAT, cost=u**2 + w**2, duration=1, **ends, **more)
    found = problem.solve(scheme, steps=10)
    assert found.status is ss.ControlStatus.SOLVED
    assert found.cost == pytest.approx(cost, rel=1e-8)
