"""Many digits: the same steps, inputs of every kind, failures and Ctrl-C as in double precision."""

import signal
from decimal import Decimal
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.program.digits import Digits, read_precision
from symsimpson.stepping.run import Run


@pytest.fixture(params=["mpmath", "arb"])
def arithmetic(request):
    if request.param == "arb":
        pytest.importorskip("flint")
    return request.param


def test_doubles_and_64_digits_agree(arithmetic):
    system = ss.systems.double_pendulum()
    ends = []
    for more in ({}, {"precision": 64, "arithmetic": arithmetic}):
        run = ss.compile(system, **more).integrate([0.7, 1.0], p0=[0, 0], h=0.0625, steps=100)
        ends.append(np.array([*run.q[-1], *run.p[-1]], dtype=float))
    assert np.abs(ends[0] - ends[1]).max() < 1e-13


@pytest.mark.parametrize("name", sweep(ss.systems.CATALOGUE, 2))
def test_every_system_in_30_digits(name, arithmetic):
    system = ss.systems.CATALOGUE[name]()
    given = system.reference_state
    runs = [
        ss.compile(system, "midpoint", **more).integrate(**given, h=0.01, steps=3)
        for more in ({}, {"precision": 30, "arithmetic": arithmetic})
    ]
    ends = [np.array([*run.q[-1], *run.p[-1]], dtype=float) for run in runs]
    assert np.abs(ends[0] - ends[1]).max() < 1e-13 * max(1, np.abs(ends[0]).max())
    assert set(runs[0].invariants) == set(runs[1].invariants)
    assert abs(float(runs[1].energy[0]) - runs[0].energy[0]) < 1e-13 * max(1, runs[0].energy[0])


def test_the_two_arithmetics_agree():
    pytest.importorskip("flint")
    ends = []
    for arithmetic in ("mpmath", "arb"):
        stepper = ss.compile(ss.systems.lagrange_top(), precision=50, arithmetic=arithmetic)
        run = stepper.integrate(["0", "1.04", "0"], v0=["9.2", 0, 252], h="0.05", steps=30)
        ends.append([*run.q[-1], *run.p[-1]])
        assert all(isinstance(x, mpmath.mp.mpf.__mro__[1]) for x in ends[-1])
    assert all(abs(a - b) < 1e-44 * max(1, abs(a)) for a, b in zip(*ends, strict=True))


def test_chosen_states_and_linearisations_have_all_digits(arithmetic):
    more = {"precision": 40, "arithmetic": arithmetic}
    stepper = ss.compile(ss.systems.double_pendulum(), **more)
    given = {"p0": ["0.1", "0.2"], "h": "0.05"}
    run = stepper.integrate(["0.8", "1"], steps=4, **given)
    kept = stepper.integrate(["0.8", "1"], t_eval=["0.1", "0.2"], **given)
    saved = stepper.integrate(["0.8", "1"], steps=4, save=["q1"], **given)
    found = stepper.linearise(["0.8", "1"], steps=2, wrt="l1", **given)
    with mpmath.workdps(45):
        near = [
            stepper.integrate(["0.8", "1"], steps=1, every=None, parameters={"l1": l1}, **given).p[
                -1
            ]
            for l1 in (run.parameters["l1"] + mpmath.mpf(10) ** -18 * sign for sign in (1, -1))
        ]
        assert abs(kept.q - run.q[[2, 4]]).max() < 1e-38
        assert abs(saved["q1"] - run["q1"]).max() < 1e-38
        slope = (near[0] - near[1]) / mpmath.mpf(10) ** -18 / 2
        assert abs(found.by_parameter["l1"][0, 2:] - slope).max() < 1e-20
        assert all(isinstance(x, mpmath.mp.mpf.__mro__[1]) for x in (*found.t, *found.q.flat))


def test_results_keep_their_digits():
    stepper = ss.compile(ss.systems.pendulum(), precision=40)
    run = stepper.integrate(["0.1"], v0=["0"], h="0.1", t_end=1)
    assert str(run.q[0, 0]) == "0.1"
    assert len(str(run.q[-1, 0])) > 38
    assert run.t[3] * 10 - 3 < 1e-38
    assert float(run.energy_error[-1]) != 0
    assert repr(run).startswith("Trajectory(pendulum, simpson: 10 steps of h=0.1, 11 states")
    q, p = stepper.step([run.q[-1, 0]], p=[run.p[-1, 0]], h="0.1")
    longer = stepper.integrate(["0.1"], v0=["0"], h="0.1", steps=11, every=None)
    assert abs(q[0] - longer.q[0, 0]) < 1e-38
    assert abs(p[0] - longer.p[0, 0]) < 1e-38


