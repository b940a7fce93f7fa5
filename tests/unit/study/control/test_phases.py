"""Phases of optimal control: arcs at bounds, whose durations are found one by one."""

import dataclasses

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from support.cases import sweep
from support.control import check_derivatives

import symsimpson as ss
from symsimpson.study.control.problem_parts import Grid
from symsimpson.study.control.uses import label_bounds

pytest.importorskip("casadi")

th, x, y = ss.coordinates("theta x y")
u, w = sp.symbols("u w", real=True)
#: A pendulum with friction, too weak to be held anywhere.
PENDULUM = ss.MechanicalSystem(
    "pendulum",
    coordinates=(th,),
    kinetic=th.diff() ** 2 / 2,
    potential=-sp.cos(th),
    forces={th: u - th.diff() / 10},
    inputs=(u,),
)
#: As far to the side as it needs 1.5 forwards, then 1.5 backwards, and how long each.
ARCS = (1.3793561749, 0.5595473731)


def aside(**more):
    given = {
        "cost": 1,
        "start": {th: 0, th.diff(): 0},
        "end": {th: sp.pi / 2, th.diff(): 0},
        "duration": (0.5, 8),
        "bounds": {u: (-1.5, 1.5)},
        "phases": [{u: 1.5}, {"u": (-2, -1.5)}],
    }
    return ss.OptimalControl(PENDULUM, **given | more)


def exact_arcs():
    """Durations of both arcs, by Newton's method on a run of high accuracy."""
    arcs, rates = np.array(ARCS), {}
    for _ in range(3):
        state = np.array([0.0, 0.0])
        slopes = np.zeros((2, 2))
        for k, push in enumerate((1.5, -1.5)):
            how = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}

            def rate(t, s, push=push):
                q, v, *tangents = s
                by_q, by_v = np.reshape(tangents, (2, 2))
                more = [by_v, -np.cos(q) * by_q - by_v / 10]
                return [v, -np.sin(q) + push - v / 10, *np.ravel(more)]

            tangents = np.stack([slopes[:, 0], np.zeros(2)], axis=1)
            whole = solve_ivp(rate, (0, arcs[k]), [*state, *tangents.ravel()], **how).y[:, -1]
            state, tangents = whole[:2], whole[2:].reshape(2, 2)
            slopes[:, 0] = tangents[:, 0]
            rates[k] = rate(0, whole)[:2]
            slopes[:, k] = rates[k]
        arcs = arcs - np.linalg.solve(slopes, state - [np.pi / 2, 0.0])
    return arcs


def test_a_grid_knows_what_lies_before_a_place():
    grid = Grid((2, 3))
    assert grid.count == 5
    assert grid.phase.tolist() == [0, 0, 1, 1, 1]
    places = grid.before(np.array([0, 1, 2, 4, 4]), np.array([0.0, 0.5, 0.25, 0.5, 1.0]))
    assert places.tolist() == [[0, 0], [1.5, 0], [2, 0.25], [2, 2.5], [2, 3]]
    assert grid.times(np.array([0.5, 0.1])).tolist() == pytest.approx([0, 0.5, 1, 1.1, 1.2, 1.3])
    assert grid.halved.steps == (4, 6)


@pytest.mark.parametrize(
    ("scheme", "order", "steps"),
    sweep([("simpson", 4, 8), ("midpoint", 2, 16), ("gauss4", 4, 8), ("lobatto6", 6, 3)]),
)
def test_switches_do_not_take_the_order(scheme, order, steps):
    right = exact_arcs()
    found = [aside().solve(scheme, steps=2 * n, tolerance=1e-12) for n in (steps, 2 * steps)]
    assert all(one.success for one in found)
    off = [abs(one.cost - right.sum()) for one in found]
    assert abs(np.log2(off[0] / off[1]) - order) < 0.4
    assert abs(found[1].switches[0] - right[0]) < 2 * off[1] + 1e-10
    plain = aside(phases=()).solve(scheme, steps=4 * steps)
    assert abs(plain.cost - right.sum()) > 1.3 * off[1]


def test_arcs_are_told_by_a_first_solution():
    about = aside(phases=()).solve("lobatto6", steps=13)
    assert about.arcs() == [{u: 1.5}, {u: -1.5}]
    exact = dataclasses.replace(aside(phases=()), phases=about.arcs())
    found = exact.solve("gauss6", steps=8, guess=about)
    assert abs(found.duration - exact_arcs().sum()) < 1e-6
    assert aside(phases=(), bounds={}, cost=u**2, duration=2).solve(steps=4).arcs() == [{}]


@pytest.mark.parametrize("scheme", sweep(["lobatto6", "gauss6"]))
def test_an_arc_that_is_not_there_is_as_short_as_it_may_be(scheme):
    """Its inputs do nothing: that the cost bends down along them by 1e-10 is not told."""
    swing = ss.MechanicalSystem(
        "swing",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=x**2 / 2,
        forces={x: u},
        inputs=(u,),
    )
    given = {
        "cost": 1,
        "start": {x: 0, x.diff(): 0},
        "end": {x: 1, x.diff(): 0},
        "duration": (0.1, 10),
        "bounds": {u: (-2, 2)},
    }
    two = ss.OptimalControl(swing, **given, phases=[{u: 2}, {u: -2}]).solve("gauss6", steps=8)
    three = ss.OptimalControl(swing, **given, phases=[{u: 2}, {}, {u: -2}])
    found = three.solve(scheme, steps=12, guess=two)
    assert found.status is ss.ControlStatus.SOLVED
    assert np.diff(found.switches)[0] < 2e-4
    assert found.duration == pytest.approx(two.duration, abs=1e-8)


