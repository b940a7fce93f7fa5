"""Chains of coordinates that are coupled to the next ones alone: their matrices are bands."""

from itertools import pairwise

import sympy as sp

import symsimpson as ss


def swinging_chain(mass=1, stiffness=1):
    """Six coordinates, each coupled to the next one, and terms linear in the velocities.

    What is given as a symbol is a parameter of value one.
    """
    x = ss.coordinates("x0:6")
    v = [c.diff() for c in x]
    pairs = list(pairwise(range(6)))
    kinetic = sum((2 + sp.cos(a)) * u**2 for a, u in zip(x, v, strict=True))
    kinetic += sum(sp.cos(x[i] - x[j]) * v[i] * v[j] for i, j in pairs)
    return ss.MechanicalSystem(
        "swinging_chain",
        coordinates=x,
        kinetic=mass * kinetic / 2,
        potential=stiffness * sum((x[i] - x[j]) ** 4 / 4 for i, j in pairs) + sum(a**4 for a in x),
        gyroscopic=sum(sp.sin(x[i]) * v[j] / 3 for i, j in pairs),
        parameters={a: 1.0 for a in (mass, stiffness) if isinstance(a, sp.Symbol)},
    )


def damped_chain(n=6, *, driven=True):
    """Springs with dampers beside them, drag, a drive at one end, an input at the other."""
    x, (c, k, u) = ss.coordinates(f"x0:{n}"), sp.symbols("c k u", real=True)
    v = [a.diff() for a in x]
    dampers = [c * (1 + (x[i + 1] - x[i]) ** 2) * (v[i + 1] - v[i]) for i in range(n - 1)]
    forces = dict.fromkeys(x, sp.S.Zero)
    for i, damper in enumerate(dampers):
        forces[x[i]] += damper
        forces[x[i + 1]] -= damper
    forces = {a: f - c * b**3 for (a, f), b in zip(forces.items(), v, strict=True)}
    forces[x[0]] += sp.cos(2 * ss.time) * x[1]
    forces[x[-1]] += u if driven else 0
    return ss.MechanicalSystem(
        "damped_chain",
        coordinates=x,
        kinetic=sum((1 + a**2 / 10) * b**2 for a, b in zip(x, v, strict=True)) / 2,
        potential=sum(k * (x[i + 1] - x[i]) ** 4 / 4 for i in range(n - 1)) + k * x[0] ** 2 / 2,
        parameters={c: 0.3, k: 2.0},
        forces=forces,
        inputs=[u] if driven else [],
    )
