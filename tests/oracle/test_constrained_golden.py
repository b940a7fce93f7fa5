"""Steps with constraints against golden values computed with 50 digits and checked with 70.

``tests/data/golden_constrained.json``: decimal inputs, the first step, the last state, its
multipliers and the largest error of the energy.
"""

import json

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.golden import read_system
from support.places import DATA

import symsimpson as ss

DATA = DATA / "golden_constrained.json"
CASES = json.loads(DATA.read_text())["cases"]
#: Lines written out, loops, and a singular M come first.
FIRST = (
    "spherical_pendulum_simpson",
    "two_bodies_simpson",
    "heavy_asymmetric_top_singular_mass_matrix_simpson",
)
CASES.sort(key=lambda case: case["name"] not in FIRST)
#: Seconds in many digits grow with the third power of the unknowns.
SMALL = [case for case in CASES if len(case["q0"]) <= 4]


def system_of(case):
    q, values, read = read_system(case | {"parameters": case["params"]})
    L, *phi = read((case["lagrangian"], *case["constraints"]))
    return ss.MechanicalSystem.from_lagrangian(case["system"], L, q, values, constraints=phi)


def run_of(case, stepper, number):
    read = np.frompyfunc(number, 1, 1)
    values = {
        name: number(sp.Rational(x).p) / number(sp.Rational(x).q)
        for name, x in case["params"].items()
    }
    return stepper.integrate(
        read(case["q0"]),
        p0=read(case["p0"]),
        h=number(case["h"]),
        steps=case["N"],
        parameters=values,
    )


def errors_of(case, run, number):
    """Return what the last state differs by from the golden one: q and p, and multipliers."""
    last = case["final"]
    wanted = {name: np.array([number(x) for x in last[name]]) for name in ("q", "p")}
    wanted["multipliers"] = np.array([number(x) for x in last["multipliers_of_state"]])
    off = {}
    for name, values in wanted.items():
        size = max(1, *map(abs, values))
        off[name] = float(max(abs(getattr(run, name)[-1] - values)) / size)
    return max(off["q"], off["p"]), off["multipliers"]


@pytest.mark.filterwarnings("ignore:.*turns a body by:symsimpson.StabilityWarning")
@pytest.mark.parametrize("case", sweep(CASES), ids=lambda case: case["name"])
def test_double_precision(case):
    run = run_of(case, ss.compile(system_of(case), case["scheme"]), float)
    state, multipliers = errors_of(case, run, float)
    assert state < 1e-12
    assert multipliers < 1e-11
    slopes = np.linalg.norm(run._slopes(), axis=2)
    scale = slopes * np.maximum(1.0, np.abs(run.q).max(axis=1))[:, None]
    assert (np.abs(run.constraint_error) / scale).max() < 1e-15
    energy = np.abs(run.energy - float(case["H0"])).max()
    assert abs(energy - float(case["sup_energy_error"])) < 1e-9 * abs(float(case["H0"])) + 1e-13


@pytest.mark.filterwarnings("ignore:.*turns a body by:symsimpson.StabilityWarning")
@pytest.mark.parametrize("case", sweep(SMALL, 1), ids=lambda case: case["name"])
def test_many_digits(case):
    with mp.workdps(55):
        stepper = ss.compile(system_of(case), case["scheme"], precision=50)
        run = run_of(case, stepper, mp.mpf)
        state, multipliers = errors_of(case, run, mp.mpf)
    assert state < 1e-30
    assert multipliers < 1e-30
