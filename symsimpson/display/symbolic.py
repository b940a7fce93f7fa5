"""Systems and schemes in LaTeX. Names of symbols are untrusted: odd ones are replaced."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import sympy as sp
from sympy.physics.mechanics import dynamicsymbols
from sympy.physics.vector import vlatex

if TYPE_CHECKING:
    from symsimpson.mechanics.system import MechanicalSystem
    from symsimpson.schemes.composition import Composition
    from symsimpson.schemes.scheme import Scheme

__all__ = ["composition", "scheme", "system"]

#: Names that SymPy may typeset as they are.
PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Equations of motion are shown for so many coordinates, with so many operations.
SHOWN, MOST_OPERATIONS = 4, 300
#: Tables of more numbers than this are not shown.
MOST_NUMBERS = 42


def system(one: MechanicalSystem) -> str:
    """Return T, V, M and, for few coordinates, the equations of motion."""
    try:
        return _equations(one)
    except RecursionError:
        return _too_long(one)


def _too_long(one: MechanicalSystem) -> str:
    text = rf"{_plain(one.name)}: {one.n} coordinates, T and V too long to be shown"
    return rf"$\text{{{text}}}$"


def _equations(one: MechanicalSystem) -> str:
    if one.large:
        return _too_long(one)
    t = dynamicsymbols._t
    safe = _safe(one)
    kinetic, potential = (sp.sympify(x).xreplace(safe) for x in (one.kinetic, one.potential))
    lines = [("T", kinetic), ("V", potential)]
    if one.n <= SHOWN:
        lines.append(("M", one.mass_matrix.xreplace(safe)))
        lagrangian = one.lagrangian
        for q in one.coordinates:
            name = q.xreplace(safe)
            moment = sp.diff(lagrangian, q.diff(t)).xreplace(safe)
            force = sp.diff(lagrangian, q).xreplace(safe)
            if sp.count_ops([moment, force]) > MOST_OPERATIONS:
                break
            label = vlatex(name)
            lines.append((f"p_{{{label}}}", moment))
            lines.append((rf"\dot{{p}}_{{{label}}}", force))
    rows = r" \\ ".join(rf"{left} &= {vlatex(right)}" for left, right in lines)
    return rf"$\displaystyle \begin{{aligned}} {rows} \end{{aligned}}$"


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


def scheme(one: Scheme) -> str:
    """Return order, nodes, weights and the tables A and B, where they are exact and few."""
    rows = [
        ("", rf"\text{{{_plain(one.name)}: {one.quadrature.kind} quadrature, order {one.order}}}"),
        ("d", str(one.degree)),
    ]
    if one.exact and one.stages * (one.degree + 1) <= MOST_NUMBERS:
        rows += [
            ("c_i", sp.latex(sp.Matrix([one.quadrature.nodes]))),
            ("b_i", sp.latex(sp.Matrix([one.quadrature.weights]))),
            ("A_{ik}", sp.latex(sp.Matrix(one.A))),
            ("B_{ik}", sp.latex(sp.Matrix(one.B))),
        ]
    else:
        rows += [
            ("c_i", sp.latex(sp.Matrix([one.quadrature.nodes]).evalf(6))),
            ("b_i", sp.latex(sp.Matrix([one.quadrature.weights]).evalf(6))),
        ]
    return _aligned(rows)


def composition(one: Composition) -> str:
    """Return order, kicks and drifts."""
    return _aligned([
        ("", rf"\text{{{_plain(one.name)}: {len(one.drifts)} drifts, order {one.order}}}"),
        ("b_k", sp.latex(sp.Matrix([one.kicks]).evalf(6))),
        ("a_k", sp.latex(sp.Matrix([one.drifts]).evalf(6))),
    ])  # fmt: skip


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9 ,()]", r"\\_", name)


def _aligned(rows: list[tuple[str, str]]) -> str:
    text = r" \\ ".join(f"{left} &= {right}" if left else f"& {right}" for left, right in rows)
    return rf"$\displaystyle \begin{{aligned}} {text} \end{{aligned}}$"
