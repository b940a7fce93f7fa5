"""Guesses that run into obstacles, or over points at which something has no slope."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

pytest.importorskip("casadi")

x, y, z = ss.coordinates("x y z")
a, b, c = sp.symbols("a b c", real=True)


def free(*inputs):
    """A point of mass 1 that is pushed along each of its coordinates."""
    q = (x, y, z)[: len(inputs)]
    return ss.MechanicalSystem(
        "point",
        coordinates=q,
        kinetic=sum(s.diff() ** 2 for s in q) / 2,
        potential=0 * x,
        forces=dict(zip(q, inputs, strict=True)),
        inputs=inputs,
    )


LINE, PLANE, SPACE = free(a), free(a, b), free(a, b, c)


def past(*obstacles, system=PLANE, unit=1, scheme="lobatto6", guess=None, **more):
    """Go by 2 along x, from rest to rest, outside of circles or spheres (centre, radius)."""
    q = system.coordinates
    rest = {s.diff(): 0 for s in q}
    path = []
    for centre, radius in obstacles:
        away = sum((s - unit * at) ** 2 for s, at in zip(q, centre, strict=True))
        path.append(away >= (unit * radius) ** 2)
    given = {
        "cost": sum(u**2 for u in system.inputs),
        "start": dict.fromkeys(q, 0) | rest,
        "end": dict.fromkeys(q, 0) | {x: 2 * unit} | rest,
        "duration": 2,
        "path": path,
    }
    return ss.OptimalControl(system, **given | more).solve(scheme, steps=20, guess=guess)


def over(height):
    return {x: ss.time, y: height * sp.sin(sp.pi * ss.time / 2)}


def test_an_obstacle_straight_ahead_is_passed():
    """12 2^2 / 2^3 along the line, and twice 12 0.5^2 over the top."""
    found = past(((1, 0), 0.5))
    assert found.success
    assert found.cost == pytest.approx(12, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [sp.Rational("1e-9"), 10**9])
def test_obstacles_of_any_unit_are_passed(unit):
    found = past(((1, 0), 0.5), unit=unit)
    assert found.success
    assert found.cost == pytest.approx(float(12 * unit**2), rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["lobatto6", "simpson"])
@pytest.mark.parametrize(
    ("obstacles", "height"),
    [
        ([((0.6, 0), 0.4)], 0.6),
        ([((1.45, 0), 0.4)], 0.6),
        ([((1, 0.1), 0.5)], -0.6),  # below, where the way is shorter
        ([((0.6, 0), 0.25), ((1.4, 0), 0.25)], 0.6),
        ([((1, 0), 0.9)], 1.2),
    ],
)
def test_obstacles_are_passed_as_from_a_guess_beside_them(obstacles, height, scheme):
    found = past(*obstacles, scheme=scheme)
    beside = past(*obstacles, scheme=scheme, guess=over(height))
    assert found.success
    assert beside.success
    assert found.cost <= beside.cost * (1 + 1e-6)


@pytest.mark.slow
def test_obstacles_within_bounds_and_in_space_are_passed():
    bounds = {y: (-0.3, 3), a: (-8, 8), b: (-8, 8)}
    assert past(((1, 0), 0.5), bounds=bounds).cost == pytest.approx(12, rel=1e-6)
    ball = past(((1, 0, 0), 0.5), system=SPACE)
    assert ball.success
    assert ball.cost == pytest.approx(12, rel=1e-6)
    quick = {"cost": 1, "duration": (0.5, 8), "bounds": {a: (-4, 4), b: (-4, 4)}}
    found = past(((1, 0), 0.5), **quick)
    assert found.duration == pytest.approx(np.sqrt(2), rel=1e-6)  # as without an obstacle


@pytest.mark.slow
def test_a_guess_says_on_which_side_an_obstacle_is_passed():
    for height in (0.6, -0.6):
        found = past(((1, 0.1), 0.5), guess=over(height))
        assert np.sign(found.q[10, 1]) == np.sign(height)


@pytest.mark.slow
def test_a_place_that_cannot_be_reached_is_told():
    found = past(((1, 0), 0.5), end={x: 1, y: 0, x.diff(): 0, y.diff(): 0})
    assert found.status is ss.ControlStatus.INFEASIBLE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "cost"),
    [
        ({x**2: 1, x.diff(): 0}, 12),
        ({x**2: 1e-6, x.diff(): 0}, 12e-6),
        ({sp.cos(x): 0, x.diff(): 0}, 3 * np.pi**2),
        ({x.diff() ** 2: 1}, 1),
    ],
)
def test_conditions_without_slope_at_the_guess_are_met(end, cost):
    start = {x: 0, x.diff(): 0}
    problem = ss.OptimalControl(LINE, cost=a**2, start=start, end=end, duration=1)
    found = problem.solve("lobatto6", steps=6)
    assert found.success, found.message
    assert found.cost == pytest.approx(cost, rel=1e-6)


@pytest.mark.slow
def test_runs_and_results_are_guesses_and_give_inputs():
    """A run of the inputs that were found is the motion that was found."""
    start, end = {x: 0, x.diff(): 0}, {x: 1, x.diff(): 0}
    problem = ss.OptimalControl(LINE, cost=a**2 + x**4, start=start, end=end, duration=1)
    found, stepper = problem.solve("simpson", steps=10), ss.compile(LINE)
    how = {"p0": found.p[0], "h": 0.1, "steps": 10}
    run = stepper.integrate(found.q[0], inputs=found, **how)
    assert np.abs(run.q - found.q).max() < 1e-12
    by_function = {"a": lambda t: found.inputs(t)["a"]}
    assert (stepper.integrate(found.q[0], inputs=by_function, **how).q == run.q).all()
    for guess in (found, run, found.trajectory, found.functions):
        again = problem.solve("simpson", steps=10, guess=guess)
        assert again.iterations < found.iterations
        assert again.cost == pytest.approx(found.cost, rel=1e-9)


@pytest.mark.slow
def test_figures_have_the_units_of_the_system():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    th = sp.Function("th")(ss.time)
    system = ss.MechanicalSystem(
        "both",
        coordinates=(x, y, th),
        kinetic=(x.diff() ** 2 + y.diff() ** 2 + th.diff() ** 2) / 2,
        potential=0 * x,
        forces={x: a, y: b, th: c},
        inputs=(a, b, c),
        units={"x": "m", "y": "m", "th": "rad", "a": "N", "b": "N", "c": "N m", "t": "s"},
    )
    found = ss.OptimalControl(
        system, cost=a**2 + b**2 + c**2, start={x: 0, y: 0, th: 0}, end={x: 1}, duration=1
    ).solve("simpson", steps=3)
    panels = found.plot().axes
    labels = ["coordinates [m]", "th [rad]", "inputs [N]", "c [N m]"]
    assert [panel.get_ylabel() for panel in panels] == labels
    assert panels[-1].get_xlabel() == "t [s]"
    (searched,) = found.plot_iterations().axes
    names = [text.get_text() for text in searched.get_legend().get_texts()]
    assert names == ["constraint violation", "optimality"]
    pyplot.close("all")
