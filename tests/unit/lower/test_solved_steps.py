"""Iterations go on until steps are solved: where they are slow, and in each coordinate."""

import mpmath as mp
import numpy as np
import pytest
from support.workspace import block

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.targets.binding import bind_mpmath


def test_slow_iterations_are_solved_to_rounding():
    """Corrections shrink slowly here, and now and then one is larger than the one before."""
    run, exact = (
        ss.compile(ss.systems.henon_heiles(), "gauss8", precision=digits).integrate(
            [0.3, 0.1], v0=[0.1, 0.2], h=2.375, steps=1
        )
        for digits in (None, 40)
    )
    assert abs(run.q - exact.q).max() < 1e-14
    assert abs(run.p - exact.p).max() < 1e-14


@pytest.mark.parametrize(
    ("own", "moved", "ratio", "verdict"),
    [
        ("1e-25", "1e-13", 1, 0),  # the next correction is 1e-12 of the increment
        ("1e-20", "1e-13", 1, 1),  # it is 1e-7 of the increment, and 3e-14 of that of the other
        ("1e-20", "1e-13", "1e-10", 0),  # corrections shrink faster
        ("1e-27", 0, 1, 0),  # at rest, but for rounding
        ("1e-25", 0, 1, 1),
    ],
)
def test_each_coordinate_is_solved_by_its_own_measure(own, moved, ratio, verdict):
    """The other coordinate is done: its last correction is 1e-30 of its increment."""
    module = bind_mpmath(source(ss.systems.double_pendulum()), checking=True)
    W = np.full((module.ROWS, 1), mp.mpf(0), dtype=object)
    given = {
        "CORRECTION_SQUARED": own,
        "INCREMENT_SQUARED": 1,
        "ACTIVE": 1,
        "RELATIVE": "inf",
        "CONTRACTION": ratio,
    }
    for name, value in given.items():
        W[getattr(module, name), 0] = mp.mpf(value)
    W[block(module, "OWN_CORRECTION", 2), 0] = [mp.mpf("1e-60"), mp.mpf(own)]
    W[block(module, "OWN_INCREMENT", 2), 0] = [mp.mpf(1), mp.mpf(moved)]
    module.check_convergence(W, 0)
    assert W[module.ACTIVE, 0] == verdict
