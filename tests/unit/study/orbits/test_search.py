"""Searches for orbits: outcomes, guesses, symmetric orbits, and rejected arguments."""

import signal

import numpy as np
import pytest
import sympy as sp
from support.orbit_cases import PROBLEMS, declared, found, numbers, walker

import symsimpson as ss
from symsimpson.study.orbits.shooting import Shooting

Status = ss.OrbitStatus


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(ss.systems.henon_heiles(), "gauss8")


@pytest.fixture(scope="module")
def orbit(stepper):
    return stepper.periodic(
        [0, 0.2551], [0.3355, 0], period=6.135, steps=48, fixed={"energy": 1 / 12, "x": 0}
    )


def test_an_orbit_and_what_it_has(orbit):
    assert orbit.status is Status.FOUND
    assert "closes up to round-off" in orbit.message
    assert orbit.stable
    assert orbit.energy == pytest.approx(1 / 12, abs=1e-14)
    assert orbit.h == orbit.period / 48
    run = orbit.trajectory
    assert np.abs(run.y[:, -1] - run.y[:, 0]).max() < 1e-13
    assert orbit.v0 == pytest.approx(run.v[0])
    finer = orbit.refined(2)
    assert finer.steps == 96
    assert abs(finer.period - 6.135235496129221) < abs(orbit.period - 6.135235496129221)
    assert "period 6.13" in repr(orbit)
    with pytest.raises(ss.InputError, match="no unstable manifold"):
        orbit.manifold()


def outcomes(stepper):
    """A search for each status, by the name of the status."""
    twice = {"period": 12.27, "steps": 96, "fixed": {"energy": 1 / 12, "x": 0}}
    oscillator = ss.compile(ss.systems.harmonic_oscillator(), "gauss8")
    (x,) = ss.coordinates("x")
    hill = ss.MechanicalSystem(
        "hill", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=-(x**4) / 4 - x**2 / 2
    )
    system, landing = walker()
    gait = ss.compile(system, "gauss8")
    start = {"v_p": ([0, 0.2551], [0.3355, 0])}["v_p"]
    return {
        "SHORTER": lambda: stepper.periodic(*start, **twice),
        "NOT_ISOLATED": lambda: oscillator.periodic([1.0], [0.0], period=6.2, steps=32),
        "NOT_CONVERGED": lambda: stepper.periodic(
            [0.31, -0.4], [0.2, 0.1], period=2.0, steps=32, fixed={"energy": 0.15}
        ),
        "STEP_FAILED": lambda: ss.compile(hill, "gauss8").periodic(
            [1.0], [0.5], period=5.0, steps=32
        ),
        "NOT_RESOLVED": lambda: stepper.periodic(*start, **twice | {"period": 6.135, "steps": 3}),
        "EQUILIBRIUM": lambda: stepper.periodic(
            [1e-3, 0], [0, 0], period=3.0, steps=32, fixed={"x": 0, "y": 0}
        ),
        "WRONG_EVENT": lambda: gait.periodic(
            [0.3, 0.2], [-0.1, -0.2], h=0.02, events=[landing], period=0.7
        ),
    }


