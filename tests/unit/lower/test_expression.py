"""Expressions of a module: sums, numbers and powers with all their digits."""

import mpmath
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.lower.expression import Expressions


def test_terms_of_sums_in_sums_are_collected():
    graph = Expressions()
    x, y, z = map(graph.make_symbol, "xyz")
    total = x + y
    assert (2 * total + z) - total == x + y + z
    assert 2 * total - total - total == 0
    assert total + total == 2 * total
    assert 3 - (x - y) - 1 == 2 + y - x


def test_numbers_are_those_of_python():
    graph = Expressions()
    assert graph.of(2) == 2
    assert {graph.of(2): "two"}[2] == "two"
    assert graph.of(sp.Rational(1, 3)) * 3 == 1


x, m = ss.coordinates("x")[0], sp.Symbol("m", positive=True)
HARD = {
    "rational powers": (1 + x**2) ** sp.Rational(2, 3) + sp.cbrt(m) - (2 + x) ** sp.Rational(-5, 7),
    "products of floats": 0.7 * (0.3 * x + 0.9) ** 4,
    "functions of numbers": sp.sin(sp.pi / 7) * x + sp.sin(1) * x**4 + x**2 * sp.tan(1),
    "a power of two": sp.Rational(2**54 + 1, 2**11) * x**2,
}


@pytest.mark.parametrize("name", HARD)
def test_energies_have_all_digits(name):
    """As SymPy evaluates them, floats being the fractions that they are."""
    system = ss.MechanicalSystem(
        "digits",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=HARD[name],
        parameters={m: 2.0},
    )
    found = ss.compile(system, "midpoint", precision=40).energy([["0.3"]], [["0"]])[0]
    exact = HARD[name].xreplace({a: sp.Rational(a) for a in HARD[name].atoms(sp.Float)})
    with mpmath.workdps(60):
        truth = mpmath.mpf(str(exact.subs({x: sp.Rational(3, 10), m: 2}).evalf(55)))
        assert abs(mpmath.mpf(found) / truth - 1) < 1e-38


def test_pivots_that_are_numbers_are_not_tested_in_runs():
    y = ss.coordinates("y")[0]
    system = ss.MechanicalSystem(
        "pivots",
        coordinates=(x, y),
        kinetic=x.diff() ** 2 / 3 + 2 * y.diff() ** 2 * (1 + x**2) / 7,
        potential=x**2 * y**2,
        parameters={},
    )
    text = ss.compile(system).source
    assert "abs(real(" not in text.partition("SIGNATURE")[2].partition("\ndef ")[0]
