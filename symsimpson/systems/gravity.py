"""Bodies that attract each other."""

from __future__ import annotations

import math
from collections.abc import Sequence

import sympy as sp

from symsimpson.declare.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem, check_count


def kepler() -> CatalogueSystem:
    """A planet in polar coordinates, from the pericentre of an ellipse, with the period 2 pi."""
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
    """A comet in the plane, from the apocentre of a narrow ellipse, with the period 2 pi.

    Fixed steps do not resolve its pericentre. Use ``kepler_plane().retimed("encounters")``.
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


#: Sun with the inner planets, and the outer planets, on 5 September 1994: mass in solar masses,
#: position in astronomical units (AU), velocity in AU per day.
SOLAR_SYSTEM = """
    1.00000597682       0.0         0.0         0.0         0.0         0.0         0.0
    0.000954786104043  -3.5023653  -3.8169847  -1.5507963   0.00565429 -0.00412490 -0.00190589
    0.000285583733151   9.0755314  -3.0458353  -1.6483708   0.00168318  0.00483525  0.00192462
    0.0000437273164546  8.3101420 -16.2901086  -7.2521278   0.00354178  0.00137102  0.00055029
    0.0000517759138449 11.4707666 -25.7294829 -10.8169456   0.00288930  0.00114527  0.00039677
    7.692307692307692e-09 -15.5387357 -25.2225594 -3.1902382 0.00276725 -0.00170702 -0.00136504
    """


def outer_solar_system() -> CatalogueSystem:
    """The Sun, the four outer planets and Pluto, in days, astronomical units and solar masses."""
    rows = [tuple(map(float, row.split())) for row in SOLAR_SYSTEM.strip().splitlines()]
    masses, places, velocities = zip(*((row[0], row[1:4], row[4:]) for row in rows), strict=True)
    return _bodies(
        "outer_solar_system",
        masses,
        2.95912208286e-4,
        places,
        velocities,
        "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.2.4",
    )


def n_body(n: int = 3) -> CatalogueSystem:
    """Bodies of mass 1 at the corners of a turning regular polygon of radius 1, with G = 1."""
    check_count("n_body", "bodies", n, 2)
    angles = [2 * math.pi * k / n for k in range(n)]
    square = sum(1 / math.sin(math.pi * k / n) for k in range(1, n)) / 4
    omega = math.sqrt(square)
    places = [(math.cos(x), math.sin(x), 0.0) for x in angles]
    velocities = [(-omega * y, omega * x, 0.0) for x, y, _ in places]
    return _bodies(
        f"n_body_{n}",
        (1.0,) * n,
        1.0,
        places,
        velocities,
        "L. M. Perko, E. L. Walter, Regular polygon solutions of the N-body problem, "
        "Proc. AMS 94 (1985), 301-309",
    )


def pythagorean() -> CatalogueSystem:
    """Bodies of mass 3, 4 and 5 in the plane, at rest at the corners of a right-angled triangle.

    They have many close encounters until the lightest escapes, so steps must adapt. Use
    ``pythagorean().retimed("encounters")``.
    """
    return _bodies(
        "pythagorean",
        (3.0, 4.0, 5.0),
        1.0,
        ((1.0, 3.0), (-2.0, -1.0), (1.0, -1.0)),
        ((0.0, 0.0),) * 3,
        "C. Burrau, Astron. Nachr. 195 (1913), 113-118; V. Szebehely, C. F. Peters, Astron. J. 72 "
        "(1967), 876-883",
    )


def figure_eight() -> CatalogueSystem:
    """Three bodies of mass 1 that follow each other along a figure of eight, with G = 1.

    The period is 6.3259.
    """
    first, last = (0.97000436, -0.24308753), (-0.93240737, -0.86473146)
    half = tuple(-x / 2 for x in last)
    return _bodies(
        "figure_eight",
        (1.0,) * 3,
        1.0,
        (first, tuple(-x for x in first), (0.0, 0.0)),
        (half, half, last),
        "A. Chenciner, R. Montgomery, Annals of Mathematics 152 (2000), 881-901",
    )


def _bodies(
    name: str,
    masses: Sequence[float],
    gravitational_constant: float,
    places: Sequence[tuple[float, ...]],
    velocities: Sequence[tuple[float, ...]],
    source: str,
) -> CatalogueSystem:
    """Declare bodies in the plane or in space by their masses, positions and velocities."""
    n, axes = len(masses), "xyz"[: len(places[0])]
    G = sp.Symbol("G", positive=True)
    m = sp.symbols(f"m0:{n}", positive=True)
    q = coordinates(" ".join(f"{axis}{i}" for i in range(n) for axis in axes))
    points = [q[len(axes) * i : len(axes) * (i + 1)] for i in range(n)]
    potential = [
        -G * m[i] * m[j] / sp.sqrt(sp.Add(*((x - y) ** 2 for x, y in zip(a, b, strict=True))))
        for i, a in enumerate(points)
        for j, b in enumerate(points[:i])
    ]
    kinetic = [m[i] * x.diff() ** 2 / 2 for i, point in enumerate(points) for x in point]
    return CatalogueSystem(
        name,
        coordinates=q,
        kinetic=sp.Add(*kinetic),
        potential=sp.Add(*potential),
        parameters={**dict(zip(m, masses, strict=True)), G: gravitational_constant},
        positions={f"body {i}": point for i, point in enumerate(points)},
        reference_state={"q0": sum(places, ()), "v0": sum(velocities, ())},
        source=source,
    )
