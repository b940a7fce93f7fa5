"""Impacts within a step that follow each other ever faster: infinitely many in a finite time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

__all__ = ["Times", "accumulation"]

#: When impacts that lose energy have acted within a step, by their numbers.
Times = dict[int, list[float]]
#: Impacts whose times add up to less than this part of a step from the last one on accumulate; from
#: one to the next they have one ratio then, but for that part of it.
ACCUMULATED, STEADY = 1e-6, 0.1


def accumulation(times: Mapping[int, Sequence[float]], h: float) -> tuple[int, float] | None:
    """Return the impact that accumulates within a step of length h, and up to when; or None.

    The times between its hits form an infinite geometric series.
    """
    for k, hits in times.items():
        if len(hits) >= 4:
            first, late, later = np.diff(hits[-4:]).tolist()
            before, ratio = (late / first, later / late) if first and late else (1.0, 1.0)
            left = ratio / (1 - ratio) * later if 0 <= ratio < 1 else np.inf
            if abs(ratio - before) <= STEADY * abs(before) and abs(left) < ACCUMULATED * h:
                return k, float(hits[-1] + left)
    return None
