"""Trajectories against golden values computed with 60 digits and checked with 90.

``tests/data/golden.json``: exact decimal inputs, the first step with its inner nodes, the final
state, the largest relative energy error, and the amplification of errors in the initial state.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import symsimpson as ss

CASES = json.loads((Path(__file__).parents[1] / "data" / "golden.json").read_text())["cases"]
TOLERANCE = {"double_pendulum": 1e-13, "lagrange_top": 1e-12}
SYSTEMS = {"double_pendulum": ss.systems.double_pendulum, "lagrange_top": ss.systems.lagrange_top}


def floats(values):
    return np.array([float(v) for v in values])


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_golden(case):
    system = SYSTEMS[case["system"]]()
    names = {str(a) for a in system.parameters}
    parameters = {k: float(v) for k, v in case["params"].items() if k in names}
    if "m_top" not in case["params"] and case["system"] == "lagrange_top":
        parameters |= {"m_top": 1.0, "g": float(case["params"]["G"]), "l": 1.0}
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
