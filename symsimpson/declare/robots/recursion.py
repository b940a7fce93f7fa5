"""T, V and frames of a robot with joint coordinates, from link to link.

Velocities are expressed in the frame of each body, from those of the previous body (Luh, Walker and
Paul, Journal of Dynamic Systems, Measurement and Control 102 (1980), 69-76). The length of T is
proportional to the number of bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.declare.bodies import body_rates, rotation_matrix
from symsimpson.declare.robots.bodies_of_tree import WORLD, Bodies, MovingBody, regrouped
from symsimpson.declare.robots.tree import Inertia, Placement
from symsimpson.support.array_types import Floats

#: Vectors and matrices of expressions.
Vector = NDArray[Any]


@dataclass(frozen=True)
class Motion:
    """How a joint moves its body: the shift and turn in the frame of the joint, and their rates.

    The rates are in the frame of the body.
    """

    shift: Vector
    turn: Vector
    velocity: Vector
    rate: Vector


def exact(numbers: Floats) -> Vector:
    """Return floats as SymPy numbers; 0 and 1 as integers, which vanish from products."""
    entries = [sp.Integer(int(x)) if x in (-1, 0, 1) else sp.Float(x) for x in numbers.ravel()]
    return np.array(entries, dtype=object).reshape(numbers.shape)


def exact_number(x: float) -> sp.Expr:
    """Return a float as a SymPy number."""
    return exact(np.array([x]))[0]


def joint_motion(kind: str, q: Sequence[sp.Expr], v: Sequence[sp.Expr]) -> Motion:
    """Return the motion of a joint along or about the axis z."""
    zero, turn = np.full(3, sp.S.Zero), exact(np.eye(3))
    if kind == "prismatic":
        along = np.array([0, 0, v[0]], dtype=object)
        return Motion(np.array([sp.S.Zero, sp.S.Zero, q[0]]), turn, along, zero)
    if kind == "floating":
        turn = np.array(rotation_matrix(q[3:]), dtype=object)
        rate = np.array(list(body_rates(q[3:], v[3:])), dtype=object)
        return Motion(np.array(q[:3]), turn, turn.T @ np.array(v[:3]), rate)
    c, s = sp.cos(q[-1]), sp.sin(q[-1])
    turn[:2, :2] = [[c, -s], [s, c]]
    rate = np.array([sp.S.Zero, sp.S.Zero, v[-1]])
    shift = np.array([*q[:-1], *[sp.S.Zero] * (4 - len(q))])
    speed = np.array([*v[:-1], *[sp.S.Zero] * (4 - len(v))])
    return Motion(shift, turn, turn.T @ speed, rate)


def motions_of(bodies: Bodies, coordinates: Callable[[MovingBody], Any]) -> list[Motion]:
    """Return the motions of all bodies; ``coordinates`` returns q and v of a body."""
    return [joint_motion(body.kind, *coordinates(body)) for body in bodies.moving]


def energies(bodies: Bodies, motions: Sequence[Motion], gravity: Vector) -> tuple[sp.Expr, sp.Expr]:
    """Return T and V."""
    zero = np.full(3, sp.S.Zero)
    state: dict[int, tuple[Vector, Vector, Vector, sp.Expr]] = {
        WORLD: (zero, zero, gravity, sp.S.Zero)
    }
    terms, weights = list[sp.Expr](), list[sp.Expr]()
    own = regrouped(bodies)
    for number, (body, motion) in enumerate(zip(bodies.moving, motions, strict=True)):
        omega, velocity, pull, level = state[body.parent]
        shift, back = exact(body.place.shift), exact(body.place.turn).T
        velocity, level = velocity + np.cross(omega, shift), level - pull @ shift
        omega, velocity, pull = (back @ x for x in (omega, velocity, pull))
        velocity, level = velocity + np.cross(omega, motion.shift), level - pull @ motion.shift
        omega, velocity, pull = (motion.turn.T @ x for x in (omega, velocity, pull))
        omega, velocity = omega + motion.rate, velocity + motion.velocity
        state[number] = omega, velocity, pull, level
        terms.append(_kinetic(own[number], omega, velocity))
        weights += [exact_number(own[number].mass) * level, -exact(own[number].moment) @ pull]
    weights.append(-exact(own[WORLD].moment) @ gravity)
    return sp.Add(*terms), sp.Add(*weights)


def _kinetic(inertia: Inertia, omega: Vector, velocity: Vector) -> sp.Expr:
    """Return the kinetic energy of a body, from velocities in its frame."""
    moment, J = exact(inertia.moment), exact(inertia.matrix)
    turning = [J[i, i] * omega[i] ** 2 / 2 for i in range(3)]
    turning += [J[i, j] * omega[i] * omega[j] for i, j in ((0, 1), (0, 2), (1, 2))]
    coupling = moment @ np.cross(velocity, omega) if inertia.moment.any() else sp.S.Zero
    return sp.Add(exact_number(inertia.mass) * (velocity @ velocity) / 2, coupling, *turning)


def frames(bodies: Bodies, motions: Sequence[Motion]) -> list[tuple[Vector, Vector]]:
    """Return position and rotation of all bodies in the world; the last one is the world."""
    found = [(np.full(3, sp.S.Zero), exact(np.eye(3)))]
    for body, motion in zip(bodies.moving, motions, strict=True):
        frame = attached(found[0 if body.parent == WORLD else body.parent + 1], body.place)
        origin, turn = frame
        found.append((origin + turn @ motion.shift, turn @ motion.turn))
    return [*found[1:], found[0]]


def attached(frame: tuple[Vector, Vector], place: Placement) -> tuple[Vector, Vector]:
    """Return the frame at a place of another frame."""
    origin, turn = frame
    return origin + turn @ exact(place.shift), turn @ exact(place.turn)
