"""Closed loops of robots, and constraints that follow from others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import sympy as sp

from symsimpson.declare.robots.bodies_of_tree import Bodies
from symsimpson.declare.robots.coordinate_forms import Form
from symsimpson.declare.robots.joint_states import find_state
from symsimpson.declare.robots.recursion import attached, exact_number
from symsimpson.declare.robots.tree import ClosedLoop, RobotTree, reject_robot
from symsimpson.errors import ModelWarning
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn

#: Numbers of states at which constraints are compared, and steps towards each of them.
STATES, STEPS = 3, 20
#: Size of the way to these states, relative to the size of the state.
MOVED = 0.05
#: A row depends on others if the part across them is smaller than this.
DEPENDENT = 1e-9


def closed(tree: RobotTree, bodies: Bodies, form: Form) -> Form:
    """Return the form with the constraints of closed loops that do not follow from others."""
    if not tree.loops:
        return form
    constraints = dict(form.constraints)
    for loop in tree.loops:
        constraints |= _equations(tree, bodies, form, loop)
    kept = _independent(constraints, form, find_state(tree, bodies, form, None, None)[0])
    left = [name for name in constraints if name not in kept]
    if left:
        warn(
            f"{tree.file}: the constraints {', '.join(left[:8])}"
            f"{f' and {len(left) - 8} more' if len(left) > 8 else ''} follow from the others. They "
            "are left out.",
            ModelWarning,
        )
    return replace(form, constraints={name: constraints[name] for name in kept})


def _equations(tree: RobotTree, bodies: Bodies, form: Form, loop: ClosedLoop) -> dict[str, sp.Expr]:
    """Return the constraints of a loop."""
    if loop.kind == "joint":
        if any(x and x not in form.functions for x in loop.ends):
            reject_robot(
                tree.file,
                f"the constraint {loop.name!r} is one of coordinates of joints.",
                remedy="Use form='joints'.",
            )
        first, second, *factors = map(exact_number, loop.numbers)
        here = form.functions[loop.ends[0]][0] - first
        other = form.functions[loop.ends[1]][0] - second if loop.ends[1] else sp.S.Zero
        return {loop.name: here - sum((c * other**k for k, c in enumerate(factors)), sp.S.Zero)}
    ends = []
    for link, place in zip(loop.ends, loop.places, strict=True):
        number, inner = bodies.links[link]
        ends.append(attached(form.frames[number], inner @ place))
    (origin, turn), (other_origin, other_turn) = ends
    conditions = [*(other_origin - origin)]
    if loop.kind == "weld":
        twist = other_turn.T @ turn
        conditions += [twist[2, 0], twist[2, 1], twist[0, 1]]
    return {f"{loop.name}_{k}": x for k, x in enumerate(conditions, 1)}


def _independent(constraints: Mapping[str, sp.Expr], form: Form, q0: Floats) -> list[str]:
    """Return the names of constraints whose gradients are independent of those before.

    The gradients are compared at random states that satisfy the constraints.
    """
    evaluate = sp.lambdify(form.coordinates, [*constraints.values()], "numpy", cse=True)

    def at(q: Floats) -> tuple[Floats, Floats]:
        step = 1e-30  # the derivative by a complex step has no round-off error of a difference
        points = q + 1j * step * np.eye(len(q))
        slopes = [np.array(evaluate(*point), dtype=complex).imag / step for point in points]
        return np.array(evaluate(*q), dtype=float), np.array(slopes).T

    random, most = np.random.default_rng(5), list[int]()
    for _ in range(STATES):
        q = q0 + MOVED * random.normal(size=len(q0)) * (abs(q0).max() or 1.0)
        for _ in range(STEPS):
            phi, slopes = at(q)
            q = q - np.linalg.lstsq(slopes, phi, rcond=1e-10)[0]
        rows = at(q)[1]
        rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
        basis, kept = np.zeros((0, len(q))), list[int]()
        for number, row in enumerate(rows):
            across = row - basis.T @ (basis @ row)
            across -= basis.T @ (basis @ across)
            if (length := np.linalg.norm(across)) > DEPENDENT:
                basis, kept = np.vstack([basis, across / length]), [*kept, number]
        most = max(most, kept, key=len)
    return [name for k, name in enumerate(constraints) if k in most]
