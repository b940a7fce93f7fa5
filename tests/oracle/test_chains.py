"""Chains of rods: bands and families of terms give the steps that all entries do."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from support.index_one import index_one

import symsimpson as ss


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["simpson", pytest.param("gauss6", marks=pytest.mark.slow)])
def test_bands_give_the_steps_of_dense_matrices(scheme):
    """In 20 digits, so that nothing is compiled; with results that are made of constraints."""
    system = ss.systems.hanging_chain(6)
    banded, dense = (
        ss.compile(system, scheme, exploit=exploit, precision=20).integrate(
            **system.reference_state, h=0.02, steps=3
        )
        for exploit in ("all", ())
    )
    for name in ("q", "p", "multipliers", "constraint_forces"):
        assert max(abs(getattr(banded, name) - getattr(dense, name)).ravel()) < 1e-15, name
    assert max(abs(banded.constraint_error).ravel()) < 1e-19
    _, exact = index_one(system)(banded.q[-1].astype(float), banded.v[-1].astype(float))
    assert np.abs(banded.multipliers[-1].astype(float) - exact).max() < 1e-11


@pytest.mark.slow
def test_multipliers_where_the_mass_matrix_is_not_constant():
    """A chain in polar coordinates, whose accelerations at rest and in motion differ by M(q)."""
    r, angle = ss.coordinates("r1:7"), ss.coordinates("a1:7")
    points, joints = list(zip(r, angle, strict=True)), [(k, k + 1) for k in range(5)]
    system = ss.MechanicalSystem(
        "polar",
        coordinates=(*r, *angle),
        kinetic=sum(a.diff() ** 2 + a**2 * b.diff() ** 2 for a, b in points) / 2,
        potential=sum(a * sp.cos(b) for a, b in points),
        constraints=[
            r[i] ** 2 + r[k] ** 2 - 2 * r[i] * r[k] * sp.cos(angle[i] - angle[k]) - 1
            for i, k in joints
        ],
    )
    near = [1, 1.5, 2, 2.5, 3, 3.5, 0, 0.5, 1.0, 1.3, 1.6, 1.8]
    q0, v0 = system.consistent(near, np.cos(np.arange(12.0)))
    stepper = ss.compile(system, precision=20)
    assert not stepper.program.header.unrolled
    run = stepper.integrate(q0, v0, h=0.01, steps=1)
    for k in (0, 1):
        _, exact = index_one(system)(run.q[k].astype(float), run.v[k].astype(float))
        assert np.abs(run.multipliers[k].astype(float) - exact).max() < 1e-11 * np.abs(exact).max()


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 10])
def test_rods_move_as_angles_do(n):
    """Two formulations of one model, the second with n coordinates and a full M(q)."""
    chain, angles = ss.systems.hanging_chain(n), ss.systems.n_pendulum(n)
    rods = ss.compile(chain, "gauss8").integrate(**chain.reference_state, h=0.01, steps=100)
    names = [name for name in angles.parameters if str(name).startswith("l")]
    free = ss.compile(angles, "gauss8").integrate(
        **angles.reference_state, h=0.01, steps=100, parameters=dict.fromkeys(names, 1.0)
    )
    x, y = np.cumsum(np.sin(free.q), axis=1), -np.cumsum(np.cos(free.q), axis=1)
    assert np.abs(rods.q[:, ::2] - x).max() < 1e-9
    assert np.abs(rods.q[:, 1::2] - y).max() < 1e-9
    assert np.abs(rods.energy - free.energy).max() < 1e-9
    assert rods.newton_iterations.sum() <= 3.1 * len(rods)


@pytest.mark.slow
def test_long_chains_hang_still_and_stay_on_their_rods():
    """Increments as small as rounding, at positions far from 0: Newton's method must end."""
    system = ss.systems.hanging_chain(200)
    stepper = ss.compile(system)
    still = np.zeros(400)
    still[1::2] = -np.arange(1, 201)
    run = stepper.integrate(still, v0=0 * still, h=0.01, steps=50)
    assert np.abs(run.q - still).max() < 1e-11
    run = stepper.integrate(**system.reference_state, h=0.01, steps=200)
    assert np.abs(run.constraint_error).max() < 4e-16 * 200
    assert np.ptp(run.energy) < 1e-6 * np.abs(run.energy).max()
    assert run.newton_iterations.max() <= 6


