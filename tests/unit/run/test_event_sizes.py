"""Zeros of expressions are told from rounding, however large they were before."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.program.observed import ObservedExpression

(x,) = ss.coordinates("x")
FREE = ss.MechanicalSystem("free", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0)


def met(expression, start, rate, *, h, steps):
    stay = ss.Change(velocities={x: x.diff()})
    run = ss.compile(FREE).integrate(
        [start], v0=[rate], h=h, steps=steps, events=[ss.Event(expression, name="met", action=stay)]
    )
    return run.events("met").t


@pytest.mark.parametrize("h", [0.01, 0.07])
@pytest.mark.parametrize(
    ("expression", "start"),
    [
        (sp.exp(40 * x) - 1, 1.0),  # 2e17 times as large as where it is zero
        ("exp(-40*x) - 1", -1.0),
        (x**9, 1.0),
        (1e-20 * x, 1.0),
        (1e20 * x - 1e-3 * sp.exp(50 * x) + 1e-3, 1.0),
    ],
)
def test_a_zero_is_met_once(expression, start, h):
    found = met(expression, start, -start, h=h, steps=int(1.9 / h))
    assert found == pytest.approx([1.0], abs=1e-13)


@pytest.mark.parametrize("h", [0.03, 0.1])
def test_what_only_becomes_small_is_no_zero(h):
    assert met(sp.exp(30 * x), 1.0, -1.0, h=h, steps=int(2 / h)).size == 0


def test_rounding_is_no_zero():
    """A difference of what is equal: its signs are those of rounding."""
    rounded = sp.sin(x) ** 2 + sp.cos(x) ** 2 - 1
    assert met(rounded, 0.3, 1.0, h=0.01, steps=500).size == 0


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("q_0", "abs(q_0)"),
        ("q_0 - 1.0", "abs(q_0) + abs(1.0)"),
        ("-q_0*p_0 + exp(q_0) - (t - 2)", "abs(-q_0 * p_0) + abs(exp(q_0)) + abs(t) + abs(2)"),
    ],
)
def test_size_of_a_sum(text, size):
    assert ObservedExpression("", text, False).size == size
    names = {"q_0": 0.3, "p_0": -2.0, "t": 5.0, "exp": np.exp}
    assert eval(size, names) >= abs(eval(text, names))