@pytest.mark.parametrize(
    ("part", "labels"),
    [
        ([1.0, 1.0, 0.0], [1, 1, -1]),
        ([1.0, 0.7, 0.0], [1, 1, -1]),  # a switch within a step
        ([1.0, 0.6, 0.4, 0.0], [1, 1, -1, -1]),
        ([1.0, 0.6, 0.5, 0.4, 0.0], [1, 0, 0, 0, -1]),
        ([0.5, 0.5, 0.5], [0, 0, 0]),
        ([0.5, 1.0, 0.999, 0.01], [1, 1, 1, -1]),
    ],
)
def test_inputs_at_bounds(part, labels):
    assert label_bounds(np.array(part)).tolist() == labels


def test_derivatives_are_exact():
    """With time, parameters to be found, and a whole duration that is given."""
    k = sp.Symbol("k", positive=True)
    system = ss.MechanicalSystem(
        "slide",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + (1 + x**2) * y.diff() ** 2) / 2,
        potential=k * x**4 - x * sp.sin(3 * ss.time),
        parameters={k: 2.0},
        forces={x: u * sp.cos(y) * ss.time, y: w - y.diff() / 5},
        inputs=(u, w),
    )
    problem = ss.OptimalControl(
        system,
        cost=u**2 + w**2 / 2 + x * ss.time**2,
        final_cost=x * ss.time + y.diff() ** 2,
        start={x: 0.1, x.diff(): 0},
        end={y: ss.time},
        duration=2.0,
        bounds={y.diff() + u * ss.time: (-9, 9)},
        unknowns={k: (1.5, 2.5)},
        phases=[{}, {u: (0, 5)}],
    )
    check_derivatives(problem, "lobatto6")


def test_a_motion_in_phases_is_one_run_behind_the_other(tmp_path):
    problem = aside(duration=2.2, phases=[{u: 1.5}, {u: 0}, {u: -1.5}])
    found = problem.solve("lobatto6", steps=(4, 3, 5))
    assert found.success, found.message
    assert found.layout.grid.steps == (4, 3, 5)
    assert found.switches.shape == (2,)
    assert (np.diff(found.t) > 0).all()
    assert found.t[-1] == found.duration
    u_of = found.input_values[..., 0]
    assert u_of[3, -1] == 1.5  # at the end of a phase an input may jump
    assert (u_of[4:7] == 0).all()
    for one, first in zip(found.trajectories, (0, 4, 7), strict=True):
        run = ss.compile(PENDULUM, "lobatto6").integrate(
            found.q[first],
            p0=found.p[first],
            h=one.h,
            steps=one.steps,
            t0=one.t[0],
            inputs={"u": one.input_values[0, ..., 0]},
        )
        assert np.abs(run.q - one.q).max() < 1e-12
        assert np.abs(run.t - one.t).max() < 1e-14
    with pytest.raises(ss.InputError, match=r"3 phases.*\n.*trajectories"):
        _ = found.trajectory
    runs, off = found.simulate(refine=6)
    assert len(runs) == 3
    assert off < 1e-5
    assert abs(runs[-1].t[-1] - found.duration) < 1e-14
    assert found.lqr(np.eye(2), [[1]]).shape == (12, 1, 2)
    assert np.abs(found.functions["theta"](found.t) - found.q[:, 0]).max() < 1e-14
    found.save(tmp_path / "a.npz")
    again = problem.open(tmp_path / "a.npz")
    assert again.x.tolist() == found.x.tolist()
    assert "4 + 3 + 5 steps" in repr(again)
    with pytest.raises(ss.InputError, match="another problem"):
        aside(phases=()).open(tmp_path / "a.npz")
    finer = problem.solve("lobatto6", steps=(8, 6, 10), guess=found)
    assert np.abs(finer.switches - found.switches).max() < 1e-6
    assert finer.iterations <= found.iterations / 3


def test_steps_are_divided_among_phases_and_doubled_in_each():
    assert aside().solve("simpson", steps=5).layout.grid.steps == (3, 2)
    found = aside().solve("simpson", steps=(3, 2), error=1e-5)
    assert found.layout.grid.steps[0] * 2 == found.layout.grid.steps[1] * 3
    assert found.error < 1e-5


@pytest.mark.parametrize(
    ("phases", "message"),
    [
        ({u: 1}, "phases is .*, which is not a list"),
        ([u], r"phases\[0\] is Symbol, not a mapping"),
        ([{th: 1}], r"phases\[0\] contains 'theta', but the system has no input of this name"),
        ([{}, {"v": 1}], r"phases\[1\] contains 'v'"),
        ([{u: 2}], r"phases\[0\] has u = 2, outside of its bounds"),
        ([{u: (1, -1)}], r"phases\[0\]\[u\] is \(1, -1\): low is above high"),
    ],
)
def test_what_makes_no_sense_is_refused(phases, message):
    with pytest.raises(ss.InputError, match=message):
        aside(phases=phases)


@pytest.mark.parametrize("steps", [0, (3,) * 3, (3, 0), 1, (), "ab", (2.0, 3.0), True])
def test_steps_that_make_no_sense_are_refused(steps):
    with pytest.raises(ss.InputError, match="steps is"):
        aside().solve("simpson", steps=steps)


def test_signals_and_phases_do_not_go_together():
    s = sp.Symbol("s", real=True)
    with pytest.raises(ss.InputError, match="Leave out signals or phases"):
        aside(duration=2, cost=(th - s) ** 2, signals={s: np.sin})
