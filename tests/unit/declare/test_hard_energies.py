"""Energies with roots, logarithms and powers that tempt one to take too much for granted."""

from fractions import Fraction
from itertools import combinations

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.workspace import jet_values

import symsimpson as ss
from symsimpson.discrete.jet import derive_jet

x, y, z = ss.coordinates("x y z")
q = ss.coordinates("q0:6")


def declare(potential, coordinates=(x, y, z), parameters=None, kinetic=None):
    used = [c for c in coordinates if sp.sympify(potential).has(c)] or list(coordinates)
    T = sum(c.diff() ** 2 for c in used) / 2 if kinetic is None else kinetic
    return ss.MechanicalSystem(
        "hard", coordinates=used, kinetic=T, potential=potential, parameters=parameters or {}
    )


def forces(system, point):
    """F of the jet, and that of SymPy, at a point, at rest."""
    jet = derive_jet(system.structure.plain)
    n = system.n
    with mp.workdps(40):
        found = jet_values(jet, point, [0] * n, system.parameters.values())
        mine = [found.get(("F", i), mp.mpf(0)) for i in range(n)]
        at = dict(zip(system.coordinates, map(sp.Float, point), strict=True))
        at |= {a: sp.Float(v) for a, v in system.parameters.items()}
        own = sp.symbols(f"u0:{system.n}", real=True)
        V = system.potential.xreplace(dict(zip(system.coordinates, own, strict=True)))
        at = dict(zip(own, map(sp.Float, point), strict=True)) | at
        truth = [mp.mpf(sp.N(-V.diff(u).subs(at), 30)) for u in own]
    return mine, truth


def right(system, point):
    mine, truth = forces(system, point)
    return all(abs(a - b) < 1e-13 * (1 + abs(b)) for a, b in zip(mine, truth, strict=True))


EXPONENTS = [Fraction(k, d) for d in (1, 2, 3, 4, 6, 8) for k in (-5, -1, 1, 3, 7)]


@pytest.mark.slow
@pytest.mark.parametrize("first", sweep(range(0, len(EXPONENTS), 5), 3))
def test_powers_of_one_base(first):
    """Every pair of exponents with one of five, and some triples."""
    for pair in combinations(EXPONENTS, 2):
        if EXPONENTS.index(pair[0]) // 5 == first // 5:
            powers = (x ** sp.Rational(e.numerator, e.denominator) for e in {*pair, Fraction(5, 4)})
            assert right(declare(sp.Add(*powers)), [0.87327]), pair


