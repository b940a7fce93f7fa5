"""Solutions that are no motions, costs in small units, and what ends a search."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.study.control.transcription import lagrange, lagrange_slopes

pytest.importorskip("casadi")

x, y = ss.coordinates("x y")
u, N = sp.symbols("u N", real=True)
CART = ss.MechanicalSystem(
    "cart", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0, forces={x: u}, inputs=(u,)
)
#: A bead on a wire whose shape is found by the force across the motion, which does no work.
BEAD = ss.MechanicalSystem(
    "bead",
    coordinates=(x, y),
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
    potential=9.81 * y,
    forces={x: -N * y.diff(), y: N * x.diff()},
    inputs=(N,),
)
FALL = ss.OptimalControl(
    BEAD,
    cost=1,
    start={x: 0, y: 10, x.diff() ** 2 + y.diff() ** 2: 1},
    end={x: 10, y: 5},
    duration=(0.5, 5),
    bounds={N: (-100, 100)},
)


def swing(factor=1, **more):
    cart = ss.systems.driven_cart_pole()
    (X, th), (U,) = cart.coordinates, cart.inputs
    rest = {X.diff(): 0, th.diff(): 0}
    given = {"start": {X: 0, th: 0, **rest}, "end": {X: 1, th: sp.pi, **rest}, "duration": 2}
    bounds = {U: (-20, 20), X: (-2, 2)}
    return ss.OptimalControl(cart, cost=factor * U**2, **given, bounds=bounds, **more)


@pytest.mark.parametrize("scheme", sweep(["lobatto6", "simpson"]))
def test_inputs_that_chatter_within_steps_are_no_solution(scheme):
    """Energy would come from a force that does no work."""
    found = FALL.solve(scheme, steps=20, guess={"duration": 1.8})
    assert np.ptp(found.trajectory.energy) > 10
    assert found.status is ss.ControlStatus.NOT_RESOLVED
    assert not found.success
    assert "'gauss6'" in found.message


def test_a_bead_falls_along_the_brachistochrone():
    found = FALL.solve("gauss6", steps=20, guess={"duration": 1.8})
    assert found.success
    assert np.ptp(found.trajectory.energy) < 1e-7
    assert found.duration == pytest.approx(1.69861, abs=2e-5)


@pytest.mark.parametrize("scheme", sweep(["gauss4", "gauss6"]))
def test_inputs_that_turn_a_body_at_rest_within_a_step_are_no_solution(scheme):
    """Where a bead hardly moves a force across its path costs nothing, and turns it many times."""
    rest = {x.diff(): 0, y.diff(): 0}
    given = {"start": {x: 0, y: 0, **rest}, "end": {x: 2, y: -2}, "duration": (0.2, 5)}
    problem = ss.OptimalControl(BEAD, cost=1, **given)
    found = [problem.solve(scheme, steps=steps) for steps in (10, 20, 40)]
    assert found[-1].success
    for one in found:
        assert not one.success or one.duration == pytest.approx(0.8243386694, abs=3e-6)


def test_too_few_steps_are_told():
    assert swing().solve(steps=2).status is ss.ControlStatus.NOT_RESOLVED
    found = swing().solve("gauss6", steps=3, error=1e-3)
    assert found.success
    assert found.layout.steps > 6
    assert found.cost == pytest.approx(67.0721, rel=3e-3)


@pytest.mark.parametrize("scheme", sweep(["lobatto6", "gauss6", "simpson"]))
def test_what_is_dear_between_nodes_is_told(scheme):
    """A hill of the cost that is narrower than a step lies between nodes, or they avoid it."""
    hill = 1e4 * sp.exp(-(((x - 0.5) / 0.01) ** 2))
    given = {"start": {x: 0, x.diff(): 0}, "end": {x: 1, x.diff(): 0}, "duration": 1}
    problem = ss.OptimalControl(CART, cost=u**2 + hill, **given)
    assert problem.solve(scheme, steps=10).status is ss.ControlStatus.NOT_RESOLVED
    flat = ss.OptimalControl(CART, cost=u**2 + hill / 1e6, **given)
    assert flat.solve(scheme, steps=10).cost == pytest.approx(12, rel=1e-3)


@pytest.mark.parametrize("factor", [1e-4, 1e-9])
def test_the_unit_of_the_cost_does_not_matter(factor):
    right, found = swing().solve(steps=20), swing(factor).solve(steps=20)
    assert found.cost / factor == pytest.approx(right.cost, rel=1e-7)
    for one, own in zip(found.costates, right.costates, strict=True):
        assert np.abs(one / factor - own).max() < 1e-5 * np.abs(own).max()


def test_the_error_of_a_small_cost_is_relative(tmp_path):
    steps = {swing(f).solve("simpson", steps=10, error=1e-3).layout.steps for f in (1, 1e-5)}
    assert len(steps) == 1
    found = swing(1e-12).solve("simpson", steps=10)
    found.save(tmp_path / "a.npz")
    with pytest.raises(ss.InputError, match="the solution of another problem"):
        swing(7e-12).open(tmp_path / "a.npz")


def test_a_search_that_ends_without_a_value_says_of_what(tmp_path):
    start = {x: 0, x.diff(): 0}
    problem = ss.OptimalControl(CART, cost=u**2 + 1 / x, start=start, duration=1)
    found = problem.solve(steps=4)
    assert found.status is ss.ControlStatus.NOT_FINITE
    assert "the cost is not finite" in found.message
    found.save(tmp_path / "a.npz")
    again = problem.open(tmp_path / "a.npz")
    assert (again.message, again.status) == (found.message, found.status)
    assert (again.x == found.x).all()
    other = ss.OptimalControl(CART, cost=u**2, start=start, duration=1)
    with pytest.raises(ss.InputError, match="the solution of another problem"):
        other.open(tmp_path / "a.npz")


def test_a_cost_without_bound_is_told():
    problem = ss.OptimalControl(CART, cost=u, start={x: 0, x.diff(): 0}, duration=1)
    found = problem.solve(steps=4, most_iterations=200)
    assert not found.success
    assert "The cost fell to -" in found.message


def test_inputs_are_told_within_the_motion():
    problem = ss.OptimalControl(CART, cost=u**2, start={x: 0}, end={x: 1}, duration=2)
    found = problem.solve(steps=4)
    assert found.inputs(2.0)["u"].shape == ()
    for t, message in (([-1, 1], "t = -1 lies outside"), (2.1, "0 <= t <= 2"), ("a", "t is 'a'")):
        with pytest.raises(ss.InputError, match=message):
            found.inputs(t)


def test_slopes_of_polynomials():
    places, at, d = np.array([0.0, 0.3, 0.7, 1.0]), np.array([0.1, 0.5, 1.0]), 1e-6
    right = (lagrange(places, at + d) - lagrange(places, at - d)) / (2 * d)
    assert np.abs(lagrange_slopes(places, at) - right).max() < 1e-8
    assert lagrange_slopes(np.array([0.0, 1.0]), at).tolist() == [[-1.0, 1.0]] * 3


@pytest.mark.parametrize("scheme", sweep(["lobatto6", "gauss6", "simpson"]))
def test_inputs_may_be_given_by_the_state(scheme):
    """At a node of two steps the row of a path stands once, unless velocities are in it."""
    given = {"cost": u**2, "start": {x: 1, x.diff(): 0}, "duration": 2}
    found = ss.OptimalControl(CART, **given, path=[(0, u + x, 0)]).solve(scheme, steps=10)
    assert found.success
    assert found.q[-1, 0] == pytest.approx(np.cos(2), abs=1e-4)
    rows = found.layout.names.count("u + x(t)")
    assert rows == {"lobatto6": 31, "simpson": 21, "gauss6": 30}[scheme]
    moving = ss.OptimalControl(CART, **given, path=[(-9, u + x.diff(), 9)])
    names = moving.solve("lobatto6", steps=10).layout.names
    assert names.count("u + Derivative(x(t), t)") == 40


@pytest.mark.parametrize("scheme", ["midpoint", "gauss6"])
def test_no_inputs_may_be_the_best(scheme):
    ends = {"start": {x: 0, x.diff(): 1}, "end": {x: 1}, "duration": 1}
    result = ss.OptimalControl(CART, cost=u**2, **ends).solve(scheme, steps=5)
    assert result.status is ss.ControlStatus.SOLVED
    assert abs(result.cost) < 1e-20


@pytest.mark.parametrize(
    ("scheme", "end", "path"),
    [
        ("lobatto6", {x: 1, (y - sp.Rational(3, 10)) ** 3: 0}, []),  # without a slope there
        ("simpson", {x: 1}, [(0, x**2 + y**2 - 1, 0)]),  # a circle, at its rightmost point
    ],
)
def test_conditions_that_touch_do_not_tell_an_optimum(scheme, end, path):
    """Multipliers without bound: the cost is 17.8799 where the least is 17.88."""
    force = sp.Symbol("force", real=True)
    flat = ss.MechanicalSystem(
        "flat",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=0,
        forces={x: u, y: force},
        inputs=(u, force),
    )
    rest = {x.diff(): 0, y.diff(): 0}
    given = {"start": {x: 0, y: 1, **rest}, "end": {**end, **rest}, "duration": 1}
    problem = ss.OptimalControl(flat, cost=u**2 + force**2, path=path, **given)
    way = {x: sp.sin(sp.pi * ss.time / 2), y: sp.cos(sp.pi * ss.time / 2)} if path else None
    found = problem.solve(scheme, steps=10, guess=way)
    assert found.status is ss.ControlStatus.NOT_OPTIMAL
    assert not found.success
    assert "all known values of an end" in found.message


@pytest.mark.parametrize("scheme", sweep(["lobatto6", "gauss6", "simpson"]))
@pytest.mark.parametrize("bounds", [{}, {u: (-1, 1)}])
def test_a_cost_that_falls_to_both_sides_is_not_least(scheme, bounds):
    """To stay is where the cost is flat, and largest: moving off at full force is best."""
    given = {"start": {x: 0, x.diff(): 0}, "duration": 1, "bounds": bounds}
    found = ss.OptimalControl(CART, cost=u**2 / 1000 - x**2 + x**4, **given).solve(scheme, steps=20)
    assert found.success
    if bounds:  # x = t^2 / 2 until shortly before the end, where force does no more
        assert found.cost == pytest.approx(1e-3 - 1 / 20 + 1 / 144, abs=1e-4)
    else:
        assert found.cost < -0.1


def test_barriers_do_not_hide_a_cost_that_falls_to_both_sides():
    """A bound of a thousandth bends the solver's matrices as much as the cost does."""
    given = {"start": {x: 0, x.diff(): 0}, "duration": 1, "bounds": {u: (-1e-3, 1e-3)}}
    cost = (1e3 * u) ** 2 / 1000 - (1e3 * x) ** 2
    found = ss.OptimalControl(CART, cost=cost, **given).solve("gauss6", steps=10)
    assert found.success
    assert found.cost == pytest.approx(1e-3 - 1 / 20, abs=1e-4)


