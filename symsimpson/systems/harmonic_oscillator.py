"""The harmonic oscillator."""

from __future__ import annotations

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["harmonic_oscillator"]


def harmonic_oscillator() -> CatalogueSystem:
    """A mass on a linear spring; too simple to show a scheme's order."""
    (x,) = coordinates("x")
    m, k = sp.symbols("m k", positive=True)
    return CatalogueSystem(
        "harmonic_oscillator",
        coordinates=(x,),
        kinetic=m * x.diff() ** 2 / 2,
        potential=k * x**2 / 2,
        parameters={m: 1.0, k: 1.0},
        positions={"mass": (x,)},
        reference_state={"q0": (1.0,), "v0": (0.0,)},
        source="V. I. Arnold, Mathematical Methods of Classical Mechanics, section 4",
    )
