"""Contents of the methods of SymPy's mechanics, for a declaration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp

from symsimpson.mechanics.checks import fail
from symsimpson.mechanics.forces import read_inputs
from symsimpson.mechanics.kane import read_kane
from symsimpson.mechanics.loads import generalised

__all__ = ["read_method"]


def read_method(
    name: str, method: Any, inputs: Sequence[sp.Expr] = ()
) -> tuple[sp.Expr, tuple[Any, ...], dict[Any, Any], list[sp.Expr], list[sp.Expr]]:
    """Return L, the coordinates, the forces by name, and the constraints of both kinds.

    Raises
    ------
    ModelError
        If it is no LagrangesMethod and no KanesMethod, or one that lacks something.
    """
    if hasattr(method, "kindiffdict"):
        return read_kane(name, method, read_inputs(name, inputs, (), ()))
    try:
        lagrangian, coordinates = method._L[0], tuple(method.q)
        held = list(method._hol_coneqs)
        loads = generalised(method.forcelist or (), method.inertial, coordinates)
        rolling = list(method.coneqs)[len(held) :]
    except (AttributeError, TypeError, IndexError):
        raise fail(
            name,
            f"{type(method).__name__} is not a sympy.physics.mechanics.LagrangesMethod, nor a "
            "KanesMethod.",
            "Pass the method itself, as system.eom_method or joints.method, or use "
            "from_lagrangian(name, L, ...).",
        ) from None
    return lagrangian, coordinates, {"forcelist": loads} if loads else {}, held, rolling
