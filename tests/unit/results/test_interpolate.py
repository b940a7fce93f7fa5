"""States between steps: the order of the scheme, stored states as they are."""

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss

T_END = 2.0


def run_of(name, scheme, h, **options):
    system = getattr(ss.systems, name)()
    start = dict(system.reference_state)
    return ss.compile(system, scheme).integrate(
        start.pop("q0"), **start, h=h, t_end=T_END, **options
    )


@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("double_pendulum", "simpson"),
            ("double_pendulum", "midpoint"),
            ("double_pendulum", "lobatto6"),
            ("double_pendulum", "gauss6"),
            ("lagrange_top", "simpson"),
            ("henon_heiles", "lobatto2"),
            ("henon_heiles", "blanes_moan4"),
            ("harmonic_oscillator", "simpson"),
        ]
    ),
)
def test_order_between_steps_is_that_of_the_scheme(name, scheme):
    h = {"henon_heiles": 0.25, "harmonic_oscillator": 0.25}.get(name, 0.02)
    order = 2 if scheme in ("midpoint", "lobatto2") else 6 if scheme.endswith("6") else 4
    if order == 6:
        h *= 2
    # the fine run has the same states where both have some; there is none at these times
    times = np.linspace(0.013, T_END - 0.017, 57)
    truth = run_of(name, "gauss16", h / 8).sol(times)
    errors = [
        np.abs(run_of(name, scheme, step).sol(times) - truth).max() for step in (h, h / 2, h / 4)
    ]
    measured = np.log2(np.divide(errors[:-1], errors[1:]))
    assert measured[-1] == pytest.approx(order, abs=0.3)
    assert measured.mean() > order - 0.3


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8", "gauss16"]))
@pytest.mark.parametrize("name", sweep(["double_pendulum", "lagrange_top", "harmonic_oscillator"]))
def test_stored_states_are_given_as_they_are(name, scheme):
    run = run_of(name, scheme, 0.01)
    assert (run.sol(run.t) == run.y).all()
    assert (run.sol(run.t[7]) == run.y[:, 7]).all()


def test_continuous_across_steps_and_resolved_within():
    run = run_of("double_pendulum", "simpson", 0.01)
    slope = np.abs(np.diff(run.y, axis=1)).max() / 0.01
    for distance in (1e-4, 1e-7, 1e-10, 1e-13):
        near = run.sol([1 - distance * 0.01, 1, 1 + distance * 0.01])
        moved = np.abs(near - near[:, [1]]).max()
        assert moved <= 2 * slope * distance * 0.01 + 1e-15


@pytest.mark.slow
def test_backwards_and_strided_runs():
    run = run_of("double_pendulum", "gauss8", 0.01)
    times = np.linspace(0, T_END, 333)
    strided = run_of("double_pendulum", "gauss8", 0.01, every=7)
    assert strided.every == 7
    assert np.abs(strided.sol(times) - run.sol(times)).max() < 1e-12
    assert np.abs(strided.sol(times[::-1])[:, ::-1] - strided.sol(times)).max() < 1e-13
    back = ss.compile(ss.systems.double_pendulum(), "gauss8").integrate(
        run.q[-1], p0=run.p[-1], h=-0.01, t0=T_END, steps=200
    )
    assert np.abs(back.sol(times) - run.sol(times)).max() < 1e-11


def test_a_call_takes_each_step_once_and_stops_often(monkeypatch):
    from symsimpson.results import interpolate

    strided = run_of("double_pendulum", "simpson", 0.01, every=50)
    times = np.linspace(0, T_END, 100)
    whole = strided.sol(times)
    monkeypatch.setattr(interpolate, "BATCH", 200)
    assert np.abs(strided.sol(times) - whole).max() < 1e-13


def test_many_digits():
    stepper = ss.compile(ss.systems.pendulum(), "gauss16", precision=40)
    run = stepper.integrate([1.0], v0=[0.0], h=0.25, steps=4)
    fine = stepper.integrate([1.0], v0=[0.0], h=0.125, steps=8)
    assert abs(run.sol(0.375) - fine.y[:, 3]).max() < 1e-12
    assert (run.sol(0.5) == run.y[:, 2]).all()


