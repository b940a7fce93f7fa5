"""Mass matrices that lose their definiteness along a run, and passages where they are small."""

import pickle
import warnings

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

m, k = sp.symbols("m k", positive=True)
VALUES = {m: 1.0, k: 0.1}


def rocket():
    """A mass m - k t, which runs out at t = 10, where x = -10 log(1 - t/10) is infinite."""
    (x,) = ss.coordinates("x")
    return ss.MechanicalSystem(
        "rocket",
        coordinates=(x,),
        kinetic=(m - k * ss.time) * x.diff() ** 2 / 2,
        potential=0,
        parameters=VALUES,
    )


def pair():
    """Of two masses one runs out at t = 10."""
    x, y = ss.coordinates("x y")
    return ss.MechanicalSystem(
        "pair",
        coordinates=(x, y),
        kinetic=m * x.diff() ** 2 / 2 + (m - k * ss.time) * (x.diff() + y.diff()) ** 2 / 2,
        potential=(x**2 + y**2) / 2,
        parameters=VALUES,
    )


def narrowing():
    """M = x: with T = 1/200, x^(3/2) = 1 - 3 t/20 is 0 at t = 20/3."""
    (x,) = ss.coordinates("x")
    return ss.MechanicalSystem(
        "narrowing", coordinates=(x,), kinetic=x * x.diff() ** 2 / 2, potential=0, parameters={}
    )


#: Systems, where they begin, and when their M is singular.
ENDINGS = (
    (rocket, {"q0": [0.0], "v0": [1.0]}, 10.0),
    (pair, {"q0": [0.0, 1.0], "v0": [1.0, 0.0]}, 10.0),
    (narrowing, {"q0": [1.0], "v0": [-0.1]}, 20 / 3),
)
ROCKET = {"q0": [0.0], "v0": [1.0], "h": 0.5}


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(rocket())


@pytest.mark.parametrize("every", [1, 4, None])
def test_a_mass_that_runs_out_ends_the_run(stepper, every):
    with pytest.raises(ss.ConvergenceError, match=r"at t=9.5 .*singular or indefinite") as caught:
        stepper.integrate(**ROCKET, t_end=12.0, every=every)
    error = caught.value
    assert (error.status, error.step, error.time) == (ss.Status.SINGULAR_LEGENDRE, 19, 9.5)
    run = error.trajectory
    assert run.t[-1] == (8.0 if every == 4 else 9.5)
    assert run.q[-1, 0] == pytest.approx(-10 * np.log(1 - run.t[-1] / 10), rel=1e-2)


def test_so_it_ends_loops_and_members(stepper):
    loop = stepper.start(**ROCKET)
    for _ in range(19):
        loop.step()
    with pytest.raises(ss.ConvergenceError, match="singular or indefinite"):
        loop.step()
    assert loop.steps == 19
    with pytest.raises(ss.ConvergenceError, match="singular or indefinite"):
        stepper.step([46.0], p=[1.0], h=0.5, t=9.75)
    rates = np.array([0.1, 0.05, 0.2])
    given = ROCKET | {"q0": [[0.0]] * 3}
    many = stepper.ensemble(**given, t_end=12.0, parameters={"k": rates})
    assert many.status.tolist() == [ss.Status.SINGULAR_LEGENDRE, 0, ss.Status.SINGULAR_LEGENDRE]
    assert many.steps.tolist() == [19, 24, 9]
    assert many.q[1, 0] == pytest.approx(-20 * np.log(1 - 12 / 20), rel=1e-5)


@pytest.mark.parametrize("unit", [1e-27, 1e24])
def test_units_do_not_matter(stepper, unit):
    given = {"parameters": {"m": unit, "k": unit / 10}, "on_failure": "return"}
    run = stepper.integrate(**ROCKET, t_end=12.0, **given)
    assert (run.status, run.steps) == (ss.Status.SINGULAR_LEGENDRE, 19)


