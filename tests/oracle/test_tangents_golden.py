"""Derivatives of forced runs against golden values of 34 digits: by q0, p0, parameters, inputs."""

import mpmath as mp
import numpy as np
import pytest
from support.cases import sweep
from support.forced_cases import CASES, CONFORMAL, OTHERS, run_of, stepper_of


def derivatives_of(case, number, **options):
    """Return the whole derivative of a run, and what it should be, a column for each name."""
    final = case["results"]["final"]
    named = final.get("sensitivity", {})
    given = {"sensitivities": tuple(named)} if named else {}
    size = 2 * len(case["q0"])
    run = run_of(case, stepper_of(case, **options), number, every=None, tangents=size, **given)
    found = [run.tangent[0]]
    read = np.frompyfunc(mp.mpf, 1, 1)
    truth = [read(np.array(final["tangent"], dtype=object))]
    if named:
        found.append(np.stack([run.sensitivity[name][0] for name in named], axis=1))
        truth.append(read(np.array(list(named.values()), dtype=object)).T)
    return np.concatenate(found, axis=1), np.concatenate(truth, axis=1)


def relative(found, truth):
    """Return the largest error of each column relative to its size."""
    gap = np.abs(found - truth).max(axis=0)
    return max(gap / np.maximum(np.abs(truth).max(axis=0), 1e-3))


@pytest.mark.slow
@pytest.mark.parametrize("case", sweep([*OTHERS, *CONFORMAL]), ids=lambda case: case["name"])
def test_derivatives_in_double_precision(case):
    found, truth = derivatives_of(case, float)
    assert relative(found.astype(object), truth) < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("case", OTHERS, ids=lambda case: case["name"])
def test_derivatives_of_the_general_path(case):
    found, truth = derivatives_of(case, float, exploit=())
    assert relative(found.astype(object), truth) < 1e-13


@pytest.mark.parametrize("case", sweep(CASES, 1), ids=lambda case: case["name"])
def test_derivatives_in_many_digits(case):
    with mp.workdps(45):
        found, truth = derivatives_of(case, mp.mpf, precision=45)
        assert relative(found, truth) < 1e-30
