"""Equations of motion of a system: in SymPy, and linear ones about a state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike

from symsimpson.errors import InputError, ModelError
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import doubles
from symsimpson.graph.nodes import Value, scaled
from symsimpson.mechanics.consistent import consistent
from symsimpson.mechanics.constraints import accelerations
from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.declared import Declared
from symsimpson.mechanics.given_states import read_values, read_vector
from symsimpson.mechanics.plain import Plain, Symbols
from symsimpson.support.array_types import Floats

__all__ = ["equations", "linearised", "terms"]

#: How far a state may be from one that satisfies the constraints, relative to it.
NEAR = 1e-6


def equations(system: Declared) -> tuple[sp.Eq, ...]:
    """Write d/dt dL/dv - dL/dq = f - Phi^T lambda - A^T nu, and constraints, phi = 0, A v = b."""
    if system.too_large_for_sympy:
        raise ModelError(
            f"system {system.name!r}: T and V are too long for equations in SymPy.\n"
            "Use stepper.residual and stepper.jacobian, which evaluate them as numbers."
        )
    multipliers = [sp.Symbol(f"lambda_{name}") for name in system.plain.held]
    written = [
        sp.Eq(sp.diff(moment, time) - force, pull)
        for moment, force, pull in terms(system, multipliers)
    ]
    held = (*system.constraints.values(), *system.velocity_constraints.values())
    return (*written, *(sp.Eq(expression, 0) for expression in held))


def terms(system: Declared, multipliers: list[sp.Symbol]) -> list[tuple[sp.Expr, sp.Expr, sp.Expr]]:
    """Return dL/dv, dL/dq and what else pulls, for each coordinate."""
    back = dict(Symbols(system.coordinates, system.parameters, system.inputs).back)
    lagrangian = system.lagrangian
    m = len(system.constraints)
    phis = zip(multipliers[:m], system.constraints.values(), strict=True)
    held = sum((multiplier * phi for multiplier, phi in phis), sp.S.Zero)
    rates = zip(multipliers[m:], system.velocity_constraints.values(), strict=True)
    rolling = sum((multiplier * rate for multiplier, rate in rates), sp.S.Zero)
    return [
        (
            sp.diff(lagrangian, q.diff(time)),
            sp.diff(lagrangian, q),
            system.plain.written(force).xreplace(back)
            - sp.diff(held, q)
            - sp.diff(rolling, q.diff(time)),
        )
        for q, force in zip(system.coordinates, system.plain.f, strict=True)
    ]


def linearised(
    system: Declared,
    q0: ArrayLike,
    v0: ArrayLike | None,
    parameters: Mapping[Any, float] | None,
    inputs: Mapping[Any, float] | None,
    t: float,
) -> tuple[Floats, Floats]:
    """Return A and B of x' = A x + B u for small changes x of (q, v) and u of inputs."""
    n, m, plain = system.n, len(system.inputs), system.plain
    q = read_vector(system, "q0", q0)
    v = np.zeros(n) if v0 is None else read_vector(system, "v0", v0)
    values = read_values("parameters", "parameter", system.parameters, parameters)
    given = read_values("inputs", "input", dict.fromkeys(system.inputs, 0.0), inputs)
    _check_held(system, q, v, parameters, t)
    known = dict(zip(plain.numbers((*plain.q, *plain.v)), (*q.tolist(), *v.tolist()), strict=True))
    known |= dict(zip(plain.numbers(plain.parameters), values, strict=True))
    known |= dict(zip(plain.numbers(plain.u), given, strict=True)) | {plain.time: t}
    residual, unknowns = _residual(plain)
    moved = (*unknowns, *plain.numbers((*plain.q, *plain.v, *plain.u)))
    slopes = [gradient(plain.graph, row, moved) for row in residual]

    def at(there: Sequence[float], wanted: Sequence[Sequence[Value]]) -> Floats:
        point = known | dict(zip(unknowns, there, strict=True))
        flat = doubles(plain.graph, [value for row in wanted for value in row], point)
        return np.reshape(flat, (len(wanted), -1))

    size = len(unknowns)
    try:
        mass, rest = (
            at([0.0] * size, wanted)
            for wanted in ([row[:size] for row in slopes], [[row] for row in residual])
        )
        there = -np.linalg.solve(mass, rest)[:, 0]  # accelerations and multipliers
        changes = -np.linalg.solve(mass, at(there.tolist(), [row[size:] for row in slopes]))[:n]
    except np.linalg.LinAlgError:
        changes = np.full((n, 2 * n + m), np.nan)
    A = np.vstack([np.eye(n, 2 * n, n), changes[:, : 2 * n]])
    B = np.vstack([np.zeros((n, m)), changes[:, 2 * n :]])
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        raise InputError(
            f"{system.name}: the linear equations have no finite values there.\n"
            "Choose a state at which T, V and forces are smooth."
        )
    return A, B


def _residual(plain: Plain) -> tuple[list[Value], tuple[int, ...]]:
    """Write M a + W^T lambda - push and W a + curve, and tell the nodes of a and lambda."""
    graph, q, v = plain.graph, plain.numbers(plain.q), plain.numbers(plain.v)
    places = (q, v, plain.time)
    held = accelerations(graph, plain.L, plain.held_rows(graph), plain.f, places)
    a = graph.numbers(f"acceleration_{i}" for i in range(len(q)))
    pulls = graph.numbers(s.name for s in plain.multipliers)
    residual = []
    for i, push in enumerate(held.push):
        mass = graph.products([plain.entry(i, j) for j in range(len(q))], a)
        turned = graph.products([row[i] for row in held.rows], pulls)
        residual.append(graph.add([*mass, *turned, scaled(-1, push)]))
    # W v stays as it is, which determines the multipliers
    for row, curve in zip(held.rows, held.curve, strict=True):
        residual.append(graph.add([*graph.products(row, a), curve]))
    return residual, (*a, *pulls)


def _check_held(
    system: Declared, q: Floats, v: Floats, parameters: Mapping[Any, float] | None, t: float
) -> None:
    """Refuse a state that the constraints do not allow."""
    if not system.plain.held:
        return
    nearest = consistent(system, q, v, (), parameters, t)
    for name, given, near in zip(("q0", "v0"), (q, v), nearest, strict=True):
        if np.abs(near - given).max() > NEAR * np.abs(near).max():
            raise InputError(
                f"{system.name}: {name} does not satisfy the constraints.\n"
                "Take the nearest state that does: q0, v0 = system.consistent(q0, v0)."
            )
