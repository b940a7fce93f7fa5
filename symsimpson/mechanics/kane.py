"""Contents of a KanesMethod of SymPy, written in coordinates and their velocities."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sympy as sp

from symsimpson.errors import ModelWarning
from symsimpson.mechanics.checks import fail, spell
from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.identities import Identities
from symsimpson.mechanics.loads import Force, added, generalised, potential_of
from symsimpson.mechanics.quadratic import rank
from symsimpson.support.calling import warn

__all__ = ["read_kane"]

#: Longer denominators of speeds are left as they are: SymPy may take for ever.
TOO_LONG = 120


def read_kane(
    name: str, kane: Any, inputs: Sequence[sp.Expr]
) -> tuple[sp.Expr, tuple[Any, ...], dict[Any, Any], list[sp.Expr], list[sp.Expr]]:
    """Return L, the coordinates, the forces by name, and the constraints of both kinds.

    A body that rolls may have a velocity that is no derivative of a place in the coordinates. Then
    Lagrange's equations of T have terms that Kane's have not, p.(d/dt dv/dq' - dv/dq), and the same
    of the angular momentum. They become the force "rolling", which has no power. Raises ModelError
    if something that is needed is not in it, or cannot be written in velocities.
    """
    try:
        parts = kane.to_linearizer()
    except ValueError as error:
        raise fail(
            name,
            f"SymPy cannot take the KanesMethod apart: {' '.join(str(error).split())}",
            "Bodies and loads are in it once kanes_equations(bodies, loads) was called. Functions "
            "of time other than coordinates and speeds may stand in loads alone.",
        ) from None
    if len(parts.f_2) > len(parts.u) - len(parts.f_v):
        raise fail(
            name,
            "the KanesMethod has auxiliary speeds.",
            "They are zero in every motion, and bring forces of constraints into evidence. Leave "
            "u_auxiliary out: run['lambda_...'] has the multipliers of constraints.",
        )
    frame, held = kane._inertial, list(parts.f_c)
    coordinates, speeds, rows = _speeds(name, kane)
    known = Identities(name, "KanesMethod", coordinates, held)
    kinetic, rolling = _inertia(kane.bodies, frame, speeds, known)
    each = [generalised([load], frame, coordinates, speeds) for load in kane.loads or ()]
    given = sp.Add(*(body.potential_energy for body in kane.bodies)).xreplace(speeds)
    potential, loads = potential_of(each, coordinates, given, inputs, known.vanish)
    if given != 0 and not known.vanish((given - potential).diff(q) for q in coordinates):
        warn(
            f"system '{name}': the potential_energy of bodies is not that of the loads.\n"
            "It is left out: Kane's equations have loads alone. Apply its forces as loads, or set "
            "it to 0.",
            ModelWarning,
        )
    forces = {"loads": loads, "rolling": rolling}
    rows += [row.xreplace(speeds) for row in parts.f_v]
    forces = {key: force for key, force in forces.items() if force}
    return kinetic - potential, coordinates, forces, held, _others(rows, known)


def _speeds(name: str, kane: Any) -> tuple[tuple[Any, ...], dict[Any, sp.Expr], list[sp.Expr]]:
    """Return the coordinates, speeds in terms of velocities, and equations without a speed.

    Speeds that no kinematical equation has get coordinates of their own.
    """
    implicit = copy.copy(kane)
    implicit.explicit_kinematics = False
    kinematics = implicit.mass_matrix_kin * kane.q.diff(time) - implicit.forcing_kin
    used = [u for u in kane.u if kinematics.has(u)]
    more = {u: sp.Function(f"{u.func.__name__}_integral")(time) for u in kane.u if u not in used}
    with_speeds = [x for x in kinematics if x.has(*used)] if used else []
    solved = list(sp.linsolve(with_speeds, *used)) if used else [()]
    if not solved or any(x.has(*used) for x in solved[0]) or len(with_speeds) != len(used):
        raise fail(
            name,
            f"the {len(with_speeds)} kinematical equations do not say what the {len(used)} speeds "
            f"{spell(tuple(used))} are.",
            "Each speed is to follow from coordinates and velocities. Write as many equations as "
            "there are speeds, as u - (...), and what coordinates are held by, as q0*q0.diff() + "
            "... of a quaternion, as equations without a speed.",
        )
    speeds = {u: _shorter(x) for u, x in zip(used, solved[0], strict=True)}
    speeds |= {u: s.diff(time) for u, s in more.items()}
    return (*kane.q, *more.values()), speeds, [x for x in kinematics if x not in with_speeds]


def _shorter(speed: sp.Expr) -> sp.Expr:
    """Simplify a denominator, which mostly is one of squares of sines and cosines."""
    over, under = sp.fraction(sp.together(speed))
    return over / (sp.trigsimp(under) if 0 < under.count_ops() < TOO_LONG else under)


def _inertia(
    bodies: Iterable[Any], frame: Any, speeds: Mapping[Any, sp.Expr], known: Identities
) -> tuple[sp.Expr, Force]:
    """Return T, and the terms that Lagrange's equations of it have and Kane's have not."""
    kinetic: list[sp.Expr] = []
    gaps: list[Force] = []
    for body in bodies:
        v = body.masscenter.vel(frame).xreplace(speeds)
        parts = [(v, body.mass * v)]
        if hasattr(body, "central_inertia"):
            w = body.frame.ang_vel_in(frame).xreplace(speeds)
            parts.append((w, body.central_inertia.dot(w)))
        for rate, momentum in parts:
            kinetic.append(momentum.dot(rate) / 2)
            turns = (rate.diff(q, frame, var_in_dcm=False).dt(frame) for q in known.rates)
            gap = [momentum.dot(turn).xreplace(speeds) for turn in turns]
            gap = [x - kinetic[-1].diff(q) for x, q in zip(gap, known.coordinates, strict=True)]
            if not known.idle(gap):
                gaps.append(dict(zip(known.coordinates, gap, strict=True)))
    total = added(gaps)
    return sp.Add(*kinetic), {q: f for q, f in total.items() if not known.vanish([f])}


def _others(rows: Sequence[sp.Expr], known: Identities) -> list[sp.Expr]:
    """Return the velocity constraints that do not follow from constraints of positions."""
    count = len(known.constraints)
    graph, matrix = known.rows([*(phi.diff(time) for phi in known.constraints), *rows])
    independent, kept = matrix[:count], []
    for equation, row in zip(rows, matrix[count:], strict=True):
        if rank(graph, [*independent, row]) > len(independent):
            independent.append(row)
            kept.append(equation)
    if count + len(kept) > len(rows):
        raise fail(
            known.name,
            "the velocity constraints do not hold the configuration constraints.",
            "Kane's equations hold velocities alone. Give the time derivative of each "
            "configuration constraint among velocity_constraints, too, or leave it out.",
        )
    return kept
