"""The mathematical pendulum."""

from __future__ import annotations

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["pendulum"]


def pendulum() -> CatalogueSystem:
    """A point mass on a massless rod, theta = 0 hanging down."""
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
