"""Golden periodic orbits, computed with 40 digits by another program, and their systems."""

import json
from functools import cache

import numpy as np
import sympy as sp

import symsimpson as ss
from support.places import DATA

CONTENT = json.loads((DATA / "golden_periodic.json").read_text("utf-8"))
PROBLEMS = {problem["name"]: problem for problem in CONTENT["problems"]}
#: Conditions that select one orbit of a family.
FIXED = {
    "lyapunov_L1": {"energy": -1.575, "y": 0},
    "halo_L2_south": {"y": 0, "z": -0.20235953267405354},
    "figure_eight": {"period": float(PROBLEMS["figure_eight"]["period"])},
    "nnm_in_phase": {"x1": 1, "v_x1": 0},
    "henon_heiles_a": {"energy": 1 / 12, "x": 0},
    "van_der_pol_1": {"v_x": 0},
}


def numbers(words):
    """Return an array of the numbers in these words."""
    return np.array([float(x) for x in words])


@cache
def declared(name):
    """Declare the system of a problem."""
    g = PROBLEMS[name]
    q = ss.coordinates(" ".join(g["coordinates"]))
    q = q if isinstance(q, tuple) else (q,)
    parameters = {sp.Symbol(k, real=True): float(v) for k, v in g["parameters"].items()}
    known = {a.name: a for a in parameters} | {"t": ss.time}
    known |= dict(zip(g["coordinates"], q, strict=True))
    known |= dict(zip(g["velocities"], [x.diff() for x in q], strict=True))

    def read(text):
        return sp.sympify(text, locals=known)

    if "lagrangian" in g:
        return ss.MechanicalSystem.from_lagrangian(name, read(g["lagrangian"]), q, parameters)
    forces = {known[k]: read(v) for k, v in g.get("forces", {}).items()}
    return ss.MechanicalSystem(
        name,
        coordinates=q,
        kinetic=read(g["kinetic"]),
        potential=read(g["potential"]),
        parameters=parameters,
        forces=forces or None,
    )


@cache
def walker():
    """Declare the compass-gait walker and the landing of its foot."""
    g, system = PROBLEMS["compass_gait"], declared("compass_gait")
    known = {str(a): a for a in system.parameters}
    known |= dict(zip(g["coordinates"], system.coordinates, strict=True))
    known |= dict(zip(g["velocities"], [x.diff() for x in system.coordinates], strict=True))

    def read(text):
        return sp.sympify(text, locals=known)

    import ast

    action = ast.literal_eval(g["action"]) if isinstance(g["action"], str) else g["action"]
    change = ss.Change(
        **{what: {known[k]: read(v) for k, v in values.items()} for what, values in action.items()}
    )
    landing = ss.Event(
        read(g["event"]),
        name="landing",
        direction=g["direction"],
        when=read(g["when"]),
        action=change,
        terminal=True,
    )
    return system, landing


def period_of(name):
    """Return the guess of the period, or the period of the drive."""
    if PROBLEMS[name]["kind"] != "forced":
        return float(PROBLEMS[name]["guess"]["period"])
    (w,) = (a for a in declared(name).parameters if a.name == "w")
    return 2 * sp.pi / w


def found(name, scheme, steps):
    """Search for the orbit of a problem from its guess."""
    guess = PROBLEMS[name]["guess"]
    stepper = ss.compile(declared(name), scheme)
    return stepper.periodic(
        numbers(guess["q0"]),
        numbers(guess["v0"]),
        period=period_of(name),
        steps=steps,
        fixed=FIXED.get(name),
    )
