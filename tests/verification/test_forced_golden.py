"""Forced and timed steps against golden values computed with 50 digits and checked with 66.

``tests/data/golden_forced.json``: decimal inputs, states, energies, the work of the forces and the
integral of dL/dt. Inputs are held over steps, or given at their nodes.
"""

import json
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from workspace import sweep

import symsimpson as ss

CASES = json.loads((Path(__file__).parents[1] / "data" / "golden_forced.json").read_text())["cases"]
CONFORMAL = [case for case in CASES if case.get("conformal")]
OTHERS = [case for case in CASES if not case.get("conformal")]


def system_of(case):
    q = ss.coordinates(" ".join(f"q{i}" for i in range(len(case["q0"]))))
    names = {"t": ss.time}
    for i, x in enumerate(q):
        names |= {f"q{i}": x, f"v{i}": x.diff()}
    values = {sp.Symbol(name, real=True): float(sp.Rational(value))
              for name, value in case["parameters"].items()}  # fmt: skip
    inputs = [sp.Symbol(name, real=True) for name in case.get("inputs", ())]
    names |= {symbol.name: symbol for symbol in (*values, *inputs)}
    L = sp.sympify(case["L"], locals=names)
    forces = {x: sp.sympify(f, locals=names) for x, f in zip(q, case["f"], strict=True)}
    if case.get("conformal"):  # exp(2 gam t) L is what damping by -2 gam L_v comes to
        L = sp.sympify(case["L"], locals={**names, "t": sp.S.Zero})
        forces = {x: -2 * names["gam"] * L.diff(x.diff()) for x in q}
    return ss.MechanicalSystem.from_lagrangian("golden", L, q, values, forces=forces, inputs=inputs)


def stepper_of(case, **options):
    wanted = case["scheme"]
    scheme = wanted["name"] or ss.galerkin(
        wanted["quadrature"], nodes=wanted["nodes"], degree=wanted["degree"]
    )
    return ss.compile(system_of(case), scheme, **options)


def run_of(case, stepper, number, **options):
    """Integrate with numbers of one kind, inputs included."""
    read = np.frompyfunc(number, 1, 1)
    q, p = (read(case[name]) for name in ("q0", "p0"))
    values = {name: number(value) for name, value in case["parameters"].items()}
    inputs = read(case["u"]) if "inputs" in case else None
    return stepper.integrate(
        q, p0=p, h=number(case["h"]), t0=number(case["t0"]), steps=case["steps"],
        parameters=values, inputs=inputs, **options,
    )  # fmt: skip


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
    final = {name: float(value) for name, value in case["results"]["final"].items()
             if isinstance(value, str)}  # fmt: skip
    assert abs(run.energy[-1] - final["H"]) < 1e-13
    assert abs(run.work["total"][-1] - final["work"]) < 1e-13
    balance = final["H"] - final["H0"] - final["work"] + final["integral_L_t"]
    assert abs(run.energy_balance[-1] - balance) < 1e-13
    coarse = run_of(case, stepper_of(case), float, every=2)
    assert np.abs(coarse.work["total"] - run.work["total"][::2]).max() < 1e-13
