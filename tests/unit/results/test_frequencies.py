"""Main frequencies of quasi-periodic signals and runs."""

import mpmath
import numpy as np
import pytest

import symsimpson as ss
from symsimpson.results.frequencies import main_frequencies

WAVES = np.array([1.0, 1.6180339887498949, -0.731, 2.618])
SIZES = np.array([1.0, 0.3, 0.1, 0.01])


def test_a_sum_of_waves():
    t = np.arange(0, 600, 0.25)
    found, amplitudes = main_frequencies(t, np.exp(1j * np.outer(t, WAVES)) @ SIZES, 4)
    assert np.abs(found - WAVES).max() < 1e-13
    assert np.abs(amplitudes - SIZES).max() < 1e-12


def test_the_frequency_of_a_pendulum():
    """To 1e-10 over 100 periods."""
    stepper = ss.compile(ss.systems.pendulum(), "gauss12")
    run = stepper.integrate([1.0], v0=[0.0], h=0.05, t_end=214.0)
    found, amplitudes = run.frequencies(2)
    quarter = mpmath.ellipk(mpmath.sin(0.5) ** 2) / mpmath.sqrt(9.81)
    assert found[0] == pytest.approx(float(mpmath.pi / 2 / quarter), rel=1e-11)
    assert found[1] == pytest.approx(3 * found[0], rel=1e-10)
    assert 2 * amplitudes[0].real == pytest.approx(1.0, abs=0.01)
    same, _ = run.frequencies(1, of=run["theta"] + 1j * run["p_theta"])
    assert abs(same[0]) == pytest.approx(found[0], rel=1e-11)


@pytest.mark.slow
def test_two_frequencies_of_a_quasi_periodic_run():
    stepper = ss.compile(ss.systems.henon_heiles(), "gauss12")
    runs = [
        stepper.integrate([0.1, 0.0], v0=[0.0, 0.1], h=0.1, t_end=t).frequencies(2)[0]
        for t in (700.0, 1400.0)
    ]
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-7)


def test_rejected():
    stepper = ss.compile(ss.systems.pendulum())
    run = stepper.integrate([1.0], v0=[0.0], h=0.05, steps=30)
    with pytest.raises(ss.InputError, match="31 states, too few"):
        run.frequencies(1)
    with pytest.raises(ss.InputError, match="signal has shape"):
        run.frequencies(1, of=[1.0])
    with pytest.raises(ss.InputError, match="count is 0"):
        run.frequencies(0)
