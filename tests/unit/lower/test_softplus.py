"""Logarithms of exponentials in modules: as plain Python, compiled, in many digits and in C."""

import math
import shutil

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.in_c import InC

import symsimpson as ss
from symsimpson.text.library import library_sources

MODULE = {**vars(math), "compiled": lambda function: function, "real": float}
for name in ("softplus", "logcosh"):
    exec(library_sources()[name], MODULE)


@pytest.mark.parametrize("size", [1e-300, 1e-9, 1e-3, 0.3, 0.999, 1.0, 1.7, 36.0, 37.5, 700.0, 1e9])
def test_a_few_units_in_the_last_place(size):
    with mp.workdps(700):
        for x in (-size, size):
            plus, log = (MODULE[name](x) for name in ("softplus", "logcosh"))
            x = mp.mpf(x)
            exact = mp.log1p(mp.exp(x)) if x < 1e6 else x
            assert abs(plus - exact) <= 4 * math.ulp(float(exact))
            exact = 2 * mp.atanh(mp.tanh(x / 2) ** 2) if size < 700 else size - mp.log(2)
            assert abs(log - exact) <= 4 * math.ulp(float(exact))


def soft(kind):
    """Soft ground: none above, 100 z below, over a distance of 1/k."""
    (z,), k = ss.coordinates("z"), sp.Symbol("k", positive=True)
    depth = {
        "softplus": sp.log(1 + sp.exp(-k * z)) / k,
        "logcosh": sp.log(2 * sp.cosh(k * z / 2)) / k - z / 2,
    }[kind]
    return ss.MechanicalSystem(
        "soft",
        coordinates=(z,),
        kinetic=z.diff() ** 2 / 2,
        potential=9.81 * z + 100 * depth,
        parameters={k: 1000.0},
    )


@pytest.mark.slow
def test_soft_ground_as_softplus(tmp_path):
    check_soft_ground("softplus", tmp_path)


@pytest.mark.slow
def test_soft_ground_as_logcosh(tmp_path):
    check_soft_ground("logcosh", tmp_path)


def check_soft_ground(kind, tmp_path):
    """Above it a body falls freely; below it the force is 100; and at it both forms agree."""
    stepper = ss.compile(soft(kind), "gauss6")
    fallen = stepper.integrate([2.0], v0=[0.0], h=0.01, t_end=0.4)
    assert abs(fallen.q[-1, 0] - (2 - 9.81 * 0.08)) < 1e-12
    raised = stepper.integrate([-2.0], v0=[0.0], h=0.01, t_end=0.1)
    assert abs(raised.q[-1, 0] - (-2 + (100 - 9.81) * 0.005)) < 1e-12
    members = stepper.ensemble([[2.0], [-2.0]], v0=[0.0], h=0.01, steps=10)
    assert np.abs(members.q[:, 0] - [2 - 9.81 * 0.005, raised.q[-1, 0]]).max() < 1e-12
    given = {"q0": [0.001], "v0": [0.1], "h": 1e-4, "steps": 50}
    run = stepper.integrate(**given, tangents=2)
    assert np.isfinite(run.tangent).all()
    digits = ss.compile(soft("softplus"), "gauss6", precision=30).integrate(**given).q[-1, 0]
    assert abs(run.q[-1, 0] - float(digits)) < 1e-13
    if shutil.which("cc"):
        exported = InC(stepper, tmp_path)
        assert exported.begin(1e-4, q=[0.001], v=[0.1]) == 0
        for _ in range(50):
            assert exported.step(1e-4) == 0
        assert abs(exported.get()[0][0] - run.q[-1, 0]) < 1e-13
