"""The Henon-Heiles system."""

from __future__ import annotations

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["henon_heiles"]


def henon_heiles() -> CatalogueSystem:
    """A star in the plane of a galaxy with a cubic potential; bounded for energies below 1/6."""
    x, y = coordinates("x y")
    return CatalogueSystem(
        "henon_heiles",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3,
        parameters={},
        positions={"star": (x, y)},
        reference_state={"q0": (0.0, 0.1), "v0": (0.48, 0.0)},
        source="M. Henon, C. Heiles, Astron. J. 69 (1964), 73-79",
    )
