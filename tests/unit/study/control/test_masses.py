"""Solutions along which something has no mass."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss

pytest.importorskip("casadi")

x, y = ss.coordinates("x y")
u, m, M = sp.symbols("u m M", real=True)


def cart(mass, **more):
    system = ss.MechanicalSystem(
        "cart",
        coordinates=(x,),
        kinetic=m * x.diff() ** 2 / 2,
        potential=0,
        forces={x: u},
        inputs=(u,),
        parameters={m: mass},
    )
    ends = {"start": {x: 0, x.diff(): 0}, "end": {x: 1, x.diff(): 0}}
    return ss.OptimalControl(system, cost=u**2, duration=1, **ends, **more)


@pytest.mark.parametrize("mass", [0.0, -1.0])
def test_what_has_no_mass_follows_no_force(mass):
    found = cart(mass).solve(steps=5)
    assert found.status is ss.ControlStatus.NO_MASS
    assert "not positive definite" in found.message
    assert not found.success


def test_a_mass_that_is_found_may_not_vanish():
    unbounded = cart(1.0, unknowns={m: (-1, 1)}).solve(steps=5)
    assert unbounded.status is ss.ControlStatus.NO_MASS
    light = cart(1.0, unknowns={m: (1e-12, 1)}).solve(steps=5)
    assert light.status is not ss.ControlStatus.NO_MASS


def test_poles_of_coordinates_are_passed():
    """Through the origin of polar coordinates, where M is singular."""
    polar = ss.MechanicalSystem(
        "polar",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + x**2 * y.diff() ** 2) / 2,
        potential=0,
        forces={x: u},
        inputs=(u,),
    )
    rest = {x.diff(): 0, y: 0, y.diff(): 0}
    problem = ss.OptimalControl(polar, cost=u**2, start={x: 0, **rest}, end={x: 1}, duration=1)
    found = problem.solve(steps=5)
    assert found.success
    assert found.cost == pytest.approx(3, rel=1e-9)


@pytest.mark.parametrize("mass", sweep([0.0, 2.0]))
def test_constraints_hold_what_has_no_mass(mass):
    """A bob on a rod without mass of its own: M is definite on what the constraint allows."""
    pair = ss.MechanicalSystem(
        "pair",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + M * y.diff() ** 2) / 2,
        potential=0,
        forces={x: u},
        inputs=(u,),
        constraints={"rod": x - y - 1},
        parameters={M: mass},
    )
    ends = {"start": {x: 1, y: 0, x.diff(): 0, y.diff(): 0}, "end": {x: 2, x.diff(): 0}}
    found = ss.OptimalControl(pair, cost=u**2, duration=1, **ends).solve(steps=5)
    assert found.success
    assert found.cost == pytest.approx(12 * (1 + mass) ** 2, rel=1e-9)
    assert np.abs(found.q[:, 0] - found.q[:, 1] - 1).max() < 1e-12
