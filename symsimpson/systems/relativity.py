"""Motions in space-time, and particles and binaries that are fast."""

from __future__ import annotations

import sympy as sp

from symsimpson.declare.coordinates import coordinates
from symsimpson.systems.entry import CatalogueHamiltonian, CatalogueSystem


def schwarzschild_geodesic() -> CatalogueSystem:
    """A particle that falls around a black hole at rest, in proper time; M is indefinite.

    The orbit has the semilatus rectum 11 M and the eccentricity 0.3, and starts at its apocentre.
    T is the time of a distant clock.
    """
    T, r, phi = coordinates("T r phi")
    M = sp.Symbol("M", positive=True)
    lapse = 1 - 2 * M / r
    metric = -lapse * T.diff() ** 2 + r.diff() ** 2 / lapse + r**2 * phi.diff() ** 2
    return CatalogueSystem(
        "schwarzschild_geodesic",
        coordinates=(T, r, phi),
        kinetic=metric / 2,
        potential=sp.S.Zero,
        parameters={M: 1.0},
        positions={"particle": (r * sp.cos(phi), r * sp.sin(phi))},
        invariants={"length of the velocity": metric},
        reference_state={
            "q0": (0.0, 110 / 7, 0.0),
            "p0": (-0.96269934254426334, 0.0, 3.9111497399412786),
        },
        source="S. Chandrasekhar, The Mathematical Theory of Black Holes, section 19",
    )


def kerr_geodesic() -> CatalogueSystem:
    """A particle in the equatorial plane of a rotating black hole, in proper time.

    The orbit has the semilatus rectum 6 M and the eccentricity 0.3 around a black hole with the
    angular momentum a = 0.9 M, and starts at its apocentre. Per unit of T, its frequencies are
    0.0376456484052298 (radial) and 0.0581612206109147 (of phi).
    """
    T, r, phi = coordinates("T r phi")
    M, a = sp.symbols("M a", positive=True)
    horizon = r**2 - 2 * M * r + a**2
    turning = -4 * M * a / r * T.diff() * phi.diff()
    around = (r**2 + a**2 + 2 * M * a**2 / r) * phi.diff() ** 2
    metric = -(1 - 2 * M / r) * T.diff() ** 2 + turning + around + r**2 / horizon * r.diff() ** 2
    return CatalogueSystem(
        "kerr_geodesic",
        coordinates=(T, r, phi),
        kinetic=metric / 2,
        potential=sp.S.Zero,
        parameters={M: 1.0, a: 0.9},
        positions={"particle": (r * sp.cos(phi), r * sp.sin(phi))},
        invariants={"length of the velocity": metric},
        reference_state={
            "q0": (0.0, 60 / 7, 0.0),
            "p0": (-0.92912170911967213, 0.0, 2.8098629794950539),
        },
        source="J. M. Bardeen, W. H. Press and S. A. Teukolsky, Astrophys. J. 178 (1972) 347",
    )


def relativistic_charge() -> CatalogueSystem:
    """A fast charge in a magnetic bottle; L is not quadratic in the velocities.

    The field on the axis is B (1 + (z/l)^2). It turns the charge back at both ends.
    """
    x, y, z = coordinates("x y z")
    m, c, charge, field, length = sp.symbols("m c e B l", positive=True)
    vx, vy, vz = x.diff(), y.diff(), z.diff()
    free = -m * c**2 * sp.sqrt(1 - (vx**2 + vy**2 + vz**2) / c**2)
    bottle = charge * field / 2 * (1 + z**2 / length**2) * (x * vy - y * vx)
    return CatalogueSystem(
        "relativistic_charge",
        coordinates=(x, y, z),
        kinetic=free + bottle,
        potential=sp.S.Zero,
        parameters={m: 1.0, c: 1.0, charge: 1.0, field: 1.0, length: 2.0},
        positions={"charge": (x, y, z)},
        invariants={"squared speed": vx**2 + vy**2 + vz**2},
        reference_state={"q0": (1.0, 0.0, 0.0), "v0": (0.0, -0.7, 0.3)},
        source="J. D. Jackson, Classical Electrodynamics, sections 12.1 and 12.5",
    )


