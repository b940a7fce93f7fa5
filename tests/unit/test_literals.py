"""Whole numbers that no int64 holds, in functions of floats."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.reference.first_order import canonical
from symsimpson.support.literals import float_literals

BIG = sp.Integer(5) * 10**24
x, y = ss.coordinates("x y")


def test_only_what_is_too_large_is_replaced():
    small = [3 * x, (x / 7, sp.Matrix([sp.Integer(2**62)]))]
    assert float_literals(small) == small
    value = float_literals(sp.Matrix([BIG * x, x / BIG])).subs(x, 2)
    assert value.atoms(sp.Integer) == set()
    assert list(map(float, value)) == [1e25, 4e-25]


@pytest.mark.parametrize("scheme", ["simpson", "gauss8"])
def test_large_energies_run(scheme):
    system = ss.MechanicalSystem(
        "big", coordinates=(x,), kinetic=5e24 * x.diff() ** 2 / 2, potential=5e24 * x**2 / 2
    )
    run = ss.compile(system, scheme).integrate([1.0], v0=[0.0], h=0.01, steps=100)
    assert abs(run.q[-1, 0] - np.cos(1)) < 1e-9


def test_large_numbers_beside_constraints_and_in_a_mass_that_varies():
    rod = ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=BIG * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=BIG * y,
        constraints={"rod": BIG * (x**2 + y**2 - 1)},
    )
    run = ss.compile(rod).integrate([1.0, 0.0], v0=[0.0, 0.0], h=0.01, steps=10)
    assert np.ptp(run.energy) < 1e-7 * 5e24
    mass = BIG * (2 + sp.sqrt(BIG + y**2) / sp.sqrt(BIG))
    system = ss.MechanicalSystem(
        "varying",
        coordinates=(x, y),
        kinetic=mass * x.diff() ** 2 / 2 + BIG * y.diff() ** 2 / 2,
        potential=BIG * x**2 / 2,
    )
    run = ss.compile(system).integrate([1.0, 0.0], v0=[0.0, 1.0], h=0.01, steps=100)
    assert abs(run.q[-1, 0] - np.cos(1 / np.sqrt(3))) < 1e-8


def test_large_numbers_in_equations():
    system = ss.MechanicalSystem(
        "root",
        coordinates=(x,),
        kinetic=BIG * x.diff() ** 2 / 2,
        potential=BIG * sp.sqrt(BIG + x**2) * sp.sqrt(BIG),
    )
    A = system.linearise([0.0], v0=[0.0])[0]
    assert np.abs(A - [[0, 1], [-1, 0]]).max() < 1e-14
    rates = canonical(system).function("math")(0.5, 5e24)
    assert all(type(one) is float for one in rates)