CASES = {
    "a logarithm that would be fixed at its pole": (sp.log(x * y + x), [2.0, 1.0], ()),
    "a difference of logarithms": (
        sp.log(x * y + x * z) - sp.log(x) + y**2 + z**2,
        [1.2, 0.7, 0.4],
        ("x",),
    ),
    "an angle of two": (sp.atan2(x * y, x * z) + z**2, [1.2, 0.7, 0.4], None),
    "a sign": (y * sp.sqrt(x**2) / x + y**2, [-0.7, 0.4], ()),
    "arcs of both sides": (y * (sp.atan(x) + sp.atan(1 / x)) + y**2, [-0.7, 0.4], ()),
    "half an angle beside a root": (
        sum(c**4 for c in q[:2]) + sp.sqrt(2 - 2 * sp.cos(q[2])) + 2 * sp.sin(q[2] / 2),
        [0.3, 0.2, 1.1],
        (),
    ),
    "half an exponent beside a root": (
        sum(c**4 for c in q[:5]) + sp.sqrt(sp.exp(q[5])) + sp.exp(q[5] / 2),
        [0.3, 0.2, 0.1, 0.5, 0.4, 0.3],
        (),
    ),
    "the inverse of a sine": (
        sum(c**4 for c in q[:2]) + sp.asin(sp.sin(q[2])) - q[2],
        [0.3, 0.2, 2.5],
        (),
    ),
    "a coefficient that is zero in the field": (
        x**2 + (2**61 - 1) * y**4 + (2**61 - 1) * x * y,
        [0.3, 0.2],
        (),
    ),
    "a denominator that is zero in the field": (
        x**2 + sp.Rational(1, 2**61 - 1) * y**2,
        [0.3, 0.2],
        (),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_nothing_is_lost(name):
    potential, point, cyclic = CASES[name]
    system = declare(potential, coordinates=(x, y, z, *q))
    assert cyclic is None or system.structure.cyclic == cyclic
    assert right(system, point)


@pytest.mark.parametrize("names", ["x y", "y x", "a b", "q1 q2", "q7 q2"])
def test_a_root_of_a_square_and_a_parameter(names):
    k = sp.Symbol("k", positive=True)
    a, b = ss.coordinates(names)
    system = declare(b * sp.sqrt(k * a**2) / a + b**2, (a, b), {k: 1.5})
    assert right(system, [-0.7, 0.4])


def test_inverse_hyperbolic_masses():
    for f in (sp.asinh, sp.acosh, sp.atanh):
        kinetic = (1 + f(2 + x**2 if f is sp.acosh else x) ** 2) * x.diff() ** 2 / 2
        assert declare(x**2, (x,), kinetic=kinetic).structure.cyclic == ()


@pytest.mark.slow
def test_linear_forces_without_a_value_at_zero():
    quotient = sp.expand((x - 1) * (x - 2) * x) / ((x - 1) * (x - 2) * x)
    system = ss.MechanicalSystem(
        "odd",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=y**2 + quotient * y,
    )
    run = ss.compile(system).integrate([0.3, 1.0], v0=[0.1, 0.0], h=0.05, steps=20)
    assert abs(run.energy_error).max() < 1e-6


@pytest.mark.parametrize(
    "potential",
    [
        sp.Pow(sp.E, x, evaluate=False) ** 2,
        sp.UnevaluatedExpr(x) ** 2,
        x * sp.AlgebraicNumber(sp.sqrt(2)),
        x * sp.Determinant(sp.MatrixSymbol("A", 2, 2)),
        x * sp.Trace(sp.MatrixSymbol("A", 2, 2)),
        x * sp.MatrixSymbol("A", 2, 2)[0, 0],
    ],
)
def test_what_is_no_plain_expression(potential):
    """Taken for what it is, or refused in words; never a traceback."""
    try:
        system = declare(potential, (x,))
    except ss.ModelError:
        return
    assert right(system, [0.4])


def test_numbers_out_of_the_range_of_doubles():
    with pytest.raises(ss.ModelError, match="smaller than doubles"):
        declare(x**2, (x,), kinetic=sp.Float("1e-400") * x.diff() ** 2)
    steep = declare((3 * x + 6 * y) ** 1000)
    with pytest.raises(ss.GenerationError, match="exceeds the range of double precision"):
        ss.compile(steep)


@pytest.mark.parametrize(
    "wrong",
    [
        {"links": [1, 2]},
        {"links": None},
        {"gravity": "abc"},
        {"gravity": 9.81},
        {"a": "1"},
        {"inertia": None},
    ],
)
def test_arms_of_nonsense(wrong):
    link = ss.Link(
        **{
            "mass": 1.0,
            "a": 1.0,
            "inertia": (1, 1, 1),
            **{key: value for key, value in wrong.items() if key in ("a", "inertia")},
        }
    )
    options = {key: value for key, value in wrong.items() if key == "gravity"}
    with pytest.raises(ss.ModelError, match="system 'arm'"):
        ss.serial_arm("arm", wrong.get("links", [link]), **options)


def test_norms_of_vectors_are_smooth():
    """SymPy writes them with moduli, of whose squares reals have no need."""
    x, y = ss.coordinates("x y")
    place = sp.Matrix([x, y])
    system = ss.MechanicalSystem(
        "kepler",
        coordinates=(x, y),
        kinetic=place.diff(ss.time).norm() ** 2 / 2,
        potential=-1 / place.norm(),
    )
    plain = ss.MechanicalSystem(
        "kepler",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-1 / sp.sqrt(x**2 + y**2),
    )
    given = {"q0": [1.0, 0.0], "v0": [0.0, 1.1], "h": 0.05, "steps": 20}
    assert (ss.compile(system).integrate(**given).q == ss.compile(plain).integrate(**given).q).all()
    with pytest.raises(ss.ModelError, match=r"Abs\(x\)"):
        ss.MechanicalSystem(
            "kink", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=sp.Abs(x) ** 3
        )


def test_hyperbolic_functions_of_all_kinds():
    (x,) = ss.coordinates("x")
    kinetic, steps = x.diff() ** 2 / 2, {"q0": [1.0], "v0": [0.3], "h": 0.05, "steps": 20}
    runs = [
        ss.compile(
            ss.MechanicalSystem("well", coordinates=(x,), kinetic=kinetic, potential=potential)
        ).integrate(**steps)
        for potential in (
            sp.coth(x) + sp.csch(x) - sp.sech(x) ** 2,
            sp.cosh(x) / sp.sinh(x) + 1 / sp.sinh(x) - 1 / sp.cosh(x) ** 2,
        )
    ]
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-14
