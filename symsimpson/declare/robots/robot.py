"""Robots as mechanical systems."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.declare.orientation import read_array
from symsimpson.declare.robots.bodies_of_tree import Bodies, MovingBody, find_bodies
from symsimpson.declare.robots.outlines import outline
from symsimpson.declare.robots.recursion import (
    Vector,
    attached,
    energies,
    exact,
    exact_number,
    frames,
    joint_motion,
)
from symsimpson.declare.robots.tree import RobotTree, locked_at, reject_robot, system_name
from symsimpson.declare.robots.urdf import read_urdf
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import ModelError, ModelWarning, reject
from symsimpson.support.calling import explain_arguments, explain_methods, warn
from symsimpson.support.names import did_you_mean, spelled

Matrix: TypeAlias = sp.ImmutableDenseMatrix
#: The names of the coordinates of a floating base.
BASE = ("base_x", "base_y", "base_z", "base_e0", "base_e1", "base_e2", "base_e3")


@explain_methods(ModelError)
@dataclass(frozen=True, eq=False, repr=False)
class Robot(MechanicalSystem):
    """A robot; :func:`from_urdf` and :func:`from_mjcf` return it.

    It is a :class:`MechanicalSystem` with the following attributes in addition.

    Attributes
    ----------
    joints : mapping from str to coordinate
        The coordinate of each joint that moves; a tuple for a planar or floating joint.
    limits : mapping from expression to (float, float)
        Bounds of coordinates, velocities and inputs, as ``bounds=`` of :class:`OptimalControl`.
    tree : RobotTree
        Links and joints with all numbers of the file.

    Examples
    --------
    >>> import symsimpson as ss
    >>> arm = ss.from_urdf('''<robot name="arm"><link name="base"/><link name="bar"><inertial>
    ...     <origin xyz="0 0 -1"/><mass value="2"/>
    ...     <inertia ixx="0.1" iyy="0.1" izz="0"/></inertial></link>
    ...     <joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/>
    ...     <axis xyz="0 1 0"/></joint></robot>''')
    >>> arm.joints["hinge"], arm.inputs
    (hinge(t), (tau_hinge,))
    """

    joints: Mapping[str, Any] = field(kw_only=True, default_factory=dict)
    limits: Mapping[Any, tuple[float, float]] = field(kw_only=True, default_factory=dict)
    tree: RobotTree = field(kw_only=True)
    #: The frame of each body, and the place of each link in its body.
    bodies: Bodies = field(kw_only=True)
    body_frames: tuple[tuple[Vector, Vector], ...] = field(kw_only=True)

    def frame(self, link: str) -> tuple[Matrix, Matrix]:
        """Return where a link is, for costs, constraints and events.

        Parameters
        ----------
        link : str
            The name of the link.

        Returns
        -------
        position : sympy matrix, 3 by 1
            The origin of the link in the world.
        rotation : sympy matrix, 3 by 3
            The matrix from the axes of the link to those of the world.

        Raises
        ------
        ModelError
            If there is no such link.

        Examples
        --------
        >>> import symsimpson as ss
        >>> arm = ss.from_urdf('''<robot name="slide"><link name="a"/><link name="b"><inertial>
        ...     <mass value="1"/></inertial></link><joint name="x" type="prismatic">
        ...     <parent link="a"/><child link="b"/><axis xyz="1 0 0"/></joint></robot>''')
        >>> arm.frame("b")[0].T
        Matrix([[x(t), 0, 0]])
        """
        if link not in self.bodies.links:
            known = list(self.bodies.links)
            reject(
                f"there is no link {link!r}.{did_you_mean(spelled(link), known)}",
                where=f"system '{self.name}'",
                remedy=f"The links are {', '.join(known[:20])}.",
                error=ModelError,
            )
        number, place = self.bodies.links[link]
        origin, turn = attached(self.body_frames[number], place)
        return Matrix(3, 1, list(origin)), Matrix(3, 3, list(turn.ravel()))


@explain_arguments(ModelError)
def from_urdf(
    path_or_text: str | os.PathLike[str],
    base: str = "fixed",
    joints: Iterable[str] | None = None,
    locked: Mapping[str, float] | None = None,
    gravity: Sequence[float] = (0, 0, -9.81),
    form: str = "joints",
) -> Robot:
    """Declare a robot by a URDF file.

    The coordinates are those of a floating base, if there is one, and one for each joint that
    moves, with the name of the joint. Each of these joints has the input ``tau_<joint>``, its
    torque or force, and the parameter ``damping_<joint>``.

    Parameters
    ----------
    path_or_text : str or path
        The file, or its text, which begins with "<".
    base : {"fixed", "floating"}, default "fixed"
        Whether the first link is fixed to the world. A floating one has the coordinates
        ``base_x``, ``base_y``, ``base_z`` of its origin, and the unit quaternion ``base_e0`` to
        ``base_e3`` (scalar first, from the body to the world).
    joints : iterable of str, optional
        The joints that move. The default is all. The others are locked.
    locked : mapping from str to float, optional
        Positions of locked joints. The default position is 0.
    gravity : three floats
        The acceleration of gravity in the world. The default is (0, 0, -9.81).
    form : {"joints", "bodies"}, default "joints"
        "bodies" gives each body a position and a quaternion, and makes joints constraints.

    Returns
    -------
    Robot

    Raises
    ------
    ModelError
        If the file is wrong; the message has the element and the line.
    StorageError
        If the file cannot be read.

    Warns
    -----
    ModelWarning
        If the file has friction, which is ignored, or moments of inertia that no body has.

    Notes
    -----
    A joint that mimics another one depends on its coordinate, and has neither input nor damping.
    Effort, velocity and position limits do not act on the motion: see ``robot.limits``.

    Examples
    --------
    >>> import symsimpson as ss
    >>> arm = ss.from_urdf('''<robot name="arm"><link name="base"/><link name="bar"><inertial>
    ...     <origin xyz="0 0 -1"/><mass value="2"/>
    ...     <inertia ixx="0.1" iyy="0.1" izz="0"/></inertial></link>
    ...     <joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/>
    ...     <axis xyz="0 1 0"/></joint></robot>''')
    >>> arm.mass_matrix
    Matrix([[2.1]])
    """
    return make_robot(read_urdf(path_or_text), base, joints, locked, gravity, form)


def make_robot(
    tree: RobotTree, base: Any, joints: Any, locked: Any, gravity: Any, form: Any
) -> Robot:
    """Declare a robot by a tree."""
    if base not in ("fixed", "floating"):
        reject(f"base is {base!r}.", remedy="Pass 'fixed' or 'floating'.", error=ModelError)
    if form not in ("joints", "bodies"):
        reject(f"form is {form!r}.", remedy="Pass 'joints' or 'bodies'.", error=ModelError)
    tree = _with_locked(tree, joints, locked)
    bodies = find_bodies(tree, floating=base == "floating")
    if base == "floating" and not bodies.moving[0].inertia.mass:
        reject_robot(
            tree.file,
            f"the base {tree.root!r} has no mass, so it cannot float.",
            tree.links[tree.root].where,
        )
    if not bodies.moving:
        reject_robot(
            tree.file, "no joint moves.", remedy="Lock fewer joints, or let the base float."
        )
    pull = exact(np.asarray(read_array("gravity", gravity, (3,))))
    return _in_joints(tree, bodies, pull)


def _with_locked(tree: RobotTree, joints: Any, locked: Any) -> RobotTree:
    """Return the tree with the joints fixed that do not move."""
    known = {x.name: x for x in tree.joints}
    positions = {str(k): float(v) for k, v in dict(locked or {}).items()}
    moving = None if joints is None else [joints] if isinstance(joints, str) else list(joints)
    for name in (*positions, *(moving or ())):
        if name not in known:
            reject_robot(
                tree.file, f"there is no joint {name!r}.{did_you_mean(str(name), list(known))}"
            )
        if name in positions and name in (moving or ()):
            reject_robot(tree.file, f"the joint {name!r} is both in joints and in locked.")
    for joint in tree.joints:
        free = joint.coordinates and joint.mimic is None
        if free and moving is not None and joint.name not in moving:
            positions.setdefault(joint.name, 0.0)
    return locked_at(tree, positions)


def _in_joints(tree: RobotTree, bodies: Bodies, gravity: Vector) -> Robot:
    """Declare a robot with the coordinates of its joints."""
    functions: dict[str, tuple[AppliedUndef, ...]] = {}
    if bodies.moving[0].joint is None:
        functions["base"] = tuple(sp.Function(x)(time) for x in BASE)
    for joint in tree.joints:
        if joint.coordinates and joint.mimic is None:
            functions[joint.name] = tuple(sp.Function(x)(time) for x in joint.coordinates)
    named = {x.name: x for x in tree.joints}

    def state(body: MovingBody) -> tuple[list[sp.Expr], list[sp.Expr]]:
        factor, offset, joint = 1.0, 0.0, body.joint
        while joint is not None and joint.mimic is not None:
            leader, f, o = joint.mimic
            factor, offset, joint = factor * f, offset + factor * o, named[leader]
        q = functions["base" if joint is None else joint.name]
        a, b = exact_number(factor), exact_number(offset)
        return [a * x + b for x in q], [a * x.diff(time) for x in q]

    motions = [joint_motion(body.kind, *state(body)) for body in bodies.moving]
    kinetic, potential = energies(bodies, motions, gravity)
    places = frames(bodies, motions)
    extra, springs, constraints = list[sp.Expr](), list[sp.Expr](), dict[str, sp.Expr]()
    for body in bodies.moving:
        if body.kind == "floating":
            key = "base" if body.joint is None else body.joint.name
            e = functions[key][3:]
            length = sum((x * x.diff(time) for x in e), sp.S.Zero)
            # an inertia of the length of the quaternion, which does not change the motion
            fourth = float(np.trace(body.inertia.about_centre())) / 3
            extra.append(2 * exact_number(fourth or 1.0) * length**2)
            constraints[f"quaternion_{key}"] = (sum(x**2 for x in e) - 1) / 2
        elif body.joint is not None:
            (q, *_), (v, *_) = state(body)
            extra.append(exact_number(body.joint.armature) * v**2 / 2)
            springs.append(
                exact_number(body.joint.stiffness) * (q - exact_number(body.joint.rest)) ** 2 / 2
            )
    motors, damping, parameters, limits = {}, {}, {}, {}
    for joint in tree.joints:
        for q in functions.get(joint.name, ()) if joint.kind != "floating" else ():
            v, name = q.diff(time), q.func.__name__
            tau, c = sp.Symbol(f"tau_{name}"), sp.Symbol(f"damping_{name}")
            motors[q], damping[q], parameters[c] = tau, -c * v, joint.damping
            for key, bound in (
                (q, joint.limits),
                (v, (-joint.speed, joint.speed)),
                (tau, (-joint.effort, joint.effort)),
            ):
                if np.isfinite(bound).any():
                    limits[key] = bound
    _warn_of_friction(tree)
    forces = {name: force for name, force in (("motors", motors), ("damping", damping)) if force}
    return Robot(
        system_name(tree.name),
        coordinates=tuple(q for some in functions.values() for q in some),
        kinetic=sp.Add(kinetic, *extra),
        potential=sp.Add(potential, *springs),
        parameters=parameters,
        forces=forces,
        inputs=tuple(motors.values()),
        constraints=constraints,
        positions=_positions(tree, bodies, places),
        joints=MappingProxyType({k: v if len(v) > 1 else v[0] for k, v in functions.items()}),
        limits=MappingProxyType(limits),
        tree=tree,
        bodies=bodies,
        body_frames=tuple(places),
    )


def _positions(
    tree: RobotTree, bodies: Bodies, places: Sequence[tuple[Vector, Vector]]
) -> dict[str, Any]:
    """Return the origins of joints, and the outlines of shapes."""
    positions: dict[str, Any] = {}
    for body, (origin, _) in zip(bodies.moving, places, strict=False):
        name = "base" if body.joint is None else body.joint.name
        positions[name] = tuple(origin)
    for link in tree.links.values():
        number, place = bodies.links[link.name]
        for shape in link.shapes:
            corners = outline(shape)
            origin, turn = attached(places[number], place)
            positions[f"{link.name} {shape.name}"] = [
                tuple(origin + turn @ exact(x)) for x in corners
            ]
    return positions


def _warn_of_friction(tree: RobotTree) -> None:
    rough = [x.name for x in tree.joints if x.friction and x.coordinates]
    if rough:
        warn(
            f"{tree.file}: the dry friction of {', '.join(rough[:5])}"
            f"{f' and {len(rough) - 5} more' if len(rough) > 5 else ''} is ignored.\nDeclare a "
            "force that is smooth, such as -F*tanh(v/0.01).",
            ModelWarning,
        )