def test_residual_vanishes_to_all_digits(arithmetic):
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system, "midpoint", precision=50, arithmetic=arithmetic)
    q, p = [0.5, -0.25], [0.125, 0.5]
    q1, _ = stepper.step(q, p=p, h=0.0625)
    assert max(abs(r) for r in stepper.residual(q, p, [q1], 0.0625)) < 1e-47
    assert stepper.jacobian(q, p, [q1], 0.0625).shape == (2, 2)


@pytest.mark.parametrize(
    "tenth",
    ["0.1", Decimal("0.1"), Fraction(1, 10), sp.Rational(1, 10), mpmath.mpf(1) / 10, 0.1],
    ids=lambda x: type(x).__name__,
)
def test_numbers_of_every_kind(tenth):
    run = ss.compile(ss.systems.pendulum(), precision=40).integrate(
        [tenth], v0=[np.int64(0)], h=tenth, steps=1, parameters={"l": sp.sqrt(2)}
    )
    binary = isinstance(tenth, (float, mpmath.mpf))
    error = abs(run.q[0, 0] * 10 - 1)
    assert (1e-17 < error < 1e-15) if binary else error < 1e-39
    assert abs(run.parameters["l"] ** 2 - 2) < 1e-38


@pytest.mark.parametrize("wrong", ["zero", 1j, None, float("nan"), sp.Symbol("x"), "inf"])
def test_what_is_no_number_is_refused(wrong):
    stepper = ss.compile(ss.systems.pendulum(), precision=40)
    with pytest.raises(ss.InputError, match="q0"):
        stepper.integrate([wrong], v0=[0], h=0.1, steps=1)


@pytest.mark.parametrize("wrong", [0, 14, 10**6, "64", 64.0, True])
def test_precision_is_checked(wrong):
    with pytest.raises(ss.InputError, match="precision is"):
        ss.compile(ss.systems.pendulum(), precision=wrong)
    with pytest.raises(ss.InputError, match="arithmetic is"):
        ss.compile(ss.systems.pendulum(), precision=64, arithmetic="long double")


def test_many_digits_need_a_number_of_them():
    with pytest.raises(ss.InputError, match="neither precision= nor arithmetic="):
        ss.compile(ss.systems.pendulum(), arithmetic="arb")


def test_without_flint_arb_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "flint", None)
    with pytest.raises(ss.InputError, match=r"symsimpson\[precise\]"):
        read_precision(64, "arb")


@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
def test_a_step_too_large_fails_as_in_double_precision(arithmetic):
    system = ss.systems.double_pendulum()
    kinds = [
        ss.compile(system, **more)
        .integrate([1.0, 2.0], p0=[0, 0], h=3.0, steps=5, on_failure="return")
        .status
        for more in ({}, {"precision": 30, "arithmetic": arithmetic})
    ]
    assert kinds[0] == kinds[1] != ss.Status.SUCCESS


def test_interrupt_keeps_whole_steps(monkeypatch):
    stepper = ss.compile(ss.systems.double_pendulum(), precision=200)
    plain = Run.take

    def interrupted(self, stop):
        plain(self, stop)
        if self.step >= 7:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Run, "take", interrupted)
    with pytest.raises(ss.Interrupted) as caught:
        stepper.integrate([1.0, 2.0], p0=[0, 0], h=0.01, steps=60, every=None)
    monkeypatch.undo()
    partial = caught.value.trajectory
    again = stepper.integrate([1.0, 2.0], p0=[0, 0], h=0.01, steps=partial.steps, every=None)
    assert 7 <= partial.steps < 60
    assert (partial.q == again.q).all()
    assert (partial.p == again.p).all()


@pytest.mark.parametrize("scheme", ["suzuki4", "lobatto2"])
@pytest.mark.slow
def test_many_explicit_steps_at_once(scheme, arithmetic, monkeypatch):
    """In one call of a kernel, balls would grow until their midpoints mean nothing."""
    monkeypatch.setattr(Digits, "stretch", 1000)
    system = ss.systems.pendulum()
    given = {**system.reference_state, "h": 0.03125, "steps": 400, "every": None}
    run = ss.compile(system, scheme, precision=40, arithmetic=arithmetic).integrate(**given)
    assert abs(run.q[0, 0] - ss.compile(system, scheme).integrate(**given).q[0, 0]) < 1e-11


def test_numbers_of_more_digits_are_rounded():
    """A mass of more digits than are computed with is no less than its modulus."""
    (x,) = ss.coordinates("x")
    m = sp.Symbol("m", real=True)
    system = ss.MechanicalSystem(
        "mass", coordinates=(x,), kinetic=m * x.diff() ** 2 / 2, potential=x**4, parameters={m: 1.0}
    )
    stepper = ss.compile(system, precision=30)
    with mpmath.workdps(60):
        many = mpmath.mpf(13) / 10
        run = stepper.integrate([many], [0], h="0.1", steps=2, parameters={"m": many})
    same = stepper.integrate(["1.3"], [0], h="0.1", steps=2, parameters={"m": "1.3"})
    assert (run.q == same.q).all()