def ends_there(scheme, make, start, end):
    run = ss.compile(make(), scheme).integrate(**start, h=0.1, t_end=12.0, on_failure="return")
    assert run.status is ss.Status.SINGULAR_LEGENDRE, (scheme, make)
    assert end - 0.11 < run.t[-1] < end
    assert np.isfinite(run.v).all()
    if make is narrowing:
        assert run.q[-1, 0] == pytest.approx((1 - 0.15 * run.t[-1]) ** (2 / 3), rel=3e-2)


@pytest.mark.slow
def test_of_newton_schemes():
    for scheme in ("midpoint", "simpson", "lobatto6", "radau5"):
        for ending in ENDINGS:
            ends_there(scheme, *ending)


@pytest.mark.slow
def test_of_schemes_by_stages():
    for scheme in ("gauss6", "gauss8", "gauss16"):
        for ending in ENDINGS:
            ends_there(scheme, *ending)


@pytest.mark.slow
def test_with_constraints_what_they_allow_matters():
    """The mass of a bob on a circle runs out; that along y does not matter where y = 0."""
    x, y = ss.coordinates("x y")
    mass = m - k * ss.time
    both, across = x.diff() ** 2 + y.diff() ** 2, m * x.diff() ** 2 + mass * y.diff() ** 2
    bob = {
        "kinetic": mass * both / 2,
        "potential": mass * y,
        "constraints": {"rod": x**2 + y**2 - 1},
    }
    bead = {"kinetic": across / 2, "potential": x**2 / 2, "constraints": {"rail": y}}
    for scheme in ("simpson", "gauss8"):
        runs = []
        for about, q0 in ((bob, [0.0, -1.0]), (bead, [1.0, 0.0])):
            system = ss.MechanicalSystem("held", coordinates=(x, y), parameters=VALUES, **about)
            given = {"v0": [0.0, 0.0], "h": 0.1, "t_end": 12.0, "on_failure": "return"}
            runs.append(ss.compile(system, scheme).integrate(q0, **given))
        assert [run.status.name for run in runs] == ["SINGULAR_LEGENDRE", "SUCCESS"]
        assert runs[0].t[-1] == pytest.approx(9.9)
        assert runs[1].q[-1, 0] == pytest.approx(np.cos(12.0), abs=1e-6)


@pytest.mark.slow
def test_of_runs_of_all_kinds():
    (x,) = ss.coordinates("x")
    given = {"q0": [0.0], "v0": [1.0], "h": 0.1}
    kinds = (
        {"tangents": 1},
        {"sensitivities": ("m",)},
        {"t_eval": [1.0, 11.0]},
        {"events": ss.Event(x - 2.0, name="far")},
    )
    for scheme in ("simpson", "gauss8"):
        stepper = ss.compile(rocket(), scheme)
        for more in kinds:
            run = stepper.integrate(**given, t_end=12.0, on_failure="return", **more)
            assert run.status is ss.Status.SINGULAR_LEGENDRE, more
        with pytest.raises(ss.ConvergenceError, match="singular or indefinite"):
            stepper.lyapunov(**given, steps=120)
        with pytest.raises(ss.ConvergenceError, match="singular or indefinite"):
            stepper.gradient(**given, steps=120, cost=x**2, wrt=("m",))


@pytest.mark.slow
def test_of_retimed_systems_a_mass_and_a_rate_that_vanish_are_told_apart():
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "sledge",
        coordinates=(x,),
        kinetic=(m - k * x) * x.diff() ** 2 / 2,
        potential=0,
        parameters=VALUES,
    )
    for rate, status in ((1 + x**2 / 50, "SINGULAR_LEGENDRE"), (1 - x / 5, "RATE_NOT_POSITIVE")):
        stepper = ss.compile(system.retimed(rate), "gauss8")
        run = stepper.integrate([0.0], v0=[1.0], h=0.3, t_end=12.0, on_failure="return")
        assert run.status.name == status


