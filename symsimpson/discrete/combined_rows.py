"""Combinations of the rows of the step's equations that depend only on the scheme."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import sympy as sp

from symsimpson.schemes.scheme import Scheme

Table = tuple[tuple[sp.Expr, ...], ...]


def elimination_order(degree: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return an order of block rows and columns in which elimination avoids singular pivots.

    The elimination of X_m by its own row works for small steps. It fails at a finite step, for
    example at x^2 = 8 with x = h omega for Simpson. Instead, row k eliminates column k + 1, and the
    pivots are the couplings of neighbouring control points. For Simpson the last pivot is
    (M + h^2 K/24) (2/h), which is never singular for K >= 0. The row p0 + D_0 L_d comes last.
    """
    inner = tuple(range(1, degree))
    return (*inner, 0), (*(k + 1 for k in inner), 1)


def force_factor(test: Sequence[sp.Expr], scheme: Scheme, i: int) -> sp.Expr:
    """Return b_i sum_k test_k A_ik: the factor of the force at node i in a combined row."""
    combined = sp.Add(*(c * x for c, x in zip(test, scheme.A[i], strict=True)))
    return sp.radsimp(scheme.quadrature.weights[i] * combined)


def inertia_factor(test: Sequence[sp.Expr], scheme: Scheme, m: int) -> sp.Expr:
    """Return sum_k test_k S_km: the factor of M X_m in a combined row."""
    terms = (c * scheme.stiffness[k][m] for k, c in enumerate(test))
    return sp.radsimp(sp.expand(sp.Add(*terms)))


def rationalise(number: sp.Expr | int) -> sp.Expr:
    """Return a number of a scheme with a rational denominator."""
    return sp.radsimp(sp.sympify(number))


def find_annihilators(scheme: Scheme) -> Table:
    """Return a basis of the nodal functionals that vanish for polynomials of degree d - 1."""
    nodes, d = scheme.quadrature.nodes, scheme.degree
    basis = []
    for first in range(len(nodes) - d):  # divided differences of d + 1 neighbours
        group = range(first, first + d + 1)
        row = [
            1 / sp.Mul(*(nodes[i] - nodes[j] for j in group if j != i)) if i in group else sp.S.Zero
            for i in range(len(nodes))
        ]
        basis.append(tuple(sp.radsimp(sp.expand(value / row[first + d])) for value in row))
    return tuple(basis)


@cache
def shear_factors(scheme: Scheme) -> tuple[tuple[bool, tuple[sp.Expr, sp.Expr]], ...] | None:
    """Factorise the step of a linear oscillator into shears without poles at z = (h omega)^2 > 0.

    The step is q1 = A(z) q + B(z) p with M = h = 1. The function tries two symmetric products:
    kick, drift, kick; and two of these with outer kicks -z/4. A drift must be b / (1 + e z) with
    e >= 0, and a kick must be a polynomial in z of degree two. The result is None if neither
    product has this form.
    """
    # the denominators have the degree of the scheme, and the products below are symmetric
    if scheme.degree > 2 or not scheme.symmetric:
        return None
    z = sp.Symbol("z", positive=True)
    A, B = _oscillator(scheme, z)
    products = (
        [(True, (A - 1) / B), (False, B), (True, (A - 1) / B)],
        [
            (True, -z / 4),
            (False, B / (2 + (E := A - 1 + B * z / 4))),
            (True, E * (2 + E) / B),
            (False, B / (2 + E)),
            (True, -z / 4),
        ],
    )
    for product in products:
        shears = []
        for is_kick, factor in product:
            numerator, denominator = sp.fraction(sp.cancel(sp.radsimp(sp.together(factor))))
            top, bottom = sp.Poly(numerator, z), sp.Poly(denominator, z)
            if is_kick and bottom.degree() == 0 and top.degree() <= 2 and top.eval(0) == 0:
                scale = bottom.eval(0)
                kick = (top.coeff_monomial(z) / scale, top.coeff_monomial(z**2) / scale)
                shears.append((True, kick))
            elif not is_kick and top.degree() == 0 and bottom.degree() <= 1:
                start = bottom.eval(0)
                slope = bottom.coeff_monomial(z) / start
                if not slope.is_nonnegative:
                    break
                shears.append((False, (top.eval(0) / start, slope)))
            else:
                break
        else:
            return tuple(shears)
    return None


def _oscillator(scheme: Scheme, z: sp.Symbol) -> tuple[sp.Expr, sp.Expr]:
    """Return A(z) and B(z) of one step q1 = A q + B p of q'' = -z q with h = 1."""
    d, b, T = scheme.degree, scheme.quadrature.weights, scheme.A
    X = (sp.S.One, *sp.symbols(f"X1:{d + 1}"))
    q, p = sp.symbols("q p")
    path = (q, *X[1:])
    rows = []
    for k in range(d):
        inertia = sum((scheme.stiffness[k][m] * path[m] for m in range(d + 1)), sp.S.Zero)
        mass = [sum(b[i] * T[i][k] * T[i][m] for i in range(scheme.stages)) for m in range(d + 1)]
        force = sum((c * x for c, x in zip(mass, path, strict=True)), sp.S.Zero)
        rows.append(inertia - z * force + (p if k == 0 else 0))
    solution = sp.solve(rows, X[1:], dict=True)[0][X[d]]
    return tuple(sp.cancel(sp.radsimp(sp.together(solution.diff(s)))) for s in (q, p))
