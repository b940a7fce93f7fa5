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
    """Return the impact that accumulates within a step of length h, and up to when; or None."""
    limits = ((k, _limit(hits, h)) for k, hits in times.items())
    return next(((k, about) for k, about in limits if about is not None), None)


def _limit(times: Sequence[float], h: float) -> float | None:
    """Return when impacts within a step of length h end that follow each other ever faster.

    Infinitely many: their times are those of a geometric series. None if they do not accumulate.
    """
    if len(times) < 4:
        return None
    first, late, later = np.diff(times[-4:]).tolist()
    before, ratio = (late / first, later / late) if first and late else (1.0, 1.0)
    left = ratio / (1 - ratio) * later if 0 <= ratio < 1 else np.inf
    steady = abs(ratio - before) <= STEADY * abs(before)
    return float(times[-1] + left) if steady and abs(left) < ACCUMULATED * h else None
