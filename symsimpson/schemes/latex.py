"""Schemes in LaTeX."""

from __future__ import annotations

from typing import Any

import sympy as sp

from symsimpson.support.markup import aligned, in_text

__all__ = ["composition", "scheme"]

#: Tables of more numbers than this are not shown.
MOST_NUMBERS = 42


def scheme(method: Any) -> str:
    """Return order, nodes, weights and the tables A and B, where they are exact and few."""
    rows = [
        (
            "",
            rf"\text{{{in_text(method.name)}: {method.quadrature.kind} quadrature, "
            rf"order {method.order}}}",
        ),
        ("d", str(method.degree)),
    ]
    if method.exact and method.stages * (method.degree + 1) <= MOST_NUMBERS:
        rows += [
            ("c_i", sp.latex(sp.Matrix([method.quadrature.nodes]))),
            ("b_i", sp.latex(sp.Matrix([method.quadrature.weights]))),
            ("A_{ik}", sp.latex(sp.Matrix(method.A))),
            ("B_{ik}", sp.latex(sp.Matrix(method.B))),
        ]
    else:
        rows += [
            ("c_i", sp.latex(sp.Matrix([method.quadrature.nodes]).evalf(6))),
            ("b_i", sp.latex(sp.Matrix([method.quadrature.weights]).evalf(6))),
        ]
    return aligned(rows)


def composition(method: Any) -> str:
    """Return order, kicks and drifts."""
    return aligned(
        [
            (
                "",
                rf"\text{{{in_text(method.name)}: {len(method.drifts)} drifts, "
                rf"order {method.order}}}",
            ),
            ("b_k", sp.latex(sp.Matrix([method.kicks]).evalf(6))),
            ("a_k", sp.latex(sp.Matrix([method.drifts]).evalf(6))),
        ]
    )
