"""Forced and timed steps against golden values computed with 50 digits and checked with 66.

``tests/data/golden_forced.json``: decimal inputs, states, energies, the work of the forces and the
integral of dL/dt. Inputs are held over steps, or given at their nodes.
"""

import mpmath as mp
import numpy as np
import pytest
from support.cases import sweep
from support.forced_cases import CONFORMAL, OTHERS, run_of, stepper_of


def last_state(case, stepper, number):
    run = run_of(case, stepper, number, every=None)
    return [*run.q[0], *run.p[0]]


def truth_of(case):
    final = case["results"]["final"]
    return [mp.mpf(x) for x in final["q"] + final["p"]]


@pytest.mark.parametrize("case", [*sweep(OTHERS, 3), *CONFORMAL], ids=lambda case: case["name"])
@pytest.mark.parametrize("general", sweep([False, True]))
def test_states_in_double_precision(case, general):
    if general and case in CONFORMAL:
        pytest.skip("the general path takes its damping for a force")
    found = last_state(case, stepper_of(case, exploit=() if general else "all"), float)
    amplification = max(1.0, float(case["amplification"]))
    error = max(abs(a - b) for a, b in zip(found, truth_of(case), strict=True))
    assert error < 1e-14 * amplification


@pytest.mark.parametrize("case", [*sweep(OTHERS, 1), *CONFORMAL], ids=lambda case: case["name"])
def test_states_in_many_digits(case):
    with mp.workdps(40):
        found = last_state(case, stepper_of(case, precision=40), mp.mpf)
        error = max(abs(a - b) for a, b in zip(found, truth_of(case), strict=True))
    assert error < 1e-30


@pytest.mark.parametrize("case", sweep(OTHERS, 3), ids=lambda case: case["name"])
def test_work_and_balance(case):
    run = run_of(case, stepper_of(case), float)
    final = {
        name: float(value)
        for name, value in case["results"]["final"].items()
        if isinstance(value, str)
    }
    assert abs(run.energy[-1] - final["H"]) < 1e-13
    assert abs(run.work["total"][-1] - final["work"]) < 1e-13
    balance = final["H"] - final["H0"] - final["work"] + final["integral_L_t"]
    assert abs(run.energy_balance[-1] - balance) < 1e-13
    coarse = run_of(case, stepper_of(case), float, every=2)
    assert np.abs(coarse.work["total"] - run.work["total"][::2]).max() < 1e-13
