"""Linear point symmetries, and the momenta that they conserve.

If L does not change under q -> q + eps (A q + b), the momentum p (A q + b) is conserved (Noether),
and by every scheme of the Galerkin family too: the symmetry acts on the control points as on q
(Marsden and West 2001, section 1.3.3). Cyclic coordinates are the case A = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.study.analysis.precise import Precise
from symsimpson.support.array_types import Floats, Reals

#: Relative singular values below this are zeros; the matrix has 16 digits.
RANK = 1e-12
#: Points on constraints are looked for so near, relative to q.
NEARBY = 1e-4
#: An entry of a null vector is a pivot if it is no smaller than this part of the largest.
PIVOT = 1e-6
#: Entries closer to a number of few digits than this are that number, in a name.
ROUND = 1e-9
#: What is left of the terms of a symmetry that is one, in many digits, and of what is zero.
EXACT, NOTHING = 1e-27, 1e-40
#: So many times as many points are tried as are needed.
MOST = 20
#: With more coordinates than this, not all linear maps are looked for: their number is squared, and
#: as many gradients of H are needed. These have blocks of so many coordinates, all alike.
MANY, BLOCKS = 12, (3, 2)
#: A name has no more terms than this.
SHOWN = 12


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The generator q -> A q + b of a symmetry."""

    A: Floats  #: shape (n, n)
    b: Floats  #: shape (n,)
    exact: Reals  #: A and b side by side, shape (n, n + 1).
    name: str  #: The momentum, written out.

    def momentum(self, q: ArrayLike, p: ArrayLike) -> Reals:
        """Return p (A q + b) for states of shape (..., n), in the digits that these have."""
        q, p = np.asarray(q), np.asarray(p)
        A, b = (self.A, self.b) if q.dtype != object else (self.exact[:, :-1], self.exact[:, -1])
        terms: Reals = p * (q @ A.T + b)
        return terms.sum(axis=-1)

    def size(self, q: ArrayLike, p: ArrayLike) -> float:
        """Return the largest sum of the moduli of the terms."""
        q, p = (np.abs(np.asarray(x, dtype=np.float64)) for x in (q, p))
        return float((p * (q @ np.abs(self.A).T + np.abs(self.b))).sum(axis=-1).max())


def block_size(n: int) -> int:
    """Return d, where A consists of equal blocks of d by d on its diagonal.

    It is n, any A, of few coordinates; of many that of points in space or in the plane, whose
    coordinates follow one another: then A turns all of them. It is 0 where neither divides n.
    """
    return n if n <= MANY else next((d for d in BLOCKS if n % d == 0), 0)


def linear_symmetries(precise: Precise, z: Reals) -> list[Symmetry]:
    """Find the linear point symmetries of a system around a state.

    G = p (A q + b) is conserved if its Poisson bracket with H vanishes, a linear equation for A
    and b at each point; as many points as there are unknowns, and some more, decide. Which
    symmetries there are is found in double precision, their generators then have many digits. Of
    systems of many coordinates all displacements b are looked for, and A as in :func:`block_size`.
    """
    n = precise.n
    d = block_size(n)
    count = n + d * d + 4
    middle = np.array([float(x) for x in z])
    # b stands beside A q: in a unit in which no q is much smaller than 1
    unit = float(min(precise.sizes[:n]))
    # a coordinate that is zero here has the size that it has on the way
    size = 0.2 * (precise.sizes.astype(np.float64) + np.abs(middle))
    light = precise.sizes[n:].astype(np.float64)
    size[n:] = 0.2 * np.minimum(np.abs(middle[n:]).max() or light.max(), light)
    random = np.random.default_rng(1)
    rows: list[Reals] = []
    for _ in range(MOST * count):
        if len(rows) == count:
            break
        point = middle + size * random.uniform(-1, 1, 2 * n)
        gradient = precise.gradient(point)
        if not np.isfinite(gradient.astype(np.float64)).all():  # H has no value around there
            continue
        q, p, H_q, H_p = point[:n], point[n:], gradient[:n], gradient[n:]
        turning = _by_block(H_q, q, d) - _by_block(p, H_p, d)
        rows.append(np.concatenate([H_q * unit, turning.ravel()]))
    rows += _of_constraints(precise, middle, random, unit, d)
    # energies and constraints have units of their own
    exact = np.array([row / (np.abs(row).max() or 1) for row in rows])
    matrix = exact.astype(np.float64)
    scale = _sizes_of_columns(matrix, unit, precise.sizes[:n].astype(np.float64), d)
    _, singular, basis = np.linalg.svd(matrix / scale)
    null = basis[np.count_nonzero(singular > RANK * singular[0]) :]
    names = precise.stepper.coordinates
    symmetries = []
    for row in _reduced(null, scale):
        full = _refined(row, exact, precise.context)
        row = _rounded(full.astype(np.float64), scale)  # many digits tell what rounding has hidden
        if row[n:].any():  # else it is a displacement, of any length
            row[:n], full[:n] = row[:n] * unit, full[:n] * unit
        A, exact_A = (_blocks(x[n:], n, d) for x in (row, full))
        generator = np.column_stack([exact_A, full[:n]])
        symmetries.append(Symmetry(A, row[:n], generator, _name(A, row[:n], names)))
    return symmetries


