"""Zeros within a step: Ridders' method, and places from which Newton's method begins."""

import math

import pytest

from symsimpson.text.driver import impacts


@pytest.fixture
def ridders(monkeypatch):
    """Returns the method for a function of one number, as Python runs it."""

    def find(function, low, high, ends, size):
        monkeypatch.setattr(impacts, "value_at", lambda means, start, t, x, *more: function(x))
        return impacts.ridders.py_func(None, None, 0.0, (low, high), ends, 0, size, None)

    return find


@pytest.mark.parametrize(
    ("function", "low", "high", "zero"),
    [
        (lambda x: x**3 - 2, 0.0, 2.0, 2 ** (1 / 3)),
        (lambda x: 2 - x**3, 2.0, 0.0, 2 ** (1 / 3)),
        (lambda x: math.exp(40 * x) - 2, -1.0, 1.0, math.log(2) / 40),
        (lambda x: 1e-200 * (x - 0.3), 0.0, 1.0, 0.3),
        (lambda x: math.atan(1e6 * (x - 0.1)), -3.0, 5.0, 0.1),
    ],
)
def test_zeros_are_found_to_rounding_in_few_evaluations(function, low, high, zero, ridders):
    taken = []

    def counted(x):
        taken.append(x)
        return function(x)

    found = ridders(counted, low, high, (function(low), function(high)), 1e-15)
    assert abs(found - zero) < 2e-15
    assert len(taken) <= 120


def test_ends_and_places_without_a_value(ridders):
    assert ridders(lambda x: x - 1, 0.0, 1.0, (-1.0, 0.0), 1e-12) == 1.0
    assert math.isnan(ridders(lambda x: math.nan, 0.0, 1.0, (-1.0, 1.0), 1e-12))
    assert math.isnan(ridders(lambda x: 1 / (x - 0.3) * math.inf, 0.0, 1.0, (-1.0, 1.0), 1e-12))
    jump = ridders(lambda x: 1.0 if x > 0.3 else -1.0, 0.0, 1.0, (-1.0, 1.0), 1e-12)
    assert abs(jump - 0.3) < 1e-12


def test_a_cubic_is_left_on_the_side_where_it_began():
    """With zero at the start, where an impact has just been, it is the later zero."""
    zero_of_cubic = impacts.zero_of_cubic.py_func
    assert abs(zero_of_cubic(0.0, -1.0, 2.0, -4.0, 1.0) - 2 / 3) < 1e-8  # 2 x - 3 x^2
    assert abs(zero_of_cubic(1.0, -1.0, -2.0, -2.0, 1.0) - 0.5) < 1e-8
    assert abs(zero_of_cubic(-1.0, 1.0, 2.0, 2.0, -1.0) - 0.5) < 1e-8
