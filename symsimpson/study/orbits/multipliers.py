"""Multipliers of an orbit from the derivative of its period map.

A symplectic map has multipliers in pairs l, 1/l. W = (D + D^-1)/2 has each stability index
k = (l + 1/l)/2 twice, and no Jordan block at 1. W is skew-Hamiltonian: Krylov spaces of W are
isotropic, so n vectors give a matrix with each index once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from symsimpson.study.orbits.flow import turned
from symsimpson.support.array_types import Floats

Complexes = NDArray[np.complex128]

#: A new Krylov vector shorter than this ends an invariant space.
BREAKDOWN = 1e-12


class Multipliers(NamedTuple):
    """Multipliers and stability indices, without the trivial ones."""

    multipliers: Complexes
    stability_indices: Complexes  #: (l + 1/l)/2 of pairs; empty unless the map is symplectic.
    trivial: float  #: Largest distance of a trivial index, or multiplier, from 1.


def symplectic_indices(D: Floats) -> Complexes:
    """Return the n stability indices of a symplectic matrix."""
    size = len(D)
    n = size // 2
    W = (D + turned(turned(D).T)) / 2  # D^-1 = J^T D^T J
    random = np.random.default_rng(1)
    Q, vector = np.zeros((size, n)), random.normal(size=size)
    for k in range(n):
        vector = _orthogonal(vector, Q[:, :k])
        Q[:, k] = vector / np.linalg.norm(vector)
        image = W @ Q[:, k]
        vector = _orthogonal(image, Q[:, : k + 1])
        if np.linalg.norm(vector) <= BREAKDOWN * np.linalg.norm(image):
            vector = random.normal(size=size)
    return np.linalg.eigvals(Q.T @ W @ Q).astype(np.complex128)


def _orthogonal(vector: Floats, Q: Floats) -> Floats:
    """Remove the components along the columns of Q and J Q, up to round-off."""
    both = np.concatenate([Q, turned(Q.T).T], axis=1)
    for _ in range(3):
        vector = vector - both @ (both.T @ vector)
    return vector


def multipliers_of(D: Floats, trivial: int, *, symplectic: bool, power: int) -> Multipliers:
    """Return the multipliers of D^power; the ``trivial`` ones nearest to 1 are left out."""
    if not np.isfinite(D).all():  # of a failed run
        return Multipliers(np.zeros(0, np.complex128), np.zeros(0, np.complex128), np.nan)
    values: Complexes = np.linalg.eigvals(D).astype(np.complex128)
    indices = symplectic_indices(D) if symplectic else values
    order = np.argsort(abs(indices - 1))
    off = float(abs(indices[order[:trivial]] - 1).max(initial=0.0))
    left = indices[order[trivial:]]
    if not symplectic:
        left = left[np.argsort(-abs(left))] ** power
        return Multipliers(left, left[:0], off)
    real = abs(left.imag) <= 1e-12 * np.maximum(1.0, abs(left))  # up to round-off
    left = np.where(real, left.real + 0j, left)[np.argsort(-abs(left))]
    root = np.sqrt(left**2 - 1 + 0j)
    large = np.where(abs(left + root) >= abs(left - root), left + root, left - root) ** power
    pairs = np.column_stack([large, 1 / large])
    return Multipliers(pairs.ravel(), pairs.mean(axis=1), off)
