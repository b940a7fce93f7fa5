"""The spherical pendulum."""

from __future__ import annotations

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["spherical_pendulum"]


def spherical_pendulum() -> CatalogueSystem:
    """A point mass on a rod free to swing in space, theta = 0 hanging down."""
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
