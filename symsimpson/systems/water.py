"""A flexible molecule of water."""

from __future__ import annotations

import math

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["water"]

#: A kilocalorie a mole in atomic mass units times square angstroms over square femtoseconds.
KILOCALORIE = 4.184e-4


def water() -> CatalogueSystem:
    """Two bonds and the angle between them as springs; angstroms, femtoseconds, mass units."""
    names = [f"{axis}_{atom}" for atom in ("O", "H1", "H2") for axis in "xyz"]
    q = coordinates(" ".join(names))
    oxygen, *hydrogens = (sp.Matrix(q[3 * i : 3 * i + 3]) for i in range(3))
    m_O, m_H, k_r, k_theta, r_0, theta_0 = sp.symbols(
        "m_O m_H k_r k_theta r_0 theta_0", positive=True
    )
    bonds = [hydrogen - oxygen for hydrogen in hydrogens]
    lengths = [sp.sqrt(bond.dot(bond)) for bond in bonds]
    angle = sp.acos(bonds[0].dot(bonds[1]) / (lengths[0] * lengths[1]))
    masses = (m_O, m_H, m_H)
    bond, bend = 1.012, math.radians(113.24)
    half = (bond * math.sin(bend / 2), bond * math.cos(bend / 2))
    return CatalogueSystem(
        "water",
        coordinates=q,
        kinetic=sp.Add(*(masses[i // 3] * x.diff() ** 2 for i, x in enumerate(q))) / 2,
        potential=k_r * sp.Add(*((r - r_0) ** 2 for r in lengths)) / 2
        + k_theta * (angle - theta_0) ** 2 / 2,
        parameters={
            m_O: 15.9994,
            m_H: 1.008,
            k_r: 1059.162 * KILOCALORIE,
            k_theta: 75.90 * KILOCALORIE,
            r_0: bond,
            theta_0: bend,
        },
        positions={name: q[3 * i : 3 * i + 3] for i, name in enumerate(("O", "H1", "H2"))},
        reference_state={
            "q0": (0.0, 0.0, 0.0, half[0], half[1], 0.05, -half[0] - 0.06, half[1], 0.0),
            "v0": (0.0, 0.0, 0.0, 0.002, -0.01, 0.004, 0.003, 0.012, -0.004),
        },
        source="Y. Wu, H. L. Tepper, G. A. Voth, Flexible simple point-charge water model with "
        "improved liquid-state properties, J. Chem. Phys. 124 (2006), 024503",
    )
