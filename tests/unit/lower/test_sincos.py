"""Sine and cosine of the emitted modules, run as plain Python, against many digits."""

import math

import mpmath as mp
import numpy as np
import pytest

from symsimpson.text.library import library_sources


@pytest.fixture(scope="module")
def sincos():
    names = {"compiled": lambda function: function}
    exec(library_sources()["sincos"], names)
    return names["sincos"]


PICK = np.random.default_rng(1)
ANGLES = {
    "in every quarter": np.linspace(-9, 9, 1001),
    "at its ends": [k * math.pi / 4 + d for k in range(-13, 14) for d in (-1e-9, 0, 1e-9)],
    "near zero": [0.0, 5e-324, 1e-300, -1e-20, 1e-8],
    "far away": PICK.uniform(-5e8, 5e8, 500),
    "at turns": [k * math.pi / 2 for k in PICK.integers(-(10**8), 10**8, 500).tolist()],
}


@pytest.mark.parametrize("where", ANGLES)
def test_two_units_in_the_last_place(where, sincos):
    with mp.workdps(40):
        for x in map(float, ANGLES[where]):
            for found, exact in zip(sincos(x), (mp.sin(x), mp.cos(x)), strict=True):
                assert abs(found - exact) <= 2 * math.ulp(float(exact)), x


@pytest.mark.parametrize("x", [5e8, -5e8, 1e300, math.inf, -math.inf, math.nan])
def test_no_angle(x, sincos):
    assert all(map(math.isnan, sincos(x)))
