"""Functions of points: every function that energies may have, and its derivatives."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

pytest.importorskip("scipy")

from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.plain import Symbols
from symsimpson.graph.point_functions import PointFunctions
from symsimpson.graph.read import FUNCTIONS

(q,) = ss.coordinates("q")
a = sp.Symbol("a", positive=True)
INSIDE = {sp.acosh: 2, sp.log: 1}


def read(expression):
    symbols = Symbols((q,), {a: 1.0})
    allowed = (*symbols.q, *symbols.v, *symbols.a)
    value = read_expression("points", "cost", expression, symbols, symbols.known, allowed)
    variables = symbols.numbers((*symbols.q, *symbols.a))
    return PointFunctions(symbols.graph, variables, [value]), variables


@pytest.mark.parametrize(
    "expression",
    [
        *(f(q / 3 + INSIDE.get(f, 0)) * a for f in FUNCTIONS if f is not sp.atan2),
        sp.atan2(q, a),
        (1 + q**2) ** sp.Rational(1, 3) + a**q,
        sp.sqrt(a + q**2) / q + sp.pi * q**-3 - sp.EulerGamma * a,
        q + 2,
        sp.Integer(3),
    ],
)
def test_values_and_derivatives(expression):
    functions, variables = read(expression)
    points = np.array([[0.3, 0.7, 1.1], [1.3, 0.4, 2.0]])
    at = dict(zip(variables, points, strict=True))
    plain = sp.sympify(expression).subs(q, sp.Symbol("q", real=True))
    symbols = sp.Symbol("q", real=True), a

    def right(value):
        return np.array([float(value.subs(dict(zip(symbols, x, strict=True)))) for x in points.T])

    assert np.abs(functions.values(at, 3)[0] - right(plain)).max() < 1e-13
    slopes = dict(zip(functions.slopes, functions.slopes_at(at, 3), strict=True))
    curved = functions.curvatures_at(at, np.full((1, 3), 2.0), 3)
    curvatures = dict(zip(functions.curved, curved, strict=True))
    for i, x in enumerate(symbols):
        slope = right(plain.diff(x))
        assert np.abs(slopes.get((0, i), 0 * slope) - slope).max() < 1e-12
        for j, z in enumerate(symbols[: i + 1]):
            curve = 2 * right(plain.diff(x, z))
            assert np.abs(curvatures.get((i, j), 0 * curve) - curve).max() < 1e-11
