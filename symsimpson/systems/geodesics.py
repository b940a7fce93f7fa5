"""Free particles on curved surfaces."""

from __future__ import annotations

import sympy as sp

from symsimpson.declare.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem


def torus_geodesic() -> CatalogueSystem:
    """A free particle on a torus; p_phi is Clairaut's constant."""
    theta, phi = coordinates("theta phi")
    m, ring, tube = sp.symbols("m R r", positive=True)
    radius = ring + tube * sp.cos(theta)
    return CatalogueSystem(
        "torus_geodesic",
        coordinates=(theta, phi),
        kinetic=m * (tube**2 * theta.diff() ** 2 + radius**2 * phi.diff() ** 2) / 2,
        potential=sp.S.Zero,
        parameters={m: 1.0, ring: 2.0, tube: 1.0},
        positions={"particle": (radius * sp.cos(phi), radius * sp.sin(phi), tube * sp.sin(theta))},
        invariants={"p_phi": m * radius**2 * phi.diff()},
        reference_state={"q0": (0.3, 0.0), "v0": (1.0, 0.4)},
        source="M. P. do Carmo, Differential Geometry of Curves and Surfaces, section 4-4",
    )


def ellipsoid_geodesic() -> CatalogueSystem:
    """A free particle on an ellipsoid with three axes; Joachimsthal's integral is conserved."""
    theta, phi = coordinates("theta phi")
    m, *axes = sp.symbols("m a b c", positive=True)
    direction = (sp.sin(theta) * sp.cos(phi), sp.sin(theta) * sp.sin(phi), sp.cos(theta))
    position = [axis * component for axis, component in zip(axes, direction, strict=True)]
    velocity = [x.diff("t") for x in position]
    normal = sp.Add(*(x**2 / axis**4 for x, axis in zip(position, axes, strict=True)))
    bend = sp.Add(*(v**2 / axis**2 for v, axis in zip(velocity, axes, strict=True)))
    return CatalogueSystem(
        "ellipsoid_geodesic",
        coordinates=(theta, phi),
        kinetic=m * sp.Add(*(v**2 for v in velocity)) / 2,
        potential=sp.S.Zero,
        parameters={m: 1.0, axes[0]: 1.0, axes[1]: 1.4, axes[2]: 0.8},
        positions={"particle": tuple(position)},
        invariants={"Joachimsthal": normal * bend},
        reference_state={"q0": (1.2, 0.1), "v0": (0.3, 0.9)},
        source="V. I. Arnold, Mathematical Methods of Classical Mechanics, appendix 15",
    )
