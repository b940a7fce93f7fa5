"""Elimination written out: small dense systems line by line, structural zeros skipped."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symsimpson.codegen.levels import Graph

__all__ = ["solve_blocks", "solve_symmetric", "solve_unpivoted"]

Matrix = Sequence[Sequence[sp.Expr]]


#: Blocks up to this size are inverted in closed form.
CLOSED_FORM = 2


def solve_blocks(
    graph: Graph,
    matrix: Matrix,
    right: Sequence[sp.Expr],
    size: int,
    hints: Sequence[str],
    section: str,
) -> list[sp.Expr]:
    """Solve by block elimination in the given order, blocks of ``size`` inverted by adjugates.

    One division a block instead of one a row: divisions wait for each other, so a step of the
    double pendulum became a tenth faster. Larger blocks are eliminated row by row.
    """
    if size < len(right) <= CLOSED_FORM:
        size = len(right)
    if size > CLOSED_FORM:
        return solve_unpivoted(graph, matrix, right, hints, section)
    count = len(right) // size

    def block(i: int, j: int) -> sp.Matrix:
        return sp.Matrix(size, size, lambda a, b: matrix[i * size + a][j * size + b])

    def named(hint: str, value: sp.Matrix) -> sp.Matrix:
        rows, columns = value.shape
        return sp.Matrix(
            rows, columns, lambda a, b: graph.define(f"{hint}_{a}_{b}", value[a, b], section)
        )

    upper: dict[tuple[int, int], sp.Matrix] = {}
    lower: dict[tuple[int, int], sp.Matrix] = {}
    inverse: list[sp.Matrix] = []
    forward: list[sp.Matrix] = []
    for i in range(count):
        for j in range(count):
            rest = block(i, j)
            for k in range(min(i, j)):
                rest -= lower[i, k] * upper[k, j]
            if j < i:
                lower[i, j] = named(f"L_{i}{j}", named(f"B_{i}{j}", rest) * inverse[j])
            else:
                upper[i, j] = named(f"U_{i}{j}", rest)
        pivot = upper[i, i]
        scale = graph.define(f"inv_det_{i}", 1 / pivot.det(method="berkowitz"), section)
        inverse.append(named(f"inv_{i}", pivot.adjugate() * scale))
        rest = sp.Matrix(right[i * size : (i + 1) * size])
        for k in range(i):
            rest -= lower[i, k] * forward[k]
        forward.append(named(f"y_{i}", rest))
    unknowns: dict[int, sp.Matrix] = {}
    for i in reversed(range(count)):
        rest = forward[i]
        for j in range(i + 1, count):
            rest -= upper[i, j] * unknowns[j]
        value = inverse[i] * named(f"z_{i}", rest)
        unknowns[i] = sp.Matrix(
            [graph.define(hints[i * size + a], value[a], section) for a in range(size)]
        )
    return [unknowns[i][a] for i in range(count) for a in range(size)]


def solve_unpivoted(
    graph: Graph, matrix: Matrix, right: Sequence[sp.Expr], hints: Sequence[str], section: str
) -> list[sp.Expr]:
    """Solve by LU factors (Doolittle) in the given order, without pivoting.

    Entries that are zero for all values stay out of the code, so the fill pattern is fixed here.
    Returns the unknowns, defined under ``hints``.
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
    return _back(graph, upper, forward, inverse, hints, section)


def solve_symmetric(
    graph: Graph, matrix: Matrix, right: Sequence[sp.Expr], hints: Sequence[str], section: str
) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Solve with a symmetric positive definite matrix by L D L^T, without roots.

    Returns the unknowns and the pivots D, all positive if and only if the matrix is.
    """
    size = len(right)
    if size == CLOSED_FORM:
        return _solve_two(graph, matrix, right, hints, section)
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
        unknowns[i] = graph.define(hints[i], rest, section)
    return unknowns, pivots


def _solve_two(
    graph: Graph, matrix: Matrix, right: Sequence[sp.Expr], hints: Sequence[str], section: str
) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Solve a symmetric 2 x 2 system with one division; the pivots' signs are those of minors."""
    (a, b), (_, d) = matrix
    determinant = graph.define("det", a * d - b**2, section)
    scale = graph.define("inv_det", 1 / determinant, section)
    x, y = right
    first = graph.define(hints[0], (d * x - b * y) * scale, section)
    second = graph.define(hints[1], (a * y - b * x) * scale, section)
    return [first, second], [a, determinant]


def _back(
    graph: Graph,
    upper: Matrix,
    forward: Sequence[sp.Expr],
    inverse: Sequence[sp.Expr],
    hints: Sequence[str],
    section: str,
) -> list[sp.Expr]:
    size = len(forward)
    unknowns: list[sp.Expr] = [sp.S.Zero] * size
    for i in reversed(range(size)):
        rest = _minus(forward[i], [(upper[i][j], unknowns[j]) for j in range(i + 1, size)])
        unknowns[i] = graph.define(hints[i], rest * inverse[i], section)
    return unknowns


def _minus(value: sp.Expr, products: Sequence[tuple[sp.Expr, sp.Expr]]) -> sp.Expr:
    return sp.Add(value, *(-a * b for a, b in products))
