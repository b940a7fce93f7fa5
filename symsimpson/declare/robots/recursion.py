"""T, V and frames of a robot with joint coordinates, from link to link.

Velocities are expressed in the frame of each body, from velocities of the previous body (Luh,
Walker and Paul, Journal of Dynamic Systems, Measurement and Control 102 (1980), 69-76). The length
of T is proportional to the number of bodies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.declare.bodies import body_rates, rotation_matrix
from symsimpson.declare.robots.bodies_of_tree import WORLD, Bodies, regrouped
from symsimpson.declare.robots.tree import Inertia, Placement, RobotTree
from symsimpson.support.array_types import Floats

#: Vectors and matrices of expressions.
Vector = NDArray[Any]


@dataclass(frozen=True)
class JointMotion:
    """How a joint moves its body: the shift and turn in the frame of the joint, and their rates.

    The rates are in the frame of the body.
    """

    shift: Vector
    turn: Vector
    velocity: Vector
    rate: Vector
    q: tuple[sp.Expr, ...]
    v: tuple[sp.Expr, ...]


def exact(numbers: Floats) -> Vector:
    """Return floats as SymPy numbers; 0 and 1 as integers, which vanish from products."""
    entries = [sp.Integer(int(x)) if x in (-1, 0, 1) else sp.Float(x) for x in numbers.ravel()]
    return np.array(entries, dtype=object).reshape(numbers.shape)


def exact_number(x: float) -> sp.Expr:
    """Return a float as a SymPy number."""
    return exact(np.array([x]))[0]


def joint_motion(kind: str, q: Sequence[sp.Expr], v: Sequence[sp.Expr]) -> JointMotion:
    """Return the motion of a joint along or about the axis z."""
    zero, turn, both = np.full(3, sp.S.Zero), exact(np.eye(3)), (tuple(q), tuple(v))
    if kind == "prismatic":
        along = np.array([sp.S.Zero, sp.S.Zero, v[0]])
        return JointMotion(np.array([sp.S.Zero, sp.S.Zero, q[0]]), turn, along, zero, *both)
    if kind in ("floating", "ball"):
        turn = np.array(rotation_matrix(q[-4:]), dtype=object)
        rate = np.array(list(body_rates(q[-4:], v[-4:])), dtype=object)
        shift, speed = (np.array(x[:3]) if len(x) == 7 else zero for x in both)
        return JointMotion(shift, turn, turn.T @ speed, rate, *both)
    c, s = sp.cos(q[-1]), sp.sin(q[-1])
    turn[:2, :2] = [[c, -s], [s, c]]
    rate = np.array([sp.S.Zero, sp.S.Zero, v[-1]])
    shift, speed = (np.array([*x[:-1], *[sp.S.Zero] * (4 - len(x))]) for x in both)
    return JointMotion(shift, turn, turn.T @ speed, rate, *both)


def motions_of(
    tree: RobotTree,
    bodies: Bodies,
    q: Mapping[str, Sequence[sp.Expr]],
    v: Mapping[str, Sequence[sp.Expr]],
) -> list[JointMotion]:
    """Return the motions of all bodies from coordinates and velocities by joint, or "base"."""
    named, motions = {x.name: x for x in tree.joints}, []
    for body in bodies.moving:
        factor, offset, joint = 1.0, 0.0, body.joint
        while joint is not None and joint.mimic is not None:
            leader, a, b = joint.mimic
            factor, offset, joint = factor * a, offset + factor * b, named[leader]
        key, a, b = joint.name if joint else "base", exact_number(factor), exact_number(offset)
        state = [a * x + b for x in q[key]], [a * x for x in v[key]]
        motions.append(joint_motion(body.kind, *state))
    return motions


def velocities(bodies: Bodies, motions: Sequence[JointMotion]) -> list[tuple[Vector, Vector]]:
    """Return angular velocity and velocity of the origin of each body, in its frame."""
    zero = np.full(3, sp.S.Zero)
    rates = [(zero, zero)]  # of the world, and then of the bodies
    for body, motion in zip(bodies.moving, motions, strict=True):
        omega, velocity = rates[body.parent + 1]
        velocity = velocity + np.cross(omega, exact(body.place.shift))
        omega, velocity = (exact(body.place.turn).T @ x for x in (omega, velocity))
        velocity = velocity + np.cross(omega, motion.shift)
        omega, velocity = (motion.turn.T @ x for x in (omega, velocity))
        rates.append((omega + motion.rate, velocity + motion.velocity))
    return rates[1:]


def energies(
    bodies: Bodies, motions: Sequence[JointMotion], gravity: Vector
) -> tuple[sp.Expr, sp.Expr]:
    """Return T and V."""
    inertias, moving = regrouped(bodies), velocities(bodies, motions)
    pulls = [
        (gravity, sp.S.Zero)
    ]  # gravity in the frame of each body, and the height of its origin
    weights = [-exact(inertias[WORLD].moment) @ gravity]
    for inertia, body, motion in zip(inertias, bodies.moving, motions, strict=False):
        pull, level = pulls[body.parent + 1]
        level -= pull @ exact(body.place.shift)
        pull = exact(body.place.turn).T @ pull
        level, pull = level - pull @ motion.shift, motion.turn.T @ pull
        pulls.append((pull, level))
        weights += [exact_number(inertia.mass) * level, -exact(inertia.moment) @ pull]
    terms = [_kinetic(inertia, *state) for inertia, state in zip(inertias, moving, strict=False)]
    return sp.Add(*terms), sp.Add(*weights)


def _kinetic(inertia: Inertia, omega: Vector, velocity: Vector) -> sp.Expr:
    """Return the kinetic energy of a body, from velocities in its frame."""
    moment, J = exact(inertia.moment), exact(inertia.matrix)
    turning = [J[i, i] * omega[i] ** 2 / 2 for i in range(3)]
    turning += [J[i, j] * omega[i] * omega[j] for i, j in ((0, 1), (0, 2), (1, 2))]
    coupling = moment @ np.cross(velocity, omega) if inertia.moment.any() else sp.S.Zero
    return sp.Add(exact_number(inertia.mass) * (velocity @ velocity) / 2, coupling, *turning)


def frames(bodies: Bodies, motions: Sequence[JointMotion]) -> list[tuple[Vector, Vector]]:
    """Return position and rotation of all bodies in the world; the last one is the world."""
    places = [(np.full(3, sp.S.Zero), exact(np.eye(3)))]
    for body, motion in zip(bodies.moving, motions, strict=True):
        origin, turn = attached(places[body.parent + 1], body.place)
        places.append((origin + turn @ motion.shift, turn @ motion.turn))
    return [*places[1:], places[0]]


def attached(frame: tuple[Vector, Vector], place: Placement) -> tuple[Vector, Vector]:
    """Return the frame at a place of another frame."""
    origin, turn = frame
    return origin + turn @ exact(place.shift), turn @ exact(place.turn)
