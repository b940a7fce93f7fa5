"""Bodies that meet, of the catalogue, against what was published of them."""

import numpy as np
import pytest

import symsimpson as ss


@pytest.mark.slow
def test_three_bodies_return_to_where_they_were():
    eight = ss.systems.figure_eight()
    run = ss.compile(eight, "gauss12").integrate(
        **eight.reference_state, h=6.32591398 / 60, t_end=6.32591398, every=None
    )
    assert np.abs(run.q[-1] - eight.reference_state["q0"]).max() < 1e-6


@pytest.mark.slow
def test_the_lightest_of_three_bodies_escapes():
    """Its place at t = 70 is that of a Taylor method with 200 bits."""
    three = ss.systems.pythagorean()
    run = ss.compile(three.retimed("encounters"), "gauss12").integrate(
        **three.reference_state, h=0.1, t_end=70.0, every=None
    )
    assert np.abs(run.q[-1, :2] - [6.93346359901, 20.26180430595]).max() < 2e-3
    assert np.abs(run.p[-1].reshape(3, 2).sum(axis=0)).max() < 1e-11


@pytest.mark.slow
def test_a_comet_follows_keplers_equation():
    comet = ss.systems.kepler_plane()
    stepper = ss.compile(comet.retimed("encounters"), "gauss12")
    run = stepper.integrate(**comet.reference_state, h=1.0, t_end=20.0)
    e, anomaly = 0.9, np.pi + 20.0
    E = anomaly
    for _ in range(60):
        E -= (E - e * np.sin(E) - anomaly) / (1 - e * np.cos(E))
    expected = e - np.cos(E), -np.sqrt(1 - e**2) * np.sin(E)
    assert run.q[-1] == pytest.approx(expected, abs=1e-9)
    kept = run.invariants["angular momentum"]
    assert np.ptp(kept) < 1e-14


@pytest.mark.slow
def test_run_times_are_measured_in_both_times():
    found = ss.work_precision(
        ss.systems.kepler_plane().retimed("encounters"),
        ["gauss8"],
        peers=(),
        errors=[1e-3],
        t_end=8.0,
        repeats=1,
    )
    assert found.names == ("gauss8", "gauss8 retimed")
    fixed, adapting = (found.fastest(name, 1e-3) for name in found.names)
    assert adapting.choice < fixed.choice
