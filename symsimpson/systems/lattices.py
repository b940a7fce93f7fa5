"""Chains, cloth and molecules: points with forces between neighbours."""

from __future__ import annotations

import math

import sympy as sp

from symsimpson.declare.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem, check_count


def fermi_pasta_ulam(n: int = 3) -> CatalogueSystem:
    """A chain of n stiff linear and n + 1 soft quartic springs between fixed ends.

    ``x_i`` is the scaled displacement of the i-th stiff spring, and ``y_i`` its scaled expansion.
    """
    check_count("fermi_pasta_ulam", "stiff springs", n, 1)
    x, y = coordinates(f"x1:{n + 1}"), coordinates(f"y1:{n + 1}")
    omega = sp.Symbol("omega", positive=True)
    soft = [
        x[0] - y[0],
        *(x[i + 1] - y[i + 1] - x[i] - y[i] for i in range(n - 1)),
        x[n - 1] + y[n - 1],
    ]
    stiffness = 50.0
    rest = (0.0,) * (n - 1)
    return CatalogueSystem(
        f"fermi_pasta_ulam_{n}",
        coordinates=(*x, *y),
        kinetic=sp.Add(*(q.diff() ** 2 for q in (*x, *y))) / 2,
        potential=omega**2 * sp.Add(*(yi**2 for yi in y)) / 2 + sp.Add(*(s**4 for s in soft)) / 4,
        parameters={omega: stiffness},
        reference_state={
            "q0": (1.0, *rest, 1.0 / stiffness, *rest),
            "v0": (1.0, *rest, 1.0, *rest),
        },
        source="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.5.1",
    )


def cloth(k: int = 10) -> CatalogueSystem:
    """A cloth of k by k points in space, with springs at neighbours and at two corners."""
    check_count("cloth", "points on each side", k, 2)
    places = [(i, j) for i in range(k) for j in range(k)]
    q = coordinates(" ".join(f"{axis}_{i}_{j}" for i, j in places for axis in "xyz"))
    point = {place: q[3 * n : 3 * n + 3] for n, place in enumerate(places)}
    m, stiffness, hold, length, g = sp.symbols("m stiffness hold length g", positive=True)
    springs = []
    for i, j in places:
        for other in ((i + 1, j), (i, j + 1)):
            if other in point:
                squares = ((x - y) ** 2 for x, y in zip(point[i, j], point[other], strict=True))
                springs.append((sp.sqrt(sp.Add(*squares)) - length) ** 2)
    corners = [
        (x - length * c) ** 2
        for i, j in ((0, 0), (0, k - 1))
        for x, c in zip(point[i, j], (i, j, 0), strict=True)
    ]
    weights = [m * g * z for _, _, z in point.values()]
    rest = 1.0 / (k - 1)
    return CatalogueSystem(
        f"cloth_{k}",
        coordinates=q,
        kinetic=m * sp.Add(*(x.diff() ** 2 for x in q)) / 2,
        potential=sp.Add(
            *(stiffness * s / 2 for s in springs), *(hold * s / 2 for s in corners), *weights
        ),
        parameters={m: 1.0 / k**2, stiffness: 100.0, hold: 1000.0, length: rest, g: 9.81},
        positions={f"point {i} {j}": xyz for (i, j), xyz in point.items()},
        reference_state={
            "q0": tuple(x for i, j in places for x in (rest * i, rest * j, 0.0)),
            "v0": (0.0,) * (3 * k**2),
        },
        source="X. Provot, Deformation constraints in a mass-spring model to describe rigid cloth "
        "behavior, Proc. Graphics Interface (1995), 147-154; structural springs alone",
    )


SOURCE = "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.4"
#: Boltzmann's constant in J/K. Energies are in kelvins, lengths in nanometres and times in
#: nanoseconds, so a mass of 1 kg is 1/BOLTZMANN.
BOLTZMANN = 1.380658e-23
PARAMETERS = {"epsilon": 119.8, "sigma": 0.341, "m": 66.34e-27 / BOLTZMANN}
#: Positions and velocities of seven atoms in a plane.
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
    """Seven atoms of argon in a plane: six around one, as in a frozen crystal."""
    state = [tuple(map(float, sum(table, ()))) for table in (PLACES, VELOCITIES)]
    return _atoms("argon", 7, 2, *state)


def argon_cluster(n: int = 20) -> CatalogueSystem:
    """Atoms of argon in space, at rest on the inner points of a face-centred cubic lattice."""
    reach = range(-4, 5)
    corners = [(i, j, k) for i in reach for j in reach for k in reach if (i + j + k) % 2 == 0]
    check_count("argon_cluster", "atoms", n, 2, len(corners))
    nearest = sorted(corners, key=lambda c: (c[0] ** 2 + c[1] ** 2 + c[2] ** 2, c))[:n]
    distance = 2 ** (1 / 6) * PARAMETERS["sigma"] / math.sqrt(2)
    places = tuple(distance * x for corner in nearest for x in corner)
    return _atoms(f"argon_cluster_{n}", n, 3, places, (0.0,) * (3 * n))


def _atoms(
    name: str, n: int, dimension: int, places: tuple[float, ...], velocities: tuple[float, ...]
) -> CatalogueSystem:
    """Declare atoms with the Lennard-Jones potential."""
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


#: 1 kcal/mol in atomic mass units, angstroms and femtoseconds.
KILOCALORIE = 4.184e-4


def water() -> CatalogueSystem:
    """Water with springs for bonds and angle, in angstroms, femtoseconds and mass units."""
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
