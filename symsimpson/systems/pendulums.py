"""Pendulums: points on rods or springs."""

from __future__ import annotations

import math
from dataclasses import replace

import sympy as sp

from symsimpson.declare.coordinates import coordinates, time
from symsimpson.systems.entry import CatalogueSystem, check_count


def pendulum() -> CatalogueSystem:
    """A point mass on a massless rod, with theta = 0 hanging down."""
    (theta,) = coordinates("theta")
    m, l, g = sp.symbols("m l g", positive=True)
    return CatalogueSystem(
        "pendulum",
        coordinates=(theta,),
        kinetic=m * l**2 * theta.diff() ** 2 / 2,
        potential=-m * g * l * sp.cos(theta),
        parameters={m: 1.0, l: 1.0, g: 9.81},
        positions={"bob": (l * sp.sin(theta), -l * sp.cos(theta))},
        reference_state={"q0": (1.0,), "v0": (0.0,)},
        source="V. I. Arnold, Mathematical Methods of Classical Mechanics, section 4",
    )


def double_pendulum() -> CatalogueSystem:
    """Two point masses on massless rods, with angles from the vertical and omega_0 = 2 pi/s."""
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
    """The double pendulum with friction in both joints and a periodic torque at the first."""
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


def elastic_pendulum() -> CatalogueSystem:
    """A point mass on a spring that swings in a plane, with theta = 0 hanging down."""
    r, theta = coordinates("r theta")
    m, k, rest, g = sp.symbols("m k r0 g", positive=True)
    return CatalogueSystem(
        "elastic_pendulum",
        coordinates=(r, theta),
        kinetic=m * (r.diff() ** 2 + r**2 * theta.diff() ** 2) / 2,
        potential=k * (r - rest) ** 2 / 2 - m * g * r * sp.cos(theta),
        parameters={m: 1.0, k: 100.0, rest: 1.0, g: 9.81},
        positions={"bob": (r * sp.sin(theta), -r * sp.cos(theta))},
        reference_state={"q0": (1.2, 0.7), "v0": (0.0, 0.0)},
        source="A. Vitt, G. Gorelik, J. Tech. Phys. 3 (1933), 294-307",
    )


def spherical_pendulum() -> CatalogueSystem:
    """A point mass on a rod that swings in space, with theta = 0 hanging down."""
    theta, phi = coordinates("theta phi")
    m, l, g = sp.symbols("m l g", positive=True)
    swing = theta.diff() ** 2 + phi.diff() ** 2 * sp.sin(theta) ** 2
    bob = (sp.sin(theta) * sp.cos(phi), sp.sin(theta) * sp.sin(phi), -sp.cos(theta))
    return CatalogueSystem(
        "spherical_pendulum",
        coordinates=(theta, phi),
        kinetic=m * l**2 * swing / 2,
        potential=-m * g * l * sp.cos(theta),
        parameters={m: 1.0, l: 1.0, g: 9.81},
        positions={"bob": tuple(l * component for component in bob)},
        invariants={"p_phi": m * l**2 * sp.sin(theta) ** 2 * phi.diff()},
        reference_state={"q0": (1.0, 0.0), "v0": (0.0, 2.0)},
        source="J. E. Marsden, M. West, Acta Numerica 10 (2001), section 3.1.3",
    )


def n_pendulum(n: int = 3) -> CatalogueSystem:
    """A chain of n point masses on massless rods, with angles from the vertical."""
    check_count("n_pendulum", "links", n, 1)
    q = coordinates(f"q1:{n + 1}")
    m = sp.symbols(f"m1:{n + 1}", positive=True)
    l = sp.symbols(f"l1:{n + 1}", positive=True)
    g = sp.Symbol("g", positive=True)
    carried = [sp.Add(*m[i:]) for i in range(n)]  # the mass that hangs on each rod
    kinetic = sp.Add(
        *(carried[i] * l[i] ** 2 * q[i].diff() ** 2 / 2 for i in range(n)),
        *(
            carried[i] * l[i] * l[j] * q[i].diff() * q[j].diff() * sp.cos(q[i] - q[j])
            for i in range(n)
            for j in range(i)
        ),
    )
    potential = -sp.Add(*(carried[i] * g * l[i] * sp.cos(q[i]) for i in range(n)))
    positions, x, y = {}, sp.S.Zero, sp.S.Zero
    for i in range(n):
        x, y = x + l[i] * sp.sin(q[i]), y - l[i] * sp.cos(q[i])
        positions[f"bob {i + 1}"] = (x, y)
    return CatalogueSystem(
        f"n_pendulum_{n}",
        coordinates=q,
        kinetic=kinetic,
        potential=potential,
        parameters={**dict.fromkeys(m, 1.0), **dict.fromkeys(l, 1.0 / n), g: 9.81},
        positions=positions,
        reference_state={"q0": tuple(0.8 - 0.3 * i / n for i in range(n)), "v0": (0.0,) * n},
        source="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section VII.1.3",
    )
