"""Roots of sums: square roots alone, with the sums in parentheses."""

import math

import pytest
import sympy as sp

from symsimpson.lower.expression import Expressions
from symsimpson.lower.printer import Printer

a, b = sp.symbols("a b", positive=True)


@pytest.mark.parametrize("power", ["1/2", "3/2", "-3/2", "1/4", "-1/4", "3/4", "-7/4", "5/4"])
@pytest.mark.parametrize("base", [a, a + b, a * b])
def test_roots(base, power):
    expression = 3 / (base ** sp.Rational(power) + 1)
    printer, graph = Printer(), Expressions()
    known = {symbol: graph.make_symbol(symbol.name) for symbol in (a, b)}
    text = printer.text(graph.read(expression, known))
    assert "**(" not in text
    assert printer.used == {"sqrt"}
    values = {"a": 0.7, "b": 1.9}
    found = eval(text, {"sqrt": math.sqrt}, values)
    assert found == pytest.approx(float(expression.subs({a: 0.7, b: 1.9})), rel=1e-14)


x, y = sp.symbols("x y", real=True)
WRITTEN = {
    x - y: "x - y",
    -x * y / 2: "-x*y/2",
    2 / (x * y): "2/(x*y)",
    x / (y - 3) ** 2: "x/(3 - y)**2",
    -(x + y) * x: "-x*(x + y)",
    (x - y) / -x: "-(x - y)/x",
    x ** sp.Rational(2, 3): "x**(2/3)",
    sp.Pow(x, y): "x**y",
    sp.exp(-x) + sp.pi: "pi + exp(-x)",
    sp.Float(0.1) * x: "0.1*x",
    1 / x - 1: "-1 + 1/x",
}


@pytest.mark.parametrize("expression", WRITTEN)
def test_parentheses_stand_where_they_are_needed(expression):
    graph = Expressions()
    known = {symbol: graph.make_symbol(symbol.name) for symbol in (x, y)}
    text = Printer().text(graph.read(expression, known))
    values = {"x": 0.3, "y": 0.9, "pi": math.pi, "exp": math.exp}
    assert eval(text, {}, values) == pytest.approx(float(expression.subs({x: 0.3, y: 0.9})))
    assert text == WRITTEN[expression]
