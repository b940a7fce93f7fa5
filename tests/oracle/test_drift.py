"""The mean energy stays: rounding and what an iteration leaves unsolved have no direction."""

import numpy as np
import pytest
from support.forms import limited

import symsimpson as ss
from symsimpson.api.stepper import Stepper
from symsimpson.lower import pipeline
from symsimpson.program.program import new_program

pytestmark = pytest.mark.slow

STEPS, SAMPLES, MEMBERS = 1_000_000, 32768, 4
#: Relative drift in 1e7 steps. What is left is of this size; products of tables rounded by
#: themselves, or an iteration that ends one correction early, make it 1e-11 and more.
MOST = 3e-12
CASES = [
    ("lobatto6", "all", False, True),
    ("lobatto8", "all", False, True),
    ("lobatto8", (), False, True),
    ("gauss6", "all", False, True),
    ("lobatto8", "all", True, True),
    ("lobatto8", (), True, True),
    ("gauss12", "all", False, False),
    ("gauss16", "all", False, False),
]


def drift(stepper, together):
    """The slope of the mean energy, relative, in 1e7 steps.

    Weights that vanish smoothly at the ends of a half leave nothing of an oscillation.
    """
    every = STEPS // SAMPLES | 1
    q0 = [0.1, 0.2] + 0.02 * np.random.default_rng(5).uniform(-1, 1, (MEMBERS, 2))
    p0 = np.full((MEMBERS, 2), 0.1)
    steps = every * SAMPLES
    if together:
        run = stepper.ensemble(q0, p0=p0, h=0.1, steps=steps, every=every)
        q, p = run.q, run.p
    else:  # one by one, nodes are lanes and iterated over as stages
        runs = [
            stepper.integrate(q, p0=p, h=0.1, steps=steps, every=every)
            for q, p in zip(q0, p0, strict=True)
        ]
        q, p = np.array([run.q for run in runs]), np.array([run.p for run in runs])
    energy = stepper.energy(q.reshape(-1, 2), p.reshape(-1, 2)).reshape(MEMBERS, -1)
    energy = (energy - energy[:, :1]) / energy[:, :1]
    half = energy.shape[1] // 2
    u = (np.arange(half) + 0.5) / half
    weights = np.exp(-1 / (u * (1 - u)))
    weights /= weights.sum()
    change = energy[:, -half:] @ weights - energy[:, :half] @ weights
    return float(change.mean()) / (half * every) * 1e7


@pytest.mark.parametrize(("scheme", "exploit", "loops", "together"), CASES)
def test_the_mean_energy_stays(scheme, exploit, loops, together, monkeypatch):
    if loops:
        limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    text = pipeline.source(ss.systems.henon_heiles(), scheme, exploit)
    stepper = Stepper(new_program(text, "drift"))
    assert abs(drift(stepper, together)) < MOST
