"""What a field decides, and what it leaves open."""

import pytest
import sympy as sp

from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import Graph
from symsimpson.graph.read import SympyConverter
from symsimpson.graph.roots import dependent_radicands

x, y, z = sp.symbols("x y z", real=True)
a, b = sp.symbols("a b", positive=True)
ROOT = sp.sqrt(x**2 + y**2)
SQUARE = sp.sqrt(x**2 + 2 * x * y + y**2)

ZEROS = {
    "Pythagoras": sp.cos(x) ** 2 + sp.sin(x) ** 2 - 1,
    "half angle": 2 * sp.cos(x / 2) ** 2 - 1 - sp.cos(x),
    "addition": sp.cos(2 * x - y) - sp.cos(2 * x) * sp.cos(y) - sp.sin(2 * x) * sp.sin(y),
    "multiples that are not rational": sp.cos(sp.sqrt(2) * x + y)
    - sp.cos(sp.sqrt(2) * x) * sp.cos(y)
    + sp.sin(sp.sqrt(2) * x) * sp.sin(y),
    "tangent": sp.tan(x) - sp.sin(x) / sp.cos(x),
    "a root and its square": x**2 / ROOT + y**2 / ROOT - ROOT,
    "exponentials": sp.exp(x + y) - sp.exp(x) * sp.exp(y),
    "hyperbolic": sp.cosh(x) ** 2 - sp.sinh(x) ** 2 - 1,
    "binomial": (x + y) ** 3 - sp.expand((x + y) ** 3),
    "dyadic floats": sp.Float(0.25) * x + sp.Float(0.5) * x - sp.Float(0.75) * x,
}
NOT_ZEROS = {
    "a sign of a root": SQUARE - (x + y),
    "signs of roots": sp.sqrt(x * y) - sp.sqrt(x) * sp.sqrt(y),
    "a root alone": sp.sqrt(x**2 + 1) - x,
    "floats are what they are": sp.Float(0.1) * x + sp.Float(0.2) * x - sp.Float(0.3) * x,
    "a small difference": sp.cos(x) ** 2 + sp.sin(x) ** 2 - 1 - sp.Float(1e-30) * x,
    "inverse of the cosine": sp.acos(sp.cos(x)) - x,
}


def read(*expressions):
    graph = Graph()
    symbols = sorted(set().union(*(e.free_symbols for e in expressions)), key=str)
    reader = SympyConverter(graph, {s: graph.symbol(s.name) for s in symbols})
    return graph, [reader(e) for e in expressions]


@pytest.mark.parametrize("name", ZEROS)
def test_zero(name):
    graph, (value,) = read(ZEROS[name])
    assert IdentityTest(graph, [value]).vanishes(value)


@pytest.mark.parametrize("name", NOT_ZEROS)
def test_not_zero(name):
    graph, (value,) = read(NOT_ZEROS[name])
    assert not IdentityTest(graph, [value]).vanishes(value)


def test_radicands_of_which_a_product_is_a_square():
    graph, values = read(SQUARE, sp.sqrt(x * y) + sp.sqrt(x) + sp.sqrt(y))
    assert len(dependent_radicands(graph, [values[0][1]])) == 1
    assert len(dependent_radicands(graph, [values[1][1]])) == 3


def test_three_distances_are_independent():
    points = [sp.symbols(f"u{i} v{i} w{i}") for i in range(3)]
    distances = [
        sp.sqrt(sum((s - t) ** 2 for s, t in zip(points[i], points[j], strict=True)))
        for i in range(3)
        for j in range(i)
    ]
    graph, values = read(*distances)
    assert not dependent_radicands(graph, [n for _, n in values])


def test_the_hole_of_roots_would_be_met():
    """Without the test of radicands, two points of the field call the difference zero at times."""
    graph, (value,) = read(SQUARE - (x + y))
    from symsimpson.graph.field import Evaluation, PrimeField

    zeros = [not Evaluation(graph, [value[1]], PrimeField(seed))[value] for seed in range(40)]
    assert 5 < sum(zeros) < 35


def test_dependence_is_found_by_moving():
    graph, (value,) = read(x * (sp.cos(y) ** 2 + sp.sin(y) ** 2) + z**2)
    findings = IdentityTest(graph, [value])
    places = [graph.symbol(s)[1] for s in "xyz"]
    assert [findings.depends(value, n) for n in places] == [True, False, True]
    freed = findings.drop_symbols(value, places)
    assert graph.nodes[freed[1]].symbols == {places[0], places[2]}


def test_second_differences_tell_what_is_linear():
    straight = x * (sp.cos(z) ** 2 + sp.sin(z) ** 2) + 3 * y - 2
    graph, values = read(straight, x * y, (x + y) ** 3 - sp.expand((x + y) ** 3) + x)
    places = [graph.symbol(s)[1] for s in "xy"]
    assert IdentityTest(graph, values).affine(values, places) == [True, False, True]
