"""Driven linear systems: no iteration, and the same path."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss

t = ss.time
a, b, c, k, w = sp.symbols("a b c k w", positive=True)
x, y, z = ss.coordinates("x y z")
VALUES = {a: 0.3, c: 0.1, k: 2.0, w: 1.7}


def driven(friction=True):
    """A drive, friction, a magnetic field and a force that turns: all that is linear."""
    lost = c * (x.diff() ** 2 + (x.diff() - y.diff()) ** 2) / 2
    forces = {"drive": {x: a * sp.cos(w * t)}}
    turn = w * (x * y.diff() - y * x.diff()) if friction else 0
    kinetic = x.diff() ** 2 / 2 + x.diff() * y.diff() / 4 + y.diff() ** 2
    return ss.MechanicalSystem.from_lagrangian(
        "driven_oscillators",
        kinetic + turn - k * (x**2 + x * y + y**2) / 2,
        coordinates=(x, y),
        forces=forces | ({"turn": {x: -c * y, y: c * x}} if friction else {}),
        dissipation=lost if friction else None,
        parameters=VALUES,
    )


SCHEMES = ["simpson", "gauss4", "midpoint", "lobatto6", "gauss6", "gauss8", "radau3"]


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(SCHEMES))
@pytest.mark.parametrize("friction", sweep([True, False]))
def test_no_iteration_gives_the_same_path(scheme, friction):
    system = driven(friction)
    assert [s.affine for s in system.structure.subsystems] == [True]
    runs = [
        ss.compile(system, scheme, exploit=e).integrate([1, 0], [0, 0.4], h=0.05, steps=2000)
        for e in ("all", ())
    ]
    assert runs[0].program.header.newton_unknowns == 0
    assert runs[1].program.header.newton_unknowns > 0
    for name in ("q", "p", "energy_balance"):
        first, second = (getattr(run, name) for run in runs)
        assert np.abs(first - second).max() < 5e-14
    assert np.abs(runs[0].work["drive"] - runs[1].work["drive"]).max() < 5e-14
    many = [
        ss.compile(system, scheme, exploit=e, precision=40).integrate(
            [1, 0], [0, 0.4], h=0.05, steps=5
        )
        for e in ("all", ())
    ]
    assert np.abs(many[0].q - many[1].q).max() < 1e-36


@pytest.mark.slow
def test_rounded_factors_do_not_add_up():
    """The residual of the path takes out what they do wrong, which is the same in all steps."""
    ends = [
        ss.compile(driven(friction=False), "gauss4", exploit=e)
        .integrate([1, 0], [0, 0.4], h=0.05, steps=400_000, every=None)
        .q
        for e in ("all", ())
    ]
    assert np.abs(ends[0] - ends[1]).max() < 2e-13


@pytest.mark.slow
def test_other_coordinates_are_iterated_beside():
    """A pendulum that nothing couples to a driven oscillator with an input."""
    u = sp.Symbol("u")
    system = ss.MechanicalSystem(
        "both",
        coordinates=(x, z),
        kinetic=x.diff() ** 2 / 2 + z.diff() ** 2 / 2,
        potential=k * x**2 / 2 - sp.cos(z),
        forces={"push": {x: u - c * x.diff()}, "drag": {z: -c * z.diff() ** 3}},
        inputs=(u,),
        parameters={c: 0.1, k: 2.0},
    )
    assert [s.affine for s in system.structure.subsystems] == [True, False]
    runs = [
        ss.compile(system, "simpson", exploit=e).integrate(
            [1, 0.5], [0, 0.4], h=0.05, steps=200, inputs=np.sin(np.arange(200.0))
        )
        for e in ("all", ())
    ]
    assert runs[0].program.header.newton_unknowns == 2
    for name in ("q", "p", "energy_balance"):
        first, second = (getattr(run, name) for run in runs)
        assert np.abs(first - second).max() < 5e-14
    assert np.abs(runs[0].work["push"] - runs[1].work["push"]).max() < 5e-14


@pytest.mark.slow
def test_friction_in_proportion_to_momenta_is_solved_at_once():
    system = ss.MechanicalSystem(
        "damped",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=k * x**2 / 2,
        dissipation=c * x.diff() ** 2 / 2,
        parameters={c: 0.1, k: 2.0},
    )
    steppers = [ss.compile(system, exploit=e) for e in (("all", "conformal"), "conformal")]
    assert [s.program.header.newton_unknowns for s in steppers] == [0, 2]
    assert all(s.program.header.conformal for s in steppers)
    assert not ss.compile(system).program.header.conformal
    runs = [s.integrate([1], [0.4], h=0.05, steps=2000) for s in steppers]
    assert np.abs(runs[0].p - runs[1].p).max() < 1e-14


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("the stiffness depends on t", {"potential": k * (1 + sp.cos(w * t) / 2) * x**2 / 2}),
        ("the force is not linear", {"potential": k * x**4}),
        ("friction is not linear", {"forces": {x: -(x.diff() ** 3)}}),
        ("friction depends on t", {"forces": {x: -sp.cos(w * t) * x.diff()}}),
        ("the mass depends on t", {"kinetic": (2 + sp.cos(w * t)) * x.diff() ** 2 / 2}),
        ("no force acts", {"forces": None}),
    ],
)
def test_what_is_not_affine(what, changes):
    given = {
        "kinetic": x.diff() ** 2 / 2,
        "potential": k * x**2 / 2,
        "forces": {x: a * sp.cos(w * t)},
    } | changes
    system = ss.MechanicalSystem("other", coordinates=(x,), parameters=VALUES, **given)
    assert not system.structure.subsystems[0].affine, what
