"""Sparse nonlinear programs of optimal control, with exact first and second derivatives.

The transcription is direct (DMOC: Ober-Bloebaum, Junge, Marsden, ESAIM COCV 17 (2011), 322), with
any Galerkin scheme. Control points, momenta and inputs of all steps are the variables x. The
discrete Euler-Lagrange equations are equality constraints. All rows are linear in functions f of
single points of the path, and the arguments of f are linear in x:

    rows = C f(L x) + D x,   Jacobian = C f' L + D,   Hessian = L^T (C^T lambda . f'') L.

Each derivative is a product of constant sparse matrices and the derivatives of f, which are
evaluated at all points at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from symsimpson.graph.point_functions import PointFunctions
from symsimpson.support.array_types import Floats, Ints


def lagrange(places: Floats, at: Floats) -> Floats:
    """Return the Lagrange polynomials of ``places`` at the points ``at``; the last axis is new."""
    values = [np.prod([(at - y) / (x - y) for y in places if y != x], axis=0) for x in places]
    return np.stack([value + 0 * at for value in values], axis=-1)


def lagrange_slopes(places: Floats, at: Floats) -> Floats:
    """Return the derivatives of the Lagrange polynomials; the last axis is new."""
    slopes = []
    for x in places:
        others = places[places != x]
        parts = [
            np.prod([(at - z) / (x - z) for z in others if z != y], axis=0) / (x - y)
            for y in others
        ]
        slopes.append(sum(parts, 0.0 * at))
    return np.stack(slopes, axis=-1)


@dataclass(frozen=True, eq=False)
class FunctionBlock:
    """The same functions at many points, with their variables and rows in the program."""

    functions: PointFunctions
    #: A sparse matrix for each variable of a point, shape (K, x). It maps the variables of the
    #: program to the K points.
    maps: list[Any]
    #: A sparse matrix for each function, shape (g, K): its coefficients in each row. Row 0 is the
    #: cost.
    rows: list[Any]
    #: Other arguments of the functions by node: numbers, or arrays of shape (K,).
    given: dict[int, Any]

    @property
    def count(self) -> int:
        """Number of points, K."""
        return int(self.maps[0].shape[0])

    @cached_property
    def _stacked(self) -> tuple[Any, Any, Any]:
        """All maps stacked vertically; all rows stacked horizontally, and their transpose."""
        rows = sparse.hstack(self.rows, format="csr")
        return sparse.vstack(self.maps, format="csr"), rows, rows.T.tocsr()

    def point_variables(self, x: Floats) -> dict[int, Any]:
        """Return the arguments of the functions at the points, by node."""
        values = (self._stacked[0] @ x).reshape(-1, self.count)
        return {**self.given, **dict(zip(self.functions.variables, values, strict=True))}

    def weights(self, rows: Floats) -> Floats:
        """Return the weights of the functions at each point for weights of the rows."""
        return np.asarray(self._stacked[2] @ rows).reshape(-1, self.count)

    def values(self, at: dict[int, Any]) -> Floats:
        """Return the contribution of the block to each row."""
        return np.asarray(self._stacked[1] @ self.functions.values(at, self.count).ravel())

    def slopes(self, at: dict[int, Any]) -> Floats:
        """Return the first derivatives at all points, in one row."""
        return self.functions.slopes_at(at, self.count).ravel()

    def gradient(self, x: Floats, rows: Floats) -> Floats:
        """Return derivatives of the weighted rows by each variable at each point."""
        weights = self.weights(rows)
        slopes = self.slopes(self.point_variables(x)).reshape(-1, self.count)
        gradient = np.zeros((len(self.maps), self.count))
        for (r, c), slope in zip(self.functions.slopes, slopes, strict=True):
            gradient[c] += weights[r] * slope
        return gradient

    def curvatures(self, at: dict[int, Any], rows: Floats) -> Floats:
        """Return second derivatives of the weighted rows at all points, in one row."""
        return self.functions.curvatures_at(at, self.weights(rows), self.count).ravel()

    def jacobian_entries(self) -> tuple[Ints, Ints, Ints, Floats]:
        """Return the number, row, column and coefficient of each term of the Jacobian."""
        pairs = [(self.rows[r].tocsc(), self.maps[c].tocsr()) for r, c in self.functions.slopes]
        return _multiply_patterns(pairs, self.count)

    def hessian_entries(self) -> tuple[Ints, Ints, Ints, Floats]:
        """Return the number, row, column and coefficient of each term of the whole Hessian."""
        pairs = [(self.maps[i].T.tocsc(), self.maps[j].tocsr()) for i, j in self.functions.curved]
        number, row, column, part = _multiply_patterns(pairs, self.count)
        same = np.array([i == j for i, j in self.functions.curved], dtype=bool)
        other = ~same[number // self.count]
        return (
            np.concatenate([number, number[other]]),
            np.concatenate([row, column[other]]),
            np.concatenate([column, row[other]]),
            np.concatenate([part, part[other]]),
        )


def _multiply_patterns(
    pairs: Sequence[tuple[Any, Any]], count: int
) -> tuple[Ints, Ints, Ints, Floats]:
    """Return coefficients a[r, k] b[k, c] of z[k] in entries (r, c) of a.diag(z).b for pairs."""
    entries: list[tuple[Any, ...]] = [(np.zeros(0, int),) * 3 + (np.zeros(0),)]
    for place, (a, b) in enumerate(pairs):
        size_a, size_b = np.diff(a.indptr), np.diff(b.indptr)
        sizes = size_a * size_b
        k = np.repeat(np.arange(count), sizes)
        within = np.arange(sizes.sum()) - np.repeat(sizes.cumsum() - sizes, sizes)
        in_a = a.indptr[k] + within // np.maximum(size_b[k], 1)
        in_b = b.indptr[k] + within % np.maximum(size_b[k], 1)
        entries.append(
            (place * count + k, a.indices[in_a], b.indices[in_b], a.data[in_a] * b.data[in_b])
        )
    number, row, column, part = (np.concatenate(x) for x in zip(*entries, strict=True))
    return number, row, column, part


class _SparsePattern:
    """A sparse matrix with entries that are linear in numbers; the pattern is constant."""

    def __init__(
        self, places: Sequence[tuple[Any, ...]], shape: tuple[int, int], constant: Any = None
    ) -> None:
        offset, numbers = 0, []
        for number, *_, size in places:
            numbers.append(number + offset)
            offset += size
        row, column, part = (np.concatenate([place[k] for place in places]) for k in (1, 2, 3))
        more = sparse.coo_matrix(shape if constant is None else constant)
        of_entries = np.concatenate([column, more.col]).astype(np.int64) * shape[0]
        of_entries += np.concatenate([row, more.row])
        keys, inverse = np.unique(of_entries, return_inverse=True)
        self.column, self.row = keys // shape[0], keys % shape[0]
        count = len(row)
        self._linear = sparse.csr_matrix(
            (part, (inverse[:count], np.concatenate(numbers))), shape=(len(keys), offset)
        )
        self._constant = np.bincount(inverse[count:], more.data, minlength=len(keys))

    def __call__(self, numbers: Sequence[Floats]) -> Floats:
        """Return the entries in column-major order."""
        return np.asarray(self._linear @ np.concatenate(numbers) + self._constant)


class NonlinearProgram:
    """A sparse nonlinear program: minimise the cost, with bounds on rows and variables.

    It is the sum of nonlinear blocks and of the sparse matrix ``linear``, D. Row 0 is the cost.
    """

    def __init__(self, blocks: Sequence[FunctionBlock], linear: Any) -> None:
        self.blocks, self._linear = tuple(blocks), linear.tocsr()
        g, x = linear.shape
        slopes = [
            (*block.jacobian_entries(), len(block.functions.slopes) * block.count)
            for block in self.blocks
        ]
        self._jacobian = _SparsePattern(slopes, (g, x), linear)
        self._in_rows = self._jacobian.row > 0
        #: Rows and columns of the entries of the Jacobian.
        self.jacobian_places: tuple[Ints, Ints] = (
            self._jacobian.row[self._in_rows] - 1,
            self._jacobian.column[self._in_rows],
        )
        curved = []
        for block in self.blocks:
            number, row, column, part = block.hessian_entries()
            upper = row <= column
            size = len(block.functions.curved) * block.count
            curved.append((number[upper], row[upper], column[upper], part[upper], size))
        self._hessian = _SparsePattern(curved, (x, x))
        #: Rows and columns of the entries of the Hessian, on and above the diagonal.
        self.hessian_places: tuple[Ints, Ints] = (self._hessian.row, self._hessian.column)
        self.shape: tuple[int, int] = (g - 1, x)
        #: The last variables, their points, and the results that were computed there.
        self._x: Floats | None = None
        self._points: list[dict[int, Any]] = []
        self._values: tuple[float, Floats] | None = None
        self._slopes: tuple[Floats, Floats] | None = None

    def values(self, x: Floats) -> tuple[float, Floats]:
        """Return the cost and the rows."""
        points = self._evaluate_points(x)
        if self._values is None:
            rows = self._linear @ x
            for block, at in zip(self.blocks, points, strict=True):
                rows += block.values(at)
            self._values = float(rows[0]), rows[1:]
        return self._values

    def slopes(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the gradient of the cost, and the entries of the Jacobian."""
        points = zip(self.blocks, self._evaluate_points(x), strict=True)
        if self._slopes is None:
            entries = self._jacobian([block.slopes(at) for block, at in points])
            gradient = np.zeros(self.shape[1])
            cost_entries = ~self._in_rows
            gradient[self._jacobian.column[cost_entries]] = entries[cost_entries]
            self._slopes = gradient, entries[self._in_rows]
        return self._slopes

    def curvatures(self, x: Floats, cost: float, multipliers: Floats) -> Floats:
        """Return entries of the Hessian of cost times the cost, and multipliers times the rows."""
        weights = np.concatenate([[cost], multipliers])
        points = zip(self.blocks, self._evaluate_points(x), strict=True)
        return self._hessian([block.curvatures(at, weights) for block, at in points])

    def _evaluate_points(self, x: Floats) -> list[dict[int, Any]]:
        """Return the arguments at all points; the last ones are cached."""
        if self._x is None or not np.array_equal(self._x, x):
            self._x, self._points = x.copy(), [block.point_variables(x) for block in self.blocks]
            self._values = self._slopes = None
        return self._points
