"""The two forms of a robot: coordinates of joints, or a position and a quaternion of each body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.bodies import body_rates, rotation_matrix
from symsimpson.declare.coordinates import time
from symsimpson.declare.robots.bodies_of_tree import WORLD, Bodies, MovingBody
from symsimpson.declare.robots.recursion import (
    Vector,
    attached,
    energies,
    exact,
    exact_number,
    frames,
    motions_of,
)
from symsimpson.declare.robots.tree import COORDINATES, RobotTree, reject_robot

#: A coordinate, or all coordinates of a joint or body.
Functions = tuple[AppliedUndef, ...]


@dataclass(frozen=True)
class Form:
    """The expressions of a robot."""

    functions: Mapping[str, Functions]  #: The coordinates by joint, or by body.
    kinetic: sp.Expr
    potential: sp.Expr
    constraints: Mapping[str, sp.Expr]
    rates: Mapping[str, sp.Expr]  #: The velocity that each input acts on.
    frames: Sequence[tuple[Vector, Vector]]  #: Of the bodies, and of the world.
    quaternions: tuple[Functions, ...]

    @property
    def coordinates(self) -> Functions:
        """All coordinates."""
        return tuple(q for some in self.functions.values() for q in some)


def functions_of_time(name: str, kind: str) -> Functions:
    """Return the coordinates of a joint or body."""
    return tuple(sp.Function(name + end)(time) for end in COORDINATES[kind])


def _length(e: Functions, moments: np.ndarray[Any, Any]) -> tuple[sp.Expr, sp.Expr]:
    """Return the kinetic energy of the length of a quaternion, and its constraint.

    The energy belongs to a motion that the constraint forbids. It makes the mass matrix regular.
    """
    rate = sum((x * x.diff(time) for x in e), sp.S.Zero)
    fourth = float(np.trace(moments)) / 3 or 1.0
    return 2 * exact_number(fourth) * rate**2, (sum(x**2 for x in e) - 1) / 2


def in_joints(tree: RobotTree, bodies: Bodies, gravity: Vector) -> Form:
    """Return T and V in the coordinates of joints."""
    functions: dict[str, Functions] = {}
    if bodies.moving[0].joint is None:
        functions["base"] = functions_of_time("base", "floating")
    for joint in tree.joints:
        if joint.coordinates and joint.mimic is None:
            functions[joint.name] = functions_of_time(joint.name, joint.kind)
    moving = {name: tuple(x.diff(time) for x in some) for name, some in functions.items()}
    motions = motions_of(tree, bodies, functions, moving)
    kinetic, potential = energies(bodies, motions, gravity)
    extra, springs, constraints = list[sp.Expr](), list[sp.Expr](), dict[str, sp.Expr]()
    quaternions = list[Functions]()
    for body, motion in zip(bodies.moving, motions, strict=True):
        if body.kind in ("floating", "ball"):
            key = body.joint.name if body.joint else "base"
            quaternions.append(functions[key][-4:])
            energy, phi = _length(quaternions[-1], body.inertia.about_centre())
            extra.append(energy)
            constraints[f"quaternion_{key}"] = phi
        elif body.joint is not None:
            extra.append(exact_number(body.joint.armature) * motion.v[-1] ** 2 / 2)
            bent = motion.q[-1] - exact_number(body.joint.rest)
            springs.append(exact_number(body.joint.stiffness) * bent**2 / 2)
    rates = {
        q.func.__name__: q.diff(time)
        for joint in tree.joints
        if joint.kind not in ("floating", "ball")
        for q in functions.get(joint.name, ())
    }
    return Form(
        functions,
        sp.Add(kinetic, *extra),
        sp.Add(potential, *springs),
        constraints,
        rates,
        frames(bodies, motions),
        tuple(quaternions),
    )


def in_bodies(tree: RobotTree, bodies: Bodies, gravity: Vector) -> Form:
    """Return T and V of free bodies, and joints as constraints.

    The coordinates of a body are its centre of mass and a quaternion.
    """
    functions = {x.name: functions_of_time(x.name, "floating") for x in bodies.moving}
    terms, weights, constraints = list[sp.Expr](), list[sp.Expr](), dict[str, sp.Expr]()
    rates, frames_of_bodies, omegas = (
        dict[str, sp.Expr](),
        list[tuple[Vector, Vector]](),
        list[Vector](),
    )
    for body in bodies.moving:
        q, inertia = functions[body.name], body.inertia
        if not inertia.mass:
            reject_robot(
                tree.file,
                f"the link {body.name!r} has no mass, so it has no motion of its own.",
                tree.links[body.name].where,
                "Use form='joints'.",
            )
        omega = np.array(list(body_rates(q[3:])), dtype=object)
        J, mass = exact(inertia.about_centre()), exact_number(inertia.mass)
        length, phi = _length(q[3:], inertia.about_centre())
        speed = sum((x.diff(time) ** 2 for x in q[:3]), sp.S.Zero)
        terms += [mass * speed / 2, omega @ J @ omega / 2, length]
        weights.append(-mass * (gravity @ np.array(q[:3])))
        constraints[f"quaternion_{body.name}"] = phi
        turn = np.array(rotation_matrix(q[3:]), dtype=object)
        origin = np.array(q[:3]) - turn @ exact(inertia.moment / inertia.mass)
        omegas.append(omega)
        frames_of_bodies.append((origin, turn))
    frames_of_bodies.append((np.full(3, sp.S.Zero), exact(np.eye(3))))
    for number, body in enumerate(bodies.moving):
        if body.joint is None:
            continue
        _reject_dependent(tree, body)
        joint, (origin, turn) = body.joint, frames_of_bodies[number]
        place, axes = attached(frames_of_bodies[body.parent], body.place)
        gap = axes.T @ (origin - place)
        twist = turn.T @ axes  # components of the axes of the joint in the body
        conditions, moved = _conditions(joint.kind, gap, twist, origin - place)
        constraints |= {f"{joint.name}_{k}": x for k, x in enumerate(conditions, 1)}
        about = omegas[number][2]
        if body.parent != WORLD:
            about -= exact(body.place.turn)[:, 2] @ omegas[body.parent]
        for name, x in zip(joint.coordinates, [*moved, None], strict=False):
            if joint.kind not in ("floating", "ball"):
                rates[name] = about if x is None else x.diff(time)
        if joint.kind in ("revolute", "continuous", "prismatic"):
            rate = rates[joint.name]
            terms.append(exact_number(joint.armature) * rate**2 / 2)
    return Form(
        functions,
        sp.Add(*terms),
        sp.Add(*weights),
        constraints,
        rates,
        frames_of_bodies,
        tuple(q[3:] for q in functions.values()),
    )


def _conditions(
    kind: str, gap: Vector, twist: Vector, shift: Vector
) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Return what a joint makes zero, and its displacements.

    ``gap`` is the shift of the body in the axes of the joint, and ``twist`` has these axes in the
    frame of the body.
    """
    aligned = [twist[2, 0], twist[2, 1]]  # the axis z of the body on the axes x and y of the joint
    if kind in ("revolute", "continuous"):
        return [*shift, *aligned], []
    if kind == "prismatic":
        return [gap[0], gap[1], *aligned, twist[0, 1]], [gap[2]]
    if kind == "planar":
        return [gap[2], *aligned], [gap[0], gap[1]]
    return ([*shift] if kind == "ball" else []), []


def _reject_dependent(tree: RobotTree, body: MovingBody) -> None:
    joint = body.joint
    assert joint is not None
    if joint.mimic is not None or joint.stiffness:
        what = "mimics another one" if joint.mimic is not None else "has a spring"
        reject_robot(
            tree.file,
            f"the joint {joint.name!r} {what}, which needs the coordinate of the joint.",
            joint.where,
            "Use form='joints'.",
        )
