"""Rotating rigid bodies, in Euler angles or in coordinates with constraints."""

from __future__ import annotations

import math
from collections.abc import Sequence

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.bodies import RigidBody, coincide
from symsimpson.declare.coordinates import coordinates
from symsimpson.declare.declared import Positions
from symsimpson.systems.entry import CatalogueSystem, State


def lagrange_top() -> CatalogueSystem:
    """The Lagrange top in Euler angles (phi, theta, psi), with a nutation with loops."""
    values = {"m_top": 0.1, "g": 9.81, "l": 0.15, "I": 0.00233, "I3": 0.000125}
    state = {"q0": (0.0, math.pi / 3, 0.0), "v0": (9.2, 0.0, 252.0)}
    return _top("lagrange_top", values, state)


def lagrange_top_cusps() -> CatalogueSystem:
    """The Lagrange top released with spin only, with a nutation with cusps."""
    gravity = 9.81
    values = {"m_top": 1.0, "g": gravity, "l": 4 * math.pi**2 / gravity, "I": 1.0, "I3": 2.0}
    state = {"q0": (0.0, math.pi / 6, 0.0), "v0": (0.0, 0.0, 2 * math.pi)}
    return _top("lagrange_top_cusps", values, state)


#: Number of points on the rim of the disc that represents the top in drawings.
RIM = 6


def _points(phi: sp.Expr, theta: sp.Expr, psi: sp.Expr, l: sp.Expr) -> Positions:
    """Return the points to draw: the centre of mass, and the rim of a disc of the body."""
    axis = sp.Matrix([sp.sin(theta) * sp.sin(phi), -sp.sin(theta) * sp.cos(phi), sp.cos(theta)])
    node = sp.Matrix([sp.cos(phi), sp.sin(phi), 0])
    third = sp.Matrix([-sp.cos(theta) * sp.sin(phi), sp.cos(theta) * sp.cos(phi), sp.sin(theta)])
    angles = [psi + 2 * sp.pi * sp.Rational(k, RIM) for k in range(RIM)]
    rim = [l * (axis + (node * sp.cos(a) + third * sp.sin(a)) / 2) for a in angles]
    return {"centre of mass": tuple(l * axis), "disc": rim}


def _top(name: str, values: dict[str, float], state: State) -> CatalogueSystem:
    """Declare a Lagrange top with these parameters and this initial state."""
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


Angles = tuple[AppliedUndef, ...]
_SOURCE = "H. Goldstein, C. Poole, J. Safko, Classical Mechanics, sections 4.4, 5.6 and 5.7"


def rigid_body() -> CatalogueSystem:
    """A free rigid body that rotates near its unstable middle axis."""
    angles, inertia, kinetic, in_space = _rotating_body()
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
    angles, inertia, kinetic, in_space = _rotating_body()
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


def _rotating_body() -> tuple[Angles, Sequence[sp.Symbol], sp.Expr, sp.Matrix]:
    """Return Euler angles, moments of inertia, T, and the angular momentum in space."""
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


def cartesian_pendulum() -> CatalogueSystem:
    """A pendulum in Cartesian coordinates, which have no singularity at the lowest point."""
    x, y, z = coordinates("x y z")
    m, l, g = sp.symbols("m l g", positive=True)
    return CatalogueSystem(
        "cartesian_pendulum",
        coordinates=(x, y, z),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2,
        potential=m * g * z,
        constraints={"rod": (x**2 + y**2 + z**2 - l**2) / 2},
        parameters={m: 1.3, l: 1.0, g: 9.81},
        positions={"bob": (x, y, z)},
        reference_state={"q0": (0.6, 0.0, -0.8), "v0": (0.4, 1.7, 0.3)},
        source="E. Hairer, Ch. Lubich, G. Wanner, Geometric Numerical Integration, VII.1.1",
    )


def quaternion_top() -> CatalogueSystem:
    """A heavy asymmetric top about a fixed point, with a unit quaternion."""
    g, m = sp.symbols("g m", positive=True)
    body = RigidBody("top", inertia=(1, sp.Rational(3, 2), sp.Rational(4, 5)))
    centre = (sp.Rational(1, 10), sp.Rational(-1, 5), 1)
    heavy = body.to_space(centre)
    q0, v0 = body.state(quaternion=(0.48, 0.64, 0.36, 0.48), angular_velocity=(0.4, -0.8, 4.2))
    return CatalogueSystem(
        "quaternion_top",
        coordinates=body.coordinates,
        kinetic=body.kinetic,
        potential=m * g * heavy[2],
        constraints=dict(zip(["length"], body.constraints, strict=True)),
        parameters={m: 0.3, g: 9.81},
        positions={"centre of mass": tuple(heavy)},
        reference_state={"q0": tuple(q0.tolist()), "v0": tuple(v0.tolist())},
        source="B. Leimkuhler and S. Reich, Simulating Hamiltonian Dynamics, chapter 8",
    )


def tumbling_body() -> CatalogueSystem:
    """A free body that spins about its middle axis and flips periodically."""
    body = RigidBody("body", inertia=(1, 2, 3))
    q0, v0 = body.state(angular_velocity=(0.01, 3.0, 0.0))
    spin = body.to_space(body.inertia * body.angular_velocity)
    return CatalogueSystem(
        "tumbling_body",
        coordinates=body.coordinates,
        kinetic=body.kinetic,
        potential=sp.S.Zero,
        constraints=dict(zip(["length"], body.constraints, strict=True)),
        invariants={f"angular momentum {axis}": spin[k] for k, axis in enumerate("xyz")},
        positions={"axis": tuple(body.to_space((0, 1, 0)))},
        reference_state={"q0": tuple(q0.tolist()), "v0": tuple(v0.tolist())},
        source="M. S. Ashbaugh, C. C. Chicone, R. H. Cushman, J. Dyn. Diff. Eq. 3 (1991) 67",
    )


def jointed_bodies() -> CatalogueSystem:
    """A body that swings about a fixed point, with a second one on a ball joint."""
    m1, m2, l1, c1, l2, g = sp.symbols("m1 m2 l1 c1 l2 g", positive=True)
    tenth = sp.Rational(1, 10)
    first = RigidBody("a", inertia=(9 * tenth, 11 * tenth, 5 * tenth))
    second = RigidBody("b", inertia=(3 * tenth, 4 * tenth, 2 * tenth), mass=m2)
    elbow = first.point((0, 0, -l1))
    joint = coincide(second.point((0, 0, l2)), elbow)
    names = ["length_a", "length_b", "joint_x", "joint_y", "joint_z"]
    held = [*first.constraints, *second.constraints, *joint]
    return CatalogueSystem(
        "jointed_bodies",
        coordinates=(*first.coordinates, *second.coordinates),
        kinetic=first.kinetic + second.kinetic,
        potential=g * (m1 * first.point((0, 0, -c1))[2] + m2 * second.position[2]),
        constraints=dict(zip(names, held, strict=True)),
        parameters={m1: 1.0, m2: 0.8, l1: 0.5, c1: 0.4, l2: 0.3, g: 9.81},
        positions={"elbow": tuple(elbow), "second": tuple(second.position)},
        reference_state={
            "q0": (0.48, 0.64, 0.36, 0.48, 0.96, 0.28, 0.0, 0.0, -0.48, 0.29568, -0.21376),
            "v0": (-0.268, -0.174, 0.456, 0.158, -0.14, 0.48, -1.38, 1.16, 0.46, -0.27784, 0.26688),
        },
        source="P. Betsch and S. Leyendecker, Int. J. Numer. Meth. Engng 67 (2006) 499",
    )
