"""The elastic pendulum."""

from __future__ import annotations

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["elastic_pendulum"]


def elastic_pendulum() -> CatalogueSystem:
    """A point mass on a spring that swings in a plane, theta = 0 hanging down."""
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
