"""Systems with contacts and dry friction, from the texts of golden cases, and small ones."""

import json

import numpy as np
import sympy as sp

import symsimpson as ss
from support.places import DATA

CASES = {
    case["name"]: case
    for case in json.loads((DATA / "golden_friction.json").read_text(encoding="utf-8"))["cases"]
}
x, y, z = ss.coordinates("x y z")
k = sp.Symbol("k", positive=True)


def read_case(name):
    """Return the system of a golden case, and its initial positions and velocities."""
    case = CASES[name]
    q = tuple(ss.coordinates(" ".join(case["coordinates"])))
    symbols = {key: sp.Symbol(key) for key in case["parameters"]}
    known = {**dict(zip(case["coordinates"], q, strict=True)), **symbols}
    known |= dict(zip(case["velocities"], (x.diff() for x in q), strict=True))
    known |= {"t": ss.time, "slip": ss.slip}

    def text(given):
        return sp.sympify(given, locals=known)

    contacts, friction = {}, {}
    for one in case.get("contacts", ()):
        of_slip = {key: text(one[key]) for key in ("friction", "slip") if key in one}
        contacts[one["name"]] = ss.Contact(
            text(one["gap"]), restitution=text(one["restitution"]), **of_slip
        )
    for one in case.get("friction", ()):
        limits = {key: text(one[key]) for key in ("limit", "static") if key in one}
        friction[one["name"]] = ss.Friction(text(one["velocity"]), **limits)
    forces = {known[key]: text(value) for key, value in case.get("forces", {}).items()}
    system = ss.MechanicalSystem.from_lagrangian(
        name,
        text(case["lagrangian"]),
        q,
        {symbols[key]: float(sp.Rational(value)) for key, value in case["parameters"].items()},
        forces=forces or None,
        contacts=contacts,
        friction=friction,
    )
    states = ([float(text(value)) for value in case[key]] for key in ("q0", "v0"))
    return system, *states


def number(text):
    return float(sp.Rational(text))


def run_case(name, scheme, h, **more):
    """Integrate a golden case with a step size."""
    system, q0, v0 = read_case(name)
    end = number(CASES[name]["t_end"])
    return ss.compile(system, scheme).integrate(q0, v0=v0, h=h, t_end=end, **more)


def events_of(run):
    """Return times, names and kinds of the records; not the impacts just before a rest."""
    records = [(x.t, run.event_names[x.event], x.kind) for x in run.records]
    rests = np.array([t for t, _, kind in records if kind == "rest"])
    return [
        one
        for one in records
        if one[2] != "impact" or not ((rests >= one[0]) & (rests - one[0] < 1e-4)).any()
    ]


def brake(limit=0.3, **more):
    """A mass on a spring with a brake."""
    return ss.MechanicalSystem(
        "brake",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=k * x**2 / 2,
        parameters={k: 1.0},
        friction={"pad": ss.Friction(x.diff(), limit=limit, **more)},
    )


def ball(restitution=0.5, **more):
    """A ball above a floor."""
    return ss.MechanicalSystem(
        "ball",
        coordinates=(z,),
        kinetic=z.diff() ** 2 / 2,
        potential=10 * z,
        contacts={"floor": ss.Contact(z, restitution=restitution)},
        **more,
    )