NAMES = [
    *("SHORTER", "NOT_ISOLATED", "NOT_CONVERGED", "STEP_FAILED"),
    *("NOT_RESOLVED", "EQUILIBRIUM", "WRONG_EVENT"),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_each_status(stepper, name):
    result = outcomes(stepper)[name]()
    assert result.status is Status[name], result.message
    assert result.success == (name in ("SHORTER", "NOT_ISOLATED"))
    assert len(result.message) > 40
    if name == "SHORTER":
        assert result.primitive.period == pytest.approx(6.135235496129, abs=1e-9)


@pytest.mark.slow
def test_ctrl_c_returns_the_last_iterate(stepper, monkeypatch):
    sweep, calls = Shooting.sweep, []

    def interrupted(self, point):
        calls.append(point)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return sweep(self, point)

    monkeypatch.setattr(Shooting, "sweep", interrupted)
    result = stepper.periodic(
        [0, 0.26], [0.33, 0], period=6.0, steps=48, fixed={"energy": 1 / 12, "x": 0}
    )
    assert result.status is Status.INTERRUPTED
    assert result.iterations == 1
    np.testing.assert_array_equal(np.concatenate([result.q0, result.p0]), calls[1].states[0])


@pytest.mark.slow
def test_guesses_along_the_orbit(stepper, orbit):
    fixed = {"energy": 1 / 12, "x": 0}
    run = orbit.trajectory
    noise = 1e-2 * np.random.default_rng(1).normal(size=(2, 12, 2))
    table = run.q[:-1:4] + noise[0], run.p[:-1:4] + noise[1]
    for guess in (run, orbit, table):
        other = stepper.periodic(guess=guess, period=6.1, steps=48, fixed=fixed)
        assert other.success, other.message
        assert other.period == pytest.approx(orbit.period, abs=1e-11)


@pytest.mark.slow
def test_modes_of_an_equilibrium():
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system, "gauss8")
    A, _ = system.linearise([0.0, 0.0])
    frequencies = np.unique(np.abs(np.linalg.eigvals(A).imag).round(9))
    for k, w in enumerate(frequencies):
        mode = stepper.periodic(mode=([0.0, 0.0], k), size=0.01, steps=32)
        assert mode.success
        assert mode.period == pytest.approx(2 * np.pi / w, rel=1e-3)
    with pytest.raises(ss.InputError, match="has 2 oscillations"):
        stepper.periodic(mode=([0.0, 0.0], 2))


@pytest.mark.slow
def test_relative_and_symmetric_orbits():
    system = ss.systems.spherical_pendulum()
    theta, phi = system.coordinates
    a = sp.Symbol("a", real=True)
    turning = ss.compile(system, "gauss8").periodic(
        [1.0, 0],
        [0.0, 2.0],
        period=1.2,
        steps=48,
        fixed={theta: 1.0, theta.diff(): 0},
        conditions={phi: phi + a},
        unknowns=(a,),
    )
    assert turning.status is Status.FOUND
    assert turning.trajectory.q[-1, 1] == pytest.approx(turning.unknowns["a"], abs=1e-13)
    # three bodies change places after a third of the period
    eight = declared("figure_eight")
    x1, y1, x2, y2, x3, y3 = eight.coordinates
    guess, period = PROBLEMS["figure_eight"]["guess"], float(PROBLEMS["figure_eight"]["period"])
    third = ss.compile(eight, "gauss8").periodic(
        numbers(guess["q0"]),
        numbers(guess["v0"]),
        period=period / 3,
        steps=32,
        fixed={"period": period / 3},
        conditions={x1: x2, y1: y2, x2: x3, y2: y3, x3: x1, y3: y1},
    )
    assert third.status is Status.FOUND
    truth = [complex(*numbers(x)) for x in PROBLEMS["figure_eight"]["multipliers"]]
    assert max(np.abs(third.multipliers - x).min() for x in truth) < 1e-7


@pytest.mark.slow
def test_an_orbit_that_is_mirrored_in_time():
    g = PROBLEMS["halo_L2_south"]
    half = ss.compile(declared("halo_L2_south"), "gauss8").periodic(
        numbers(g["guess"]["q0"]),
        numbers(g["guess"]["v0"]),
        period=2.354,
        steps=384,
        fixed={"y": 0, "v_x": 0, "v_z": 0, "z": -0.20235953267405354},
        middle={"y": 0, "v_x": 0, "v_z": 0},
    )
    assert half.success, half.message
    assert half.period == pytest.approx(float(g["period"]), abs=1e-10)
    indices = np.sort(half.stability_indices.real)
    np.testing.assert_allclose(indices, np.sort(numbers(g["stability_indices"])), atol=1e-8)


