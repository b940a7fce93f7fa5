"""Three bodies that meet closely: the problem of C. Burrau (Astron. Nachr. 195 (1913), 113-118)."""

import sympy as sp

import symsimpson as ss


def pythagorean():
    """Masses 3, 4, 5, each at rest at the corner opposite to the side of its length."""
    q = ss.coordinates("x1 y1 x2 y2 x3 y3")
    v = [c.diff() for c in q]
    m = (3, 4, 5)
    kinetic = sum(m[k] * (v[2 * k] ** 2 + v[2 * k + 1] ** 2) for k in range(3)) / 2
    potential = -sum(
        m[i] * m[j] / sp.sqrt((q[2 * i] - q[2 * j]) ** 2 + (q[2 * i + 1] - q[2 * j + 1]) ** 2)
        for i in range(3)
        for j in range(i)
    )
    system = ss.MechanicalSystem(
        "pythagorean", coordinates=q, kinetic=kinetic, potential=potential, parameters={}
    )
    object.__setattr__(system, "reference_state", {"q0": [1, 3, -2, -1, 1, -1], "v0": [0] * 6})
    return system
