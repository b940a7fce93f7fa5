"""A robot as a tree of links and joints, in numbers, as files describe it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np

from symsimpson.declare.plain import reduce_frozen
from symsimpson.errors import ModelError, ModelWarning, reject
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.names import did_you_mean

#: The coordinates of each kind of joint, after the name of the joint. Files of MuJoCo have balls.
COORDINATES = {
    "revolute": ("",),
    "continuous": ("",),
    "prismatic": ("",),
    "fixed": (),
    "planar": ("_x", "_y", "_theta"),
    "floating": ("_x", "_y", "_z", "_e0", "_e1", "_e2", "_e3"),
    "ball": ("_e0", "_e1", "_e2", "_e3"),
}
#: Relative error of moments of inertia, which people write with few digits.
WRITTEN = 1e-2
#: Negative moments below this part of the largest moment of the robot are mistakes without effect.
NEGLIGIBLE = 1e-6
#: Numbers of rotations and axes below this are round-off error.
ROUNDED = 1e-15


@dataclass(frozen=True)
class Placement:
    """A frame in another one: x_outer = turn @ x + shift."""

    turn: Floats = field(default_factory=lambda: np.eye(3))
    shift: Floats = field(default_factory=lambda: np.zeros(3))

    def __matmul__(self, inner: Placement) -> Placement:
        turn = self.turn @ inner.turn
        near = np.round(turn)
        turn = np.where(abs(turn - near) < ROUNDED, near, turn)
        return Placement(turn, self.turn @ inner.shift + self.shift)


@dataclass(frozen=True)
class Inertia:
    """Mass, first moment and inertia matrix of a body, about the origin of its frame."""

    mass: float = 0.0
    moment: Floats = field(default_factory=lambda: np.zeros(3))  #: Mass times centre.
    matrix: Floats = field(default_factory=lambda: np.zeros((3, 3)))

    def __add__(self, other: Inertia) -> Inertia:
        return Inertia(
            self.mass + other.mass, self.moment + other.moment, self.matrix + other.matrix
        )

    def seen_from(self, place: Placement) -> Inertia:
        """Return the same body in the outer frame of ``place``."""
        R, s = place.turn, place.shift
        turned = R @ self.moment
        shifted = 2 * (s @ turned) * np.eye(3) - np.outer(s, turned) - np.outer(turned, s)
        steiner = self.mass * (s @ s * np.eye(3) - np.outer(s, s))
        return Inertia(self.mass, turned + self.mass * s, R @ self.matrix @ R.T + shifted + steiner)

    def about_centre(self) -> Floats:
        """Return the inertia matrix about the centre of mass."""
        if not self.mass:
            return self.matrix
        c = self.moment / self.mass
        return np.asarray(self.matrix - self.mass * (c @ c * np.eye(3) - np.outer(c, c)))


@dataclass(frozen=True)
class Shape:
    """A box, a cylinder or a sphere to draw."""

    kind: str
    size: tuple[float, ...]  #: Lengths of a box; radius and length; radius.
    place: Placement


@dataclass(frozen=True)
class RobotLink:
    """A link: a rigid body."""

    name: str
    inertia: Inertia = field(default_factory=Inertia)
    shapes: tuple[Shape, ...] = ()
    where: str = ""  #: The line of the file, for messages.


@dataclass(frozen=True)
class RobotJoint:
    """A joint between two links. Its frame equals the frame of the child at the coordinate 0."""

    name: str
    kind: str
    parent: str
    child: str
    place: Placement = field(default_factory=Placement)
    axis: Floats = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    limits: tuple[float, float] = (-np.inf, np.inf)
    effort: float = np.inf
    speed: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0  #: Inertia of the motor, at the joint.
    stiffness: float = 0.0
    rest: float = 0.0  #: The coordinate at which the spring exerts no force.
    mimic: tuple[str, float, float] | None = None  #: Leader, factor and offset.
    where: str = ""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(self.name + end for end in COORDINATES[self.kind])


@dataclass(frozen=True)
class ClosedLoop:
    """A constraint that closes a loop.

    "connect" keeps the origins of two frames together, and "weld" the whole frames. "joint" makes a
    coordinate a polynomial of another one.
    """

    name: str
    kind: str
    ends: tuple[str, str]  #: Links, or joints; the second joint may be missing.
    places: tuple[Placement, Placement] = (Placement(), Placement())  #: The frames in the links.
    numbers: tuple[float, ...] = ()  #: Both coordinates at rest, and the coefficients.


@dataclass(frozen=True)
class RobotTree:
    """Links, and the joints between them in the order of the file."""

    name: str
    links: Mapping[str, RobotLink]
    joints: tuple[RobotJoint, ...]
    root: str
    file: str = "robot"  #: The name of the file, for messages.
    loops: tuple[ClosedLoop, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return reduce_frozen(self)

    def outward(self) -> tuple[RobotJoint, ...]:
        """Return the joints that the base reaches, parents before children."""
        below: dict[str, list[RobotJoint]] = {}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint)
        ordered = [*below.get(self.root, ())]
        for joint in ordered:  # the list grows on the way
            ordered += below.get(joint.child, ())
        return tuple(ordered)


def reject_robot(file: str, problem: str, where: str = "", remedy: str = "") -> NoReturn:
    """Raise a ModelError about an element of a file."""
    reject(problem, f"{file}, {where}" if where else file, remedy=remedy, error=ModelError)


def make_tree(
    name: str,
    links: Sequence[RobotLink],
    joints: Sequence[RobotJoint],
    file: str,
    loops: tuple[ClosedLoop, ...] = (),
) -> RobotTree:
    """Check that links and joints form one tree."""
    for what, some in (("link", links), ("joint", joints)):
        seen: dict[str, Any] = {}
        for x in some:
            if x.name in seen:
                before = f"The other one: {seen[x.name].where}."
                reject_robot(file, f"two {what}s have the name {x.name!r}.", x.where, before)
            seen[x.name] = x
    named = {x.name: x for x in links}
    above: dict[str, RobotJoint] = {}
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in named:
                reject_robot(
                    file,
                    f"the {role} {link!r} of the joint {joint.name!r} is no link."
                    f"{did_you_mean(link, list(named))}",
                    joint.where,
                )
        if joint.child in above:
            reject_robot(
                file,
                f"the link {joint.child!r} has two parents, by the joints "
                f"{above[joint.child].name!r} and {joint.name!r}.",
                joint.where,
                "A robot is a tree. Close a loop by constraints=.",
            )
        above[joint.child] = joint
    roots = [x for x in named if x not in above]
    if len(roots) != 1:
        reject_robot(
            file,
            "the links form a loop without a base."
            if not roots
            else "it has several bases: "
            f"{', '.join(map(repr, roots[:5]))} are children of no joint.",
            named[roots[1]].where if len(roots) > 1 else "",
            "Exactly one link must be the child of no joint.",
        )
    tree = RobotTree(name, MappingProxyType(named), tuple(joints), roots[0], file, loops)
    missed = {x.child for x in joints} - {x.child for x in tree.outward()}
    for joint in joints:
        if joint.child in missed:
            reject_robot(
                file,
                f"the joint {joint.name!r} belongs to a loop that the base {roots[0]!r} does not "
                "reach.",
                joint.where,
            )
    _check_mimics(file, {x.name: x for x in joints})
    _check_inertias(file, links)
    return tree


def _check_mimics(file: str, joints: Mapping[str, RobotJoint]) -> None:
    for joint in joints.values():
        leader, seen = joint, {joint.name}
        while leader.mimic is not None:
            following = joints.get(leader.mimic[0])
            if following is None or len(following.coordinates) != 1:
                reject_robot(
                    file,
                    f"the joint {leader.name!r} mimics {leader.mimic[0]!r}, which is no joint "
                    f"with one coordinate.{did_you_mean(leader.mimic[0], list(joints))}",
                    leader.where,
                )
            if following.name in seen:
                reject_robot(file, f"the joint {joint.name!r} mimics itself.", joint.where)
            seen.add(following.name)
            leader = following


def _check_inertias(file: str, links: Sequence[RobotLink]) -> None:
    """Reject negative masses and moments, and warn of moments that no body has."""
    moments = {x.name: np.linalg.eigvalsh(x.inertia.about_centre()) for x in links}
    largest, strange, light = max(x[2] for x in moments.values()), list[str](), list[str]()
    for link in links:
        mass, (least, middle, most) = link.inertia.mass, moments[link.name]
        if mass < 0:
            reject_robot(file, f"the link {link.name!r} has the mass {mass:g}.", link.where)
        if least < -NEGLIGIBLE * largest:
            reject_robot(
                file,
                f"the link {link.name!r} has the principal moment of inertia {least:.3g}.",
                link.where,
                "Moments are integrals of squared distances. Check the signs.",
            )
        if most - middle - least > WRITTEN * most:
            strange.append(link.name)
        if mass == 0 and most > 0:
            light.append(link.name)
    if strange:
        warn(
            f"{file}: no body has the moments of inertia of {', '.join(strange[:5])}"
            f"{f' and {len(strange) - 5} more' if len(strange) > 5 else ''}.\nA principal moment "
            "exceeds the sum of the other two. The motion is computed with these numbers. Check "
            "them.",
            ModelWarning,
        )
    if light:
        warn(
            f"{file}: there are moments of inertia without a mass: {', '.join(light[:5])}.\nThe "
            "motion is computed with these numbers. Check whether <mass> is missing.",
            ModelWarning,
        )


def locked_at(tree: RobotTree, positions: Mapping[str, float]) -> RobotTree:
    """Return the tree with some joints fixed at positions, and what mimics them."""
    known = dict(positions)
    while True:
        followers = {
            x.name: x.mimic[1] * known[x.mimic[0]] + x.mimic[2]
            for x in tree.joints
            if x.mimic is not None and x.mimic[0] in known and x.name not in known
        }
        if not followers:
            break
        known |= followers
    fixed = [_fixed(x, known[x.name]) if x.name in known else x for x in tree.joints]
    return replace(tree, joints=tuple(fixed))


def _fixed(joint: RobotJoint, position: float) -> RobotJoint:
    """Return a fixed joint at a position."""
    moved = moved_by(joint.kind, joint.axis, position)
    return replace(joint, kind="fixed", place=joint.place @ moved, mimic=None)


def moved_by(kind: str, axis: Floats, position: float) -> Placement:
    """Return the motion of a joint with one coordinate; other joints do not move."""
    if kind == "prismatic":
        return Placement(shift=position * axis)
    if kind in ("revolute", "continuous"):
        return Placement(rotation_about(axis, position))
    return Placement()


def rotation_about(axis: Floats, angle: float) -> Floats:
    """Return the rotation by an angle about a unit vector (Rodrigues)."""
    c, s = cosine_and_sine(angle)
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) * c + s * skew + (1 - c) * np.outer(axis, axis))


def cosine_and_sine(angle: float) -> tuple[float, float]:
    """Return cosine and sine, exactly 0 and 1 at floats near multiples of pi/2."""
    quarters = round(2 * angle / np.pi)
    if abs(angle - quarters * np.pi / 2) < 1e-12:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarters % 4]
    return float(np.cos(angle)), float(np.sin(angle))


def system_name(name: str) -> str:
    """Return a name that a file and a module may have."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_")[:60]
    return plain if re.match(r"[A-Za-z]", plain) else f"robot_{plain}".rstrip("_")
