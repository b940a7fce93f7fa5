"""Extrapolation of the midpoint rule in many digits."""

import mpmath
import pytest

from symsimpson.reference.extrapolation import extrapolate


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e7])
def test_units_of_time_make_no_steps(unit):
    """From a first step of 1/16 on, a way of 1e7 took more than the most steps allowed."""
    rate = 1 / mpmath.mpf(unit)
    with mpmath.workdps(40):
        end = mpmath.mpf(unit) * 3
        ((q, p),) = extrapolate(
            lambda y: [rate * y[1], -rate * y[0]], [mpmath.mpf(1), mpmath.mpf(0)], [end], 1e-30, 30
        )
        angle = rate * end
        assert abs(q - mpmath.cos(angle)) < 1e-28
        assert abs(p + mpmath.sin(angle)) < 1e-28
