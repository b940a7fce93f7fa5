"""Linear point symmetries, and the momenta that they conserve.

If L does not change under q -> q + eps (A q + b), the momentum p (A q + b) is conserved (Noether).
Every scheme of the Galerkin family conserves it, too: the symmetry acts on the control points as on
q (Marsden and West 2001, section 1.3.3). A cyclic coordinate is the case A = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.study.analysis.discrete_flow import DiscreteFlow
from symsimpson.support.array_types import Floats, Reals

#: Relative singular values below this are zeros; the matrix has 16 digits.
RANK = 1e-12
#: Distance from q, relative to q, of the points on constraints.
NEARBY = 1e-4
#: An entry of a null vector is a pivot if it is at least this part of the largest entry.
PIVOT = 1e-6
#: An entry closer than this to a multiple of 1/12 is that number.
ROUND = 1e-9
#: Largest relative residual of a symmetry in many digits, and largest value of a zero column.
EXACT, ZERO = 1e-27, 1e-40
#: Largest number of points to try, relative to the number of points that are needed.
MAX_POINTS = 20
#: With more coordinates than this, only symmetries with equal diagonal blocks in A are found. The
#: number of gradients of H that a general A needs grows like n**2. The blocks have these sizes.
MANY, BLOCKS = 12, (3, 2)
#: Largest number of terms in a name.
MAX_TERMS = 12


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The generator q -> A q + b of a symmetry."""

    A: Floats  #: Shape (n, n).
    b: Floats  #: Shape (n,).
    exact: Reals  #: [A, b] in many digits, shape (n, n + 1).
    name: str  #: The momentum as an expression, for example "p_x*y - p_y*x".

    def momentum(self, q: ArrayLike, p: ArrayLike) -> Reals:
        """Return p (A q + b), shape (...), for states of shape (..., n), in their precision."""
        q, p = np.asarray(q), np.asarray(p)
        A, b = (self.A, self.b) if q.dtype != object else (self.exact[:, :-1], self.exact[:, -1])
        terms: Reals = p * (q @ A.T + b)
        return terms.sum(axis=-1)

    def size(self, q: ArrayLike, p: ArrayLike) -> float:
        """Return the largest sum of the absolute values of the terms, over all states."""
        q, p = (np.abs(np.asarray(x, dtype=np.float64)) for x in (q, p))
        return float((p * (q @ np.abs(self.A).T + np.abs(self.b))).sum(axis=-1).max())


def block_size(n: int) -> int:
    """Return the size d of the equal diagonal blocks of A.

    With few coordinates d = n, so that A is any matrix. With many coordinates, d is 3 for points in
    space or 2 for points in a plane, and A rotates all points. If neither
    divides n, d is 0, and A = 0.
    """
    return n if n <= MANY else next((d for d in BLOCKS if n % d == 0), 0)


def linear_symmetries(flow: DiscreteFlow, z: Reals) -> list[Symmetry]:
    """Find the linear point symmetries of a system near the state z.

    G = p (A q + b) is conserved if its Poisson bracket with H vanishes. At each point this is a
    linear equation for A and b. A few more points than unknowns determine the null space. Double
    precision gives its dimension, and the generators are then solved for in many digits. With many
    coordinates A is restricted as in :func:`block_size`, while b is general.
    """
    n = flow.n
    d = block_size(n)
    count = n + d * d + 4
    middle = np.array([float(x) for x in z])
    # b is added to A q, so that its unit is the smallest size of a coordinate
    unit = float(min(flow.sizes[:n]))
    # the size of a coordinate that is zero at z is its size along the motion
    size = 0.2 * (flow.sizes.astype(np.float64) + np.abs(middle))
    light = flow.sizes[n:].astype(np.float64)
    size[n:] = 0.2 * np.minimum(np.abs(middle[n:]).max() or light.max(), light)
    random = np.random.default_rng(1)
    rows: list[Reals] = []
    for _ in range(MAX_POINTS * count):
        if len(rows) == count:
            break
        point = middle + size * random.uniform(-1, 1, 2 * n)
        gradient = flow.gradient(point)
        if not np.isfinite(gradient.astype(np.float64)).all():  # H is singular at this point
            continue
        q, p, H_q, H_p = point[:n], point[n:], gradient[:n], gradient[n:]
        bracket = _contract_blocks(H_q, q, d) - _contract_blocks(p, H_p, d)
        rows.append(np.concatenate([H_q * unit, bracket.ravel()]))
    rows += _constraint_rows(flow, middle, random, unit, d)
    # energies and constraints may have different units
    exact = np.array([row / (np.abs(row).max() or 1) for row in rows])
    matrix = exact.astype(np.float64)
    scale = _scale_columns(matrix, unit, flow.sizes[:n].astype(np.float64), d)
    _, singular, basis = np.linalg.svd(matrix / scale)
    null = basis[np.count_nonzero(singular > RANK * singular[0]) :]
    names = flow.stepper.coordinates
    symmetries = []
    for row in _reduce_basis(null, scale):
        full = _refine_row(row, exact, flow.context)
        row = _round_entries(full.astype(np.float64), scale)  # without the round-off of the SVD
        if row[n:].any():  # else A = 0, and the length of b is arbitrary
            row[:n], full[:n] = row[:n] * unit, full[:n] * unit
        A, exact_A = (_block_diagonal(x[n:], n, d) for x in (row, full))
        generator = np.column_stack([exact_A, full[:n]])
        symmetries.append(Symmetry(A, row[:n], generator, _name_momentum(A, row[:n], names)))
    return symmetries


