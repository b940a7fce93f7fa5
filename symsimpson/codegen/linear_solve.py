"""Elimination written out: small dense systems as straight lines, structural zeros skipped."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symsimpson.codegen.levels import Graph

__all__ = ["solve_symmetric", "solve_unpivoted"]

Matrix = Sequence[Sequence[sp.Expr]]


def solve_unpivoted(
    graph: Graph, matrix: Matrix, right: Sequence[sp.Expr], wishes: Sequence[str], section: str
) -> list[sp.Expr]:
    """Solve by LU factors (Doolittle) in the given order, without pivoting.

    Entries that are zero for all values stay out of the code, so the fill pattern is fixed here.
    Returns the unknowns, defined under ``wishes``.
    """
    size = len(right)
    upper: list[list[sp.Expr]] = [[sp.S.Zero] * size for _ in range(size)]
    lower: list[list[sp.Expr]] = [[sp.S.Zero] * size for _ in range(size)]
    inverse: list[sp.Expr] = []
    forward: list[sp.Expr] = []
    for i in range(size):
        for j in range(i):
            rest = _minus(matrix[i][j], [(lower[i][k], upper[k][j]) for k in range(j)])
            lower[i][j] = graph.define(f"lu_{i}_{j}", rest * inverse[j], section)
        for j in range(i, size):
            rest = _minus(matrix[i][j], [(lower[i][k], upper[k][j]) for k in range(i)])
            upper[i][j] = graph.define(f"lu_{i}_{j}", rest, section)
        inverse.append(graph.define(f"pivot_{i}", 1 / upper[i][i], section))
        rest = _minus(right[i], [(lower[i][k], forward[k]) for k in range(i)])
        forward.append(graph.define(f"y_{i}", rest, section))
    return _back(graph, upper, forward, inverse, wishes, section)


def solve_symmetric(
    graph: Graph, matrix: Matrix, right: Sequence[sp.Expr], wishes: Sequence[str], section: str
) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Solve with a symmetric positive definite matrix by L D L^T, without roots.

    Returns the unknowns and the pivots D, all positive if and only if the matrix is.
    """
    size = len(right)
    scaled: list[list[sp.Expr]] = [[sp.S.Zero] * size for _ in range(size)]
    lower: list[list[sp.Expr]] = [[sp.S.Zero] * size for _ in range(size)]
    pivots: list[sp.Expr] = []
    inverse: list[sp.Expr] = []
    forward: list[sp.Expr] = []
    for i in range(size):
        for j in range(i):
            rest = _minus(matrix[i][j], [(lower[j][k], scaled[i][k]) for k in range(j)])
            scaled[i][j] = graph.define(f"ld_{i}_{j}", rest, section)
            lower[i][j] = graph.define(f"l_{i}_{j}", scaled[i][j] * inverse[j], section)
        rest = _minus(matrix[i][i], [(lower[i][k], scaled[i][k]) for k in range(i)])
        pivots.append(graph.define(f"d_{i}", rest, section))
        inverse.append(graph.define(f"inv_d_{i}", 1 / pivots[i], section))
        rest = _minus(right[i], [(lower[i][k], forward[k]) for k in range(i)])
        forward.append(graph.define(f"z_{i}", rest, section))
    unknowns: list[sp.Expr] = [sp.S.Zero] * size
    for i in reversed(range(size)):
        rest = _minus(
            forward[i] * inverse[i], [(lower[k][i], unknowns[k]) for k in range(i + 1, size)]
        )
        unknowns[i] = graph.define(wishes[i], rest, section)
    return unknowns, pivots


def _back(
    graph: Graph,
    upper: Matrix,
    forward: Sequence[sp.Expr],
    inverse: Sequence[sp.Expr],
    wishes: Sequence[str],
    section: str,
) -> list[sp.Expr]:
    size = len(forward)
    unknowns: list[sp.Expr] = [sp.S.Zero] * size
    for i in reversed(range(size)):
        rest = _minus(forward[i], [(upper[i][j], unknowns[j]) for j in range(i + 1, size)])
        unknowns[i] = graph.define(wishes[i], rest * inverse[i], section)
    return unknowns


def _minus(value: sp.Expr, products: Sequence[tuple[sp.Expr, sp.Expr]]) -> sp.Expr:
    return sp.Add(value, *(-a * b for a, b in products))