def post_newtonian_binary() -> CatalogueHamiltonian:
    """Two bodies to first post-Newtonian order, in their centre of mass, with reduced units.

    eps is 1/c^2, and nu the reduced mass divided by the total mass. From one apocentre to the next
    the direction turns by 0.245730315496435 more than 2 pi.
    """
    x, y = coordinates("x y")
    px, py = sp.symbols("px py", real=True)
    eps, nu = sp.symbols("eps nu", positive=True)
    r, squared = sp.sqrt(x**2 + y**2), px**2 + py**2
    radial = (x * px + y * py) / r
    correction = -(1 - 3 * nu) * squared**2 / 8 + 1 / (2 * r**2)
    correction -= ((3 + nu) * squared + nu * radial**2) / (2 * r)
    return CatalogueHamiltonian(
        "post_newtonian_binary",
        coordinates=(x, y),
        momenta=(px, py),
        hamiltonian=squared / 2 - 1 / r + eps * correction,
        parameters={eps: 0.01, nu: 0.25},
        positions={"separation": (x, y)},
        invariants={"angular momentum": x * py - y * px},
        reference_state={"q0": (1.9142304419288803, 0.0), "p0": (0.0, 0.49628298620213837)},
        source="T. Damour and G. Schaefer, Nuovo Cimento B 101 (1988) 127",
    )


def restricted_three_bodies() -> CatalogueHamiltonian:
    """A small body beside two large ones, in their rotating frame, near the point L4."""
    x, y = coordinates("x y")
    px, py = sp.symbols("px py", real=True)
    mu = sp.Symbol("mu", positive=True)
    first, second = sp.sqrt((x + mu) ** 2 + y**2), sp.sqrt((x - 1 + mu) ** 2 + y**2)
    hamiltonian = (px**2 + py**2) / 2 + y * px - x * py - (1 - mu) / first - mu / second
    return CatalogueHamiltonian(
        "restricted_three_bodies",
        coordinates=(x, y),
        momenta=(px, py),
        hamiltonian=hamiltonian,
        parameters={mu: 0.0125},
        positions={"body": (x, y)},
        invariants={"Jacobi's constant": -2 * hamiltonian},
        reference_state={"q0": (0.4975, 0.8660254), "p0": (-0.8660254, 0.4875)},
        source="V. Szebehely, Theory of Orbits, Academic Press 1967, section 1.5",
    )


def point_vortices() -> CatalogueHamiltonian:
    """Three point vortices in a plane, q = x and p = g y; H_pp is singular."""
    x = coordinates("x1 x2 x3")
    p = sp.symbols("p1 p2 p3", real=True)
    g = sp.symbols("g1 g2 g3", nonzero=True, real=True)
    pairs = ((0, 1), (0, 2), (1, 2))
    hamiltonian = sp.Add(
        *(
            -g[i] * g[j] * sp.log((x[i] - x[j]) ** 2 + (p[i] / g[i] - p[j] / g[j]) ** 2) / 4 / sp.pi
            for i, j in pairs
        )
    )
    return CatalogueHamiltonian(
        "point_vortices",
        coordinates=x,
        momenta=p,
        hamiltonian=hamiltonian,
        parameters=dict(zip(g, (1.0, 0.75, -0.5), strict=True)),
        invariants={
            "impulse x": sp.Add(*p),
            "impulse y": -sp.Add(*(g[i] * x[i] for i in range(3))),
            "angular impulse": sp.Add(*(g[i] * x[i] ** 2 + p[i] ** 2 / g[i] for i in range(3))),
        },
        reference_state={"q0": (0.0, 1.0, 0.25), "p0": (0.1, -0.2, 0.45)},
        source="H. Aref, Annu. Rev. Fluid Mech. 15 (1983) 345",
    )


def lotka_volterra() -> CatalogueHamiltonian:
    """Prey exp(q) and predators exp(p), with H = T(p) + V(q)."""
    (q,) = coordinates("q")
    p = sp.Symbol("p", real=True)
    birth, eaten, growth, death = sp.symbols("birth eaten growth death", positive=True)
    return CatalogueHamiltonian(
        "lotka_volterra",
        coordinates=(q,),
        momenta=(p,),
        hamiltonian=birth * p - eaten * sp.exp(p) + death * q - growth * sp.exp(q),
        parameters={birth: 1.0, eaten: 1.0, growth: 1.0, death: 1.0},
        reference_state={"q0": (0.6931471805599453,), "p0": (0.0,)},
        source="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section I.1",
    )


def spin_boson() -> CatalogueHamiltonian:
    """A spin of length j that is coupled to an oscillator; H_JJ passes through zero.

    J is the component of the spin along its axis, and phi the angle about it.
    """
    phi, x = coordinates("phi x")
    J, p = sp.symbols("J p", real=True)
    j, split, omega, coupling = sp.symbols("j split omega coupling", positive=True)
    spin = split * J + coupling * x * sp.sqrt(j**2 - J**2) * sp.cos(phi)
    return CatalogueHamiltonian(
        "spin_boson",
        coordinates=(phi, x),
        momenta=(J, p),
        hamiltonian=spin + (p**2 + omega**2 * x**2) / 2,
        parameters={j: 1.0, split: 1.0, omega: 0.8, coupling: 0.2},
        reference_state={"q0": (0.4, 0.5), "p0": (0.3, 0.0)},
        source="C. Emary and T. Brandes, Phys. Rev. E 67 (2003) 066203, classical limit",
    )
