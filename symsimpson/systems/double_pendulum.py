"""The double pendulum."""

from __future__ import annotations

import math
from dataclasses import replace

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates, time
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["double_pendulum", "driven_double_pendulum"]


def double_pendulum() -> CatalogueSystem:
    """Two point masses on massless rods, angles from the vertical, omega_0 = 2 pi/s."""
    q1, q2 = coordinates("q1 q2")
    m1, m2, l1, l2, g = sp.symbols("m1 m2 l1 l2 g", positive=True)
    gravity = 9.81
    length = gravity / (2 * math.pi) ** 2  # l = g/omega_0^2
    elbow = (l1 * sp.sin(q1), -l1 * sp.cos(q1))
    return CatalogueSystem(
        "double_pendulum",
        coordinates=(q1, q2),
        kinetic=(m1 + m2) * l1**2 * q1.diff() ** 2 / 2
        + m2 * l2**2 * q2.diff() ** 2 / 2
        + m2 * l1 * l2 * q1.diff() * q2.diff() * sp.cos(q1 - q2),
        potential=-(m1 + m2) * g * l1 * sp.cos(q1) - m2 * g * l2 * sp.cos(q2),
        parameters={m1: 1.0, m2: 1.0, l1: length, l2: length, g: gravity},
        positions={"elbow": elbow, "bob": (elbow[0] + l2 * sp.sin(q2), elbow[1] - l2 * sp.cos(q2))},
        reference_state={"q0": (math.pi / 4, math.pi / 3), "p0": (0.0, 0.0)},
        source="J. A. Rojas-Quintero, F. Dubois, F. Jourdan, arXiv:2512.03330, table 1, with "
        "l = g/omega_0^2",
    )


def driven_double_pendulum() -> CatalogueSystem:
    """The double pendulum with friction in both joints, and a torque at the first that swings."""
    free = double_pendulum()
    q1, q2 = free.coordinates
    c1, c2, a, w = sp.symbols("c1 c2 a w", positive=True)
    return replace(
        free,
        name="driven_double_pendulum",
        parameters={**free.parameters, c1: 0.05, c2: 0.05, a: 2.0, w: 5.0},
        forces={"motor": {q1: a * sp.cos(w * time)}},
        dissipation=c1 * q1.diff() ** 2 / 2 + c2 * (q2.diff() - q1.diff()) ** 2 / 2,
        source=f"{free.source}; friction and torque are ours",
    )
