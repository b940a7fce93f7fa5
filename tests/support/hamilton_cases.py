"""Golden cases of general Lagrangians and Hamiltonians, and the systems that they declare."""

import json
from functools import cache

import mpmath as mp
import sympy as sp

import symsimpson as ss
from support.places import DATA

CONTENT = json.loads((DATA / "golden_hamilton.json").read_text("utf-8"))
#: Hamiltonians are integrated by schemes with as many nodes as degrees.
CASES = [case for case in CONTENT["cases"] if "needs" not in case]
EXACT = {entry["name"]: entry for entry in CONTENT["exact"]}


@cache
def declared(name):
    """Declare the system of a golden case."""
    case = next(case for case in CONTENT["cases"] if case["name"] == name)
    q = ss.coordinates(" ".join(case["coordinates"]))
    q = q if isinstance(q, tuple) else (q,)
    parameters = {sp.Symbol(k, real=True): float(v) for k, v in case["parameters"].items()}
    known = dict(zip(case["coordinates"], q, strict=True)) | {a.name: a for a in parameters}
    if case["kind"] == "lagrangian":
        known |= dict(zip(case["velocities"], (x.diff() for x in q), strict=True))
        L = sp.sympify(case["expression"], locals=known | {"t": ss.time})
        return ss.MechanicalSystem.from_lagrangian(name, L, q, parameters)
    p = tuple(sp.Symbol(x, real=True) for x in case["momenta"])
    known |= dict(zip(case["momenta"], p, strict=True))
    H = sp.sympify(case["expression"], locals=known | {"t": ss.time})
    return ss.HamiltonianSystem(
        name, coordinates=q, momenta=p, hamiltonian=H, parameters=parameters
    )


def start_of(case, number=float):
    """Return the initial state and the step of a case."""
    start = {name: [number(x) for x in case[name]] for name in ("q0", "v0", "p0") if name in case}
    return start | {"h": number(case["h"]), "t0": number(case["t0"])}


def relative_error(found, truth):
    """Return the largest difference, relative to the largest true number, or to 1."""
    truth = [mp.mpf(x) for x in truth]
    largest = max(1, *(abs(x) for x in truth))
    return max(abs(mp.mpf(x) - y) for x, y in zip(found, truth, strict=True)) / largest
