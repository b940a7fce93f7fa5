"""Systems with velocity constraints in modules, files and checkpoints, and in bands."""

from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.systems import ROLLING

SMALL = ["ball_on_turntable", "snakeboard", "chaplygin_sleigh", "rolling_disc"]


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep([*SMALL, *(x for x in ROLLING if x not in SMALL)]))
def test_modules_files_and_checkpoints_are_read_again(name, tmp_path):
    system = ROLLING[name]()
    given = {**system.reference_state, "h": 0.01}
    loaded = ss.load(ss.generate(system, "simpson", directory=tmp_path))
    run = ss.compile(system).integrate(**given, steps=8, checkpoint=tmp_path / "r.ckpt")
    assert np.array_equal(loaded.integrate(**given, steps=8).q, run.q)
    run.save(tmp_path / "run.nc")
    again = ss.open_trajectory(tmp_path / "run.nc")
    assert np.array_equal(again.multipliers, run.multipliers)
    assert np.array_equal(ss.resume(tmp_path / "r.ckpt").q, run.q)


def train(n):
    """Masses in a row, of which each third one binds three velocities: a band."""
    q = ss.coordinates(f"x:{n}")
    rows = {
        f"row {i}": q[i].diff() + sp.cos(q[i + 1]) * q[i + 2].diff() - q[i + 1].diff() / 3
        for i in range(0, n - 2, 3)
    }
    pairs = pairwise(q)
    return ss.MechanicalSystem(
        f"train_{n}",
        coordinates=q,
        kinetic=sum(a.diff() ** 2 for a in q) / 2,
        potential=sum((a - b) ** 2 + (a - b) ** 4 for a, b in pairs),
        velocity_constraints=rows,
    )


@pytest.mark.plain
@pytest.mark.slow
def test_bands_give_the_same_steps_and_derivatives():
    system = train(12)
    q0, v0 = system.consistent(0.1 * np.arange(12), np.sin(np.arange(12.0)))
    found = []
    for exploit in ("all", ()):
        stepper = ss.compile(system, "simpson", exploit=exploit)
        run = stepper.integrate(q0, v0=v0, h=0.02, steps=10, tangents=3)
        cost = {"cost": "x3 + p_x7**2", "wrt": ("q", "v")}
        slopes = stepper.gradient(q0, v0=v0, h=0.02, steps=5, **cost)
        found.append((run.q, run.p, run.tangent[-1], slopes.gradient))
    assert "BAND" in ss.compile(system).source
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() < 1e-12 * np.abs(other).max()
