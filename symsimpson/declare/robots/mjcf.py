"""Readers of MuJoCo's models, by the compiler of MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from symsimpson.declare.bodies import rotation_matrix
from symsimpson.declare.robots.tree import (
    ClosedLoop,
    Inertia,
    Placement,
    RobotJoint,
    RobotLink,
    RobotTree,
    Shape,
    make_tree,
    moved_by,
    reject_robot,
)
from symsimpson.declare.robots.xml_reader import parse, read_text
from symsimpson.errors import ModelError, reject
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import import_library

#: Kinds of joints by MuJoCo's number.
KINDS = ("floating", "ball", "prismatic", "continuous")
#: Shapes that are drawn, by MuJoCo's number, with the number of their sizes.
SHAPES = {2: "sphere", 3: "cylinder", 5: "cylinder", 6: "box"}
#: What ``ignore`` may name.
IGNORED = {
    "contacts": "contacts between geoms",
    "tendons": "tendons",
    "actuators": "actuators other than torques",
    "limits": "soft limits of joints",
    "friction": "dry friction of balls and free joints",
    "damping": "nonlinear damping, or damping of balls",
    "springs": "nonlinear springs, or springs of balls",
    "fluid": "forces of a fluid",
    "flexes": "deformable bodies",
}


def read_mjcf(path_or_text: Any, ignore: Any) -> tuple[RobotTree, Floats]:
    """Read a model; return its tree and gravity. Raises ModelError for what it cannot have."""
    file, text = read_text(path_or_text)
    root = parse(file, text)  # rejects entities and large files
    if root.tag != "mujoco":
        remedy = "Read it with from_urdf." if root.tag == "robot" else ""
        reject_robot(file, "it is not a model of MuJoCo.", root.where, remedy)
    mujoco = import_library("mujoco", "from_mjcf", "robots")
    try:
        if file == "the given text":
            model = mujoco.MjModel.from_xml_string(text)
        else:
            model = mujoco.MjModel.from_xml_path(file)
    except ValueError as error:
        reject_robot(file, f"MuJoCo rejects it: {' '.join(str(error).split())}")
    ignored = {ignore} if isinstance(ignore, str) else set(ignore)
    if unknown := ignored - IGNORED.keys():
        reject(
            f"ignore contains {min(map(str, unknown))!r}.",
            remedy=f"Choose from {', '.join(IGNORED)}.",
            error=ModelError,
        )
    disabled = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    if disabled or "friction" in ignored:
        model.dof_frictionloss[:] = 0
    for what in _missing(mujoco, model):
        if what not in ignored:
            reject_robot(
                file,
                f"it has {IGNORED[what]}, which are not available.",
                remedy=f"Leave them out: ignore=({what!r},). Or remove them from the file.",
            )
    return _tree(mujoco, model, file), np.array(model.opt.gravity)


def _missing(mujoco: Any, m: Any) -> Iterator[str]:
    """Yield what a model has and a system cannot have."""
    turning = m.jnt_type <= 1  # floating joints and balls
    of_balls = turning[m.dof_jntid] if m.nv else np.zeros(0, bool)
    direct = np.array([_is_torque(mujoco, m, k) for k in range(m.nu)], dtype=bool)
    touching = (m.geom_contype != 0) | (m.geom_conaffinity != 0)
    allowed = not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    medium = any((m.opt.density, m.opt.viscosity, *m.opt.wind))
    features = {
        "contacts": allowed and (len(set(m.geom_bodyid[touching].tolist())) > 1 or m.npair > 0),
        "tendons": m.ntendon > 0,
        "actuators": not direct.all(),
        "limits": m.jnt_limited.any(),
        "friction": m.dof_frictionloss[of_balls].any(),
        "damping": m.dof_damping[of_balls].any() or _any(m, "dof_dampingpoly"),
        "springs": m.jnt_stiffness[turning].any() or _any(m, "jnt_stiffnesspoly"),
        "fluid": medium,
        "flexes": m.nflex > 0,
    }
    return (what for what, there in features.items() if there)


def _any(model: Any, name: str) -> bool:
    """Return whether an array that only new versions of MuJoCo have has an entry."""
    return bool(np.any(getattr(model, name, 0)))


def _is_torque(mujoco: Any, m: Any, k: int) -> bool:
    """Return whether an actuator is a torque or force at a joint, with the gear ratio 1."""
    plain = m.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT
    plain = plain and m.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE
    plain = plain and m.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
    plain = plain and m.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
    gear = m.actuator_gear[k]
    return bool(plain and m.actuator_gainprm[k][0] == gear[0] == 1 and not gear[1:].any())


def _place(position: Floats, quaternion: Floats) -> Placement:
    turn = np.array(rotation_matrix(quaternion.tolist()), dtype=np.float64)
    return Placement(turn, np.array(position))


def _tree(mujoco: Any, m: Any, file: str) -> RobotTree:
    """Return the tree of a model. Between several joints of a body are links without mass."""

    def name(kind: str, number: int) -> str:
        named = mujoco.mj_id2name(m, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), number)
        return named or f"{kind.lower()}_{number}"

    links = [RobotLink("world")]
    joints = list[RobotJoint]()
    for body in range(1, m.nbody):
        above, link_name = name("BODY", m.body_parentid[body]), name("BODY", body)
        above = "world" if m.body_parentid[body] == 0 else above
        place = _place(m.body_pos[body], m.body_quat[body])
        first = m.body_jntadr[body]
        for k in range(first, first + m.body_jntnum[body]):
            link = f"{link_name} after {name('JOINT', k)}"
            joints.append(_joint(m, k, name("JOINT", k), above, link, place))
            links.append(RobotLink(link))
            above, place = link, Placement(shift=-m.jnt_pos[k])
        joints.append(RobotJoint(f"{link_name} fixed", "fixed", above, link_name, place))
        links.append(_link(m, body, link_name))
    loops = tuple(_loops(mujoco, m, file, name))
    return make_tree(mujoco_name(m), links, joints, file, loops)


def mujoco_name(m: Any) -> str:
    """Return the name of a model, the first of its names."""
    return str(m.names.split(b"\0", 1)[0].decode(errors="replace")) or "robot"


def _joint(m: Any, k: int, name: str, above: str, link: str, place: Placement) -> RobotJoint:
    """Return a joint between two links."""
    kind, dof, q = KINDS[m.jnt_type[k]], m.jnt_dofadr[k], m.jnt_qposadr[k]
    place = Placement() if kind == "floating" else place @ Placement(shift=m.jnt_pos[k].copy())
    axis = m.jnt_axis[k].copy()
    scalar = kind in ("prismatic", "continuous")
    if scalar:  # the model has its shape at the coordinate qpos0
        place = place @ moved_by(kind, axis, -float(m.qpos0[q]))
    limits = tuple(m.jnt_range[k].tolist()) if m.jnt_limited[k] else (-np.inf, np.inf)
    numbers: dict[str, Any] = {}
    if scalar:
        numbers = {
            "damping": float(m.dof_damping[dof]),
            "friction": float(m.dof_frictionloss[dof]),
            "stiffness": float(m.jnt_stiffness[k]),
            "rest": float(m.qpos_spring[q]),
        }
    elif m.dof_armature[dof : dof + 3].any():
        reject(f"the joint {name!r} has an armature, but turns about all axes.", error=ModelError)
    armature = float(m.dof_armature[dof]) if scalar else 0.0
    return RobotJoint(name, kind, above, link, place, axis, limits, armature=armature, **numbers)


def _link(m: Any, body: int, name: str) -> RobotLink:
    """Return a link with the inertia and the shapes of a body."""
    inertia = Inertia(float(m.body_mass[body]), np.zeros(3), np.diag(m.body_inertia[body]))
    shapes = []
    for k in range(m.body_geomadr[body], m.body_geomadr[body] + m.body_geomnum[body]):
        if (shape := SHAPES.get(int(m.geom_type[k]))) is not None:
            size = m.geom_size[k].tolist()
            size = [2 * x for x in size] if shape == "box" else [size[0], 2 * size[1]]
            shapes.append(Shape(shape, tuple(size), _place(m.geom_pos[k], m.geom_quat[k])))
    place = _place(m.body_ipos[body], m.body_iquat[body])
    return RobotLink(name, inertia.seen_from(place), tuple(shapes))


def _loops(mujoco: Any, m: Any, file: str, name: Any) -> Iterator[ClosedLoop]:
    """Yield the equality constraints that are active."""
    kinds = mujoco.mjtEq
    for k in range(m.neq):
        called = mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_EQUALITY, k) or f"equality_{k}"
        kind, data = kinds(int(m.eq_type[k])), m.eq_data[k]
        ends = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
        if not m.eq_active0[k]:
            continue
        if kind == kinds.mjEQ_JOINT:
            zeros = [float(m.qpos0[m.jnt_qposadr[x]]) if x >= 0 else 0.0 for x in ends]
            first, second = (name("JOINT", x) if x >= 0 else "" for x in ends)
            yield ClosedLoop(called, "joint", (first, second), numbers=(*zeros, *data[:5].tolist()))
        elif kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            if int(m.eq_objtype[k]) != int(mujoco.mjtObj.mjOBJ_BODY):
                reject_robot(
                    file, f"the constraint {called!r} is one of sites.", remedy="Use bodies."
                )
            first, second = ("world" if x == 0 else name("BODY", x) for x in ends)
            names = first, second
            if kind == kinds.mjEQ_CONNECT:
                yield ClosedLoop(
                    called,
                    "connect",
                    names,
                    (Placement(shift=data[:3].copy()), Placement(shift=data[3:6].copy())),
                )
            else:
                yield ClosedLoop(
                    called,
                    "weld",
                    names,
                    (_place(data[3:6], data[6:10]), Placement(shift=data[:3].copy())),
                )
        else:
            reject_robot(file, f"the constraint {called!r} has a kind that is not available.")
