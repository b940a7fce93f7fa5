"""Bodies that turn without poles, and points held by rods, in coordinates with constraints."""

from __future__ import annotations

import sympy as sp

from symsimpson.mechanics.bodies import RigidBody
from symsimpson.mechanics.coordinates import coordinates
from symsimpson.mechanics.rotations import coincide
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["cartesian_pendulum", "jointed_bodies", "quaternion_top", "tumbling_body"]


def cartesian_pendulum() -> CatalogueSystem:
    """A point on a rod of fixed length, in space: no pole where it hangs."""
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
    """A heavy top without symmetry about a fixed point, by a unit quaternion."""
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
    """A free body that spins about its middle axis, and turns over again and again."""
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
    """A body that swings about a fixed point, and another that hangs on it by a ball joint."""
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