@pytest.mark.slow
def test_retimed_systems_and_hamiltonians():
    system = ss.systems.henon_heiles()
    x, _ = system.coordinates
    stepper = ss.compile(system.retimed(1 / (1 + x**2)), "gauss12")
    orbit = stepper.periodic(
        [0, 0.2551], [0.3355, 0], h=0.1, period=6.135, fixed={"energy": 1 / 12, "x": 0}
    )
    assert orbit.success
    assert orbit.period == pytest.approx(6.135235496129221, abs=1e-12)
    trojan = ss.systems.restricted_three_bodies()
    start = trojan.reference_state
    orbit = ss.compile(trojan, "gauss8").periodic(start["q0"], p0=start["p0"], period=6.6, steps=64)
    assert orbit.status is Status.FOUND
    assert orbit.trivial < 1e-12


@pytest.mark.slow
def test_steps_are_doubled_until_the_error_is_small(stepper, orbit):
    coarse = stepper.periodic(
        [0, 0.2551],
        [0.3355, 0],
        period=6.135,
        steps=12,
        fixed={"energy": 1 / 12, "x": 0},
        error=1e-10,
    )
    assert coarse.success
    assert coarse.error <= 1e-10
    assert abs(coarse.period / 6.135235496129221 - 1) < 10 * coarse.error
    hopeless = ss.compile(ss.systems.henon_heiles(), "midpoint").periodic(
        guess=orbit, steps=64, fixed={"energy": 1 / 12, "x": 0}, error=1e-15
    )
    assert hopeless.status is Status.NOT_RESOLVED


WRONG = {
    "period": ({"period": -1}, "period is -1"),
    "many": (
        {"period": 6, "fixed": {"energy": 0.1, "x": 0, "y": 0.1}},
        "3 conditions, but at most 2",
    ),
    "name": ({"period": 6, "fixed": {"foo": 1}}, "unknown name 'foo'"),
    "no period": ({}, "needs the period"),
    "unknown": ({"period": 6, "unknowns": ("k",)}, "no parameter"),
    "steps": ({"period": 6, "steps": 0}, "steps is 0"),
    "square": ({"period": 6, "conditions": {"x": sp.Symbol("k") ** 2}}, "affine function"),
    "coordinate": ({"period": 6, "conditions": {"z": 1}}, "not a coordinate"),
    "symbol": ({"period": sp.Symbol("a")}, "the period contains a"),
    "error": ({"period": 6, "error": -1}, "error is -1"),
}


@pytest.mark.parametrize("case", WRONG.values(), ids=WRONG)
def test_rejected(stepper, case):
    given, message = case
    with pytest.raises(ss.InputError, match=message):
        stepper.periodic([0, 0.2], [0.3, 0], **given)


def test_rejected_systems(stepper):
    with pytest.raises(ss.InputError, match="needs a guess"):
        stepper.periodic(period=6)
    with pytest.raises(ss.InputError, match="constraints"):
        ss.compile(ss.systems.cartesian_pendulum()).periodic([0, -1], [0.1, 0], period=2)
    driven = ss.compile(declared("duffing_low"), "gauss8")
    with pytest.raises(ss.InputError, match="no period of the drive"):
        driven.periodic([0.5], [0.0], period=4.8)
    with pytest.raises(ss.InputError, match="energy of this system is not constant"):
        driven.periodic([0.5], [0.0], period=4.833219467061220, fixed={"energy": 1})
    with pytest.raises(ss.SchemeError, match="no derivatives"):
        ss.compile(ss.systems.henon_heiles(), "kahan_li8").periodic([0, 0.2], [0.3, 0], period=6)


def test_damped_and_driven_orbits():
    cycle = found("van_der_pol_1", "gauss8", 96)
    assert cycle.status is Status.FOUND
    assert cycle.trivial < 1e-12
    assert len(cycle.multipliers) == 1
    assert cycle.stability_indices.size == 0


