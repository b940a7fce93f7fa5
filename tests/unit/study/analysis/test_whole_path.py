"""Runs with an error tolerance: what happens late, for a short time, or not at all."""

import math
import os
import re
import signal
import threading
import warnings

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.reference import rk4, second_order
from symsimpson.study.analysis.stability import stress

x, y = ss.coordinates("x y")
t, u = ss.time, sp.Symbol("u")
KINETIC = x.diff() ** 2 / 2
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error")]


@pytest.fixture(autouse=True)
def own_folder(monkeypatch, tmp_path):
    monkeypatch.setattr("symsimpson.program.cache.cache_folder", lambda: tmp_path)


def system(name, potential, **given):
    return ss.MechanicalSystem(
        name, coordinates=(x,), kinetic=KINETIC, potential=potential, **given
    )


def test_a_damped_swing_keeps_its_path():
    swing = system("damped_swing", -9.81 * sp.cos(x), dissipation=x.diff() ** 2 / 4)
    run = ss.integrate(swing, [3.0], v0=[0.0], t_end=300.0, error=1e-8)
    steps = round(20 / run.h)
    _, exact = rk4(second_order(swing), [3.0, 0.0], h=run.h / 1000, steps=1000 * steps, every=1000)
    assert np.abs(run.q[: steps + 1, 0] - exact[:, 0]).max() < 1e-7
    assert run.success
    assert 0 < run.error_estimate <= 1e-8
    assert f"{run.error_estimate:.1e}" in run.message


def test_a_wall_late_in_the_run():
    wall = ss.MechanicalSystem(
        "late_wall",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=sp.exp(40 * (x - 500)) + y**2 / 2,
    )
    run = ss.integrate(wall, [0.0, 1.0], v0=[0.1, 0.0], t_end=8000.0, error=1e-6)
    # x = X - log(cosh(20 v (t - t0))) / 20 about the turning point X
    turn = 500 + math.log(0.005) / 40
    back = (20 * turn + math.log(2)) / 2
    right = turn - (2 * (8000 - back) - math.log(2)) / 20
    assert abs(run.q[-1, 0] - right) < 1e-6 * 500
    assert run.success


@pytest.mark.parametrize("width", [0.1, 0.01])
def test_a_short_pulse_late_in_the_run(width):
    pulsed = system("pulsed", x**2 / 2, forces={x: 5 * sp.exp(-(((t - 50) / width) ** 2))})
    run = ss.integrate(pulsed, [1.0], v0=[0.0], t_end=100.0, error=1e-6)
    # the response to a pulse, and its Gaussian average
    kick = 5 * math.sqrt(math.pi) * width * math.exp(-(width**2) / 4)
    assert run.q[-1, 0] == pytest.approx(math.cos(100) + kick * math.sin(50), abs=3e-6)


def test_a_narrow_bump_on_a_free_flight():
    bump = system("bump", sp.exp(-((20 * (x - 300)) ** 2)) / 10)
    run = ss.integrate(bump, [0.0], v0=[1.0], t_end=1000.0, error=1e-7)
    # the energy gives the delay
    place = np.linspace(-1, 1, 200_001)
    slower = 1 / np.sqrt(1 - np.exp(-((20 * place) ** 2)) / 5) - 1
    assert run.q[-1, 0] == pytest.approx(1000 - slower.sum() * 1e-5, abs=2e-4)


def test_chaos_is_no_success(tmp_path):
    chaotic = ss.systems.double_pendulum()
    given = {"q0": [2.5, 2.9], "v0": [0, 0], "t_end": 30.0, "schemes": "gauss8"}
    for _ in range(2):  # also where the choice is known
        with pytest.warns(ss.ResolutionWarning, match=r"exceeds it from t = 1?\d\.?\d* on") as told:
            run = ss.integrate(chaotic, **given, error=1e-6, every=None)
    assert len(told) == 1
    assert told[0].filename == __file__
    assert re.match(
        r"\w+: The error is \S+; the tolerance is 1.0e-06. The error", str(told[0].message)
    )
    assert (run.success, run.status) == (False, ss.Status.TOLERANCE_NOT_MET)
    assert run.error_estimate > 1e-6
    run.save(tmp_path / "run.nc")
    again = ss.open_trajectory(tmp_path / "run.nc")
    assert (again.status, again.error_estimate) == (run.status, run.error_estimate)
    with pytest.raises(ss.InputError, match=r"too sensitive|no scheme reaches error=1e-06"):
        ss.choose(chaotic, **given, error=1e-6)


@pytest.mark.parametrize("ends", [(1e6, 1e6 + 20), (5.0, -15.0)])
def test_time_begins_anywhere_and_goes_both_ways(ends):
    driven = system("far", x**2 / 2, forces={x: sp.cos(2 * (t - ends[0]))})
    run = ss.integrate(driven, [1.0], v0=[0.0], t0=ends[0], t_end=ends[1], error=1e-9)
    assert run.t[[0, -1]] == pytest.approx(ends, rel=1e-15)
    passed = run.t - ends[0]
    exact = np.cos(passed) * 4 / 3 - np.cos(2 * passed) / 3
    assert run.q[:, 0] == pytest.approx(exact, abs=1e-7)


