"""Sines and cosines that are written by those of other angles keep their values."""

import pytest
import sympy as sp

from symsimpson.discrete.angles import halve_angles, split_sums
from symsimpson.graph.nodes import Graph
from symsimpson.graph.read import SympyConverter, to_sympy
from symsimpson.graph.rebuild import rebuild

x, y = sp.symbols("x y", real=True)
AT = {x: 0.7, y: -1.3}


def rewritten(expression, replace):
    graph = Graph()
    known = {s: graph.symbol(s.name) for s in (x, y)}
    value = SympyConverter(graph, known)(expression)
    (new,) = rebuild(graph, [value], replace(graph, value))
    return to_sympy(graph, new, {n: s for s, (_, n) in known.items()})


@pytest.mark.parametrize("function", [sp.sin, sp.cos])
def test_halved(function):
    """Those of the angle itself alone: of twice the angle they stay."""
    old = function(x) * function(y) + function(2 * x)
    new = rewritten(old, lambda graph, _: halve_angles(graph, graph.numbers(["x"])))
    assert {f.args[0] for f in new.atoms(sp.sin, sp.cos)} == {x / 2, y, 2 * x}
    assert new.subs(AT) == pytest.approx(old.subs(AT), abs=1e-15)


@pytest.mark.parametrize("function", [sp.sin, sp.cos])
@pytest.mark.parametrize("angle", [x + y, x - y, 2 * x - y])
def test_summed(function, angle):
    old = function(angle) + sum(sp.sin(a) * sp.cos(a) for a in angle.args)
    new = rewritten(old, lambda graph, value: split_sums(graph, [value[1]]))
    assert not new.has(function(angle))
    assert new.subs(AT) == pytest.approx(old.subs(AT), abs=1e-15)
