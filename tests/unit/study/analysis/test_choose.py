"""Schemes and steps for a wanted error: it is reached, and what is said is true."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.study.analysis.choose import CANDIDATES
from symsimpson.study.analysis.stability.frequency import largest_frequency, largest_stable

PENDULUM = ss.systems.double_pendulum()
STATE = PENDULUM.reference_state
#: At t = 10, in 72 digits.
TRUTH = np.array([-0.248608400375483644278, -0.613578116238233122889])


@pytest.fixture(autouse=True)
def no_run_of_many_steps(request, monkeypatch):
    """The interpreter would take long for it."""
    if not request.node.get_closest_marker("slow"):
        monkeypatch.setattr("symsimpson.study.analysis.candidates.SCOUT_STEPS", 0)


@pytest.mark.parametrize("error", sweep([1e-6, 1e-3, 1e-9, 1e-12], 0))
def test_errors_of_the_state(error):
    choice = ss.choose(PENDULUM, **STATE, t_end=10, error=error)
    run = choice.stepper.integrate(**STATE, h=choice.h, t_end=10, every=None)
    found = np.abs(run.q[0] - TRUTH).max()
    assert found <= error
    assert f"{choice.stepper.scheme} with h = {choice.h:.6g}" in choice.reason
    assert choice.stepper.scheme in repr(choice)
    assert f"the tolerance is {error:.1e}" in choice.reason


class EverySecond:
    """A clock for which everything takes a second: choices do not depend on the machine."""

    def __init__(self):
        self.perf_counter = iter(range(10**6)).__next__


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8", "gauss12", "gauss16"]))
@pytest.mark.parametrize("error", sweep([1e-6, 1e-3, 1e-9]))
def test_no_more_work_than_needed(error, scheme, monkeypatch):
    """With a good part fewer steps, the error is too large, or iterations outweigh them."""
    monkeypatch.setattr("symsimpson.study.analysis.candidates.time", EverySecond())
    choice = ss.choose(PENDULUM, **STATE, t_end=10, error=error, schemes=[scheme])
    steps = round(10 / choice.h)
    few = int(0.6 * steps)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ss.StabilityWarning)
        runs = [
            choice.stepper.integrate(**STATE, h=10 / n, steps=n, every=None, on_failure="return")
            for n in (steps, few)
        ]
    work, less = (run.newton_iterations.sum() + run.steps for run in runs)
    assert not runs[1].success or np.abs(runs[1].q[0] - TRUTH).max() > error / 4 or less > work


@pytest.mark.slow
def test_errors_of_the_energy():
    choice = ss.choose(PENDULUM, **STATE, t_end=3000, error=1e-7, on="energy", schemes=["simpson"])
    run = choice.stepper.integrate(**STATE, h=choice.h, t_end=3000)
    assert 1e-9 < np.abs(run.energy_error).max() <= 1e-7
    assert choice.error_estimate == np.abs(run.energy_error).max()


@pytest.mark.slow
def test_chaos_beyond_rounding_is_told():
    """The error of a double pendulum that turns over doubles 25 times in each half of this time."""
    chaotic = ss.systems.double_pendulum()
    with pytest.raises(ss.InputError, match="too sensitive to its initial state"):
        ss.choose(chaotic, [2.5, 2.9], v0=[0, 0], t_end=10.0, error=1e-6, schemes=["gauss16"])


@pytest.mark.slow
def test_longer_runs_take_smaller_steps():
    short, long = (
        ss.choose(PENDULUM, **STATE, t_end=t, error=1e-6, schemes=["gauss8"]) for t in (50, 2000)
    )
    assert long.h < short.h
    assert long.error_estimate <= 1e-6


@pytest.mark.slow
def test_the_fastest_oscillation_bounds_the_step():
    spring = ss.systems.harmonic_oscillator()
    assert largest_frequency(spring, [0.3], [1.0, 400.0]) == pytest.approx(20.0)
    assert largest_stable("simpson") == pytest.approx(8**0.5)
    assert largest_stable("midpoint") == largest_stable("gauss16") == np.inf
    stiff = ss.systems.elastic_pendulum()
    choice = ss.choose(
        stiff,
        [1.0, 0.3],
        v0=[0, 0],
        t_end=1,
        error=0.5,
        on="energy",
        parameters={"k": 1e4},
        schemes=["simpson"],
    )
    assert choice.h * 100 <= 8**0.5


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"error": 0.0}, "error is 0.0"),
        ({"error": float("nan")}, "error is nan"),
        ({"error": 1.5}, "error is 1.5, relative to the largest change along the path"),
        ({"error": 2, "on": "energy"}, "error is 2, relative to the energy's scale"),
        ({"t_end": 0.0}, "t_end is 0.0, the same as t0"),
        ({"t_end": "long"}, "t_end is 'long'"),
        ({"t_end": 10**400}, "t_end is 1000.*not a finite real number"),
        ({"t_end": True}, "t_end is True, not a finite real number"),
        ({"on": "momentum"}, "on is 'momentum'"),
        ({"error": 1e-17}, "Double precision rounds each number by more"),
        ({"error": 2.3e-16}, "none of simpson reaches error=2.3e-16"),
        ({"p0": None}, "exactly one of v0 and p0"),
        ({"q0": [1.0]}, "q0 has shape"),
    ],
)
def test_wrong_input(given, message):
    asked = {**STATE, "t_end": 2.0, "error": 1e-5, "schemes": ["simpson"]} | given
    with pytest.raises(ss.InputError, match=message):
        ss.choose(PENDULUM, **asked)


@pytest.mark.parametrize("kind", sweep([np.float32, np.int64, Fraction, sp.Integer]))
def test_numbers_of_other_kinds_are_numbers(kind, monkeypatch):
    monkeypatch.setattr("symsimpson.study.analysis.candidates.time", EverySecond())
    given = {**STATE, "error": 1e-3, "schemes": ["simpson"]}
    assert ss.choose(PENDULUM, **given, t_end=kind(1)).h == ss.choose(PENDULUM, **given, t_end=1).h


@pytest.mark.slow
def test_explicit_schemes_are_tried_where_there_are_such_steps():
    henon = ss.systems.henon_heiles()
    choice = ss.choose(henon, **henon.reference_state, t_end=50, error=1e-4)
    assert "blanes_moan" in f"{choice.stepper.scheme} {choice.reason}"
    run = choice.stepper.integrate(**henon.reference_state, h=choice.h, t_end=50, every=None)
    fine = ss.compile(henon, "gauss16").integrate(
        **henon.reference_state, h=0.05, t_end=50, every=None
    )
    assert np.abs(run.q - fine.q).max() < 1e-4


def test_a_step_beyond_linear_stability_is_warned_of():
    """Once for a step and its parameters, with the step to take; gaps are beyond, too."""
    spring = ss.systems.harmonic_oscillator()
    start = {"q0": [1.0], "p0": [0.0], "steps": 10, "every": None}
    stepper = ss.compile(spring, "simpson")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stepper.integrate(**start, h=2.8)
        stepper.integrate(**start, h=0.28, parameters={"k": 100.0})
        ss.compile(spring, "gauss4").integrate(**start, h=3.1)
        stepper.integrate([1.0], p0=[0.0], h=3.0, steps=0)
    with pytest.warns(ss.StabilityWarning, match=r"turns by 9 rad(.|\n)*Take h below 3\.14"):
        ss.compile(spring, "gauss4").integrate(**start, h=9.0)  # stable, and not resolved
    with pytest.warns(
        ss.StabilityWarning, match=r"h=-2.9 .* h omega is 2.9\. .*\nTake h below 2.83"
    ) as told:
        stepper.integrate(**start, h=-2.9)
    assert told[0].filename == __file__
    with pytest.warns(ss.StabilityWarning, match="omega=10; h omega is 3.7"):
        stepper.integrate(**start, h=0.37, parameters={"k": 100.0})
    with pytest.warns(ss.StabilityWarning, match="from 2 on"):
        ss.compile(ss.systems.henon_heiles(), "lobatto2").integrate(
            [0.1, 0.1], p0=[0, 0], h=2.0, steps=2, on_failure="return"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stepper.integrate(**start, h=-2.9)


@pytest.mark.slow
def test_of_separable_systems_with_constraints_the_family_alone_is_tried():
    """Compositions whose drifts are straight are refused, and so not tried."""
    system = ss.systems.cartesian_pendulum()
    assert system.structure.separable
    choice = ss.choose(system, **system.reference_state, t_end=1.0, error=1e-4)
    assert choice.stepper.scheme in CANDIDATES


@pytest.mark.slow
def test_a_narrow_ellipse_is_retimed():
    comet = ss.systems.kepler_plane()
    q0, v0 = [1.99, 0.0], [0.0, (0.01 / 1.99) ** 0.5]
    choice = ss.choose(comet, q0, v0=v0, t_end=20.0, error=1e-6)
    assert choice.stepper.system == "kepler_plane_retimed"
    assert "A fixed step size needs at least" in choice.reason
    run = choice.stepper.integrate(q0, v0=v0, h=choice.h, t_end=20.0)
    exact = ss.compile(comet.retimed("encounters"), "gauss16").integrate(
        q0, v0=v0, h=0.5, t_end=20.0
    )
    assert np.abs(run.q[-1] - exact.q[-1]).max() < 1e-6
    assert run.steps < 500


@pytest.mark.slow
def test_a_wide_ellipse_is_not():
    comet = ss.systems.kepler_plane()
    choice = ss.choose(comet, [1.05, 0.0], v0=[0.0, 0.9513], t_end=60.0, error=1e-6)
    assert choice.stepper.system == "kepler_plane"
    given = ss.choose(
        comet.retimed("encounters"),
        [1.05, 0.0],
        v0=[0.0, 0.9513],
        t_end=60.0,
        error=1e-6,
        schemes=["gauss8"],
    )
    assert given.stepper.system == "kepler_plane_retimed"
    assert "fixed" not in given.reason


@pytest.mark.slow
def test_what_takes_long_to_derive_is_not_tried(monkeypatch):
    """Twenty bodies in a time of their own took more than ten minutes, their run three seconds."""
    chosen = {"WITH_EXPLICIT": ("blanes_moan4",), "RETIMED_CANDIDATES": ("simpson",)}
    chosen["DERIVATION_SECONDS"] = 1e9
    for name, value in chosen.items():
        monkeypatch.setattr(f"symsimpson.study.analysis.choose.{name}", value)
    comet = ss.systems.kepler_plane()
    choice = ss.choose(comet, [1.99, 0.0], v0=[0.0, (0.01 / 1.99) ** 0.5], t_end=20.0, error=1e-3)
    assert choice.stepper.system == "kepler_plane"


def test_one_scheme_is_a_choice_of_one():
    given = {"t_end": 1.0, "error": 1e-3}
    for one in ("simpson", ss.SIMPSON):
        assert ss.choose(PENDULUM, **STATE, **given, schemes=one).stepper.scheme == "simpson"
    assert " simpson " in f" {ss.integrate(PENDULUM, **STATE, **given, schemes='simpson').message}"
    assert list(ss.step_costs(PENDULUM, "simpson").here) == ["simpson"]
