"""Places between two others where a function of one number changes its sign."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

__all__ = ["ridders"]


def ridders(
    function: Callable[[float], float],
    low: float,
    high: float,
    ends: tuple[float, float],
    size: float,
) -> float:
    """Return a change of sign between two places, within a size; NaN where there is no value.

    C. Ridders, IEEE Transactions on Circuits and Systems 26 (1979) 979.
    """
    first, last = ends
    while abs(high - low) > size:
        middle = (low + high) / 2
        value = function(middle)
        root = math.sqrt(value * value - first * last) if math.isfinite(value) else math.nan
        if not math.isfinite(root):
            return math.nan
        if not value or middle in (low, high):
            return middle
        share = math.copysign(value / root, first * value) if root else 0.0
        x = middle + (middle - low) * share
        there = function(x)
        if not math.isfinite(there):
            return math.nan
        # the smallest bracket of what is known
        known = sorted(
            [(low, first), (middle, value), (x, there), (high, last)], reverse=high < low
        )
        ((low, first), (high, last)) = next(
            (a, b) for a, b in pairwise(known) if (a[1] > 0) != (b[1] > 0) or not b[1]
        )
        if not last:
            return high
    return (low + high) / 2