class Result:
    def __init__(self, functions):
        self.functions = functions

    def __repr__(self):
        return "Result"


def test_inputs_are_functions_of_time_or_arrays():
    cart = system("input_cart", x**2 / 2, forces={x: u}, inputs=(u,))
    given = {"q0": [0.0], "v0": [0.0], "t_end": 30.0, "error": 1e-9}
    for function in (lambda t: math.sin(t / 2), lambda t: np.sin(t / 2)):
        run = ss.integrate(cart, **given, inputs={"u": function})
        exact = 4 / 3 * np.sin(run.t / 2) - 2 / 3 * np.sin(run.t)
        assert run.q[:, 0] == pytest.approx(exact, abs=1e-8)
    for sign in (1, -1):  # results of optimal control look alike and are not stored
        result = Result({"u": lambda t, sign=sign: sign * np.sin(t / 2)})
        run = ss.integrate(cart, **given, inputs=result)
        exact = 4 / 3 * np.sin(run.t / 2) - 2 / 3 * np.sin(run.t)
        assert run.q[:, 0] == pytest.approx(sign * exact, abs=1e-8)
    values = np.array([1.0, -1.0, 0.5])
    for held in (values, ss.samples([*values, 7.0], period=10.0)):
        run = ss.integrate(cart, **given, inputs={u: held})
        assert run.steps % 3 == 0
        z = 0j  # x - i v turns about each value
        for value in values:
            z = value + (z - value) * np.exp(10j)
        assert run.q[-1, 0] == pytest.approx(z.real, abs=1e-8)
    for wrong in (None, {u: np.ones((3, 2))}):
        with pytest.raises(ss.InputError, match=r"Pass a number or a function of t\. Or"):
            ss.integrate(cart, **given, inputs=wrong)
    with pytest.raises(ss.InputError, match="not a whole number of periods"):
        ss.integrate(cart, **given, inputs={u: ss.samples(values, period=7.0)})


def test_events_act_on_the_run():
    ball = system("bounced", 10 * x)
    floor = ss.Event(x, name="floor", action=ss.Impact(0.9))
    run = ss.integrate(ball, [1.0], v0=[0.0], t_end=4.0, error=1e-9, events=[floor])
    times = np.cumsum([0.2**0.5, *(2 * 0.2**0.5 * 0.9**k for k in range(1, 12))])
    hits = run.events("floor").t
    assert hits == pytest.approx(times[: len(hits)], abs=1e-9)
    assert run.success
    stop = ss.Event(x, name="stop", terminal=True)
    swing = system("stopped", -sp.cos(x))
    run = ss.integrate(swing, [1.0], v0=[0.0], t_end=50.0, error=1e-9, events=[stop])
    assert run.ended_by == "stop"
    # a quarter of the period
    assert run.t[-1] == pytest.approx(sp.elliptic_k(sp.sin(0.5) ** 2).evalf(), abs=1e-8)


def test_it_never_warns_of_its_own_step():
    """An oscillation that is fast and at rest, the first time and from disk."""
    stiff = ss.MechanicalSystem(
        "fast_at_rest",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=x**2 / 2 + 1000 * y**2,
    )
    given = {"q0": [1.0, 0.0], "v0": [0.0, 0.0], "t_end": 20.0, "error": 1e-8}
    for _ in range(2):
        run = ss.integrate(stiff, **given, schemes="gauss16")
        assert run.h * math.sqrt(2000) <= math.pi
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ss.compile(stiff, "gauss16").integrate([1.0, 0.0], p0=[0, 0], h=run.h, t_end=20.0)


def test_all_results_have_the_estimate():
    pendulum = ss.systems.pendulum()
    given = {"q0": [1.0], "v0": [0.0], "t_end": 20.0, "error": 1e-9}
    results = [
        ss.integrate(pendulum, **given, **kept)
        for kept in ({}, {"every": None}, {"t_eval": [0.0, 3.0]}, {"save": "energy"})
    ]
    assert len({run.error_estimate for run in results}) == 1
    assert results[0].to_xarray().attrs["error_estimate"] == results[0].error_estimate
    assert ss.compile(pendulum).integrate([1.0], v0=[0.0], h=0.1, steps=2).error_estimate is None


PENDULUM = ss.systems.double_pendulum()
START = {"q0": [0.3, 0.3], "v0": [0, 0]}
LONG = {
    "choose": lambda: ss.choose(PENDULUM, **START, t_end=1e5, error=1e-7, schemes="simpson"),
    "integrate": lambda: ss.integrate(PENDULUM, **START, t_end=1e5, error=1e-7, schemes="gauss4"),
    "work_precision": lambda: ss.work_precision(
        PENDULUM, "simpson", "runge-kutta", errors=1e-12, state=START, t_end=100.0
    ),
    "certify": ss.compile(PENDULUM, "gauss8").certify,
    "stress": lambda: [*stress(ss.compile(PENDULUM), steps=20_000_000)],
}


def test_interrupts_are_heard():
    ss.compile(PENDULUM, "simpson").integrate(**START, h=0.01, steps=2)
    for call in LONG.values():
        timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            call()
        timer.join()
