"""Expressions of users: long ones, deep ones, and numbers that have no value."""

from functools import cache

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.program.observed import read_expression

GIVEN = {"q0": [0.3, 0.4], "v0": [0.1, -0.2], "h": 0.01, "steps": 5}


@cache
def swing():
    return ss.compile(ss.systems.double_pendulum())


def highest(expression):
    return swing().integrate(**GIVEN, reduce={"m": ("max", expression)}).reduced["m"]


@pytest.mark.parametrize("count", [99, 100, 101, 250, 600])
def test_sums_of_any_length(count):
    """As that of the momenta of hundreds of bodies, with all kinds of signs."""
    q1, q2 = ss.systems.double_pendulum().coordinates
    run = swing().integrate(**GIVEN)
    a, b = run.q.T
    text = "q1-" + "-".join(["q2"] * (count - 2)) + "+q1"
    assert highest(text) == pytest.approx((2 * a - (count - 2) * b).max(), rel=1e-12)
    terms = [(-1) ** k * sp.sin(k * q1) * q2 for k in range(1, count + 1)]
    exact = sum((-1) ** k * np.sin(k * a) * b for k in range(1, count + 1))
    assert highest(sp.Add(*terms)) == pytest.approx(exact.max(), rel=1e-9)


def test_long_sums_are_zeros_events_and_costs():
    text = f"({'+'.join(['q1'] * 256)}) / 256"
    run, short = swing().integrate(**GIVEN, every=1), {"rel": 1e-12}
    found, wanted = (run.events(f"{x} - 0.3005") for x in (text, "q1"))
    assert found.t == pytest.approx(wanted.t, **short)
    acted = swing().integrate(**GIVEN, events=[ss.Event(f"{text} - 0.3005", name="e")])
    assert acted.events("e").t == pytest.approx(wanted.t, rel=1e-6)  # its steps have parts
    slopes = (swing().gradient(**GIVEN, cost=f"({x})**2", wrt="q").gradient for x in (text, "q1"))
    assert next(slopes) == pytest.approx(next(slopes), **short)


def test_signs_of_one_rank_are_read_from_the_left():
    run = swing().integrate(**GIVEN)
    a, b = run.q.T
    for text, values in {
        "q1 - (q2 - q1) - q2": a - (b - a) - b,
        "q1 / q2 / (q1 / q2 * q1) * q2 % 0.2": a / b / (a / b * a) * b % 0.2,
        "-q1**2 - -q2": -(a**2) + b,
        "2**q1**q2 - (2**q1)**q2": 2 ** (a**b) - (2**a) ** b,
    }.items():
        assert highest(text) == pytest.approx(values.max(), rel=1e-14)


@pytest.mark.parametrize(
    "text",
    ["1/0", "sqrt(-1)*q1", "q1 + log(0)", "(-8)**(1/3)", "exp(1000)", "1e200*1e200", "5 % (1 - 1)"],
)
def test_numbers_without_a_value_are_refused(text):
    with pytest.raises(ss.InputError, match="in it has no value"):
        read_expression(swing().program, text)


@pytest.mark.parametrize("text", ["-" * 300 + "q1", "**".join(["q1"] * 201)])
def test_deep_nests_are_refused(text):
    with pytest.raises(ss.InputError, match="nested too deeply"):
        read_expression(swing().program, text)


def test_a_matrix_is_no_expression():
    matrix = sp.Matrix(ss.systems.double_pendulum().coordinates)
    with pytest.raises(ss.InputError, match="a matrix, not one expression"):
        read_expression(swing().program, matrix)
    with pytest.raises(ss.InputError, match="not one expression"):
        swing().gradient(**GIVEN, running=matrix, wrt="q")


def test_coordinates_to_wrap_in_an_array():
    run = swing().integrate(**GIVEN)
    assert len(run.events("q1 - 5", wrap=np.array([]))) == 0
    assert len(run.events("q1 - 5", wrap=np.array(["q1", "q2"]))) == 0
