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
