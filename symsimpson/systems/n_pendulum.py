"""The plane pendulum with n links."""

from __future__ import annotations

import sympy as sp

from symsimpson.errors import ModelError
from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["n_pendulum"]


def n_pendulum(n: int = 3) -> CatalogueSystem:
    """A chain of n point masses on massless rods, absolute angles from the vertical."""
    if isinstance(n, bool) or not isinstance(n, int) or n < 1:
        raise ModelError(f"a pendulum has a whole number of links, not {n!r}.\nUse n_pendulum(3).")
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
