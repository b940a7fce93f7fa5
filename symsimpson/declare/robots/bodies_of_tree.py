"""The moving bodies of a robot: links that fixed joints connect are one body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from symsimpson.declare.plain import reduce_frozen
from symsimpson.declare.robots.tree import Inertia, Placement, RobotJoint, RobotTree
from symsimpson.support.array_types import Floats

#: The number of the world among the bodies.
WORLD = -1


@dataclass(frozen=True)
class MovingBody:
    """A body, and the joint that moves it. The axis of the joint is the axis z of its frame."""

    name: str  #: Of the first link.
    joint: RobotJoint | None  #: None for a floating base.
    parent: int
    place: Placement  #: The frame in that of the parent, at the coordinate 0.
    inertia: Inertia

    @property
    def kind(self) -> str:
        """The kind of the joint."""
        return "floating" if self.joint is None else self.joint.kind


@dataclass(frozen=True)
class Bodies:
    """The bodies, parents before children, and the place of each link in its body."""

    moving: tuple[MovingBody, ...]
    links: Mapping[str, tuple[int, Placement]]

    def __reduce__(self) -> tuple[Any, ...]:
        return reduce_frozen(self)


def find_bodies(tree: RobotTree, *, floating: bool) -> Bodies:
    """Collect the links that move together."""
    links: dict[str, tuple[int, Placement]] = {tree.root: (WORLD, Placement())}
    heads: list[tuple[str, RobotJoint | None, int, Placement]] = []
    if floating:
        links[tree.root] = 0, Placement()
        heads.append((tree.root, None, WORLD, Placement()))
    for joint in tree.outward():
        number, place = links[joint.parent]
        place = place @ joint.place
        if joint.kind != "fixed":
            aligned = Placement(np.eye(3) if joint.kind == "floating" else axes_along(joint.axis))
            heads.append((joint.child, joint, number, place @ aligned))
            number, place = len(heads) - 1, Placement(aligned.turn.T)
        links[joint.child] = number, place
    total = [Inertia() for _ in heads]
    for name, (number, place) in links.items():
        if number != WORLD:
            total[number] = total[number] + tree.links[name].inertia.seen_from(place)
    moving = [MovingBody(*head, inertia) for head, inertia in zip(heads, total, strict=True)]
    return Bodies(tuple(moving), MappingProxyType(links))


def axes_along(axis: Floats) -> Floats:
    """Return a rotation that turns z to a unit vector; a permutation, if it is possible."""
    largest = int(abs(axis).argmax())
    if abs(axis[largest]) == 1.0:
        first = np.eye(3)[(largest + 1) % 3]
    else:
        first = np.cross(axis, np.eye(3)[int(abs(axis).argmin())])
        first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1) + 0.0


def regrouped(bodies: Bodies) -> list[Inertia]:
    """Return inertias with the same energies and many zero entries; the last is the world's.

    What a joint does not turn may belong to the parent: for a revolute joint, the mass, the
    moment along the axis, and as much of the inertia as is equal about both other axes. For a
    prismatic joint, it is the whole inertia matrix (Khalil and Bennis, Comments on "Direct
    calculation of minimum set of inertial parameters of serial robots", IEEE Transactions on
    Robotics and Automation 10 (1994), 78-79).
    """
    inertias = [*(body.inertia for body in bodies.moving), Inertia()]  # the last one is the world's
    for number in reversed(range(len(bodies.moving))):
        body, inertia = bodies.moving[number], inertias[number]
        if body.kind in ("revolute", "continuous"):
            across = np.diag([inertia.matrix[1, 1]] * 2 + [0.0])
            along = np.array([0.0, 0.0, inertia.moment[2]])
            moved = Inertia(inertia.mass, along, across)
        elif body.kind == "prismatic":
            moved = Inertia(matrix=inertia.matrix)
        else:
            continue
        inertias[number] = Inertia(
            inertia.mass - moved.mass, inertia.moment - moved.moment, inertia.matrix - moved.matrix
        )
        inertias[body.parent] = inertias[body.parent] + moved.seen_from(body.place)
    return inertias
