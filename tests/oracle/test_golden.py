"""Trajectories against golden values computed with 60 digits and checked with 90.

``tests/data/golden.json``: exact decimal inputs, the first step with its inner nodes, the final
state, the largest relative energy error, and the amplification of errors in the initial state.
"""

import json

import mpmath
import numpy as np
import pytest
from support.cases import sweep
from support.places import DATA

import symsimpson as ss

CASES = json.loads((DATA / "golden.json").read_text())["cases"]
TOLERANCE = {"double_pendulum": 1e-13, "lagrange_top": 1e-12}
SYSTEMS = {"double_pendulum": ss.systems.double_pendulum, "lagrange_top": ss.systems.lagrange_top}


def floats(values):
    return np.array([float(v) for v in values])


def parameters_of(case, system):
    names = {str(a) for a in system.parameters}
    found = {k: v for k, v in case["params"].items() if k in names}
    if "m_top" not in case["params"] and case["system"] == "lagrange_top":
        found |= {"m_top": "1", "g": case["params"]["G"], "l": "1"}
    return found


@pytest.mark.parametrize("case", sweep(CASES, 3), ids=lambda case: case["name"])
def test_golden(case):
    system = SYSTEMS[case["system"]]()
    parameters = {k: float(v) for k, v in parameters_of(case, system).items()}
    q0, p0, h = floats(case["q0"]), floats(case["p0"]), float(case["h"])
    stepper = ss.compile(system, case["scheme"])
    run = stepper.integrate(q0, p0=p0, h=h, steps=case["N"], parameters=parameters)
    tolerance = TOLERANCE[case["system"]]
    for state, q, p in (
        (case["first_step"], run.q[1], run.p[1]),
        (case["final"], run.q[-1], run.p[-1]),
    ):
        end = "1" if "q1" in state else ""
        for found, key in ((q, f"q{end}"), (p, f"p{end}")):
            truth = floats(state[key])
            scale = max(1.0, np.abs(truth).max()) if key[0] == "q" else np.abs(truth).max()
            assert np.abs(found - truth).max() <= tolerance * scale, key
    inner = case["first_step"]["q_internal"]
    nodes = np.array([*(floats(node) for node in inner), run.q[1]])
    residual = stepper.residual(q0, p0, nodes, h, parameters)
    assert np.abs(residual).max() < 1e-12 * max(1.0, np.abs(p0).max() / h)
    assert np.isclose(
        np.abs(run.energy_error).max(), float(case["sup_rel_energy_error"]), rtol=1e-6, atol=2e-15
    )


@pytest.mark.parametrize("arithmetic", ["mpmath", "arb"])
@pytest.mark.parametrize("case", sweep(CASES), ids=lambda case: case["name"])
def test_golden_in_64_digits(case, arithmetic):
    if arithmetic == "arb":
        pytest.importorskip("flint")
    system = SYSTEMS[case["system"]]()
    stepper = ss.compile(system, case["scheme"], precision=64, arithmetic=arithmetic)
    run = stepper.integrate(
        case["q0"],
        p0=case["p0"],
        h=case["h"],
        steps=case["N"],
        parameters=parameters_of(case, system),
    )
    for state, place, end in ((case["first_step"], 1, "1"), (case["final"], -1, "")):
        for found, key in ((run.q[place], f"q{end}"), (run.p[place], f"p{end}")):
            for number, truth in zip(found, stretched(state[key]), strict=True):
                assert abs(number - truth) < mpmath.mpf("1e-30") * max(1, abs(truth))
    error = max(abs(run.energy_error))
    truth = float(case["sup_rel_energy_error"])
    assert abs(float(error) - truth) < 1e-12 * truth


def stretched(values):
    """Read decimal strings in more digits than mpmath takes by itself."""
    with mpmath.workdps(60):
        return [mpmath.mpf(value) for value in values]
