"""What is computed once, and lines in an order that no hash decides."""

import re
from itertools import count

import mpmath
import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.cases import sweep
from support.workspace import new_workspace

import symsimpson as ss
from symsimpson.discrete.equations import DiscreteEquations, discretise
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.module_kernels import lower
from symsimpson.lower.pipeline import derive, source
from symsimpson.schemes.named import read_scheme
from symsimpson.support import derivation


def test_values_move_to_the_next_step_in_the_order_of_their_names():
    low = Lowering(discretise(ss.systems.pendulum(), ss.SIMPSON))
    (q,) = low.q
    parts = [low.graph.define(f"part_{k}", q ** (k + 2), "some") for k in range(8)]
    total = low.graph.define("total", low.graph.total(parts), "some")
    following = low.graph.declare("q_next", Level.STEP)
    before = len(low.graph.definitions)
    low.advance_symbol(total, {q: following})
    names = [symbol.name for symbol in list(low.graph.definitions)[before:]]
    assert names == [*(f"part_{k}_next" for k in range(8)), "total_next"]


def test_values_that_share_much_move_in_as_many_visits_as_there_are(monkeypatch):
    """Two paths lead down from each level of a diamond: there are 2^200 of them."""
    low = Lowering(discretise(ss.systems.pendulum(), ss.SIMPSON))
    (top,) = low.q
    for k in range(200):
        left = low.graph.define(f"left_{k}", top**2 + k, "some")
        right = low.graph.define(f"right_{k}", top**3 + k, "some")
        top = low.graph.define(f"top_{k}", left * right, "some")
    following = low.graph.declare("q_next", Level.STEP)
    made, define = [], low.graph.define
    monkeypatch.setattr(low.graph, "define", lambda *given: made.append(given) or define(*given))
    assert low.advance_symbol(top, {low.q[0]: following}).name == "top_199_next"
    assert len(made) == 600


@pytest.mark.parametrize("n", sweep([3, 6, 2]))
def test_dampers_between_all_masses_are_compiled_at_once(n):
    """Of x' = A x the end is exp(t A) x(0); lines that are shared are followed once."""
    q = ss.coordinates(" ".join(f"x{i}" for i in range(n)))
    c = sp.Symbol("c", positive=True)
    pairs = [(i, j) for i in range(n) for j in range(i)]
    system = ss.MechanicalSystem(
        f"damped_{n}",
        coordinates=q,
        kinetic=sum(x.diff() ** 2 for x in q) / 2,
        potential=sum((i + 1) * x**2 for i, x in enumerate(q)) / 2,
        parameters={c: 0.4},
        dissipation=sum(c * (q[i].diff() - q[j].diff()) ** 2 for i, j in pairs) / 2,
    )
    run = ss.compile(system, "simpson").integrate(
        [1.0, *[0.0] * (n - 1)], v0=[0.0] * n, h=0.01, t_end=1.0
    )
    damping = 0.4 * (n * np.eye(n) - 1)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(np.arange(1.0, n + 1)), -damping]])
    w, E = np.linalg.eig(A)
    right = (E * np.exp(w)) @ np.linalg.solve(E, np.eye(2 * n)[0])
    assert abs(run.q[-1] - right[:n].real).max() < 1e-7


def test_a_sum_of_known_angles_needs_no_sine_of_its_own():
    text = source(ss.systems.double_pendulum(), ss.SIMPSON)
    equations = text.partition("def step_equations(")[2].partition("\ndef ")[0]
    angles = re.findall(r"sincos\((\w+)\)", equations)
    assert sorted(angles) == ["q1_1", "q1_2", "q2_1", "q2_2"]


def test_a_sine_that_something_is_divided_by_keeps_its_digits():
    x, y = ss.coordinates("x y")
    g = sp.Symbol("g", positive=True)
    system = ss.MechanicalSystem(
        "close",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=g / sp.sin(x - y) ** 2 + sp.cos(x) + sp.cos(y),
        parameters={g: 1.0},
    )
    assert "sincos(angle" in source(system, ss.SIMPSON)


