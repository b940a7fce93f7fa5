"""The jet of a Lagrangian: L and its derivatives at one point (q, v)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import sympy as sp

if TYPE_CHECKING:
    from symsimpson.mechanics.plain import Plain

__all__ = ["Jet", "derive_jet"]

Vector = tuple[sp.Expr, ...]
Matrix: TypeAlias = sp.ImmutableDenseMatrix


@dataclass(frozen=True)
class Jet:
    """L and its first and second derivatives, exact, in plain symbols.

    ``L_qv[i, j]`` is the derivative by q_i and v_j; ``L_vv`` is the mass matrix and ``L_v`` the
    momentum of the continuous system.
    """

    lagrangian: sp.Expr
    L_q: Vector
    L_v: Vector
    L_qq: Matrix
    L_qv: Matrix
    L_vv: Matrix


def derive_jet(plain: Plain) -> Jet:
    """Differentiate L = v.M.v/2 + a.v - V once and exactly."""
    q, v, mass = plain.q, plain.v, plain.mass
    n = len(q)
    kinetic = sp.Add(
        *(mass[i, i] * v[i] ** 2 / 2 for i in range(n)),
        *(mass[i, j] * v[i] * v[j] for i in range(n) for j in range(i)),
    )
    linear = sp.Add(*(a * w for a, w in zip(plain.gyroscopic, v, strict=True)))
    lagrangian = kinetic + linear - plain.potential
    L_q = tuple(lagrangian.diff(x) for x in q)
    L_v = tuple(
        sp.Add(a, *(mass[i, j] * v[j] for j in range(n))) for i, a in enumerate(plain.gyroscopic)
    )
    L_qq = [[sp.S.Zero] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            L_qq[i][j] = L_qq[j][i] = L_q[i].diff(q[j])
    L_qv = [[L_v[j].diff(q[i]) for j in range(n)] for i in range(n)]
    return Jet(lagrangian, L_q, L_v, Matrix(L_qq), Matrix(L_qv), mass)
