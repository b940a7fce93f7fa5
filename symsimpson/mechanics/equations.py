"""Equations of motion of a system: in SymPy, and linear ones about a state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError, ModelError
from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.declared import Declared
from symsimpson.mechanics.given import read_values, read_vector
from symsimpson.mechanics.plain import Symbols
from symsimpson.support.literals import float_literals

__all__ = ["equations", "linearised", "terms"]

Floats = NDArray[np.float64]


def equations(system: Declared) -> tuple[sp.Eq, ...]:
    """Write d/dt dL/dv - dL/dq = f - Phi^T lambda - A^T nu, and constraints, phi = 0, A v = b."""
    _check(system, "equations")
    multipliers = [sp.Symbol(f"lambda_{name}") for name in system.plain.held]
    written = [
        sp.Eq(sp.diff(moment, time) - force, pull)
        for moment, force, pull in terms(system, multipliers)
    ]
    held = (*system.constraints.values(), *system.velocity_constraints.values())
    return (*written, *(sp.Eq(expression, 0) for expression in held))


def _check(system: Declared, what: str) -> None:
    if system.too_large_for_sympy:
        raise ModelError(
            f"system {system.name!r}: T and V are too long for {what} in SymPy.\n"
            "Use stepper.residual and stepper.jacobian, which evaluate them as numbers."
        )


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
    _check(system, "linear equations")
    if system.plain.held:
        raise ModelError(
            f"system {system.name!r} has constraints, so its coordinates do not vary freely.\n"
            "Declare it in as many coordinates as it has degrees of freedom to linearise it."
        )
    n, m = system.n, len(system.inputs)
    q = read_vector(system, "q0", q0)
    v = np.zeros(n) if v0 is None else read_vector(system, "v0", v0)
    further = read_values("parameters", "parameter", system.parameters, parameters)
    further += read_values("inputs", "input", dict.fromkeys(system.inputs, 0.0), inputs)
    plain = Symbols(system.coordinates, system.parameters, system.inputs)
    a = sp.symbols(f"a:{n}", cls=sp.Dummy)
    rows = []
    for moment, force, pull in terms(system, []):
        moment, force, pull = (x.xreplace(plain.replace) for x in (moment, force, pull))
        moved = zip((*plain.q, *plain.v), (*plain.v, *a), strict=True)
        rate = sum((sp.diff(moment, x) * y for x, y in moved), sp.diff(moment, plain.t))
        rows.append(rate - force - pull)
    residual = sp.Matrix(rows)
    parts = [residual.jacobian(x) for x in (a, plain.q, plain.v)]
    parts += [residual.jacobian(plain.u) if m else sp.zeros(n, 0)]
    arguments = [*plain.q, *plain.v, *a, *plain.a, *plain.u, plain.t]
    function = sp.lambdify(arguments, float_literals([residual, *parts]), "numpy", cse=True)
    rest, mass = (np.asarray(x, float) for x in function(*q, *v, *np.zeros(n), *further, t)[:2])
    there = np.linalg.solve(mass, -rest[:, 0])  # the acceleration
    matrices = [np.asarray(x, float) for x in function(*q, *v, *there, *further, t)]
    slopes = -np.linalg.solve(
        matrices[1], np.hstack([matrices[2], matrices[3], matrices[4].reshape(n, m)])
    )
    A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), slopes[:, : 2 * n]])
    B = np.vstack([np.zeros((n, m)), slopes[:, 2 * n :]])
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        raise InputError(
            f"{system.name}: the linear equations have no finite values there.\n"
            "Choose a state at which T, V and forces are smooth."
        )
    return A, B
