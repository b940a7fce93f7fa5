"""Schemes in LaTeX."""

from __future__ import annotations

from typing import Any

import sympy as sp

from symsimpson.support.markup import aligned, in_text

#: Tables of more numbers than this are not shown.
MOST_NUMBERS = 42


def scheme(method: Any) -> str:
    """Return order, nodes, weights and the tables A and B, where they are exact and few."""
    rule = method.quadrature
    tables = {"c_i": sp.Matrix([rule.nodes]), "b_i": sp.Matrix([rule.weights])}
    if method.exact and method.stages * (method.degree + 1) <= MOST_NUMBERS:
        tables |= {"A_{ik}": sp.Matrix(method.A), "B_{ik}": sp.Matrix(method.B)}
    else:
        tables = {name: table.evalf(6) for name, table in tables.items()}
    title = _title(method, f"{rule.kind} quadrature")
    rows = [(name, sp.latex(table)) for name, table in tables.items()]
    return aligned([title, ("d", str(method.degree)), *rows])


def composition(method: Any) -> str:
    """Return order, kicks and drifts."""
    tables = ("b_k", method.kicks), ("a_k", method.drifts)
    rows = [(name, sp.latex(sp.Matrix([table]).evalf(6))) for name, table in tables]
    return aligned([_title(method, f"{len(method.drifts)} drifts"), *rows])


def _title(method: Any, kind: str) -> tuple[str, str]:
    return "", rf"\text{{{in_text(method.name)}: {kind}, order {method.order}}}"
