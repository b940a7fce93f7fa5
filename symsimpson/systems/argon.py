"""Atoms of argon, frozen."""

from __future__ import annotations

import math

import sympy as sp

from symsimpson.errors import ModelError
from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["argon", "argon_cluster"]

SOURCE = "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.4"
#: Boltzmann's constant in joules a kelvin; energies are in kelvins, lengths in nanometres, times in
#: nanoseconds, so that masses of 1 kg are 1/BOLTZMANN.
BOLTZMANN = 1.380658e-23
PARAMETERS = {"epsilon": 119.8, "sigma": 0.341, "m": 66.34e-27 / BOLTZMANN}
#: Places and velocities of seven atoms in a plane.
PLACES = (
    (0.00, 0.00),
    (0.02, 0.39),
    (0.34, 0.17),
    (0.36, -0.21),
    (-0.02, -0.40),
    (-0.35, -0.16),
    (-0.31, 0.21),
)
VELOCITIES = ((-30, -20), (50, -90), (-70, -60), (90, 40), (80, 90), (-40, 100), (-80, -60))


def argon() -> CatalogueSystem:
    """Seven atoms of argon in a plane: six around one, in a frozen crystal."""
    state = [tuple(map(float, sum(table, ()))) for table in (PLACES, VELOCITIES)]
    return _atoms("argon", 7, 2, *state)


def argon_cluster(n: int = 20) -> CatalogueSystem:
    """Atoms of argon in space, at rest on a face-centred cubic lattice around its centre."""
    if isinstance(n, bool) or not isinstance(n, int) or n < 2:
        raise ModelError(f"a cluster has two atoms at least, not {n!r}.\nUse argon_cluster(20).")
    reach = range(-4, 5)
    corners = [(i, j, k) for i in reach for j in reach for k in reach if (i + j + k) % 2 == 0]
    if n > len(corners):
        raise ModelError(f"the lattice is made for {len(corners)} atoms, not {n}.\nUse fewer.")
    nearest = sorted(corners, key=lambda c: (c[0] ** 2 + c[1] ** 2 + c[2] ** 2, c))[:n]
    distance = 2 ** (1 / 6) * PARAMETERS["sigma"] / math.sqrt(2)
    places = tuple(distance * x for corner in nearest for x in corner)
    return _atoms(f"argon_cluster_{n}", n, 3, places, (0.0,) * (3 * n))


def _atoms(
    name: str, n: int, dimension: int, places: tuple[float, ...], velocities: tuple[float, ...]
) -> CatalogueSystem:
    """Declare atoms by Lennard and Jones's potential."""
    epsilon, sigma, m = sp.symbols("epsilon sigma m", positive=True)
    axes = "xyz"[:dimension]
    q = coordinates(" ".join(f"{axis}{i}" for i in range(n) for axis in axes))
    points = [q[dimension * i : dimension * (i + 1)] for i in range(n)]
    pairs = []
    for i, a in enumerate(points):
        for b in points[:i]:
            square = sp.Add(*((x - y) ** 2 for x, y in zip(a, b, strict=True)))
            pairs.append(4 * epsilon * (sigma**12 / square**6 - sigma**6 / square**3))
    return CatalogueSystem(
        name,
        coordinates=q,
        kinetic=m * sp.Add(*(x.diff() ** 2 for x in q)) / 2,
        potential=sp.Add(*pairs),
        parameters=dict(zip((epsilon, sigma, m), PARAMETERS.values(), strict=True)),
        positions={f"atom {i}": point for i, point in enumerate(points)},
        reference_state={"q0": places, "v0": velocities},
        source=SOURCE,
    )
