"""Robots as mechanical systems."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import sympy as sp

from symsimpson.declare.contacts import Contact, Friction, name_elements
from symsimpson.declare.coordinates import time
from symsimpson.declare.orientation import read_array
from symsimpson.declare.robots.bodies_of_tree import Bodies, find_bodies
from symsimpson.declare.robots.coordinate_forms import Form, in_bodies, in_joints
from symsimpson.declare.robots.joint_states import find_state
from symsimpson.declare.robots.loops import closed
from symsimpson.declare.robots.mjcf import read_mjcf
from symsimpson.declare.robots.outlines import positions_of
from symsimpson.declare.robots.recursion import attached, exact
from symsimpson.declare.robots.tree import RobotTree, locked_at, reject_robot, system_name
from symsimpson.declare.robots.urdf import read_urdf
from symsimpson.declare.system import NONE, MechanicalSystem
from symsimpson.errors import ModelError, ModelWarning, reject
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_arguments, explain_methods, warn
from symsimpson.support.contact_values import OF_CONTACT
from symsimpson.support.names import did_you_mean, spelled

Matrix: TypeAlias = sp.ImmutableDenseMatrix


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
    bodies: Bodies = field(kw_only=True)
    form: Form = field(kw_only=True)

    @property
    def reference_state(self) -> Mapping[str, Any]:
        """A state at rest: joints at 0, or at the limit nearest to it."""
        q0, v0 = self.state()
        return {"q0": q0, "v0": v0}

    @property
    def default_inputs(self) -> Mapping[str, float]:
        """Inputs of runs that do not pass them: 0."""
        return dict.fromkeys(map(str, self.inputs), 0.0)

    def state(
        self,
        positions: Mapping[str, Any] | None = None,
        velocities: Mapping[str, Any] | None = None,
    ) -> tuple[Floats, Floats]:
        """Return an initial state from positions and velocities of joints.

        Parameters
        ----------
        positions : mapping from str to float, optional
            Coordinates by joint. Others are 0, or at the limit nearest to it. The base,
            ``"base"``, has seven: its origin and a unit quaternion.
        velocities : mapping from str to float, optional
            Velocities by joint; others are 0. The base has the velocity of its origin in the
            world, and its angular velocity in its own axes.

        Returns
        -------
        q0, v0 : ndarray, shape (n,)
            Values of the coordinates and their velocities, in both forms of a robot.

        Raises
        ------
        InputError
            If a joint does not move, or has another number of coordinates.

        Examples
        --------
        >>> import symsimpson as ss
        >>> arm = ss.from_urdf('''<robot name="slide"><link name="a"/><link name="b"><inertial>
        ...     <mass value="1"/></inertial></link><joint name="x" type="prismatic">
        ...     <parent link="a"/><child link="b"/><axis xyz="1 0 0"/></joint></robot>''')
        >>> arm.state({"x": 0.5})
        (array([0.5]), array([0.]))
        """
        return find_state(self.tree, self.bodies, self.form, positions, velocities)

    def table(self) -> str:
        """Return a table of the joints, as text.

        Returns
        -------
        str
            A line for each joint: its kind, its coordinates, limits, and what it moves.

        Examples
        --------
        >>> import symsimpson as ss
        >>> arm = ss.from_urdf('''<robot name="slide"><link name="a"/><link name="b"><inertial>
        ...     <mass value="1"/></inertial></link><joint name="x" type="prismatic">
        ...     <parent link="a"/><child link="b"/><limit lower="0" upper="2"/></joint></robot>''')
        >>> print(arm.table())
        slide: 1 of 1 joints moves, 1 coordinate, 1 kg
        joint  type       limits  moves
        x      prismatic  0 to 2  b
        """
        rows = [("joint", "type", "limits", "moves")]
        for x in self.tree.joints:
            bounds = (
                f"{x.limits[0]:.4g} to {x.limits[1]:.4g}" if np.isfinite(x.limits).any() else ""
            )
            leader = f"as {x.mimic[0]}" if x.mimic else x.kind
            rows.append((x.name, leader, bounds, x.child))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        mass, moving = sum(x.inertia.mass for x in self.tree.links.values()), len(self.joints)
        head = (
            f"{self.name}: {moving} of {len(self.tree.joints)} joints "
            f"{'moves' if moving == 1 else 'move'}, {self.n} "
            f"coordinate{'s' if self.n > 1 else ''}, {mass:.6g} kg"
        )
        lines = ["  ".join(f"{x:<{w}}" for x, w in zip(row, widths, strict=True)) for row in rows]
        return "\n".join([head, *map(str.rstrip, lines)])

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
            The matrix from the axes of the link to the axes of the world.

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
        origin, turn = attached(self.form.frames[number], place)
        return Matrix(3, 1, list(origin)), Matrix(3, 3, list(turn.ravel()))

    def with_contacts(
        self, contacts: Any = NONE, friction: Any = NONE, parameters: Mapping[Any, float] = NONE
    ) -> Robot:
        """Return the robot with contacts and dry friction in addition.

        Parameters
        ----------
        contacts, friction : mapping from str to Contact or Friction, or sequence, optional
            See :class:`MechanicalSystem`. The friction of a joint "elbow" has the name
            "elbow.slip". An entry with this name replaces it.
        parameters : mapping from symbol to number, optional
            Default values of symbols in the contacts.

        Returns
        -------
        Robot

        Raises
        ------
        ModelError
            If an entry is invalid, or two have the same name.

        Examples
        --------
        >>> import symsimpson as ss
        >>> arm = ss.from_urdf('''<robot name="slide"><link name="a"/><link name="b"><inertial>
        ...     <mass value="1"/></inertial></link><joint name="z" type="prismatic">
        ...     <parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>''')
        >>> robot = arm.with_contacts({"floor": ss.Contact(arm.frame("b")[0][2])})
        >>> run = ss.compile(robot).integrate([0.1], v0=[0.0], h=0.01, t_end=1.0)
        >>> run.modes.at(1.0)
        {'floor': 'rest'}
        """
        return replace(
            self,
            contacts={**self.contacts, **name_elements(self.name, contacts, Contact)},
            friction={**self.friction, **name_elements(self.name, friction, Friction)},
            parameters={**self.parameters, **parameters},
        )


@explain_arguments(ModelError)
def from_urdf(
    path_or_text: str | os.PathLike[str],
    base: str = "fixed",
    joints: Iterable[str] | None = None,
    locked: Mapping[str, float] | None = None,
    gravity: Sequence[float] = (0, 0, -9.81),
    form: str = "joints",
    friction: bool = True,
) -> Robot:
    """Declare a robot by a URDF file.

    The coordinates are seven of a floating base, if there is one, and one for each joint that
    moves, with the name of the joint. Each of these joints has the input ``tau_<joint>``, its
    torque or force, and the parameter ``damping_<joint>``. A joint with dry friction also has the
    parameter ``friction_<joint>``, and a :class:`Friction` with the name ``<joint>.slip``.

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
    friction : bool, default True
        Whether joints have the dry friction of the file. ``False`` leaves it out.

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
        If the file has moments of inertia that no body has, or dry friction of a joint that is
        floating or mimics another one. This friction is omitted.

    Notes
    -----
    A joint that mimics another one depends on its coordinate, and has neither input, damping nor
    friction.
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
    return make_robot(read_urdf(path_or_text), base, joints, locked, gravity, form, friction)


