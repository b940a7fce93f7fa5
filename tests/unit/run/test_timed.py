"""Derivatives of retimed runs against differences of many digits, at the end of the run."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss

KEPLER, PENDULUM = ss.systems.kepler_plane(), ss.systems.double_pendulum()
COMET = {"q0": ["1.6", "0"], "v0": ["0.1", "0.6"], "h": "0.3", "t_end": "3"}
CASES = {
    "kepler": (KEPLER, "encounters", "simpson", COMET, ("mu", "m"), 3),
    "kepler, last state": (KEPLER, "encounters", "gauss8", COMET, ("mu",), None),
    "rate with E0": (
        PENDULUM,
        "kinetic",
        "simpson",
        {"q0": ["0.8", "1"], "v0": ["0.1", "0.6"], "h": "0.03", "t_end": "0.3"},
        ("l1", "g"),
        1,
    ),
}
DIGITS, SMALL = 40, 13


def ends(stepper, every, **how):
    run = stepper.integrate(**how, every=every)
    return np.concatenate([run.q[-1], run.p[-1]])


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(CASES, 1))
def test_variations_and_sensitivities(name):
    system, rate, scheme, how, names, every = CASES[name]
    with mp.workdps(DIGITS):
        stepper = ss.compile(system.retimed(rate), scheme, precision=DIGITS)
        size, small = 2 * system.n, mp.mpf(10) ** -SMALL
        how = {
            key: np.array([mp.mpf(x) for x in value], dtype=object)
            if isinstance(value, list)
            else mp.mpf(value)
            for key, value in how.items()
        }
        run = stepper.integrate(**how, every=every, tangents=size, sensitivities=names)
        p0 = stepper.integrate(how["q0"], v0=how["v0"], h=how["h"], steps=0).p[0]
        start = {key: how[key] for key in ("h", "t_end")}
        for k in range(size):
            d = np.array([small * (i == k) for i in range(size)], dtype=object)
            up, down = (
                ends(stepper, every, q0=how["q0"] + x[: system.n], p0=p0 + x[system.n :], **start)
                for x in (d, -d)
            )
            wanted = (up - down) / (2 * small)
            assert max(abs(wanted - run.tangent[-1][:, k])) < 1e-23 * max(1, *abs(wanted))
        for key in names:
            value = mp.mpf({str(a): x for a, x in system.parameters.items()}[key])
            up, down = (
                ends(stepper, every, **how, parameters={key: value + x}) for x in (small, -small)
            )
            wanted = (up - down) / (2 * small)
            assert max(abs(wanted - run.sensitivity[key][-1])) < 1e-23 * max(1, *abs(wanted))
    assert len(run.tangent) == len(run)


@pytest.mark.slow
def test_doubles_have_what_many_digits_have():
    how = {
        "q0": [1.6, 0.0],
        "v0": [0.1, 0.6],
        "h": 0.3,
        "t_end": 3.0,
        "tangents": 4,
        "sensitivities": "mu",
    }
    few = ss.compile(KEPLER.retimed("encounters"), "gauss8").integrate(**how)
    many = ss.compile(KEPLER.retimed("encounters"), "gauss8", precision=30).integrate(**how)
    np.testing.assert_allclose(few.tangent, many.tangent.astype(float), rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        few.sensitivity["mu"], many.sensitivity["mu"].astype(float), rtol=0, atol=1e-12
    )


@pytest.mark.slow
def test_one_step_is_differentiated_as_it_is_taken():
    stepper = ss.compile(KEPLER.retimed("encounters"), "simpson")
    q, p, h = np.array([1.6, 0.0]), np.array([0.1, 0.6]), 0.3
    q1, p1, D = stepper.tangent(q, p=p, h=h, wrt=("q", "p", "mu"))
    end = stepper.integrate(q, p0=p, h=h, steps=1)
    np.testing.assert_array_equal(q1, end.q[1])
    np.testing.assert_array_equal(p1, end.p[1])
    small = 1e-6
    for k in range(4):
        d = small * np.eye(4)[k]
        up, down = (np.concatenate(stepper.step(q + x[:2], p=p + x[2:], h=h)) for x in (d, -d))
        np.testing.assert_allclose(D[:, k], (up - down) / (2 * small), rtol=0, atol=1e-8)


(X,) = ss.coordinates("X")
K, LAMBDA = sp.symbols("k lambda", positive=True)


def oscillator(symbol):
    return ss.MechanicalSystem(
        "oscillator",
        coordinates=(X,),
        kinetic=X.diff() ** 2 / 2,
        potential=symbol * X**2 / 2,
        parameters={symbol: 1.0},
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "rate", "names"),
    [
        (oscillator(K), "kinetic", ("c_rest", "k")),
        pytest.param(oscillator(LAMBDA), 1 / (1 + X**2), ("lambda",), marks=pytest.mark.slow),
    ],
)
def test_parameters_of_the_rate_and_with_names_of_python(system, rate, names):
    stepper = ss.compile(system.retimed(rate))
    how = {"v0": [0.3], "h": 0.05, "t_end": 1.0}
    run = stepper.integrate([1.0], **how, sensitivities=names)
    for found in run.sensitivity.values():
        assert np.isfinite(found).all()
    for name, own in zip(names, run.sensitivity.values(), strict=True):
        up, down = (
            ends(stepper, 1, q0=[1.0], **how, parameters={name: 1.0 + x}) for x in (1e-6, -1e-6)
        )
        np.testing.assert_allclose(own[-1], (up - down) / 2e-6, rtol=0, atol=1e-8)


def test_an_end_by_less_than_rounding_behind_a_step():
    stepper = ss.compile(oscillator(K).retimed(sp.Integer(1)))
    how = {"v0": [0.0], "h": 0.25, "t_end": 4.5, "tangents": 2}
    some, every = (stepper.integrate([1.0], **how, every=n) for n in (7, 1))
    np.testing.assert_allclose(some.tangent[-1], every.tangent[-1], rtol=0, atol=1e-14)


def test_what_follows_from_the_start_is_no_parameter(tmp_path):
    system = oscillator(K).retimed(sp.Integer(1))
    stepper = ss.compile(system)
    for name in ("E0", "g_start"):
        with pytest.raises(ss.InputError, match="follows from the initial state"):
            stepper.integrate([1.0], v0=[0.0], h=0.25, t_end=1.0, sensitivities=name)
    with pytest.raises(ss.GenerationError, match="more than one module"):
        ss.generate(system, directory=tmp_path, derivatives=())
    loaded = ss.load(ss.generate(system, directory=tmp_path))
    with pytest.raises(ss.InputError, match="this module has no derivatives of its runs"):
        loaded.integrate([1.0], v0=[0.0], h=0.25, t_end=1.0, tangents=2)


def test_what_is_not_there_is_refused():
    stepper = ss.compile(KEPLER.retimed("encounters"), "simpson")
    with pytest.raises(ss.InputError, match="gradients of costs"):
        stepper.gradient([1.6, 0.0], v0=[0.0, 0.6], h=0.1, t_end=1.0, cost="x", wrt="q")
    with pytest.raises(ss.InputError, match="Lyapunov exponents"):
        stepper.lyapunov([1.6, 0.0], v0=[0.0, 0.6], h=0.1, steps=40)
    with pytest.raises(ss.InputError, match="derivatives of ensembles"):
        stepper.ensemble([[1.6, 0.0]], v0=[[0.0, 0.6]], h=0.1, t_end=1.0, tangents=4)
    with pytest.raises(ss.SchemeError, match="kicks and drifts"):
        ss.compile(KEPLER.retimed("encounters"), "kahan_li8").integrate(
            [1.6, 0.0], v0=[0.0, 0.6], h=0.1, t_end=1.0, tangents=4
        )


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.0, 0.4])
def test_the_kinetic_rate_does_not_depend_on_units(start):
    """A pendulum from rest and with a velocity, in units of atoms, too."""
    m, g = sp.symbols("m g", positive=True)
    system = ss.MechanicalSystem(
        "pendulum_units",
        coordinates=(X,),
        kinetic=m * X.diff() ** 2 / 2,
        potential=-m * g * sp.cos(X),
        parameters={m: 1.0, g: 1.0},
    )
    stepper, runs = ss.compile(system.retimed("kinetic"), "gauss8"), []
    for mass, second in ((1.0, 1.0), (1e-27, 1e-15), (6e24, 3.2e7)):
        how = {"v0": [start / second], "h": 0.2 * second, "t_end": 10.0 * second}
        run = stepper.integrate([1.5], **how, parameters={"m": mass, "g": second**-2})
        runs.append((run.steps, run.t / second, run.q[:, 0]))
    for steps, t, q in runs[1:]:
        assert steps == runs[0][0]
        np.testing.assert_allclose(t, runs[0][1], rtol=1e-9)
        np.testing.assert_allclose(q, runs[0][2], atol=1e-9)
    assert np.diff(runs[0][1]).min() < 0.1  # and it adapts


@pytest.mark.parametrize("how", [{"steps": 3}, {"t_end": 2e20}])
def test_a_first_step_that_is_lost_in_rounding(how):
    stepper = ss.compile(oscillator(K).retimed(sp.Integer(1)))
    with pytest.raises(ss.InputError, match="below round-off"):
        stepper.integrate([1.0], v0=[0.0], h=0.1, t0=1e20, **how)


def _thrown(constant=0.0):
    m, g = sp.symbols("m g", positive=True)
    return ss.MechanicalSystem(
        "stone",
        coordinates=(X,),
        kinetic=m * X.diff() ** 2 / 2,
        potential=m * g * X + constant,
        parameters={m: 1.0, g: 9.81},
    ).retimed("kinetic")


@pytest.mark.slow
@pytest.mark.parametrize("mass", [1.0, 1e-27, 1e24])
@pytest.mark.parametrize("speed", [0.0, 10.0])
def test_a_stone_from_where_no_energy_is_known(mass, speed):
    """At rest at the origin E0 = V = 0."""
    run = ss.compile(_thrown(), "gauss8").integrate(
        [0.0], v0=[speed], h=0.1, t_end=3.0, parameters={"m": mass}
    )
    assert run.q[-1, 0] == pytest.approx(3 * speed - 9.81 * 4.5, abs=1e-4)


@pytest.mark.slow
def test_a_constant_in_the_potential_does_not_change_the_kinetic_rate():
    how = {"v0": [10.0], "h": 0.1, "t_end": 3.0}
    runs = [ss.compile(_thrown(C), "gauss8").integrate([0.0], **how) for C in (0, 1000)]
    assert runs[0].steps == runs[1].steps
    np.testing.assert_allclose(runs[0].t, runs[1].t, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1.5e11])
@pytest.mark.parametrize("constant", [0.0, 3.0])
@pytest.mark.parametrize("mass", [1.0, 1e-27, 1e24])
def test_the_kinetic_rate_resolves_an_eccentric_orbit(unit, constant, mass):
    x, y = ss.coordinates("x y")
    m, GM = sp.symbols("m GM", positive=True)
    C = sp.Symbol("C", real=True)
    system = ss.MechanicalSystem(
        "kepler_units",
        coordinates=(x, y),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=m * (C - GM / sp.sqrt(x**2 + y**2)),
        parameters={m: mass, GM: 1.0, C: constant / unit},
    )
    start, speed, period = [-1.95 * unit, 0.0], -((0.05 / 1.95) ** 0.5), 2 * np.pi * unit**1.5
    run = ss.compile(system.retimed("kinetic"), "gauss12").integrate(
        start, v0=[0.0, speed / unit**0.5], h=period / 30, t_end=3 * period
    )
    assert run.steps == pytest.approx(390, abs=10)
    np.testing.assert_allclose(run.q[-1] / unit, [-1.95, 0.0], atol=1e-9)
