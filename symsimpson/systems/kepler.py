"""The Kepler problem."""

from __future__ import annotations

import math

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["kepler", "kepler_plane"]


def kepler() -> CatalogueSystem:
    """A planet in polar coordinates, started at the pericentre of an ellipse, period 2 pi."""
    r, phi = coordinates("r phi")
    m, mu = sp.symbols("m mu", positive=True)
    x, y = r * sp.cos(phi), r * sp.sin(phi)
    vx = r.diff() * sp.cos(phi) - r * phi.diff() * sp.sin(phi)
    vy = r.diff() * sp.sin(phi) + r * phi.diff() * sp.cos(phi)
    area = r**2 * phi.diff()
    eccentricity = 0.6
    speed = math.sqrt((1 + eccentricity) / (1 - eccentricity))
    return CatalogueSystem(
        "kepler",
        coordinates=(r, phi),
        kinetic=m * (r.diff() ** 2 + r**2 * phi.diff() ** 2) / 2,
        potential=-m * mu / r,
        parameters={m: 1.0, mu: 1.0},
        positions={"planet": (x, y)},
        invariants={
            "angular momentum": m * area,
            "eccentricity x": vy * area / mu - sp.cos(phi),
            "eccentricity y": -vx * area / mu - sp.sin(phi),
        },
        reference_state={"q0": (1 - eccentricity, 0.0), "v0": (0.0, speed / (1 - eccentricity))},
        source="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.2",
    )


def kepler_plane() -> CatalogueSystem:
    """A comet in Cartesian coordinates, started at the apocentre of a narrow ellipse, period 2 pi.

    Fixed steps miss its pericentre: for ``kepler_plane().retimed("encounters")``.
    """
    x, y = coordinates("x y")
    m, mu = sp.symbols("m mu", positive=True)
    r, area = sp.sqrt(x**2 + y**2), x * y.diff() - y * x.diff()
    eccentricity = 0.9
    return CatalogueSystem(
        "kepler_plane",
        coordinates=(x, y),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-m * mu / r,
        parameters={m: 1.0, mu: 1.0},
        positions={"comet": (x, y)},
        invariants={
            "angular momentum": m * area,
            "eccentricity x": y.diff() * area / mu - x / r,
            "eccentricity y": -x.diff() * area / mu - y / r,
        },
        reference_state={
            "q0": (1 + eccentricity, 0.0),
            "v0": (0.0, math.sqrt((1 - eccentricity) / (1 + eccentricity))),
        },
        source="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.2",
    )
