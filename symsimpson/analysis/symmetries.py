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

from symsimpson.analysis.precise import Precise

__all__ = ["Symmetry", "linear_symmetries"]

#: Relative singular values below this are zeros; the matrix has 16 digits.
RANK = 1e-12
#: Entries closer to a number of few digits than this are that number, in a name.
ROUND = 1e-9


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The generator q -> A q + b of a symmetry.

    Attributes
    ----------
    A : ndarray, shape (n, n)
    b : ndarray, shape (n,)
    name : str
        The momentum, written out.
    """

    A: NDArray[np.float64]
    b: NDArray[np.float64]
    name: str

    def momentum(self, q: ArrayLike, p: ArrayLike) -> NDArray[Any]:
        """Give p (A q + b) for states of shape (..., n)."""
        terms: NDArray[Any] = np.asarray(p) * (np.asarray(q) @ self.A.T + self.b)
        return terms.sum(axis=-1)

    def size(self, q: ArrayLike, p: ArrayLike) -> float:
        """Give the largest sum of the moduli of the terms."""
        q, p = (np.abs(np.asarray(x, dtype=np.float64)) for x in (q, p))
        return float((p * (q @ np.abs(self.A).T + np.abs(self.b))).sum(axis=-1).max())


def linear_symmetries(precise: Precise, z: NDArray[Any]) -> list[Symmetry]:
    """Find the linear point symmetries of a system around a state.

    G = p (A q + b) is conserved if its Poisson bracket with H vanishes, a linear equation for A
    and b at each point; as many points as there are unknowns, and some more, decide.
    """
    n = precise.n
    middle = np.array([float(x) for x in z])
    size = 0.2 * (1 + np.abs(middle))
    size[n:] = 0.2 * (np.abs(middle[n:]).max() or 1.0)
    random = np.random.default_rng(1)
    rows = []
    for _ in range(n * n + n + 4):
        point = middle + size * random.uniform(-1, 1, 2 * n)
        gradient = precise.gradient(point).astype(np.float64)
        q, p, H_q, H_p = point[:n], point[n:], gradient[:n], gradient[n:]
        turning = np.outer(H_q, q) - np.outer(p, H_p)
        rows.append(np.concatenate([H_q, turning.ravel()]))
    matrix = np.array(rows)
    scale = np.abs(matrix).max(axis=0)
    scale[scale < RANK * scale.max()] = scale.max()
    _, singular, basis = np.linalg.svd(matrix / scale)
    null = basis[np.count_nonzero(singular > RANK * singular[0]) :] / scale
    names = precise.stepper.coordinates
    return [Symmetry(row[n:].reshape(n, n), row[:n], _name(row, names)) for row in _reduced(null)]


def _reduced(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bring a basis into reduced echelon form; what is round stays round."""
    rows = rows.copy()
    done = 0
    for column in range(rows.shape[1]):
        if done == len(rows):
            break
        pivot = done + int(np.abs(rows[done:, column]).argmax())
        if abs(rows[pivot, column]) < ROUND * np.abs(rows[pivot]).max():
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] * rows[done]
        done += 1
    rounded = np.round(rows * 12) / 12  # halves, thirds and quarters
    return np.where(np.abs(rows - rounded) < ROUND, rounded, rows)


def _name(row: NDArray[np.float64], names: Sequence[str]) -> str:
    n = len(names)
    terms = [(row[i], f"p_{a}") for i, a in enumerate(names)]
    terms += [
        (row[n + n * i + j], f"p_{a}*{b}")
        for i, a in enumerate(names)
        for j, b in enumerate(names)
    ]  # fmt: skip
    text = ""
    for factor, term in terms:
        if factor != 0:
            amount = "" if abs(factor) == 1 else f"{abs(factor):.4g}*"
            text += (" - " if factor < 0 else " + ") + amount + term
    return text.removeprefix(" + ").replace(" - ", "-", 1) if text[:3] == " - " else text[3:]
