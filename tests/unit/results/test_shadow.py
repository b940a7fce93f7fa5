"""The energy that a scheme keeps: its orders, and its value against closed formulas."""

import json

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.places import DATA

import symsimpson as ss
from symsimpson.results import energies

GOLDEN = json.loads((DATA / "golden_forced.json").read_text("utf-8"))["modified_energy"]


def half_swings(energies, steps=(0.04, 0.02, 0.01), scheme="simpson"):
    stepper = ss.compile(ss.systems.double_pendulum(), scheme)
    found = []
    for h in steps:
        run = stepper.integrate([0.8, 1.0], p0=[0, 0], h=h, t_end=2.0)
        found.append(np.ptp(energies(run)) / 2)
    return np.array(found)


def step_means(run):
    """H + dH in the mean over each step: to h^6 for schemes of order 4."""
    return (run.energy[1:] + run.energy[:-1]) / 2 + energies.mean_corrections(run)


def orders(swings):
    return np.log2(swings[:-1] / swings[1:])


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4"], 1))
def test_orders_of_schemes_of_order_four(scheme):
    assert abs(orders(half_swings(lambda run: run.energy, scheme=scheme))[1] - 4.0) < 0.1
    assert abs(orders(half_swings(step_means, scheme=scheme))[1] - 6.0) < 0.2
    assert abs(orders(half_swings(lambda run: run.shadow_energy, scheme=scheme))[1] - 8.0) < 0.3


@pytest.mark.parametrize(
    ("scheme", "order"), sweep([("midpoint", 4.0), ("lobatto6", 8.0), ("gauss6", 8.0)], 0)
)
def test_orders_of_other_schemes(scheme, order):
    swings = half_swings(step_means, (0.02, 0.01, 0.005)[: 3 if order == 4 else 2], scheme)
    assert abs(orders(swings)[-1] - order) < 0.3


def test_the_other_sign_gives_twice_the_swing():
    """And so would any mistake of the leading term: the order would not rise."""

    def wrong(run):
        return 2 * run.energy - run.shadow_energy

    swings, plain = half_swings(wrong), half_swings(lambda run: run.energy)
    assert abs(orders(swings)[1] - 4.0) < 0.1
    assert abs(swings[1] / plain[1] - 2.0) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("case", sweep(GOLDEN[::-1], 1), ids=lambda case: case["name"])
@pytest.mark.parametrize(("scheme", "order", "term"), [("midpoint", 2, "H2"), ("simpson", 4, "H4")])
def test_the_leading_term_is_that_of_the_closed_formula(case, scheme, order, term):
    q = ss.coordinates(" ".join(f"q{i}" for i in range(len(case["q0"]))))
    values = {sp.Symbol(name, positive=True): float(x) for name, x in case["parameters"].items()}
    names = {f"q{i}": x for i, x in enumerate(q)} | {f"v{i}": x.diff() for i, x in enumerate(q)}
    L = sp.sympify(case["L"], locals=names | {symbol.name: symbol for symbol in values})
    system = ss.MechanicalSystem.from_lagrangian(case["name"], L, q, values)
    stepper, errors = ss.compile(system, scheme), []
    start = [np.array(case[name], dtype=float) for name in ("q0", "p0")]
    for h in (0.04, 0.02):
        run = stepper.integrate(start[0], p0=start[1], h=h, steps=8)
        found = (run.shadow_energy[0] - run.energy[0]) / h**order
        errors.append(abs(found - float(case[term])))
    assert errors[1] < 0.01 * abs(float(case[term]))
    assert errors[0] / errors[1] > 3.5  # what is left is of order h^2 at least


def test_it_hardly_moves_where_the_energy_swings():
    """H swings by a thousand times as much as what it keeps."""
    stepper = ss.compile(ss.systems.double_pendulum(), "simpson")
    run = stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.01, steps=100)
    assert np.ptp(run.shadow_energy) < 2e-3 * np.ptp(run.energy)


@pytest.mark.slow
def test_it_is_drawn_beside_the_energy():
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.05, steps=50)
    axes = run.plot_energy(shadow=True)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "energy",
        "shadow energy",
    ]


@pytest.mark.parametrize(
    ("name", "given", "match"),
    [
        ("damped_oscillator", {}, "energy is not constant"),
        ("pendulum", {"every": 2}, "every=1"),
        ("pendulum", {"steps": 3}, "four steps"),
    ],
)
def test_runs_without_one_say_why(name, given, match):
    stepper = ss.compile(getattr(ss.systems, name)())
    run = stepper.integrate([1.0], v0=[0.0], **{"h": 0.05, "steps": 50, **given})
    with pytest.raises(ss.InputError, match=match):
        _ = run.shadow_energy


@pytest.mark.parametrize("length", [{"steps": 20}, {"t_end": 1.0}])
def test_retimed_runs_have_none(length):
    stepper = ss.compile(ss.systems.kepler_plane().retimed("encounters"), "simpson")
    run = stepper.integrate([1.6, 0.0], v0=[0.0, 0.5], h=0.1, **length)
    with pytest.raises(ss.InputError, match="constant in transformed time"):
        _ = run.shadow_energy
