"""An independent truth: L_d in many digits from T and V alone, derivatives by differences.

Nothing here uses the package's derivation, tables or generated code, save the declaration.
"""

from __future__ import annotations

import mpmath as mp
import sympy as sp

DIGITS = 60


def lagrangian(system):
    """L(q, v) as a function of mpmath numbers, straight from the user's own T, a and V."""
    q = sp.symbols(f"oq:{system.n}")
    v = sp.symbols(f"ov:{system.n}")
    names = {c.diff(): w for c, w in zip(system.coordinates, v, strict=True)}
    names |= dict(zip(system.coordinates, q, strict=True))
    expression = system.lagrangian.xreplace(names)
    function = sp.lambdify((q, v, tuple(system.parameters)), expression, modules="mpmath")
    return lambda x, w, parameters: function(x, w, parameters)


def forces(system):
    """f(t, q, v) by coordinate, straight from the user's forces by coordinate and dissipation."""
    q = sp.symbols(f"oq:{system.n}")
    v = sp.symbols(f"ov:{system.n}")
    t = system.coordinates[0].args[0]
    names = {c.diff(): w for c, w in zip(system.coordinates, v, strict=True)}
    names |= dict(zip(system.coordinates, q, strict=True))
    loss = sp.sympify(system.dissipation or 0).xreplace(names)
    rows = [
        sp.sympify(system.forces.get(c, 0)).xreplace(names) - sp.diff(loss, w)
        for c, w in zip(system.coordinates, v, strict=True)
    ]
    return sp.lambdify((t, q, v, tuple(system.parameters)), rows, modules="mpmath")


def virtual_work(system, quadrature, stages, degree):
    """F_k(X, h, parameters) = h sum_i b_i A_ik f_i, by the quadrature of L_d; the step begins at 0.

    A row for each control point.
    """
    f = forces(system)
    points = nodes_and_weights("lobatto", degree + 1)[0]
    nodes, weights = nodes_and_weights(quadrature, stages)
    tables = [interpolate(points, c) for c in nodes]

    def F(X, h, parameters):
        rows = [[mp.mpf(0)] * system.n for _ in X]
        for c, b, (basis, slopes) in zip(nodes, weights, tables, strict=True):
            q = [mp.fdot(basis, column) for column in zip(*X, strict=True)]
            v = [mp.fdot(slopes, column) / h for column in zip(*X, strict=True)]
            for row, share in zip(rows, basis, strict=True):
                for a, value in enumerate(f(c * h, q, v, parameters)):
                    row[a] += h * b * share * value
        return rows

    return F


def nodes_and_weights(quadrature, stages):
    """Gauss or Lobatto rules on [0, 1] by root finding."""
    if quadrature == "gauss":
        points = mp.polyroots(
            list(reversed(mp.taylor(lambda x: mp.legendre(stages, x), 0, stages)))
        )
    else:
        inner = mp.taylor(lambda x: mp.legendre(stages - 1, x), 0, stages - 1)
        slopes = [k * c for k, c in enumerate(inner)][1:]
        points = [
            mp.mpf(-1),
            *(mp.polyroots(list(reversed(slopes))) if stages > 2 else []),
            mp.mpf(1),
        ]
    points = sorted((1 + mp.re(x)) / 2 for x in points)
    vandermonde = mp.matrix(stages, stages)
    for k in range(stages):
        for i, x in enumerate(points):
            vandermonde[k, i] = x**k
    moments = mp.matrix([mp.mpf(1) / (k + 1) for k in range(stages)])
    return points, list(mp.lu_solve(vandermonde, moments))


def interpolate(points, x):
    """Lagrange basis and its derivative at x."""
    basis, slopes = [], []
    for k, here in enumerate(points):
        others = [p for j, p in enumerate(points) if j != k]
        scale = mp.fprod(here - p for p in others)
        basis.append(mp.fprod(x - p for p in others) / scale)
        slopes.append(
            mp.fsum(mp.fprod(x - p for p in others if p is not skipped) for skipped in others)
            / scale
        )
    return basis, slopes


def discrete_lagrangian(system, quadrature, stages, degree):
    """L_d(X, h, parameters) with X a list of d + 1 control points."""
    L = lagrangian(system)
    points = nodes_and_weights("lobatto", degree + 1)[0]
    nodes, weights = nodes_and_weights(quadrature, stages)
    tables = [interpolate(points, c) for c in nodes]

    def Ld(X, h, parameters):
        total = mp.mpf(0)
        for b, (basis, slopes) in zip(weights, tables, strict=True):
            q = [mp.fdot(basis, column) for column in zip(*X, strict=True)]
            v = [mp.fdot(slopes, column) / h for column in zip(*X, strict=True)]
            total += b * L(q, v, parameters)
        return h * total

    return Ld


def gradient(Ld, X, h, parameters, step="1e-20"):
    """D_k L_d for all control points by central differences."""
    step = mp.mpf(step)
    rows = []
    for k in range(len(X)):
        row = []
        for a in range(len(X[0])):
            values = []
            for sign in (1, -1):
                moved = [list(x) for x in X]
                moved[k][a] += sign * step
                values.append(Ld(moved, h, parameters))
            row.append((values[0] - values[1]) / (2 * step))
        rows.append(row)
    return rows


def hessian(Ld, X, h, parameters, step="1e-15"):
    """D_m D_k L_d by differences of L_d, as a function of pairs ((k, a), (m, b))."""
    step = mp.mpf(step)

    def second(k, a, m, b):
        total = mp.mpf(0)
        for s in (1, -1):
            for t in (1, -1):
                moved = [list(x) for x in X]
                moved[k][a] += s * step
                moved[m][b] += t * step
                total += s * t * Ld(moved, h, parameters)
        return total / (4 * step**2)

    return second
