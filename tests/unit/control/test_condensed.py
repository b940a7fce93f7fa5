"""States by the stepper in place of unknowns, and problems in any unit."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.control.condensed import Condensed, at_start, moved
from symsimpson.control.grid import Grid
from symsimpson.control.guess import initial_point
from symsimpson.control.layout import Layout
from symsimpson.control.reading import read_family
from symsimpson.control.scaling import scaled

pytest.importorskip("casadi")

x, theta = ss.coordinates("x theta")
u = sp.Symbol("u", real=True)
m, M, l, g = sp.symbols("m M l g", positive=True)


def crane(kg=1.0, metre=1.0, second=1.0, **more):
    """A load on a trolley that goes by one metre, in any units."""
    ahead, up = x.diff() + l * sp.cos(theta) * theta.diff(), l * sp.sin(theta) * theta.diff()
    system = ss.MechanicalSystem(
        "crane",
        coordinates=(x, theta),
        kinetic=(M * x.diff() ** 2 + m * (ahead**2 + up**2)) / 2,
        potential=-m * g * l * sp.cos(theta),
        forces={x: u},
        inputs=(u,),
        parameters={m: 0.3 * kg, M: kg, l: metre / 2, g: 9.81 * metre / second**2},
    )
    rest = {theta: 0, x.diff(): 0, theta.diff(): 0}
    given = {"cost": u**2, "start": {x: 0, **rest}, "end": {x: metre, **rest}}
    return ss.OptimalControl(system, **{**given, "duration": 2 * second, **more})


#: Trolleys of a kilogram, an attogram and a planet; and all units at once.
UNITS = {
    "attograms": (1e-18, 1, 1),
    "planets": (1e24, 1, 1),
    "nanometres": (1, 1e-9, 1),
    "microseconds": (1, 1, 1e-6),
    "atoms": (1e-26, 1e-10, 1e-12),
}


@pytest.mark.parametrize("units", sweep(UNITS))
@pytest.mark.parametrize("condensed", [False, True])
def test_an_optimum_does_not_depend_on_units(units, condensed):
    kg, metre, second = UNITS[units]
    limits = kg * metre / second**2
    found = crane(kg, metre, second).solve(steps=12, condensed=condensed)
    same = crane().solve(steps=12)
    assert found.success
    assert found.cost / (limits**2 * second) == pytest.approx(same.cost, rel=1e-9)
    assert found.violation < 1e-8
    if not condensed:  # the way there is the same, too
        assert found.iterations == same.iterations
    assert found.input_values / limits == pytest.approx(same.input_values, abs=1e-6)


@pytest.mark.parametrize("units", sweep(UNITS))
def test_a_file_of_another_problem_is_refused_in_any_units(units, tmp_path):
    kg, metre, second = UNITS[units]
    crane(kg, metre, second).solve(steps=4).save(tmp_path / "one.npz")
    assert crane(kg, metre, second).open(tmp_path / "one.npz").success
    other = crane(kg, 2 * metre, second)
    with pytest.raises(ss.InputError, match="the solution of another problem"):
        other.open(tmp_path / "one.npz")


PROBLEMS = {
    "free duration, bounds of states": {
        "cost": 1 + u**2,
        "duration": (1, 3),
        "bounds": {u: (-20, 20), x: (-1, 2), x.diff(): (-1, 0.8)},
    },
    "a free start": {"start": {x: 0, theta: 0}, "bounds": {theta: (-1, 1)}},
    "phases": {  # the time alone has many minima that are nearly as low
        "phases": [{u: (0, 5)}, {u: (-5, 0)}],
        "duration": (1, 3),
        "cost": 1 + u**2 / 10,
    },
    "an unknown": {"unknowns": {l: (0.2, 1.0)}},
}


@pytest.mark.parametrize("name", sweep(PROBLEMS, 0))
@pytest.mark.parametrize("scheme", sweep(["simpson", "lobatto6", "gauss4"]))
def test_both_forms_have_the_same_solution(name, scheme):
    problem = crane(**PROBLEMS[name])
    full = problem.solve(scheme, steps=16)
    found = problem.solve(scheme, steps=16, condensed=True)
    assert full.success
    assert found.success
    assert found.cost == pytest.approx(full.cost, rel=1e-7)
    assert found.q == pytest.approx(full.q, abs=1e-4)
    for one, other in zip(found.costates, full.costates, strict=True):
        assert one == pytest.approx(other, abs=1e-3 * np.abs(other).max())
    assert found.violation < 1e-8


def test_derivatives_are_those_of_its_own_values():
    layout = Layout(crane(duration=(1, 3)).reading, read_family("simpson"), Grid((3,)))
    programme, *_ = layout.programme
    guess = initial_point(layout, {"u": lambda t: np.sin(3 * t), "duration": 1.7})
    own = scaled(programme, layout, guess)
    bounds = tuple(map(own.inside, layout.bounds))
    start = own.inside(moved(layout, at_start(layout, guess)))
    form = Condensed(own, layout, start, bounds)
    w, rows, eps = form.inside(start), form.shape[0], 1e-6
    weights = np.random.default_rng(3).normal(size=rows)

    def slopes(w):
        gradient, entries = form.slopes(w)
        return gradient, entries.reshape(-1, rows).T

    def lagrangian(w):
        gradient, jacobian = slopes(w)
        return 0.7 * gradient + weights @ jacobian

    hessian = np.zeros((len(w), len(w)))
    hessian[form.hessian_places] = form.curvatures(w, 0.7, weights)
    for k in range(len(w)):
        step = np.eye(len(w))[k] * eps
        (more, above), (less, below) = form.values(w + step), form.values(w - step)
        gradient, jacobian = slopes(w)
        assert gradient[k] == pytest.approx((more - less) / (2 * eps), abs=1e-7)
        assert jacobian[:, k] == pytest.approx((above - below) / (2 * eps), abs=1e-7)
        turned = (lagrangian(w + step) - lagrangian(w - step)) / (2 * eps)
        assert hessian[: k + 1, k] == pytest.approx(turned[: k + 1], abs=1e-6)


def test_constraints_need_the_full_form():
    (a, b), f = ss.coordinates("a b"), sp.Symbol("f", real=True)
    held = ss.MechanicalSystem(
        "held",
        coordinates=(a, b),
        kinetic=(a.diff() ** 2 + b.diff() ** 2) / 2,
        potential=b,
        constraints={"rod": a**2 + b**2 - 1},
        forces={a: f},
        inputs=(f,),
    )
    problem = ss.OptimalControl(held, cost=f**2, start={a: 0, b: -1}, end={b: 0}, duration=1)
    with pytest.raises(ss.InputError, match="condensed=False"):
        problem.solve(steps=4, condensed=True)


def test_a_guess_whose_motion_ends_is_refused():
    (r,), f = ss.coordinates("r"), sp.Symbol("f", real=True)
    fall = ss.MechanicalSystem(
        "fall",
        coordinates=(r,),
        kinetic=r.diff() ** 2 / 2,
        potential=-1 / r,
        forces={r: f},
        inputs=(f,),
    )
    problem = ss.OptimalControl(fall, cost=f**2, start={r: 1, r.diff(): -1}, end={r: 1}, duration=2)
    with pytest.raises(ss.InputError, match=r"the motion of the guess ends early, at t = "):
        problem.solve(steps=8, condensed=True)