@explain_arguments(ModelError)
def from_mjcf(
    path_or_text: str | os.PathLike[str],
    gravity: Sequence[float] | None = None,
    ignore: Iterable[str] = (),
    form: str = "joints",
    friction: bool = True,
) -> Robot:
    """Declare a robot by a model of MuJoCo, with MuJoCo's own compiler.

    Coordinates, inputs, parameters and dry friction are as for :func:`from_urdf`. Ball joints have
    a unit quaternion. Springs, dampers and armatures of joints, and equality constraints between
    bodies or joints, belong to the system. Constraints and dry friction are rigid.

    Parameters
    ----------
    path_or_text : str or path
        The file, or its text, which begins with "<".
    gravity : three floats, optional
        The acceleration of gravity. By default, the model has it.
    ignore : iterable of str, optional
        What to ignore: "contacts", "tendons", "actuators", "limits", "friction", "damping",
        "springs", "fluid" or "flexes".
    form : {"joints", "bodies"}, default "joints"
        See :func:`from_urdf`.
    friction : bool, default True
        Whether joints have dry friction, the ``frictionloss`` of the file. ``False`` leaves it
        out, as ``ignore="friction"`` does.

    Returns
    -------
    Robot

    Raises
    ------
    ModelError
        If MuJoCo rejects the model, or it has features that ``ignore`` could omit.
    StorageError
        If the file cannot be read.
    InputError
        If MuJoCo is not installed.

    Warns
    -----
    ModelWarning
        If constraints follow from others. They are left out.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.from_mjcf("<mujoco/>")  # doctest: +SKIP
    Traceback (most recent call last):
    symsimpson.errors.ModelError: the given text: no joint moves.
    """
    ignored = (ignore,) if isinstance(ignore, str) else tuple(ignore)
    tree, pull = read_mjcf(path_or_text, ignored if friction else (*ignored, "friction"))
    used: Any = pull if gravity is None else gravity
    return make_robot(tree, "fixed", None, None, used, form, friction)


