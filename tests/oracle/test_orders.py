"""Observed orders on nonlinear problems; the harmonic oscillator would hide errors of order."""

import json

import mpmath
import numpy as np
import pytest
from support.cases import sweep
from support.places import DATA

import symsimpson as ss


def orders(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.parametrize(
    ("scheme", "order", "levels"),
    sweep([("simpson", 4, range(2, 5)), ("midpoint", 2, range(4, 7))]),
)
def test_energy_of_the_double_pendulum(scheme, order, levels):
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system, scheme)
    errors = []
    for k in levels:
        run = stepper.integrate(**system.reference_state, h=0.1 / 2**k, steps=100 * 2**k)
        errors.append(np.abs(run.energy_error).max())
    assert np.all(np.abs(orders(errors) - order) < 0.1), errors


def test_energy_errors_of_the_double_pendulum_are_the_known_ones():
    system = ss.systems.double_pendulum()
    known = {
        "simpson": [4.4115e-4, 2.2239e-5, 1.3304e-6, 8.3515e-8],
        "midpoint": [3.2242e-3, 1.1918e-3, 3.5513e-4, 8.9637e-5],
    }
    for scheme, values in known.items():
        stepper = ss.compile(system, scheme)
        for k, value in enumerate(values):
            run = stepper.integrate(**system.reference_state, h=0.1 / 2**k, steps=100 * 2**k)
            assert np.isclose(np.abs(run.energy_error).max(), value, rtol=2e-4)


EXACT = json.loads((DATA / "exact_top.json").read_text())[0]


def exact_nutation(times):
    """cos theta = u1 + (u2 - u1) sn^2(lambda t), for a start at the largest theta."""
    u1, u2, k2, lam = (mpmath.mpf(EXACT[name]) for name in ("u1", "u2", "k2", "lam"))
    sn = [mpmath.ellipfun("sn", lam * t, m=k2) for t in times]
    return np.array([float(mpmath.acos(u1 + (u2 - u1) * s**2)) for s in sn])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "order", "known"),
    [
        ("simpson", 4, [3.438e-6, 2.142e-7, 1.338e-8, 8.363e-10]),
        ("midpoint", 2, [1.691e-2, 4.213e-3, 1.052e-3, 2.631e-4]),
    ],
)
def test_nutation_of_the_top(scheme, order, known):
    """Against elliptic functions: the largest relative error over about one period."""
    system = ss.systems.lagrange_top()
    stepper = ss.compile(system, scheme)
    errors = []
    for k in range(2, 6):
        h = 0.05 / 2**k
        run = stepper.integrate(**system.reference_state, h=h, steps=37 * 2**k)
        errors.append(np.abs(run.q[:, 1] / exact_nutation(run.t) - 1).max())
    assert np.all(np.abs(orders(errors) - order) < 0.1), errors
    assert np.allclose(errors, known, rtol=2e-3)


@pytest.mark.parametrize(("scheme", "order"), [("simpson", 4), ("midpoint", 2)])
def test_energy_of_the_top(scheme, order):
    system = ss.systems.lagrange_top()
    stepper = ss.compile(system, scheme)
    errors = []
    for k in range(1, 5):
        run = stepper.integrate(**system.reference_state, h=0.05 / 2**k, steps=37 * 2**k)
        errors.append(np.abs(run.energy_error).max())
    assert np.all(np.abs(orders(errors) - order) < 0.1), errors


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "order"), [("gauss4", 4), ("lobatto6", 6)])
def test_other_members_of_the_family(scheme, order):
    system = ss.systems.double_pendulum()
    truth = np.array([-0.248608400375483644278, -0.613578116238233122889])  # t = 10, 72 digits
    stepper = ss.compile(system, scheme)
    errors = []
    for k in range(2, 5):
        run = stepper.integrate(**system.reference_state, h=0.1 / 2**k, t_end=10.0, every=None)
        errors.append(np.abs(run.q[0] - truth).max())
    assert np.all(np.abs(orders(errors) - order) < 0.15), errors
