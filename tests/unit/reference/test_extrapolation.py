"""Extrapolation of the midpoint rule in many digits."""

import mpmath
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.reference import canonical, truth
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


@pytest.mark.parametrize(("mass", "size"), [(1.0, 1.0), (2e-27, 1e-10), (6e24, 1e11)])
def test_tolerances_do_not_depend_on_units(mass, size):
    """A Duffing oscillator from rest, in its own units and in those of atoms and planets."""
    (x,) = ss.coordinates("x")
    m, a = sp.symbols("m a", positive=True)
    potential = m * (x**2 / 2 + x**4 / (4 * a**2))
    system = ss.MechanicalSystem(
        "duffing",
        coordinates=(x,),
        kinetic=m * x.diff() ** 2 / 2,
        potential=potential,
        parameters={m: mass, a: size},
    )
    found = truth(canonical(system), [size, 0], [2, 4], digits=12)
    units = [size, mass * size]
    assert max(error / unit for error, unit in zip(found.errors, units, strict=True)) < 1e-8
    right = [0.5026550421025530, 1.1024603586732359]  # x and v at t = 4, with 24 digits
    for value, unit, number in zip(found.y[-1], units, right, strict=True):
        assert abs(value / unit - number) < 1e-9