@pytest.mark.slow
@pytest.mark.parametrize(
    "scheme", ["suzuki4", *(pytest.param(x, marks=pytest.mark.slow) for x in ("kahan_li6",))]
)
def test_compositions_of_rattle_keep_their_order(scheme):
    """In 25 digits: errors fall by the order; positions and velocities stay allowed."""
    system = ss.systems.cartesian_pendulum()
    stepper = ss.compile(system, scheme, precision=25)
    ends = [
        stepper.integrate(**system.reference_state, h=f"{0.32 / k}", steps=k) for k in (8, 16, 32)
    ]
    errors = [float(max(abs(a.q[-1] - b.q[-1]))) for a, b in pairwise(ends)]
    assert abs(np.log2(errors[0] / errors[1]) - stepper.order) < 0.15
    assert max(abs(ends[0].constraint_error).ravel()) < 1e-23
    assert max(abs((ends[0].q * ends[0].p).sum(axis=1))) < 1e-22


def test_a_drift_may_end_where_all_coordinates_are_zero():
    """Rest at the origin has no size that a correction could be relative to."""
    x, y = ss.coordinates("x y")
    line = ss.MechanicalSystem(
        "line",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=x**2 / 2,
        constraints=[x - y],
    )
    stepper = ss.compile(line, "suzuki4", precision=20)
    assert not stepper.integrate([0, 0], [0, 0], h="0.1", steps=2).q.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        ("cartesian_pendulum", "suzuki4"),
        ("cartesian_pendulum", "kahan_li8"),
        ("hanging_chain", "suzuki4"),
    ],
)
def test_certificates_of_compositions(name, scheme):
    system = getattr(ss.systems, name)(*([2] if name == "hanging_chain" else []))
    certificate = ss.compile(system, scheme).certify(h=0.05)
    assert certificate.passed, certificate


@pytest.mark.slow
def test_compositions_follow_the_schemes_of_the_family():
    """A chain, whose loops are those of bands, and a drive in its forces."""
    x, y = ss.coordinates("x y")
    driven = ss.MechanicalSystem(
        "driven",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + 2 * y.diff() ** 2) / 2,
        potential=9.81 * y,
        forces={x: ss.time},
        constraints=[x**2 + y**2 - 1],
    )
    starts = {driven: {"q0": [0.6, -0.8], "v0": [0.8, 0.6]}}
    chain = ss.systems.hanging_chain(12)
    starts[chain] = chain.reference_state
    for system, start in starts.items():
        ends = [
            ss.compile(system, scheme).integrate(**start, h=0.005, steps=100)
            for scheme in ("kahan_li6", "gauss8")
        ]
        assert np.abs(ends[0].q - ends[1].q).max() < 1e-10
        assert np.abs(ends[0].p - ends[1].p).max() < 1e-8


def shuffled(count):
    """Return places of ``count`` things in an order that is not its own inverse."""
    return [(5 * k + 2) % count for k in range(count)]


def ring():
    """Return a ring of 17 pendula, one heavier than the others and one with a spring."""
    q, k, m = ss.coordinates("q:17"), *sp.symbols("k m", positive=True)
    return ss.MechanicalSystem(
        "ring",
        coordinates=q,
        kinetic=(sum(x.diff() ** 2 for x in q) + (m - 1) * q[2].diff() ** 2) / 2,
        potential=k * sum(1 - sp.cos(a - b) for a, b in pairwise((*q, q[0]))) + k * q[5] ** 2,
        parameters={k: 1.2, m: 1.5},
    )


def damped_ring():
    """Return that ring with friction between neighbours, and drag on one of them."""
    system, (k, m) = ring(), sp.symbols("k m", positive=True)
    q = system.coordinates
    rates = [k * (a.diff() - b.diff()) * (1 + a**2) / 9 for a, b in pairwise((*q, q[0]))]
    forces = {a: rates[i - 1] - rates[i] for i, a in enumerate(q)}
    forces[q[3]] -= m * q[3].diff() ** 3
    fields = {f.name: getattr(system, f.name) for f in dataclasses.fields(system) if f.init}
    return ss.MechanicalSystem(**fields | {"name": "damped_ring", "forces": forces})


