"""Golden cases of forced and timed systems: their systems, steppers and runs."""

import json

import numpy as np
import sympy as sp

import symsimpson as ss
from support.places import DATA

CASES = json.loads((DATA / "golden_forced.json").read_text())["cases"]
CONFORMAL = [case for case in CASES if case.get("conformal")]
OTHERS = [case for case in CASES if not case.get("conformal")]


def system_of(case):
    q = ss.coordinates(" ".join(f"q{i}" for i in range(len(case["q0"]))))
    names = {"t": ss.time}
    for i, x in enumerate(q):
        names |= {f"q{i}": x, f"v{i}": x.diff()}
    values = {
        sp.Symbol(name, real=True): float(sp.Rational(value))
        for name, value in case["parameters"].items()
    }
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
    if case.get("conformal") and options.get("exploit", "all") == "all":
        options["exploit"] = ("all", "conformal")
    return ss.compile(system_of(case), scheme, **options)


def run_of(case, stepper, number, **options):
    """Integrate with numbers of one kind, inputs included."""
    start, given = given_to(case, number)
    return stepper.integrate(start, **given, **options)


def given_to(case, number):
    """Return q0 and what else a run of a case is given, as numbers of one kind."""
    read = np.frompyfunc(number, 1, 1)
    q, p = (read(case[name]) for name in ("q0", "p0"))
    values = {name: number(value) for name, value in case["parameters"].items()}
    inputs = read(case["u"]) if "inputs" in case else None
    return q, {
        "p0": p,
        "h": number(case["h"]),
        "t0": number(case["t0"]),
        "steps": case["steps"],
        "parameters": values,
        "inputs": inputs,
    }
