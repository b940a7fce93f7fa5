"""Systems in LaTeX. Names of symbols are untrusted: odd ones are replaced."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import sympy as sp
from sympy.physics.mechanics import dynamicsymbols
from sympy.physics.vector import vlatex

from symsimpson.markup import aligned, in_text
from symsimpson.mechanics.plain import Symbols

if TYPE_CHECKING:
    from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["system"]

#: Names that SymPy may typeset as they are.
PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Equations of motion are shown for so many coordinates, with so many operations.
SHOWN, MOST_OPERATIONS = 4, 300


def system(one: MechanicalSystem) -> str:
    """Return T, V, M and, for few coordinates, the equations of motion."""
    try:
        return _equations(one)
    except RecursionError:
        return _too_long(one)


def _too_long(one: MechanicalSystem) -> str:
    text = rf"{in_text(one.name)}: {one.n} coordinates, T and V too long to be shown"
    return rf"$\text{{{text}}}$"


def _equations(one: MechanicalSystem) -> str:
    if one.large:
        return _too_long(one)
    t = dynamicsymbols._t
    safe = _safe(one)
    kinetic, potential = (sp.sympify(x).xreplace(safe) for x in (one.kinetic, one.potential))
    lines = [("T", kinetic), ("V", potential)]
    pulls: list[sp.Expr] = []
    for k, phi in enumerate(one.constraints.values()):
        lines.append(("0", sp.sympify(phi).xreplace(safe)))
        multiplier = sp.Symbol(f"lambda_{k + 1}" if len(one.constraints) > 1 else "lambda")
        pulls.append(multiplier * sp.sympify(phi))
    if one.n <= SHOWN:
        lines.append(("M", one.mass_matrix.xreplace(safe)))
        lagrangian = one.lagrangian
        back = dict(Symbols(one.coordinates, one.parameters, one.inputs).back)
        for q, own in zip(one.coordinates, one.plain.f, strict=True):
            name = q.xreplace(safe)
            moment = sp.diff(lagrangian, q.diff(t)).xreplace(safe)
            force = sp.diff(lagrangian - sp.Add(*pulls), q) + one.plain.written(own).xreplace(back)
            force = force.xreplace(safe)
            if sp.count_ops([moment, force]) > MOST_OPERATIONS:
                break
            label = vlatex(name)
            lines.append((f"p_{{{label}}}", moment))
            lines.append((rf"\dot{{p}}_{{{label}}}", force))
    return aligned([(left, vlatex(right)) for left, right in lines])


def _safe(one: MechanicalSystem) -> dict[Any, Any]:
    """Map what is named oddly to plain symbols."""
    t = dynamicsymbols._t
    replace: dict[Any, Any] = {
        a: sp.Symbol(f"a_{i}") for i, a in enumerate(one.parameters) if not PLAIN.fullmatch(a.name)
    }
    for i, q in enumerate(one.coordinates):
        if not PLAIN.fullmatch(q.func.__name__):
            plain = sp.Function(f"q_{i}")(t)
            replace |= {q: plain, q.diff(t): plain.diff(t)}
    return replace
