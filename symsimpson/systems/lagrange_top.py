"""The symmetric heavy top."""

from __future__ import annotations

import math

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.mechanics.system import Positions
from symsimpson.systems.entry import CatalogueSystem, State

__all__ = ["lagrange_top", "lagrange_top_cusps"]


def lagrange_top() -> CatalogueSystem:
    """The Lagrange top in Euler angles (phi, theta, psi), with a nutation that makes loops."""
    values = {"m_top": 0.1, "g": 9.81, "l": 0.15, "I": 0.00233, "I3": 0.000125}
    state = {"q0": (0.0, math.pi / 3, 0.0), "v0": (9.2, 0.0, 252.0)}
    return _top("lagrange_top", values, state)


def lagrange_top_cusps() -> CatalogueSystem:
    """The Lagrange top released with spin alone: its nutation makes cusps."""
    gravity = 9.81
    values = {"m_top": 1.0, "g": gravity, "l": 4 * math.pi**2 / gravity, "I": 1.0, "I3": 2.0}
    state = {"q0": (0.0, math.pi / 6, 0.0), "v0": (0.0, 0.0, 2 * math.pi)}
    return _top("lagrange_top_cusps", values, state)


#: The top is drawn as a disc around its axis, with so many points on its rim.
RIM = 6


def _points(phi: sp.Expr, theta: sp.Expr, psi: sp.Expr, l: sp.Expr) -> Positions:
    """Return the centre of mass, and the rim of a disc that turns with the body."""
    axis = sp.Matrix([sp.sin(theta) * sp.sin(phi), -sp.sin(theta) * sp.cos(phi), sp.cos(theta)])
    node = sp.Matrix([sp.cos(phi), sp.sin(phi), 0])
    third = sp.Matrix([-sp.cos(theta) * sp.sin(phi), sp.cos(theta) * sp.cos(phi), sp.sin(theta)])
    angles = [psi + 2 * sp.pi * sp.Rational(k, RIM) for k in range(RIM)]
    rim = [l * (axis + (node * sp.cos(a) + third * sp.sin(a)) / 2) for a in angles]
    return {"centre of mass": tuple(l * axis), "disc": rim}


def _top(name: str, values: dict[str, float], state: State) -> CatalogueSystem:
    phi, theta, psi = coordinates("phi theta psi")
    symbols = dict(zip(values, sp.symbols(list(values), positive=True), strict=True))
    m_top, g, l, inertia, spin_inertia = symbols.values()
    spin = psi.diff() + phi.diff() * sp.cos(theta)
    swing = theta.diff() ** 2 + phi.diff() ** 2 * sp.sin(theta) ** 2
    p_phi = inertia * phi.diff() * sp.sin(theta) ** 2 + spin_inertia * spin * sp.cos(theta)
    return CatalogueSystem(
        name,
        coordinates=(phi, theta, psi),
        kinetic=inertia * swing / 2 + spin_inertia * spin**2 / 2,
        potential=m_top * g * l * sp.cos(theta),
        parameters={symbol: values[key] for key, symbol in symbols.items()},
        positions=_points(phi, theta, psi, l),
        invariants={"p_phi": p_phi, "p_psi": spin_inertia * spin},
        reference_state=state,
        source="J. A. Rojas-Quintero, F. Dubois, F. Jourdan, arXiv:2512.03330, section 4",
    )