def test_many_digits_resolve_more_of_a_step():
    stepper = ss.compile(ss.systems.pendulum(), precision=40)
    run = stepper.integrate([1.0], v0=[0.0], h="0.1", steps=10)
    slopes = []
    for little in ("5e-16", "2e-15", "1e-20"):
        later = run.t[5] + type(run.t[5])(little)
        slopes.append(float((run.sol(later) - run.y[:, 5])[0] / type(run.t[5])(little)))
    assert slopes == pytest.approx([float(run.v[5, 0])] * 3, rel=1e-9)
    assert run.at(["0.25"]).t[0] == run.at([0.25]).t[0]
    assert type(run.at([0.25]).t[0]) is type(run.t[0])
    assert run.plot_energy().get_xlabel() == "t"
    assert run.plot_path().get_aspect() == 1


@pytest.mark.slow
def test_the_least_part_of_a_step_is_taken():
    stepper = ss.compile(ss.systems.lagrange_top(), "midpoint")
    start = ss.systems.lagrange_top().reference_state
    for h in (1e-3, 1e-4):
        run = stepper.integrate(**start, h=h, steps=30)
        for little in (1e-17, 1e-16, 1e-15, 1e-14):
            assert np.abs(run.sol(little) - run.y[:, 0]).max() < 300 * little + 1e-16


@pytest.mark.slow
def test_states_at_times_have_everything():
    run = run_of("double_pendulum", "gauss16", 0.01)
    found = run.at(np.linspace(0.5, 1.5, 11))
    assert isinstance(found, ss.States)
    assert found["q1"].shape == found["v_q2"].shape == found.energy.shape == (11,)
    assert np.abs(found.energy - run.energy[0]).max() < 1e-12
    part = run[50:151:10]
    assert np.abs(part.y - found.y).max() < 1e-12
    assert len(found.to_pandas()) == found.to_xarray().sizes["time"] == 11


@pytest.mark.parametrize("t", [-0.1, T_END + 1e-6, np.nan, [0.5, np.inf]])
def test_times_outside_are_refused(t):
    with pytest.raises(ss.InputError, match=r"outside the run, 0 <= t <= 2|not finite"):
        run_of("double_pendulum", "simpson", 0.01).sol(t)


def test_what_has_no_states_between():
    run = run_of("double_pendulum", "simpson", 0.01, every=None)
    with pytest.raises(ss.InputError, match="Pass every=1"):
        run.sol(1.0)
    with pytest.raises(ss.InputError, match="shape"):
        run_of("double_pendulum", "simpson", 0.01).sol([[1.0]])
    with pytest.raises(ss.InputError, match="not real numbers"):
        run_of("double_pendulum", "simpson", 0.01).sol("now")


def test_part_of_a_step_that_fails_is_said(monkeypatch):
    from symsimpson.results.interpolate import DenseOutput

    run = run_of("double_pendulum", "simpson", 0.01)
    monkeypatch.setattr(
        DenseOutput, "after", lambda self, start, later: (run.q[:1], run.p[:1], np.array([2]))
    )
    with pytest.raises(ss.ConvergenceError, match=r"the part of a step to t = 0\.005"):
        run.sol(0.005)


@pytest.mark.slow
def test_where_the_motion_is_hardly_resolved_parts_are_divided(monkeypatch):
    """Near a pole of its coordinates the rigid body turns as fast as its step allows."""
    from symsimpson.results.interpolate import DenseOutput

    divided = []
    original = DenseOutput._take_robust_steps
    monkeypatch.setattr(
        DenseOutput, "_take_robust_steps", lambda *given: divided.append(1) or original(*given)
    )
    system = ss.systems.rigid_body()
    coarse, fine = (
        ss.compile(system, "gauss8").integrate(**system.reference_state, h=h, steps=round(10 / h))
        for h in (0.02, 0.0025)
    )
    times = np.random.default_rng(0).uniform(0, 10, 5000)
    found, truth = coarse.at(times), fine.at(times)
    assert divided
    for what in "qp":
        own = np.abs(getattr(coarse, what) - getattr(fine, what)[::8]).max()
        between = np.abs(getattr(found, what) - getattr(truth, what)).max()
        assert between < 1.1 * own


def test_what_is_in_doubt_goes_the_way_of_a_run(monkeypatch):
    from symsimpson.results import interpolate

    run = run_of("double_pendulum", "simpson", 0.01, every=7)
    times = np.linspace(0, T_END, 41)
    expected = run.sol(times)
    monkeypatch.setattr(interpolate.np, "flatnonzero", lambda x: np.arange(len(x)))
    assert np.abs(run.sol(times) - expected).max() < 1e-13
