"""Equations of motion of a system: in SymPy, and linear ones about a state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError, ModelError
from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.plain import Symbols
from symsimpson.names import spelled

if TYPE_CHECKING:
    from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["equations", "linearised"]

Floats = NDArray[np.float64]


def equations(system: MechanicalSystem) -> tuple[sp.Eq, ...]:
    """Write d/dt dL/dv - dL/dq = f - Phi^T lambda, and constraints, phi = 0."""
    _check(system, "equations")
    multipliers = [sp.Symbol(f"lambda_{name}") for name in system.constraints]
    written = [
        sp.Eq(sp.diff(moment, time) - force, pull)
        for moment, force, pull in _terms(system, multipliers)
    ]
    return (*written, *(sp.Eq(phi, 0) for phi in system.constraints.values()))


def _check(system: MechanicalSystem, what: str) -> None:
    if system.large:
        raise ModelError(
            f"system {system.name!r}: T and V are too long for {what} in SymPy.\n"
            "Use stepper.residual and stepper.jacobian, which evaluate them as numbers."
        )


def _terms(
    system: MechanicalSystem, multipliers: list[sp.Symbol]
) -> list[tuple[sp.Expr, sp.Expr, sp.Expr]]:
    """Return dL/dv, dL/dq and what else pulls, for each coordinate."""
    back = dict(Symbols(system.coordinates, system.parameters, system.inputs).back)
    lagrangian = system.lagrangian
    phis = zip(multipliers, system.constraints.values(), strict=True)
    held = sum((multiplier * phi for multiplier, phi in phis), sp.S.Zero)
    return [
        (
            sp.diff(lagrangian, q.diff(time)), sp.diff(lagrangian, q),
            system.plain.written(own).xreplace(back) - sp.diff(held, q),
        )
        for q, own in zip(system.coordinates, system.plain.f, strict=True)
    ]  # fmt: skip


def linearised(
    system: MechanicalSystem, q0: ArrayLike, v0: ArrayLike | None,
    parameters: Mapping[Any, float] | None, inputs: Mapping[Any, float] | None, t: float,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return A and B of x' = A x + B u for small changes x of (q, v) and u of inputs."""
    _check(system, "linear equations")
    if system.constraints:
        raise ModelError(
            f"system {system.name!r} has constraints, so its coordinates do not vary freely.\n"
            "Declare it in as many coordinates as it has degrees of freedom to linearise it."
        )
    n, names = system.n, [*system.coordinates]
    q, v, a = (list(sp.symbols(f"{x}:{n}", cls=sp.Dummy)) for x in "qva")
    rates = {x.diff(time): y for x, y in zip(names, v, strict=True)}
    plain = {**rates, **dict(zip(names, q, strict=True))}
    rows = []
    for moment, force, pull in _terms(system, []):
        moment, force, pull = (x.xreplace(rates).xreplace(plain) for x in (moment, force, pull))
        rate = sum(
            (sp.diff(moment, x) * y for x, y in zip((*q, *v), (*v, *a), strict=True)),
            sp.diff(moment, time),
        )
        rows.append(rate - force - pull)
    residual = sp.Matrix(rows)
    parts = [residual.jacobian(x) for x in (a, q, v)]
    parts += [residual.jacobian(list(system.inputs)) if system.inputs else sp.zeros(n, 0)]
    arguments = [*q, *v, *a, *system.parameters, *system.inputs, time]
    function = sp.lambdify(arguments, [residual, *parts], "numpy", cse=True)
    at_rest = np.zeros(n)
    given = _numbers(system, "q0", names, q0)
    given += _numbers(system, "v0", names, at_rest if v0 is None else v0)
    further = [
        *_values("parameters", system.parameters, parameters or {}),
        *_values("inputs", dict.fromkeys(system.inputs, 0.0), inputs or {}),
    ]
    rest, mass = (np.asarray(x, float) for x in function(*given, *at_rest, *further, t)[:2])
    there = np.linalg.solve(mass, -rest[:, 0])  # the acceleration
    found = [np.asarray(x, float) for x in function(*given, *there, *further, t)]
    m = len(system.inputs)
    slopes = -np.linalg.solve(found[1], np.hstack([found[2], found[3], found[4].reshape(n, m)]))
    A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), slopes[:, : 2 * n]])
    B = np.vstack([np.zeros((n, m)), slopes[:, 2 * n :]])
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        raise InputError(
            f"{system.name}: the linear equations have no finite values there.\n"
            "Choose a state at which T, V and forces are smooth."
        )
    return A, B


def _numbers(system: MechanicalSystem, what: str, names: list[Any], given: Any) -> list[float]:
    if isinstance(given, Mapping):
        known = {spelled(key): x for key, x in given.items()}
        given = [known.get(spelled(q), np.nan) for q in names]
    try:
        found = [float(x) for x in given]
    except (TypeError, ValueError):
        found = []
    if len(found) != system.n or not np.isfinite(found).all():
        raise InputError(
            f"{what} is {given!r}.\nPass {system.n} finite numbers, in the order of "
            f"{', '.join(map(spelled, names))}."
        )
    return found


def _values(what: str, known: Mapping[Any, Any], given: Mapping[Any, float]) -> list[float]:
    own = {spelled(key): float(x) for key, x in known.items()}
    for key, x in given.items():
        if spelled(key) not in own:
            raise InputError(
                f"{what} names {spelled(key)!r}.\nThere are {', '.join(own) or 'none'}."
            )
        own[spelled(key)] = float(x)
    return list(own.values())