def rods():
    """Return a chain of nine bobs on rods, whose names stand in another order."""
    x, y, k, m = ss.coordinates("x:9"), ss.coordinates("y:9"), *sp.symbols("k m", positive=True)
    bobs = [(x[i], y[i]) for i in shuffled(9)]
    ends = pairwise([(sp.S.Zero, sp.S.Zero), *bobs])
    return ss.MechanicalSystem(
        "rods",
        coordinates=(*x, *y),
        kinetic=(sum(a.diff() ** 2 for bob in bobs for a in bob) + (m - 1) * x[2].diff() ** 2) / 2,
        potential=sum(9.81 * b + k * (a - 1) ** 2 * b**2 for a, b in bobs),
        constraints=[(a - c) ** 2 + (b - d) ** 2 - 1 for (a, b), (c, d) in ends],
        parameters={k: 0.7, m: 1.3},
    )


def blades():
    """Return six blades on springs in a row, whose names stand in another order."""
    q, k, m = ss.coordinates("q:18"), *sp.symbols("k m", positive=True)
    bodies = [q[3 * i : 3 * i + 3] for i in (1, 4, 5, 0, 3, 2)]
    return ss.MechanicalSystem(
        "blades",
        coordinates=q,
        kinetic=(sum(a.diff() ** 2 for a in q) + (m - 1) * q[7].diff() ** 2) / 2,
        potential=k * sum((a - c) ** 2 + (b - d) ** 2 for (a, b, _), (c, d, _) in pairwise(bodies)),
        velocity_constraints=[x.diff() * sp.sin(a) - y.diff() * sp.cos(a) for x, y, a in bodies],
        parameters={k: 0.7, m: 1.3},
    )


@pytest.mark.slow
@pytest.mark.parametrize("make", [ring, damped_ring, rods, blades])
def test_the_order_of_coordinates_changes_nothing(make):
    """States, multipliers and all derivatives, where bands take coordinates in another order."""
    system = make()
    n = system.n
    rng = np.random.default_rng(3)
    q0, v0 = system.consistent(np.linspace(0.2, 1.9, n), rng.uniform(-0.3, 0.3, n))
    start, x = {"q0": q0, "v0": v0, "h": 0.01, "steps": 10}, system.coordinates[4]
    results = []
    for exploit in ("all", ()):
        stepper = ss.compile(system, exploit=exploit)
        order = np.array(stepper.program.header.coordinate_order)
        run = stepper.integrate(**start, tangents=3, sensitivities=("k", "m"))
        maps = stepper.linearise(**start, wrt=("k", "h"))
        gradient = stepper.gradient(**start, cost=x**3, running=x**2, wrt=("q", "v", "k", "m"))
        results.append(
            [
                *(run.q, run.p, run.energy, run.tangent, run.multipliers),
                *(run.sensitivity["k"], run.sensitivity["m"]),
                *(maps.by_state, maps.by_parameter["k"], maps.by_parameter["h"]),
                *(gradient.value, *gradient),
            ]
        )
        if exploit:  # a wrong turn of the order would be seen
            assert (order[order] != np.arange(n)).any()
    for banded, dense in zip(*results, strict=True):
        scale = np.abs(dense).max(initial=1.0)
        assert np.abs(np.subtract(banded, dense)).max(initial=0.0) < 1e-11 * scale


@pytest.mark.slow
def test_second_derivatives_and_shadow_energies_of_a_ring():
    system, rng = ring(), np.random.default_rng(3)
    q0, v0 = rng.uniform(-0.5, 0.5, (2, 17))
    nodes, weights = np.array([q0 + 0.02 * v0, q0 + 0.05 * v0]), rng.uniform(-1, 1, (3, 17))
    banded, dense = (ss.compile(system, exploit=exploit) for exploit in ("all", ()))
    second = [x.hessian(q0, nodes, 0.05, weights, wrt="k") for x in (banded, dense)]
    assert np.abs(np.subtract(*second)).max() < 1e-13
    shadow = banded.integrate(q0, v0=v0, h=0.05, steps=100).shadow_energy
    assert np.ptp(shadow) < 1e-8
