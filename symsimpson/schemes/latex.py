"""Schemes in LaTeX."""

from __future__ import annotations

from typing import Any

import sympy as sp

from symsimpson.support.markup import aligned, in_text

__all__ = ["composition", "scheme"]

#: Tables of more numbers than this are not shown.
MOST_NUMBERS = 42


def scheme(one: Any) -> str:
    """Return order, nodes, weights and the tables A and B, where they are exact and few."""
    rows = [
        ("", rf"\text{{{in_text(one.name)}: {one.quadrature.kind} quadrature, order {one.order}}}"),
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
    return aligned(rows)


def composition(one: Any) -> str:
    """Return order, kicks and drifts."""
    return aligned(
        [
            ("", rf"\text{{{in_text(one.name)}: {len(one.drifts)} drifts, order {one.order}}}"),
            ("b_k", sp.latex(sp.Matrix([one.kicks]).evalf(6))),
            ("a_k", sp.latex(sp.Matrix([one.drifts]).evalf(6))),
        ]
    )