def _sizes_of_columns(matrix: Floats, unit: float, sizes: Floats, d: int) -> Floats:
    """Return the sizes of columns; of those that are nothing but rounding, what they might have.

    Coordinates may have units of their own, as metres and radians: what b and A multiply, H_q and
    q, is judged in these.
    """
    each = sizes.reshape(-1, d).max(axis=0) if d else sizes[:0]
    units = np.concatenate([unit / sizes, np.outer(1 / each, each).ravel()])
    largest = np.abs(matrix).max(axis=0)
    scale = largest / units
    return np.where(largest < NOTHING, scale.max(), scale) * units


def _by_block(left: Reals, right: Reals, d: int) -> Reals:
    """Return left.E.right for each A that has a 1 in the same place of all its blocks, (d, d)."""
    if not d:
        return np.zeros((0, 0), dtype=left.dtype)
    return left.reshape(-1, d).T @ right.reshape(-1, d)


def _blocks(entries: Reals, n: int, d: int) -> Reals:
    """Return the matrix with equal blocks on its diagonal, (n, n)."""
    A = np.zeros((n, n), dtype=entries.dtype) + 0 * entries.sum()
    for first in range(0, n, d) if d else ():
        A[first : first + d, first : first + d] = entries.reshape(d, d)
    return A


def _of_constraints(
    precise: Precise, z: Floats, random: np.random.Generator, unit: float, d: int
) -> list[Reals]:
    """Ask that a symmetry moves along the constraints: Phi (A q + b) = 0 where phi = 0."""
    n, held = precise.n, len(precise.stepper.program.header.constraints)
    rows = []
    for _ in range((n + d * d) // held + 4 if held else 0):
        point = z + NEARBY * (unit + np.abs(z)) * random.uniform(-1, 1, 2 * n)
        q = precise.placed(point)[:n]
        rows += [
            np.concatenate([slope * unit, _by_block(slope, q, d).ravel()])
            for slope in precise.slopes(q)
        ]
    return rows


def _refined(row: Floats, matrix: Reals, context: Any) -> Reals:
    """Solve for those entries of a null vector that are no round numbers, in many digits.

    A ratio of parameters may be near a round number: where these solve nothing, all are solved for
    that are not zero, but the largest. Raises ArithmeticError if they are not determined.
    """
    twelfths = [(x, round(12 * x)) for x in row]
    fractions = [context.mpf(k) / 12 if x == k / 12 else None for x, k in twelfths]
    full = np.array(fractions, dtype=object)
    full = _solved(full, np.array([x is None for x in full]), matrix, context)
    if _off(full, matrix) > EXACT:
        others = row != 0
        others[np.abs(row).argmax()] = False
        full = _solved(full, others, matrix, context)
        if _off(full, matrix) > EXACT:
            raise ArithmeticError("a linear symmetry is not determined: it is none in many digits")
    return full


def _solved(row: Reals, open_: NDArray[np.bool_], matrix: Reals, context: Any) -> Reals:
    """Solve for the open entries of a null vector, with the others as they are."""
    full = np.where(open_, context.zero, row)
    if open_.any():
        try:
            solution, _ = context.qr_solve(matrix[:, open_].tolist(), (-(matrix @ full)).tolist())
        except ValueError as error:
            raise ArithmeticError(f"a linear symmetry is not determined: {error}") from None
        full[open_] = list(solution)
    return full


def _off(row: Reals, matrix: Reals) -> float:
    """Return how far a row is from a null vector, relative to its terms."""
    terms = matrix * row
    return float(abs(terms.sum(axis=1)).max() / (abs(terms).max() or 1))


def _reduced(rows: Floats, scale: Floats) -> Floats:
    """Bring an orthonormal basis into reduced echelon form, divided by the scale of its columns.

    No pivot is a small entry of such a row, which is rounding, however the scales differ. What is
    round stays round.
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
    return _rounded(rows / rows[np.arange(len(pivots)), pivots][:, None], scale)


def _rounded(rows: Floats, scale: Floats) -> Floats:
    """Return halves, thirds and quarters where entries are as near to these as rounding.

    What is small in the sizes of its columns is 0.
    """
    sizes = np.abs(rows) * scale
    twelfths = np.round(rows * 12) / 12
    close = (twelfths != 0) & (np.abs(rows - twelfths) < ROUND)
    nothing = sizes < ROUND * sizes.max(axis=-1, keepdims=True)
    return np.where(nothing, 0.0, np.where(close, twelfths, rows))


def _name(A: Floats, b: Floats, names: Sequence[str]) -> str:
    """Write p (A q + b), of a long sum its first terms."""
    terms = [(b[i], f"p_{x}") for i, x in enumerate(names) if b[i]]
    terms += [(A[i, j], f"p_{names[i]}*{names[j]}") for i, j in np.argwhere(A)]
    text = ""
    for factor, term in terms[:SHOWN]:
        amount = "" if abs(factor) == 1 else f"{abs(factor):.4g}*"
        text += (" - " if factor < 0 else " + ") + amount + term
    text += f" + ... ({len(terms)} terms)" if len(terms) > SHOWN else ""
    return text.removeprefix(" + ").replace(" - ", "-", 1) if text[:3] == " - " else text[3:]
