"""Readers of URDF files, the robot descriptions of ROS."""

from __future__ import annotations

from typing import Any

import numpy as np

from symsimpson.declare.robots.tree import (
    COORDINATES,
    ROUNDED,
    Inertia,
    Placement,
    RobotJoint,
    RobotLink,
    RobotTree,
    Shape,
    make_tree,
    reject_robot,
    rotation_about,
)
from symsimpson.declare.robots.xml_reader import Element, parse, read_text
from symsimpson.support.array_types import Floats
from symsimpson.support.names import did_you_mean

#: Attributes of the shapes that can be drawn.
SHAPES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}


def read_urdf(path_or_text: Any) -> RobotTree:
    """Read a URDF file or text. Raises ModelError with element and line if it is wrong."""
    file, text = read_text(path_or_text)
    robot = parse(file, text)
    if robot.tag != "robot":
        reject_robot(
            file,
            f"the first element is <{robot.tag}>, not <robot>.",
            robot.where,
            "Read files of MuJoCo with symsimpson.from_mjcf." if robot.tag == "mujoco" else "",
        )
    macro = next((x for x in robot.children if x.tag.startswith("xacro:")), None)
    if macro is not None:
        reject_robot(
            file,
            f"<{macro.tag}> is a macro.",
            macro.where,
            "Expand the file first: xacro robot.urdf.xacro > robot.urdf.",
        )
    links = [_read_link(x) for x in robot.all("link")]
    if not links:
        reject_robot(file, "it has no link.", robot.where)
    joints = [_read_joint(x) for x in robot.all("joint")]
    return make_tree(robot.attributes.get("name", "robot"), links, joints, file)


def _placement(element: Element) -> Placement:
    """Read the element <origin> of an element: a position, and turns about fixed axes x, y, z."""
    origin = element.first("origin")
    if origin is None:
        return Placement()
    roll, pitch, yaw = origin.numbers("rpy", (0.0, 0.0, 0.0)).tolist()
    x, y, z = np.eye(3)
    turn = Placement(rotation_about(z, yaw)) @ Placement(rotation_about(y, pitch))
    turn = turn @ Placement(rotation_about(x, roll))
    return Placement(turn.turn, origin.numbers("xyz", (0.0, 0.0, 0.0)))


def _read_link(element: Element) -> RobotLink:
    name, inertial, inertia = element.text("name"), element.first("inertial"), Inertia()
    element.warn_of_typos("inertial visual collision collision_checking", "name")
    if inertial is not None:
        inertial.warn_of_typos("origin mass inertia", "")
        place = _placement(inertial)
        weight, moments = inertial.first("mass"), inertial.first("inertia")
        mass = 0.0 if weight is None else weight.number("value")
        matrix = np.zeros((3, 3)) if moments is None else _matrix(moments)
        inertia = Inertia(mass, np.zeros(3), matrix).seen_from(place)
    shapes = tuple[Shape, ...]()
    for tag in ("visual", "collision"):  # one of them suffices
        read = (_read_shape(x) for x in element.all(tag))
        shapes = shapes or tuple(x for x in read if x is not None)
    return RobotLink(name, inertia, shapes, element.where)


def _matrix(element: Element) -> Floats:
    xx, yy, zz = (element.number(x) for x in ("ixx", "iyy", "izz"))
    xy, xz, yz = (element.number(x, 0.0) for x in ("ixy", "ixz", "iyz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _read_shape(element: Element) -> Shape | None:
    """Read a shape to draw; None for a mesh."""
    geometry = element.first("geometry")
    for shape in geometry.children if geometry is not None else ():
        if shape.tag in SHAPES:
            counts = {"size": (0.0, 0.0, 0.0)}
            sizes = [shape.numbers(x, counts.get(x, (0.0,))) for x in SHAPES[shape.tag]]
            return Shape(shape.tag, tuple(np.concatenate(sizes).tolist()), _placement(element))
    return None


def _read_joint(element: Element) -> RobotJoint:
    file, name, kind = element.file, element.text("name"), element.text("type")
    kinds = [x for x in COORDINATES if x != "ball"]
    if kind not in kinds:
        reject_robot(
            file,
            f"the joint has the unknown type {kind!r}.{did_you_mean(kind, kinds)}",
            element.where,
            f"The types are {', '.join(kinds)}.",
        )
    ends = []
    for role in ("parent", "child"):
        end = element.first(role)
        if end is None:
            reject_robot(file, f"the joint has no <{role}>.", element.where)
        ends.append(end.text("link"))
    axis = np.array([1.0, 0.0, 0.0])
    if (given := element.first("axis")) is not None:
        axis = given.numbers("xyz", (1.0, 0.0, 0.0))
        length = float(np.linalg.norm(axis))
        if length < 1e-9 and kind not in ("fixed", "floating"):
            reject_robot(file, "the axis is zero.", given.where)
        axis = axis / (length or 1.0)
        axis = np.where(abs(axis) < ROUNDED, 0.0, axis)
    element.warn_of_typos("origin parent child axis calibration dynamics limit mimic", "name type")
    limit, dynamics = element.first("limit"), element.first("dynamics")
    numbers: dict[str, Any] = {}
    if limit is not None:
        limit.warn_of_typos("", "lower upper effort velocity")
        if kind in ("revolute", "prismatic"):
            low, high = limit.number("lower", 0.0), limit.number("upper", 0.0)
            if low > high:
                reject_robot(file, f"lower is {low:g}, above upper, {high:g}.", limit.where)
            numbers["limits"] = low, high
        numbers["effort"] = limit.number("effort", np.inf)
        numbers["speed"] = limit.number("velocity", np.inf)
    if dynamics is not None:
        dynamics.warn_of_typos("", "damping friction")
        for what in ("damping", "friction"):
            numbers[what] = dynamics.number(what, 0.0)
            if numbers[what] < 0:
                reject_robot(file, f"the {what} is {numbers[what]:g}.", dynamics.where)
    if (mimic := element.first("mimic")) is not None and kind != "fixed":
        if len(COORDINATES[kind]) != 1:
            reject_robot(file, f"a {kind} joint cannot mimic another one.", mimic.where)
        factor, offset = mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)
        numbers["mimic"] = mimic.text("joint"), factor, offset
    place, where = _placement(element), element.where
    return RobotJoint(name, kind, ends[0], ends[1], place, axis, where=where, **numbers)