def make_robot(
    tree: RobotTree, base: Any, joints: Any, locked: Any, gravity: Any, form: Any, friction: bool
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
    _check_carried(tree, bodies)
    pull = exact(np.asarray(read_array("gravity", gravity, (3,))))
    write = in_joints if form == "joints" else in_bodies
    return _declare(tree, bodies, closed(tree, bodies, write(tree, bodies, pull)), friction)


def _check_carried(tree: RobotTree, bodies: Bodies) -> None:
    """Reject a joint that moves links without mass and moments only: it has no equation."""
    carried = [bool(x.inertia.mass or x.inertia.matrix.any()) for x in bodies.moving]
    for number in reversed(range(len(bodies.moving))):
        body = bodies.moving[number]
        joint, moving = "", body.joint
        if moving is not None:
            joint = moving.name
            carried[number] |= bool(moving.armature or moving.mimic)
        if not carried[number]:
            reject_robot(
                tree.file,
                f"the joint {joint!r} moves the link {body.name!r}, which has no mass.",
                tree.links[body.name].where,
                f"Give it an <inertial>, or lock the joint: locked={{{joint!r}: 0}}.",
            )
        if body.parent >= 0:
            carried[body.parent] |= carried[number]


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


def _declare(tree: RobotTree, bodies: Bodies, form: Form, rough: bool) -> Robot:
    """Declare the system of a form, ``rough`` with dry friction."""
    motors, damping, friction = dict[Any, sp.Expr](), dict[Any, sp.Expr](), dict[str, Friction]()
    parameters, limits, inputs = dict[Any, float](), dict[Any, tuple[float, float]](), []
    for joint in tree.joints:
        for name in joint.coordinates if joint.mimic is None else ():
            if name not in form.rates:
                continue
            rate, tau = form.rates[name], sp.Symbol(f"tau_{name}")
            inputs.append(tau)
            c = sp.Symbol(f"damping_{name}")
            parameters[c] = joint.damping
            if rough and joint.friction:
                limit = sp.Symbol(f"friction_{name}")
                parameters[limit] = joint.friction
                friction[f"{name}{OF_CONTACT}"] = Friction(rate, limit=limit)
            for q in form.coordinates:  # the power is tau times the rate
                if (lever := rate.diff(q.diff(time))) != 0:
                    motors[q] = motors.get(q, sp.S.Zero) + tau * lever
                    damping[q] = damping.get(q, sp.S.Zero) - c * rate * lever
            bounds = {rate: (-joint.speed, joint.speed), tau: (-joint.effort, joint.effort)}
            if joint.name in form.functions:
                bounds[form.functions[joint.name][0]] = joint.limits
            limits |= {x: bound for x, bound in bounds.items() if np.isfinite(bound).any()}
    if rough:
        _warn_of_friction(tree, form)
    forces = {name: force for name, force in (("motors", motors), ("damping", damping)) if force}
    joints = {
        joint.name: form.functions.get(joint.name, form.functions.get(joint.child))
        for joint in tree.joints
        if joint.coordinates and joint.mimic is None
    }
    return Robot(
        system_name(tree.name),
        coordinates=form.coordinates,
        kinetic=form.kinetic,
        potential=form.potential,
        parameters=parameters,
        forces=forces,
        inputs=tuple(inputs),
        friction=friction,
        constraints=form.constraints,
        positions=positions_of(tree, bodies, form.frames),
        joints=MappingProxyType({k: x[0] if x and len(x) == 1 else x for k, x in joints.items()}),
        limits=MappingProxyType(limits),
        tree=tree,
        bodies=bodies,
        form=form,
    )


def _warn_of_friction(tree: RobotTree, form: Form) -> None:
    """Warn of dry friction of joints without a velocity of their own."""
    left = [
        x.name
        for x in tree.joints
        if x.friction and x.coordinates and (x.mimic or x.coordinates[0] not in form.rates)
    ]
    if left:
        warn(
            f"{tree.file}: the dry friction of {', '.join(left[:5])}"
            f"{f' and {len(left) - 5} more' if len(left) > 5 else ''} is left out, because "
            "these joints are floating or mimic others.\nAdd friction with robot.with_contacts, "
            "or pass friction=False.",
            ModelWarning,
        )
