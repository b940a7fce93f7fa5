"""The exact top against 40 printed digits, itself, and its equations of motion."""

import json

import mpmath as mp
import numpy as np
import pytest
from support.places import DATA

from symsimpson.reference import ExactTop

CASES = json.loads((DATA / "exact_top.json").read_text())
TOY = {"m_top": "0.1", "g": "9.81", "l": "0.15", "I": "0.00233", "I3": "0.000125"}


def make(name, digits=40):
    with mp.workdps(digits + 10):
        if name == "cusp":
            unit = {"m_top": 1, "g": 1, "l": 4 * mp.pi**2, "I": 1, "I3": 2}
            return ExactTop([0, mp.pi / 6, 0], [0, 0, 2 * mp.pi], unit, digits=digits)
        return ExactTop([0, mp.pi / 3, 0], ["9.2", 0, 252], TOY, digits=digits)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_printed_digits(case):
    top = make(case["name"])
    with mp.workdps(45):
        for found, key in (
            (top.period, "period"),
            (top.precession, "dphi_period"),
            (top.spin, "dpsi_period"),
            (top.p_phi, "p_phi"),
            (top.p_psi, "p_psi"),
            *((root, f"u{i + 1}") for i, root in enumerate(top.roots)),
        ):
            assert abs(found - mp.mpf(case[key])) < mp.mpf(10) ** -38 * max(1, abs(found)), key
        for point in case["points"]:
            q, p = top.state(point["t"])
            for found, key in zip((*q, p[1]), ("phi", "theta", "psi", "p_theta"), strict=True):
                gap = abs(found - mp.mpf(point[key]))
                assert gap < mp.mpf(10) ** -38 * max(1, abs(found)), (key, point["t"])


@pytest.mark.parametrize("name", ["loop", "cusp"])
def test_weierstrass_and_jacobi_agree(name):
    top = make(name)
    with mp.workdps(45):
        for t in ("0.1", "0.77", "3.9"):
            assert abs(top.theta(t) - top.theta_weierstrass(t)) < mp.mpf(10) ** -38


def test_half_a_turn_of_the_cuspidal_top():
    with mp.workdps(45):
        assert abs(make("cusp").spin - mp.pi) < mp.mpf(10) ** -38


def test_moving_start():
    """A start within the motion leads back to the same motion."""
    top = make("loop")
    for t in ("0.3", "1.4"):
        q, p = top.state(t)
        with mp.workdps(50):
            sine, u = mp.sin(q[1]), mp.cos(q[1])
            inertia = mp.mpf(TOY["I"])
            v_phi = (p[0] - p[2] * u) / (inertia * sine**2)
            v = [v_phi, p[1] / inertia, p[2] / mp.mpf(TOY["I3"]) - v_phi * u]
        later = ExactTop(q, v, TOY, digits=40)
        assert abs(later.period - top.period) < mp.mpf(10) ** -36
        for x, y in zip(
            later.state("0.5")[0], top.state(mp.mpf(t) + mp.mpf("0.5"))[0], strict=True
        ):
            assert abs(x - y) < 1e-14 * max(1, abs(y))


def test_nutation_in_double_precision():
    pytest.importorskip("scipy")
    for name in ("loop", "cusp"):
        top = make(name, digits=20)
        t = np.array([0.0, 0.1, 0.9, 1.7, 40.3, 1846.7])
        exact = np.array([float(top.theta(x)) for x in t])
        assert np.abs(top.nutation(t) - exact).max() < 1e-12


@pytest.mark.parametrize("theta", [0, "3.2", -1])
def test_singular_start_is_refused(theta):
    with pytest.raises(ValueError, match="theta0"):
        ExactTop([0, theta, 0], [1, 0, 1], TOY)
    with pytest.raises(ValueError, match="parameters"):
        ExactTop([0, 1, 0], [1, 0, 1], {"m": 1})