def test_rounding_of_multipliers_in_units_of_atoms_is_nothing():
    radius, second = 1e-10, 1e-14
    given = {"start": {x: 0, x.diff(): 0}, "end": {x: radius, y: 0, y.diff(): 0}}
    rod = ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * radius / second**2 * y,
        forces={x: -u * y / radius, y: u * x / radius},
        inputs=(u,),
        constraints={"circle": x**2 + y**2 - radius**2},
    )
    angle = sp.pi * ss.time / (2 * second)
    cost = (u * second**2 / radius) ** 2 / second
    found = ss.OptimalControl(rod, cost=cost, duration=second, **given).solve(
        "gauss6", steps=10, guess={x: radius * sp.sin(angle), y: -radius * sp.cos(angle)}
    )
    assert found.success
    assert found.cost == pytest.approx(37.592695, rel=1e-6)


@pytest.mark.parametrize(("height", "cost"), [(1000, 220.798), (3000, 317.173)])
def test_a_hill_is_passed_at_a_side(height, cost):
    """Straight over it the cost is 328.017 or 756.925, to which searches come ever more slowly."""
    rest = {x.diff(): 0, y.diff(): 0}
    ends = {"start": {x: -1, y: 0, **rest}, "end": {x: 1, y: 0, **rest}, "duration": 1}
    flat = ss.MechanicalSystem(
        "flat",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=0,
        forces={x: u, y: N},
        inputs=(u, N),
    )
    hill = height * sp.exp(-4 * (x**2 + y**2))
    problem = ss.OptimalControl(flat, cost=u**2 + N**2 + hill, **ends)
    found = problem.solve("simpson", steps=20)
    assert found.success
    assert found.cost == pytest.approx(cost, rel=1e-4)
    assert np.abs(found.q[:, 1]).max() > 0.3
    aside = problem.solve("simpson", steps=20, guess={y: sp.sin(sp.pi * ss.time)})
    assert found.cost == pytest.approx(aside.cost, rel=1e-8)
    stopped = problem.solve("simpson", steps=20, most_iterations=30)
    assert not stopped.success
