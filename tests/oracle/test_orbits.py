"""Periodic orbits against values of 25 digits, and the orders of all that belongs to an orbit."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.orbit_cases import PROBLEMS, declared, found, numbers, walker

import symsimpson as ss

ORBITS = [name for name, x in PROBLEMS.items() if x.get("kind") in ("periodic", "forced")]
ORBITS = [name for name in ORBITS if "guess" in PROBLEMS[name]]


def multipliers_of(name):
    return np.array([complex(*numbers(x)) for x in PROBLEMS[name]["multipliers"]])


@pytest.mark.parametrize("name", sweep(ORBITS, 1))
def test_golden_orbits(name):
    g = PROBLEMS[name]
    expect = {k: 5 * float(v) for k, v in g["expect"].items() if k not in ("scheme", "steps")}
    orbit = found(name, "gauss8", g["expect"]["steps"])
    assert orbit.status is ss.OrbitStatus.FOUND, orbit.message
    assert orbit.iterations <= 8
    assert orbit.unfolding < 1e-12
    assert abs(orbit.trivial) < 1e-10
    assert abs(orbit.period - float(g["period"])) <= max(expect["period"], 1e-14)
    if "state" in expect:
        off = [*(orbit.q0 - numbers(g["q0"])), *(orbit.p0 - numbers(g["p0"]))]
        assert np.abs(off).max() <= max(expect["state"], 1e-14)
    if "energy" in expect:
        assert abs(orbit.energy - float(g["energy"])) <= expect["energy"]
    if "indices_relative" in expect:
        indices = np.sort(numbers(g["stability_indices"]))
        # a rounding of the state changes the index by this part
        rounding = np.finfo(float).eps * np.abs(orbit.derivative).max()
        off = np.sort(orbit.stability_indices.real) / indices - 1
        assert np.abs(off).max() <= max(expect["indices_relative"], rounding)
    else:
        off = [np.abs(orbit.multipliers - l).min() for l in multipliers_of(name)]
        assert max(off) <= max(expect["multipliers"], 1e-14)


@pytest.mark.slow
def test_corrections_fall_quadratically():
    """From a guess with an error of 1 %, in scaled units."""
    stepper = ss.compile(declared("nnm_in_phase"), "gauss8")
    orbit = stepper.periodic(
        [1.01, 1.2], [0.0, 0.02], period=5.87, steps=64, fixed={"x1": 1, "v_x1": 0}
    )
    assert orbit.success
    a, b, c = orbit.corrections[-3:]
    assert b < 30 * a**2
    assert c < max(30 * b**2, 1e-14)


ORDERS = [
    (name, scheme, order)
    for name in ("lyapunov_L1", "nnm_in_phase", "henon_heiles_a", "duffing_high", "van_der_pol_1")
    for scheme, order in (("midpoint", 2), ("simpson", 4), ("lobatto6", 6), ("gauss8", 8))
]
#: Pairs of numbers of steps, at which errors are far above round-off.
PAIRS = {"midpoint": (512, 1024), "simpson": (192, 384), "lobatto6": (64, 128), "gauss8": (24, 48)}
OTHER_PAIRS = {("lyapunov_L1", "gauss8"): (32, 48), ("van_der_pol_1", "gauss8"): (48, 64)}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scheme", "order"), sweep(ORDERS, 4))
def test_orders(name, scheme, order):
    g, errors = PROBLEMS[name], []
    pair = OTHER_PAIRS.get((name, scheme), PAIRS[scheme])
    for steps in pair:
        orbit = found(name, scheme, steps)
        assert orbit.success, orbit.message
        off = [*(orbit.q0 - numbers(g["q0"])), *(orbit.p0 - numbers(g["p0"]))]
        here = [np.abs(off).max()]
        if g["kind"] == "periodic":
            here.append(abs(orbit.period - float(g["period"])))
        here.append(max(np.abs(orbit.multipliers - l).min() for l in multipliers_of(name)))
        errors.append(here)
    observed = np.log(np.array(errors[0]) / errors[1]) / np.log(pair[1] / pair[0])
    assert np.abs(observed - order).max() < 0.15, observed


@pytest.mark.slow
def test_a_gait_and_its_period_doubling(tmp_path):
    g, doubling = PROBLEMS["compass_gait"], PROBLEMS["compass_gait_doubling"]
    system, landing = walker()
    stepper = ss.compile(system, "gauss8")
    guess = g["guess"]
    orbit = stepper.periodic(
        numbers(guess["q0"]), numbers(guess["v0"]), h=0.02, period=0.7324, events=[landing]
    )
    assert orbit.status is ss.OrbitStatus.FOUND
    assert abs(orbit.period - float(g["period"])) < 1e-14
    assert np.abs(orbit.q0 - numbers(g["q0"])).max() < 1e-13
    off = [np.abs(orbit.multipliers - l).min() for l in multipliers_of("compass_gait")]
    assert max(off) < 5e-14
    family = orbit.family("slope", to=0.08, count=30)
    assert family.status is ss.FamilyStatus.REACHED
    (place,) = family.bifurcations
    assert place.kind == "period doubling"
    assert abs(place.value - float(doubling["slope"])) < 1e-12
    family.save(tmp_path / "gaits.npz")
    (again,) = stepper.open_family(tmp_path / "gaits.npz", events=[landing]).bifurcations
    assert abs(again.value - place.value) < 1e-12
    other = family.switch(place, count=3, to=0.085)
    assert other[0].success
    lengths = other[0].search.run(other[0], every=1).events("landing").t
    first, second = np.diff([0, *lengths])
    assert abs(first - second) > 1e-3


@pytest.mark.slow
def test_folds_of_a_driven_oscillator():
    stepper = ss.compile(declared("duffing_low"), "gauss8")
    (w,) = (a for a in declared("duffing_low").parameters if a.name == "w")
    orbit = stepper.periodic([0.5], [0.0], period=2 * sp.pi / w, steps=48, parameters={"w": 1.1})
    family = orbit.family("w", to=1.8, count=300)
    folds = sorted(x.value for x in family.bifurcations if x.kind == "fold")
    truth = [float(PROBLEMS[f"duffing_fold_{k}"]["w"]) for k in (2, 1)]
    np.testing.assert_allclose(folds, truth, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_lamberts_problem():
    g = PROBLEMS["lambert"]
    for scheme, order, steps in (("simpson", 4, 48), ("gauss8", 8, 8)):
        stepper, errors = ss.compile(declared("lambert"), scheme), []
        for factor in (1, 2):
            path = stepper.boundary(
                numbers(g["start"]), numbers(g["end"]), duration=2.0, steps=factor * steps
            )
            assert path.success
            errors.append(np.abs(path.v0 - numbers(g["v0"])).max())
        assert abs(np.log2(errors[0] / errors[1]) - order) < 0.15 + 0.3 * (order == 8)


@pytest.mark.slow
def test_the_family_of_the_pendulum():
    """T = 4 K(sin^2(a/2)) for amplitudes a from 0.1 to 3.1."""
    special = pytest.importorskip("scipy.special")
    stepper = ss.compile(ss.systems.pendulum(), "gauss16")
    orbit = stepper.periodic(
        [0.1],
        [0.0],
        period=2 * np.pi,
        steps=32,
        fixed={"v_theta": 0},
        parameters={"m": 1, "l": 1, "g": 1},
    )
    family = orbit.family("energy", to=-np.cos(3.1), count=500)
    assert family.status is ss.FamilyStatus.REACHED
    truth = 4 * special.ellipk(np.sin(family["theta"] / 2) ** 2)
    assert np.abs(family["period"] / truth - 1).max() < 1e-12


@pytest.mark.slow
def test_halo_orbits_branch_off_planar_ones():
    """Of the Earth and the Moon; the catalogue of JPL begins at the Jacobi constant 3.17434."""
    x, y, z = ss.coordinates("x y z")
    mu = sp.Symbol("mu", positive=True)
    vx, vy, vz = x.diff(), y.diff(), z.diff()
    first = sp.sqrt((x + mu) ** 2 + y**2 + z**2)
    second = sp.sqrt((x - 1 + mu) ** 2 + y**2 + z**2)
    L = ((vx - y) ** 2 + (vy + x) ** 2 + vz**2) / 2 + (1 - mu) / first + mu / second
    system = ss.MechanicalSystem.from_lagrangian(
        "earth_moon", L, (x, y, z), {mu: 1.215058560962404e-02}
    )
    stepper = ss.compile(system, "gauss8")
    planar = stepper.periodic(
        mode=([0.8369151257723572, 0, 0], 1), size=0.01, steps=96, fixed={"y": 0}
    )
    assert planar.success
    assert abs(planar.q0[2]) < 1e-12
    family = planar.family("energy", to=-1.58, count=100)
    (place,) = family.bifurcations
    assert place.kind == "branch point"
    assert abs(-2 * place.value - 3.17435) < 1e-4
    halo = family.switch(place, count=10)
    assert all(orbit.success for orbit in halo)
    assert abs(halo["z"]).min() > 1e-4
