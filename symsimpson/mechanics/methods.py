"""Contents of the methods of SymPy's mechanics, for a declaration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp

from symsimpson.mechanics.checks import fail
from symsimpson.mechanics.forces import read_inputs
from symsimpson.mechanics.identities import Identities
from symsimpson.mechanics.kane import read_kane
from symsimpson.mechanics.loads import generalised, potential_of

__all__ = ["read_method"]


def read_method(
    name: str, method: Any, inputs: Sequence[sp.Expr] = ()
) -> tuple[sp.Expr, tuple[Any, ...], dict[Any, Any], list[sp.Expr], list[sp.Expr]]:
    """Return L, the coordinates, the forces by name, and the constraints of both kinds.

    Raises ModelError if it is no LagrangesMethod and no KanesMethod, or one that lacks something.
    """
    driven = read_inputs(name, inputs, (), ())
    if hasattr(method, "kindiffdict"):
        return read_kane(name, method, driven)
    try:
        lagrangian, coordinates = method._L[0], tuple(method.q)
        held = list(method._hol_coneqs)
        frame, loads = method.inertial, method.forcelist or ()
        each = [generalised([load], frame, coordinates) for load in loads]
        rolling = list(method.coneqs)[len(held) :]
    except (AttributeError, TypeError, IndexError):
        raise fail(
            name,
            f"{type(method).__name__} is not a sympy.physics.mechanics.LagrangesMethod, nor a "
            "KanesMethod.",
            "Pass the method itself, as system.eom_method or joints.method, or use "
            "from_lagrangian(name, L, ...).",
        ) from None
    known = Identities(name, "LagrangesMethod", coordinates, held)
    potential, force = potential_of(each, coordinates, sp.S.Zero, driven, known.vanish)
    forces = {"forcelist": force} if force else {}
    return lagrangian - potential, coordinates, forces, held, rolling