def _scale_columns(matrix: Floats, unit: float, sizes: Floats, d: int) -> Floats:
    """Return the sizes of the columns; zero columns have the size of the largest column.

    Sizes are compared in units of H_q and q, the factors of b and A. Coordinates may have different
    units, such as metres and radians.
    """
    block_sizes = sizes.reshape(-1, d).max(axis=0) if d else sizes[:0]
    units = np.concatenate([unit / sizes, np.outer(1 / block_sizes, block_sizes).ravel()])
    largest = np.abs(matrix).max(axis=0)
    scale = largest / units
    return np.where(largest < ZERO, scale.max(), scale) * units


def _contract_blocks(left: Reals, right: Reals, d: int) -> Reals:
    """Return the derivative of left.A.right by the entries of the blocks of A, shape (d, d)."""
    if not d:
        return np.zeros((0, 0), dtype=left.dtype)
    return left.reshape(-1, d).T @ right.reshape(-1, d)


def _block_diagonal(entries: Reals, n: int, d: int) -> Reals:
    """Return the matrix with equal diagonal blocks, shape (n, n)."""
    A = np.zeros((n, n), dtype=entries.dtype) + 0 * entries.sum()
    for first in range(0, n, d) if d else ():
        A[first : first + d, first : first + d] = entries.reshape(d, d)
    return A


def _constraint_rows(
    flow: DiscreteFlow, z: Floats, random: np.random.Generator, unit: float, d: int
) -> list[Reals]:
    """Return the equations Phi (A q + b) = 0 at points on the constraints near z."""
    n, m = flow.n, len(flow.stepper.program.header.constraints)
    rows = []
    for _ in range((n + d * d) // m + 4 if m else 0):
        point = z + NEARBY * (unit + np.abs(z)) * random.uniform(-1, 1, 2 * n)
        q = flow.project(point)[:n]
        rows += [
            np.concatenate([slope * unit, _contract_blocks(slope, q, d).ravel()])
            for slope in flow.constraint_jacobian(q)
        ]
    return rows


def _refine_row(row: Floats, matrix: Reals, context: Any) -> Reals:
    """Solve in many digits for the entries of a null vector that are not multiples of 1/12.

    A ratio of parameters may be close to a multiple of 1/12. If the result is not a null vector,
    all nonzero entries except for the largest one are solved for. Raises ArithmeticError if they
    are not determined.
    """
    twelfths = [(x, round(12 * x)) for x in row]
    fractions = [context.mpf(k) / 12 if x == k / 12 else None for x, k in twelfths]
    full = np.array(fractions, dtype=object)
    full = _solve_entries(full, np.array([x is None for x in full]), matrix, context)
    if _relative_residual(full, matrix) > EXACT:
        unknown = row != 0
        unknown[np.abs(row).argmax()] = False
        full = _solve_entries(full, unknown, matrix, context)
        if _relative_residual(full, matrix) > EXACT:
            raise ArithmeticError(
                "a linear symmetry is not determined: it does not hold in many digits"
            )
    return full


def _solve_entries(row: Reals, unknown: NDArray[np.bool_], matrix: Reals, context: Any) -> Reals:
    """Solve for the unknown entries of a null vector, in the least-squares sense."""
    full = np.where(unknown, context.zero, row)
    if unknown.any():
        try:
            solution, _ = context.qr_solve(matrix[:, unknown].tolist(), (-(matrix @ full)).tolist())
        except ValueError as error:
            raise ArithmeticError(f"a linear symmetry is not determined: {error}") from None
        full[unknown] = list(solution)
    return full


def _relative_residual(row: Reals, matrix: Reals) -> float:
    """Return the largest entry of matrix @ row, relative to its largest term."""
    terms = matrix * row
    return float(abs(terms.sum(axis=1)).max() / (abs(terms).max() or 1))


def _reduce_basis(rows: Floats, scale: Floats) -> Floats:
    """Bring an orthonormal basis into reduced echelon form, and divide by the column scales.

    A small entry of a row may be a round-off error, and is never a pivot. Entries close to a
    multiple of 1/12 are rounded to it.
    """
    rows, pivots = rows.copy(), list[int]()
    for column in range(rows.shape[1]):
        done = len(pivots)
        if done == len(rows):
            break
        pivot = done + int(np.abs(rows[done:, column]).argmax())
        if abs(rows[pivot, column]) < PIVOT * np.abs(rows[pivot]).max():
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] / rows[done, column] * rows[done]
        pivots.append(column)
    rows = rows / scale
    return _round_entries(rows / rows[np.arange(len(pivots)), pivots][:, None], scale)


def _round_entries(rows: Floats, scale: Floats) -> Floats:
    """Round entries that are close to a multiple of 1/12, and set small ones to 0.

    An entry is small relative to the largest entry of its row, in units of the column scales.
    """
    sizes = np.abs(rows) * scale
    twelfths = np.round(rows * 12) / 12
    close = (twelfths != 0) & (np.abs(rows - twelfths) < ROUND)
    small = sizes < ROUND * sizes.max(axis=-1, keepdims=True)
    return np.where(small, 0.0, np.where(close, twelfths, rows))


def _name_momentum(A: Floats, b: Floats, names: Sequence[str]) -> str:
    """Write p (A q + b) as text, with at most ``MAX_TERMS`` terms."""
    terms = [(b[i], f"p_{x}") for i, x in enumerate(names) if b[i]]
    terms += [(A[i, j], f"p_{names[i]}*{names[j]}") for i, j in np.argwhere(A)]
    text = ""
    for factor, term in terms[:MAX_TERMS]:
        coefficient = "" if abs(factor) == 1 else f"{abs(factor):.4g}*"
        text += (" - " if factor < 0 else " + ") + coefficient + term
    text += f" + ... ({len(terms)} terms)" if len(terms) > MAX_TERMS else ""
    return text.removeprefix(" + ").replace(" - ", "-", 1) if text[:3] == " - " else text[3:]
