"""Generalised forces of SymPy's loads: vectors at points, torques on frames."""

from __future__ import annotations

from typing import Any

import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

__all__ = ["generalised"]


def generalised(method: Any) -> dict[Any, sp.Expr]:
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
        speed = q.diff(dynamicsymbols._t)
        parts = []
        for where, vector in loads:
            turning = hasattr(where, "ang_vel_in")
            velocity = where.ang_vel_in(inertial) if turning else where.vel(inertial)
            parts.append(vector.dot(velocity.diff(speed, inertial, var_in_dcm=False)))
        total = sp.Add(*parts)
        if total != 0:
            found[q] = total
    return found