@pytest.mark.slow
def test_boundaries():
    kepler = ss.compile(ss.systems.kepler_plane(), "gauss8")
    path = kepler.boundary([1.0, 0.0], [-0.5, 1.2], duration=2.0, steps=24)
    assert path.success
    assert path.trajectory.q[-1] == pytest.approx([-0.5, 1.2], abs=1e-13)
    free = kepler.boundary({"x": 1, "y": 0, "v_x": 0}, [-0.5, 1.2], duration=None, steps=24)
    assert free.success
    assert free.v0[0] == pytest.approx(0, abs=1e-12)
    failed = kepler.boundary([1.0, 0.0], [-1.0, 1e-3], duration=3.0)
    assert failed.status is Status.STEP_FAILED
    with pytest.raises(ss.InputError, match="shape"):
        kepler.boundary([1, 0, 0], [1, 2], duration=1)
    with pytest.raises(ss.InputError, match="duration is -1"):
        kepler.boundary([1, 0], [1, 2], duration=-1)
    with pytest.raises(ss.InputError, match="5 conditions, but at most 4"):
        kepler.boundary({"x": 1, "y": 0, "v_x": 0}, [-0.5, 1.2], duration=2.0)


def test_the_time_in_conditions_at_the_end():
    """An oscillator meets a point that moves: 3/2 sin T = T/2 + 1/5."""
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "spring", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=x**2 / 2
    )
    stepper = ss.compile(system, "gauss12")
    target = {x - ss.time / 2: 0.2}
    path = stepper.boundary({x: 0.0, x.diff(): 1.5}, target, duration=None, steps=16)
    assert path.success
    T = path.duration
    assert 1.5 * np.sin(T) == pytest.approx(T / 2 + 0.2, abs=1e-11)
    assert path.iterations <= 10
    fixed = stepper.boundary({x: 0.0}, target, duration=2.0, steps=16)
    assert fixed.v0[0] == pytest.approx(1.2 / np.sin(2), abs=1e-11)


def test_mirrored_orbits_keep_their_period():
    """Refinement, a family along the period, and a condition on it mean the whole period."""
    stepper = ss.compile(ss.systems.henon_heiles(), "gauss8")
    x, y = ss.systems.henon_heiles().coordinates
    half = {"fixed": {x: 0, y.diff(): 0}, "middle": {x: 0, y.diff(): 0}}
    start = [0, 0.25], [0.335, 0]
    given = {"period": 6.1, "steps": 48, **half}
    given["fixed"] = {**half["fixed"], "energy": 1 / 12}
    orbit = stepper.periodic(start[0], start[1], **given)
    assert orbit.success
    finer = orbit.refined(2)
    assert finer.steps == 2 * orbit.steps
    assert finer.period == pytest.approx(orbit.period, rel=1e-9)
    given["fixed"] = {**half["fixed"], "period": orbit.period}
    again = stepper.periodic(start[0], start[1], **given)
    assert again.period == pytest.approx(orbit.period, rel=1e-13)
    assert again.energy == pytest.approx(1 / 12, rel=1e-9)
    family = again.family("period", to=6.2)
    assert family["period"][-1] == pytest.approx(6.2, rel=1e-13)
    assert family[-1].trajectory.t[-1] == pytest.approx(6.2, rel=1e-13)


def test_tables_with_an_even_number_of_rows():
    """Four states of a circle are interpolated to eight without an error."""
    stepper = ss.compile(ss.systems.kepler_plane(), "gauss8")
    t = np.arange(4) * np.pi / 2
    q, p = np.stack([np.cos(t), np.sin(t)], 1), np.stack([-np.sin(t), np.cos(t)], 1)
    orbit = stepper.periodic(guess=(q, p), period=2 * np.pi, steps=64, fixed={"period": 2 * np.pi})
    assert orbit.success
    assert orbit.iterations <= 3


def test_unknowns_in_any_order():
    """Names belong to their values if they are not in the order of the parameters."""
    (x,) = ss.coordinates("x")
    a, b = sp.symbols("a b", positive=True)
    system = ss.MechanicalSystem(
        "spring",
        coordinates=(x,),
        kinetic=a * x.diff() ** 2 / 2,
        potential=b * x**2 / 2,
        parameters={a: 1.0, b: 2.0},
    )
    orbit = ss.compile(system, "gauss6").periodic(
        [1.0], [0.0], period=6.0, unknowns=("b", "a"), fixed={"period": 6.0, x: 1.0}
    )
    assert orbit.unknowns == {name: orbit.parameters[name] for name in ("a", "b")}
