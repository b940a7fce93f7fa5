"""Rigid bodies with three different moments of inertia, in Euler angles."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["heavy_top", "rigid_body"]

Angles = tuple[AppliedUndef, ...]
_SOURCE = "H. Goldstein, C. Poole, J. Safko, Classical Mechanics, sections 4.4, 5.6 and 5.7"


def rigid_body() -> CatalogueSystem:
    """A free rigid body, started near the rotation about its unstable middle axis."""
    angles, inertia, kinetic, in_space = _turning()
    return CatalogueSystem(
        "rigid_body",
        coordinates=angles,
        kinetic=kinetic,
        potential=sp.S.Zero,
        parameters=dict(zip(inertia, (1.0, 2.0, 3.0), strict=True)),
        invariants={f"angular momentum {axis}": in_space[i] for i, axis in enumerate("xyz")},
        reference_state={"q0": (0.1, 1.2, 0.3), "v0": (0.5, 1.0, 0.2)},
        source=_SOURCE,
    )


def heavy_top() -> CatalogueSystem:
    """A heavy asymmetric top with a fixed point and its centre of mass on the third axis."""
    angles, inertia, kinetic, in_space = _turning()
    m, g, l = sp.symbols("m g l", positive=True)
    return CatalogueSystem(
        "heavy_top",
        coordinates=angles,
        kinetic=kinetic,
        potential=m * g * l * sp.cos(angles[1]),
        parameters={inertia[0]: 1.0, inertia[1]: 1.5, inertia[2]: 0.8, m: 1.0, g: 9.81, l: 0.3},
        invariants={"angular momentum z": in_space[2]},
        reference_state={"q0": (0.0, 1.0, 0.2), "v0": (0.5, 0.3, 6.0)},
        source=_SOURCE,
    )


def _turning() -> tuple[Angles, Sequence[sp.Symbol], sp.Expr, sp.Matrix]:
    """Return angles, moments of inertia, the kinetic energy, and angular momentum in space."""
    angles = coordinates("phi theta psi")
    inertia = sp.symbols("I1 I2 I3", positive=True)
    phi, theta, psi = angles
    # the angular velocity in the body, for rotations about z, x and z
    omega = [
        phi.diff() * sp.sin(theta) * sp.sin(psi) + theta.diff() * sp.cos(psi),
        phi.diff() * sp.sin(theta) * sp.cos(psi) - theta.diff() * sp.sin(psi),
        phi.diff() * sp.cos(theta) + psi.diff(),
    ]
    to_space = (sp.rot_axis3(psi) * sp.rot_axis1(theta) * sp.rot_axis3(phi)).T
    momentum = [i * w for i, w in zip(inertia, omega, strict=True)]
    kinetic = sp.Add(*(i * w**2 for i, w in zip(inertia, omega, strict=True))) / 2
    return angles, inertia, kinetic, to_space * sp.Matrix(momentum)