@pytest.mark.parametrize("function", sweep([sp.cos, sp.sin, sp.tan]))
def test_signs_taken_out_of_angles_are_not_lost(function):
    """An angle may change its sign once what is inside it has a name."""
    x, y = ss.coordinates("x y")
    for inner in (sp.sin(y), sp.cos(y), sp.exp(y)):
        for angle in (x - inner, inner - x):
            system = ss.MechanicalSystem(
                "signs",
                coordinates=(x, y),
                kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
                potential=function(angle),
                parameters={},
            )
            module = bind_float(source(system, "midpoint"))
            W = new_workspace(module, [0.3, 0.8], [0.0, 0.0], [])
            module.prepare(0.1, 0.0, W)
            module.energy(0.1, 0.0, W)
            truth = float(function(angle).subs({x: 0.3, y: 0.8}))
            assert W[module.ENERGY, 0] == pytest.approx(truth, rel=1e-14)


@pytest.mark.parametrize(
    "number",
    sweep([sp.Integer(10) ** 20, sp.Rational(1.38e-23), sp.Rational(0.1) ** 3, sp.factorial(30)]),
)
@pytest.mark.parametrize("scheme", sweep(["midpoint", "gauss8"]))
def test_numbers_beyond_64_bits(number, scheme):
    (x,) = ss.coordinates("x")
    k = sp.Symbol("k")

    def swung(factor, parameters):
        system = ss.MechanicalSystem(
            "large",
            coordinates=(x,),
            kinetic=x.diff() ** 2 / 2,
            potential=factor * x**4,
            parameters=parameters,
        )
        h = 0.1 / float(number) ** 0.5
        return ss.compile(system, scheme).integrate([0.3], v0=[0.0], h=h, steps=5).q

    np.testing.assert_allclose(swung(number, {}), swung(k, {k: float(number)}), rtol=1e-14)


def test_numbers_with_long_denominators():
    (x,) = ss.coordinates("x")
    tiny = ss.MechanicalSystem(
        "tiny",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=sp.Rational(0.1) ** 30 * x**2,
        parameters={},
    )
    assert ss.compile(tiny).energy([[3.0]], [[0.0]])[0] == pytest.approx(9e-30, rel=1e-15)


@pytest.mark.parametrize(
    ("constant", "value"),
    [
        (sp.EulerGamma, mpmath.euler),
        (sp.Catalan, mpmath.catalan),
        (sp.GoldenRatio, mpmath.phi),
        (sp.TribonacciConstant, "1.8392867552141611325518525646532866004241787460975"),
    ],
)
def test_constants_of_sympy_have_all_digits(constant, value):
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "constant", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=constant * x**4 / 4
    )
    for digits, options in (
        (15, {}),
        (40, {"precision": 40}),
        (40, {"precision": 40, "arithmetic": "arb"}),
    ):
        energy = ss.compile(system, "midpoint", **options).energy([[2]], [[0]])[0]
        with mpmath.workdps(45):
            exact = 4 * mpmath.mpf(value)
            assert abs(mpmath.mpf(energy) - exact) < mpmath.mpf(10) ** (1 - digits)


@pytest.mark.parametrize("function", sweep([sp.erf, sp.erfc]))
def test_the_error_function_is_taken(function):
    """A step in double precision, and the same in 30 digits; V'' by an independent library."""
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "error_function", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=function(x)
    )
    runs = [
        ss.compile(system, **options).integrate([0.3], v0=[0.1], h=0.05, steps=20)
        for options in ({}, {"precision": 30}, {"precision": 30, "arithmetic": "arb"})
    ]
    for run in runs:
        assert abs(float(run.q[-1, 0] - runs[1].q[-1, 0])) < 1e-14
    exact = mpmath.erf(0.3) if function is sp.erf else mpmath.erfc(0.3)
    assert abs(runs[0].energy[0] - float(exact) - 0.005) < 1e-15


def test_loops_over_terms_derive_no_jet_of_the_whole(monkeypatch):
    """For many bodies it would take longer than all the rest."""
    equations = discretise(ss.systems.n_body(12), read_scheme("simpson"))

    def derived(self):
        raise AssertionError("the jet of all coordinates was derived")

    monkeypatch.setattr(DiscreteEquations, "jet", property(derived))
    assert "FAMILY_1" in lower(equations).tables


@pytest.mark.parametrize("system", [ss.systems.pendulum(), ss.systems.puma560(3)])
def test_each_stage_takes_its_own_time(monkeypatch, system):
    """By a clock that ticks when it is read; the jet comes before the text, or within it."""
    monkeypatch.setattr(derivation.time, "perf_counter", count().__next__)
    stages = derive(system, "midpoint").seconds
    assert list(stages) == ["reading", "structure", "jet", "text"]
    assert all(seconds > 0 for seconds in stages.values())
