"""Contents of a LagrangesMethod of SymPy: L, constraints, and loads as generalised forces."""

from __future__ import annotations

from typing import Any

import sympy as sp

from symsimpson.mechanics.checks import fail
from symsimpson.mechanics.coordinates import time

__all__ = ["read_method"]


def read_method(
    name: str, lm: Any
) -> tuple[sp.Expr, tuple[Any, ...], dict[Any, sp.Expr], list[sp.Expr], list[sp.Expr]]:
    """Return L, the coordinates, the generalised forces, and the constraints of both kinds.

    Raises
    ------
    ModelError
        If it is no LagrangesMethod.
    """
    try:
        lagrangian, coordinates = lm._L[0], tuple(lm.q)
        held, loads = list(lm._hol_coneqs), _generalised(lm)
        rolling = list(lm.coneqs)[len(held) :]
    except (AttributeError, TypeError, IndexError):
        kane = type(lm).__name__ == "KanesMethod"
        raise fail(
            name,
            f"{type(lm).__name__} is not a sympy.physics.mechanics.LagrangesMethod.",
            "Kane's equations come without a Lagrangian, and a variational step is made of "
            "one. Write L = sympy.physics.mechanics.Lagrangian(frame, *bodies), with the "
            "bodies' potential_energy, and use from_lagrangian(name, L, coordinates, "
            "parameters)."
            if kane
            else "Pass the LagrangesMethod itself, or use from_lagrangian(name, L, ...).",
        ) from None
    return lagrangian, coordinates, loads, held, rolling


def _generalised(method: Any) -> dict[Any, sp.Expr]:
    """Return the generalised forces of a LagrangesMethod's ``forcelist``, by coordinate.

    Parameters
    ----------
    method : sympy.physics.mechanics.LagrangesMethod
        Its ``forcelist`` holds pairs of a point and a force, or of a frame and a torque.

    Returns
    -------
    dict
        For each coordinate the sum of vector . d(velocity)/d(velocity of the coordinate); those
        on which no force acts are left out.
    """
    loads, inertial = list(method.forcelist or []), method.inertial
    found: dict[Any, sp.Expr] = {}
    for q in method.q:
        speed = q.diff(time)
        parts = []
        for where, vector in loads:
            turning = hasattr(where, "ang_vel_in")
            velocity = where.ang_vel_in(inertial) if turning else where.vel(inertial)
            parts.append(vector.dot(velocity.diff(speed, inertial, var_in_dcm=False)))
        total = sp.Add(*parts)
        if total != 0:
            found[q] = total
    return found
