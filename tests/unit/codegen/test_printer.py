"""Roots of sums: square roots alone, with the sums in parentheses."""

import math

import pytest
import sympy as sp

from symsimpson.codegen.printer import Printer

a, b = sp.symbols("a b", positive=True)


@pytest.mark.parametrize("power", ["1/2", "3/2", "-3/2", "1/4", "-1/4", "3/4", "-7/4", "5/4"])
@pytest.mark.parametrize("base", [a, a + b, a * b])
def test_roots(base, power):
    expression = 3 / (base ** sp.Rational(power) + 1)
    printer = Printer()
    text = printer.doprint(expression)
    assert "**(" not in text
    assert printer.used == {"sqrt"}
    values = {"a": 0.7, "b": 1.9}
    found = eval(text, {"sqrt": math.sqrt}, values)
    assert found == pytest.approx(float(expression.subs({a: 0.7, b: 1.9})), rel=1e-14)
