"""Lengths that are natural to functions of positions, whatever the unit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from symsimpson.support.array_types import Reals

#: Displacements that are tried, and the part of itself by which a slope is to change.
TRIED, CHANGED = 10.0 ** np.arange(-24, 25), 1e-3


def bending_length(slopes: Callable[[Reals], Reals], q: Reals) -> Reals:
    """Estimate the length on which slopes change by as much as they are.

    It is the radius of a circle, 1 for functions of angles, and 0 where slopes are constant. So
    large are the terms of a function, in units of its slope, where it is zero as they cancel.
    Slopes are of shape (..., m, n) at positions of the shape of q, (..., n), and lengths of shape
    (..., m).
    """
    first = slopes(q).astype(np.float64)
    size = np.linalg.norm(first, axis=-1)
    lengths = np.zeros(size.shape)
    way = np.linspace(0.7, 1.3, q.shape[-1])  # along no axis
    for length in TRIED:
        with np.errstate(all="ignore"):
            change = np.linalg.norm(slopes(q + length * way).astype(np.float64) - first, axis=-1)
            part = change / size
        new = (lengths == 0) & (part > CHANGED) & np.isfinite(part)
        lengths[new] = length / part[new]
        if (lengths > 0).all():
            break
    return lengths