@pytest.mark.slow
def test_a_pole_is_noticed_whatever_is_stored():
    """The pendulum swings through the lowest point, where phi turns by pi within a step."""
    stepper = ss.compile(ss.systems.spherical_pendulum(), "gauss8")
    given = {"h": 0.05, "steps": 200}
    for every in (1, 7, None):
        with pytest.warns(ss.ResolutionWarning, match="singular point of the coordinates"):
            stepper.integrate([1.0, 0.0], p0=[0.0, 1e-4], every=every, **given)
    p0 = np.tile([0.0, 0.3], (300, 1))
    p0[177, 1] = 1e-4
    with pytest.warns(
        ss.ResolutionWarning, match="member 177, and possibly others: .*singular point"
    ):
        stepper.ensemble([1.0, 0.0], p0=p0, **given)
    wide = {"h": 0.01, "steps": 2000, "every": None}
    assert stepper.integrate([1.0, 0.0], p0=[0.0, 0.3], **wide).success  # in silence


#: From here the pendulum passes 3e-5 rad from the pole.
NEAR_POLE = {"q0": [1.0, 0.0], "p0": [0.0, 1e-4], "h": 0.05}
UNRESOLVED = "singular point of the coordinates, near theta="


@pytest.fixture(scope="module")
def pendulum():
    return ss.compile(ss.systems.spherical_pendulum())


def driven_pendulum():
    theta, phi = ss.coordinates("theta phi")
    u = sp.Symbol("u")
    return ss.MechanicalSystem(
        "driven",
        coordinates=(theta, phi),
        kinetic=(theta.diff() ** 2 + sp.sin(theta) ** 2 * phi.diff() ** 2) / 2,
        potential=-9.81 * sp.cos(theta),
        forces={theta: u},
        inputs=(u,),
    )


def take(loop, count, *given):
    """Return at which of so many steps a loop warns."""
    warned = []
    for number in range(count):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            loop.step(*given)
        warned += [number] * len(told)
    return warned


@pytest.mark.slow
def test_loops_notice_a_pole_once(pendulum):
    """The bob is at the lowest point at 0.54 s; steps ahead show that from 0.5 s on."""
    loop = pendulum.start(**NEAR_POLE)
    assert take(loop, 9) == []
    assert take(pickle.loads(pickle.dumps(loop)), 40) == [0]
    with pytest.warns(ss.ResolutionWarning, match=UNRESOLVED):
        loop.step()
    assert take(loop, 390) == []
    wide = NEAR_POLE | {"p0": [0.0, 0.3], "h": 0.01}
    assert take(pendulum.start(**wide), 400) == []


@pytest.mark.slow
def test_ensembles_notice_a_pole_wherever_they_are(pendulum, tmp_path):
    p0 = np.tile([0.0, 2.0], (9, 1))
    p0[7] = NEAR_POLE["p0"]
    given = NEAR_POLE | {"p0": p0, "steps": 400}
    for more in ({}, {"store": tmp_path / "s"}, {"every": None}):
        with pytest.warns(ss.ResolutionWarning, match=f"member 7.*{UNRESOLVED}"):
            pendulum.ensemble(**given, **more)


@pytest.mark.slow
def test_runs_with_inputs_notice_a_pole():
    stepper = ss.compile(driven_pendulum())
    inputs = 0.0, np.zeros(400), lambda t: 0.0 * t
    for every in (1, 13, None):
        for u in inputs:
            with pytest.warns(ss.ResolutionWarning, match=UNRESOLVED):
                stepper.integrate(**NEAR_POLE, steps=400, every=every, inputs={"u": u})
    assert take(stepper.start(**NEAR_POLE), 40, 0.0) == [9]
    wide = NEAR_POLE | {"p0": [0.0, 0.3], "h": 0.01}
    for every in (1, 13, None):  # in silence
        stepper.integrate(**wide, steps=400, every=every, inputs={"u": lambda t: np.sin(t) / 9})


@pytest.mark.slow
def test_a_regular_motion_is_not_run_again(monkeypatch):
    """The axis of the top comes to 0.047 rad from the vertical, in steps of 0.008 rad."""
    top = ss.systems.lagrange_top()
    stepper = ss.compile(top)
    again = []
    for steps in (5000, 100_000):
        run = stepper.integrate(**top.reference_state, h=0.001, steps=steps, every=None)
        with monkeypatch.context() as patch:
            patch.setattr("symsimpson.run.verdict.Request", lambda *x, **_: again.append(x))
            same = stepper.integrate(**top.reference_state, h=0.001, steps=steps, every=None)
        assert again == []
        assert (same.q == run.q).all()
