"""A square piece of cloth."""

from __future__ import annotations

import sympy as sp

from symsimpson.errors import ModelError
from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["cloth"]


def cloth(k: int = 10) -> CatalogueSystem:
    """K by k points in space, springs between neighbours, two corners held by springs."""
    if isinstance(k, bool) or not isinstance(k, int) or k < 2:
        raise ModelError(f"a cloth has a whole number of points a side, not {k!r}.\nUse 10.")
    places = [(i, j) for i in range(k) for j in range(k)]
    q = coordinates(" ".join(f"{axis}_{i}_{j}" for i, j in places for axis in "xyz"))
    point = {place: q[3 * n : 3 * n + 3] for n, place in enumerate(places)}
    m, stiffness, hold, length, g = sp.symbols("m stiffness hold length g", positive=True)
    springs = []
    for i, j in places:
        for other in ((i + 1, j), (i, j + 1)):
            if other in point:
                squares = ((x - y) ** 2 for x, y in zip(point[i, j], point[other], strict=True))
                springs.append((sp.sqrt(sp.Add(*squares)) - length) ** 2)
    corners = [
        (x - length * c) ** 2
        for i, j in ((0, 0), (0, k - 1))
        for x, c in zip(point[i, j], (i, j, 0), strict=True)
    ]
    weights = [m * g * z for _, _, z in point.values()]
    rest = 1.0 / (k - 1)
    return CatalogueSystem(
        f"cloth_{k}",
        coordinates=q,
        kinetic=m * sp.Add(*(x.diff() ** 2 for x in q)) / 2,
        potential=sp.Add(
            *(stiffness * s / 2 for s in springs), *(hold * s / 2 for s in corners), *weights
        ),
        parameters={m: 1.0 / k**2, stiffness: 100.0, hold: 1000.0, length: rest, g: 9.81},
        positions={f"point {i} {j}": xyz for (i, j), xyz in point.items()},
        reference_state={
            "q0": tuple(x for i, j in places for x in (rest * i, rest * j, 0.0)),
            "v0": (0.0,) * (3 * k**2),
        },
        source="X. Provot, Deformation constraints in a mass-spring model to describe rigid cloth "
        "behavior, Proc. Graphics Interface (1995), 147-154; structural springs alone",
    )
