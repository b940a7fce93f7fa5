"""Elimination written out: small dense systems line by line, structural zeros skipped."""

from __future__ import annotations

from collections.abc import Sequence

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.levels import Definitions, Level

__all__ = ["solve_in_pairs", "solve_symmetric"]

Matrix = Sequence[Sequence[Expression]]
Block = list[list[Expression]]
Vector = Sequence[Expression]


#: Systems of so many equations have one division.
PAIR = 2


def solve_in_pairs(
    graph: Definitions, matrix: Matrix, right: Vector, hints: Sequence[str], section: str
) -> list[Expression]:
    """Solve by elimination in the given order, two rows at a time, without pivoting.

    A block on the diagonal is inverted by its adjugate, with one division for both rows: divisions
    wait for each other, so a step of the double pendulum became a tenth faster. Entries that are
    zero for all values stay out of the code. Returns the unknowns, defined under ``hints``.
    """
    rows = [range(k, min(k + PAIR, len(right))) for k in range(0, len(right), PAIR)]
    count = range(len(rows))

    def named(hint: str, value: Block) -> Block:
        return [
            [graph.define(f"{hint}_{a}_{b}", x, section) for b, x in enumerate(row)]
            for a, row in enumerate(value)
        ]

    def less(value: Block, products: Sequence[tuple[Block, Block]]) -> Block:
        return [
            [
                _minus(x, [(L[a][k], y[b]) for L, U in products for k, y in enumerate(U)])
                for b, x in enumerate(row)
            ]
            for a, row in enumerate(value)
        ]

    def times(left: Block, right: Block) -> Block:
        return [
            [graph.total(x * right[k][b] for k, x in enumerate(row)) for b in range(len(right[0]))]
            for row in left
        ]

    upper: dict[tuple[int, int], Block] = {}
    lower: dict[tuple[int, int], Block] = {}
    inverse: list[Block] = []
    forward: list[Block] = []
    for i in count:
        for j in count:
            block = [[matrix[a][b] for b in rows[j]] for a in rows[i]]
            rest = less(block, [(lower[i, k], upper[k, j]) for k in range(min(i, j))])
            if j < i:
                lower[i, j] = named(f"L_{i}{j}", times(named(f"B_{i}{j}", rest), inverse[j]))
            else:
                upper[i, j] = named(f"U_{i}{j}", rest)
        determinant, adjugate = _adjugate(upper[i, i])
        scale = graph.define(f"inv_det_{i}", 1 / determinant, section)
        inverse.append(named(f"inv_{i}", [[x * scale for x in row] for row in adjugate]))
        column = [[right[a]] for a in rows[i]]
        forward.append(named(f"y_{i}", less(column, [(lower[i, k], forward[k]) for k in range(i)])))
    unknowns: dict[int, Block] = {}
    for i in reversed(count):
        rest = less(forward[i], [(upper[i, j], unknowns[j]) for j in count[i + 1 :]])
        value = times(inverse[i], named(f"z_{i}", rest))
        unknowns[i] = [
            [graph.define(hints[a], x, section)] for a, (x,) in zip(rows[i], value, strict=True)
        ]
    return [x for i in count for (x,) in unknowns[i]]


def _adjugate(block: Block) -> tuple[Expression, Block]:
    """Return the determinant and the adjugate of a block of one or two rows."""
    if len(block) == 1:
        return block[0][0], [[block[0][0].graph.of(1)]]
    (a, b), (c, d) = block
    return a * d - b * c, [[d, -b], [-c, a]]


def solve_symmetric(
    graph: Definitions, matrix: Matrix, right: Vector, hints: Sequence[str], section: str
) -> tuple[list[Expression], list[Expression]]:
    """Solve with a symmetric positive definite matrix by L D L^T, without roots.

    Returns the unknowns and the pivots D, all positive if and only if the matrix is.
    """
    size = len(right)
    if size == PAIR:
        return _solve_two(graph, matrix, right, hints, section)
    scaled: list[list[Expression]] = [[graph.of(0)] * size for _ in range(size)]
    lower: list[list[Expression]] = [[graph.of(0)] * size for _ in range(size)]
    pivots: list[Expression] = []
    inverse: list[Expression] = []
    forward: list[Expression] = []
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
    unknowns: list[Expression] = [graph.of(0)] * size
    for i in reversed(range(size)):
        rest = _minus(
            forward[i] * inverse[i], [(lower[k][i], unknowns[k]) for k in range(i + 1, size)]
        )
        unknowns[i] = graph.define(hints[i], rest, section)
    return unknowns, pivots


def _solve_two(
    graph: Definitions, matrix: Matrix, right: Vector, hints: Sequence[str], section: str
) -> tuple[list[Expression], list[Expression]]:
    """Solve a symmetric 2 x 2 system with one division; the pivots' signs are those of minors."""
    (a, b), (_, d) = matrix
    pivot = a
    determinant = graph.define("det", a * d - b**2, section)
    scale = graph.define("inv_det", 1 / determinant, section)
    x, y = right
    if graph.level(scale) <= Level.RUN:  # the inverse is known before
        a, b, d = a * scale, b * scale, d * scale
        scale = graph.of(1)
    first = graph.define(hints[0], (d * x - b * y) * scale, section)
    second = graph.define(hints[1], (a * y - b * x) * scale, section)
    return [first, second], [pivot, determinant]


def _minus(value: Expression, products: Sequence[tuple[Expression, Expression]]) -> Expression:
    return value.graph.total([value, *(-a * b for a, b in products)])
