"""Characteristic lengths of functions of positions, in any unit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from symsimpson.support.array_types import Reals

#: Trial displacements, and the relative change of a slope that a displacement must cause.
TRIED, CHANGED = 10.0 ** np.arange(-24, 25), 1e-3


def bending_length(slopes: Callable[[Reals], Reals], q: Reals) -> Reals:
    """Estimate the displacement that changes the slopes of functions by 100 %.

    The length is the radius for a circle, 1 for functions of angles, and 0 for constant slopes.
    If the terms of a function cancel to zero, their size is about this length times the slope.
    ``slopes`` maps positions of shape (..., n) to slopes of shape (..., m, n). ``q`` has shape
    (..., n). The result has shape (..., m).
    """
    first = slopes(q).astype(np.float64)
    size = np.linalg.norm(first, axis=-1)
    lengths = np.zeros(size.shape)
    direction = np.linspace(0.7, 1.3, q.shape[-1])  # parallel to no axis
    for length in TRIED:
        with np.errstate(all="ignore"):
            moved = slopes(q + length * direction).astype(np.float64)
            change = np.linalg.norm(moved - first, axis=-1) / size
        new = (lengths == 0) & (change > CHANGED) & np.isfinite(change)
        lengths[new] = length / change[new]
        if (lengths > 0).all():
            break
    return lengths
