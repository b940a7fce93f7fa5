"""States to draw a curve through: stored states, both sides of events, and states between."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from symsimpson.errors import ConvergenceError, InputError
from symsimpson.support.array_types import Floats

__all__ = ["Curve", "curve_of"]

#: Chords that miss the motion by more than FINE of the range are divided, and by more than ROUGH
#: are not drawn.
FINE, ROUGH = 0.002, 0.02
#: The part of an interval at which its chord is checked, and how many intervals are.
PART, CHECKED = 0.381966, 200
#: States between take at most so many steps, divided by the number of coordinates; steps of
#: numbers with many digits count as many.
STEPS, DIGITS = 100_000, 1000
#: Ranges below this part of the values are rounding; below this part of other ranges, noise.
ROUNDING, NOISE = 1e-6, 1e-12

Read = Callable[[Any], list[Any]]


class Curve(NamedTuple):
    """States along a curve, those that are stored or of events, and whether lines join them."""

    states: Any
    knots: Any
    connected: bool


def curve_of(some: Any, read: Read, connected: bool = True) -> Curve:
    """Return states such that straight lines between them follow what ``read`` gives of states.

    Runs take steps again for states between theirs. If that takes too many steps, or only states
    are known, and lines would mislead, the curve is not connected.
    """
    if not connected or not hasattr(some, "q"):  # saved quantities
        return Curve(some, some, connected)
    knots = curve = _with_events(some)
    t, parts = _times(knots), 1
    while (miss := _chords_miss(curve, read, some)) > FINE:
        parts *= 2
        inner = t[:-1, None] + np.diff(t)[:, None] * np.arange(1, parts) / parts
        more = _between(some, inner[np.diff(t) != 0].ravel())
        if more is None:
            break
        curve = _merged(knots, more.t, more.q, more.p)
    joined = miss <= ROUGH and len(t) > 1
    return Curve(curve if joined else knots, knots, joined)


def _chords_miss(curve: Any, read: Read, some: Any) -> float:
    """Return how far chords between states miss the motion of a run, as a part of its range."""
    t = _times(curve)
    first = np.flatnonzero(np.diff(t))
    if not first.size:
        return 0.0
    uneven = np.linspace(0, 1, CHECKED) ** 1.1  # no period hides between these intervals
    first = first[np.unique((uneven * (first.size - 1)).astype(np.int64))]
    a, b, span = curve[first], curve[first + 1], t[first + 1] - t[first]
    there = t[first] + PART * span
    inner = _between(some, there)
    if inner is None:  # Hermite's polynomial
        rise, span = b.q - a.q, span[:, None]
        bend = (1 - PART) * (span * a.v - rise) - PART * (span * b.v - rise)
        q = a.q + PART * rise + PART * (1 - PART) * bend
        inner = a.with_states(there, q, a.p + PART * (b.p - a.p))
    misses, sizes = [], []
    for columns in zip(*map(read, (curve, a, b, inner)), strict=True):
        y, u, v, w = (np.nan_to_num(np.asarray(x, float), posinf=0, neginf=0) for x in columns)
        misses.append(np.abs(u + PART * (v - u) - w).max(initial=0.0))
        y = np.concatenate([y, w])
        rounding = ROUNDING * np.abs(y).max(initial=0.0)
        sizes.append(np.ptp(y, axis=0).max(initial=rounding))
    ranges = np.maximum(sizes, NOISE * max(sizes, default=0.0))
    return float((misses / np.where(ranges > 0, ranges, 1.0)).max(initial=0.0))


def _between(some: Any, t: Floats) -> Any:
    """Return states of a run at times; None if it has none, or they take too many steps."""
    costly = some.program.n * (DIGITS if hasattr(some.program.numbers, "digits") else 1)
    try:
        dense = getattr(some, "sol", None)
        if dense is not None and dense.cost(t) * costly <= STEPS:
            return some.at(t)
    except (InputError, ConvergenceError):
        pass
    return None


def _with_events(some: Any) -> Any:
    """Return states and, between them, those before and after each event."""
    t, records = _times(some), getattr(some, "records", ())
    records = [x for x in records if t.min(initial=np.inf) <= x.t <= t.max(initial=-np.inf)]
    if not records:
        return some
    q = np.array([q for x in records for q in (x.q, x.q_after)])
    p = np.array([p for x in records for p in (x.p, x.p_after)])
    return _merged(some, np.repeat([float(x.t) for x in records], 2), q, p)


def _merged(some: Any, *more: Any) -> Any:
    """Return states with more of them, t, q and p, which replace those at the same times."""
    t, new = _times(some), np.asarray(more[0], dtype=np.float64)
    rest = ~np.isin(t, new)
    order = np.argsort(np.concatenate([t[rest], new]) * (1 if t[-1] >= t[0] else -1), kind="stable")
    pairs = zip((t, some.q, some.p), (new, *more[1:]), strict=True)
    return some.with_states(*(np.concatenate([x[rest], y])[order] for x, y in pairs))


def _times(some: Any) -> Floats:
    return np.asarray(some.t, dtype=np.float64)
