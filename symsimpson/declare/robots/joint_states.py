"""Initial states of robots from positions and velocities of joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.declare.orientation import multiply, read_orientation
from symsimpson.declare.robots.bodies_of_tree import Bodies
from symsimpson.declare.robots.coordinate_forms import Form
from symsimpson.declare.robots.recursion import frames, motions_of, velocities
from symsimpson.declare.robots.tree import COORDINATES, RobotTree
from symsimpson.errors import reject
from symsimpson.support.array_types import Floats
from symsimpson.support.names import did_you_mean

#: Names of joints that turn about all axes.
BALLS = ("floating", "ball")


def find_state(
    tree: RobotTree,
    bodies: Bodies,
    form: Form,
    positions: Mapping[str, Any] | None,
    rates: Mapping[str, Any] | None,
) -> tuple[Floats, Floats]:
    """Return q and v; see :meth:`Robot.state`."""
    joints = {x.name: x for x in tree.joints if x.coordinates and x.mimic is None}
    kinds = {name: x.kind for name, x in joints.items()}
    if bodies.moving[0].joint is None:
        kinds = {"base": "floating"} | kinds
    for name in (*(positions or {}), *(rates or {})):
        if name not in kinds:
            reject(
                f"no joint {name!r} moves.{did_you_mean(str(name), list(kinds))}",
                where=tree.name,
                remedy=f"The joints are {', '.join(kinds)}.",
            )
    q, v = dict[str, Floats](), dict[str, Floats]()
    for name, kind in kinds.items():
        size, turns = len(COORDINATES[kind]), kind in BALLS
        rest = np.zeros(size)
        if turns:
            rest[-4] = 1.0
        elif name in joints:
            rest = np.clip(rest, *joints[name].limits)
        q[name] = _read(name, "position", (positions or {}).get(name, rest), size)
        v[name] = _read(
            name, "velocity", (rates or {}).get(name, np.zeros(size - turns)), size - turns
        )
        if turns:
            e = read_orientation(None, None, q[name][-4:])
            q[name] = np.concatenate([q[name][:-4], e])
            turning = multiply(e, np.array([0.0, *v[name][-3:]])) / 2
            v[name] = np.concatenate([v[name][:-3], turning])
    if kinds.keys() == form.functions.keys():
        return np.concatenate([*q.values()]), np.concatenate([*v.values()])
    return _of_bodies(tree, bodies, q, v)


def _of_bodies(
    tree: RobotTree, bodies: Bodies, q: Mapping[str, Floats], v: Mapping[str, Floats]
) -> tuple[Floats, Floats]:
    """Return positions of the centres of mass and quaternions of all bodies, and their rates."""
    exact_q, exact_v = ({k: [sp.Float(y) for y in x] for k, x in some.items()} for some in (q, v))
    motions = motions_of(tree, bodies, exact_q, exact_v)
    places, moving = frames(bodies, motions), velocities(bodies, motions)
    positions, rates = list[Floats](), list[Floats]()
    for body, place, motion in zip(bodies.moving, places, moving, strict=False):
        origin, turn = (np.asarray(x, dtype=np.float64) for x in place)
        omega, velocity = (np.asarray(x, dtype=np.float64) for x in motion)
        centre = body.inertia.moment / body.inertia.mass
        e = read_orientation(None, turn, None)
        positions += [origin + turn @ centre, e]
        speed = turn @ (velocity + np.cross(omega, centre))
        rates += [speed, multiply(e, np.array([0.0, *omega])) / 2]
    return np.concatenate(positions), np.concatenate(rates)


def _read(name: str, what: str, given: Any, size: int) -> Floats:
    """Read the numbers of a joint."""
    try:
        numbers = np.atleast_1d(np.asarray(given, dtype=np.float64))
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (size,) or not np.isfinite(numbers).all():
        reject(
            f"the {what} of {name!r} is {given!r}.",
            remedy=f"Pass {'a finite number' if size == 1 else f'{size} finite numbers'}.",
        )
    return numbers
