"""States to draw a curve through: stored states, both sides of events, and states between."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from symsimpson.errors import ConvergenceError, InputError
from symsimpson.support.array_types import Floats, Ints

__all__ = [
    "FINE",
    "MOST",
    "ROUGH",
    "Curve",
    "at_once",
    "chords_miss",
    "curve_of",
    "envelope",
    "sample",
]

#: A curve has at most so many points; a screen has some thousand columns.
MOST = 8000
#: Chords that miss the motion by more than FINE of the range are divided, and by more than ROUGH
#: are not drawn.
FINE, ROUGH = 0.002, 0.02
#: The same over time, where so many states fill a band.
BAND = 0.2
#: The part of an interval at which its chord is checked, and how many intervals are.
PART, CHECKED = 0.381966, 200
#: States between take at most so many steps, divided by the number of coordinates; steps of
#: numbers with many digits count as many.
STEPS, DIGITS = 300_000, 1000
#: Ranges below this part of the values are rounding, as are intervals below this part of others.
ROUNDING, NOTHING = 1e-6, 1e-9
#: What is smaller than this part of others in a figure is noise, which no curve resolves.
NOISE = 1e-12

Read = Callable[[Any], list[Any]]


class Curve(NamedTuple):
    """States along a curve, those that are stored or of events, and whether lines join them."""

    states: Any
    knots: Any
    connected: bool


def curve_of(some: Any, read: Read, connected: bool = True, *, thin: bool = False) -> Curve:
    """Return states such that straight lines between them follow what ``read`` gives of states.

    Runs take steps again for states between theirs. If that takes too many steps, or only states
    are known, and lines would mislead, the curve is not connected. ``thin`` leaves out states of
    long runs.
    """
    if not connected or not hasattr(some, "q"):  # saved quantities
        return Curve(some, some, connected)
    if thin and len(some) > MOST:
        some = some[sample(len(some), MOST)]
    knots = curve = _with_events(some, MOST // 4 if thin else 20 * MOST)
    t, parts = _times(knots), 1
    rough = ROUGH if thin or len(t) < MOST / 4 else BAND
    while True:
        miss = chords_miss(curve, read, some)
        finer = parts * math.ceil(math.sqrt(min(miss, 1.0) / FINE))
        finer = min(finer, MOST // max(1, len(t) - 1))
        inner = t[:-1, None] + np.diff(t)[:, None] * np.arange(1, finer) / finer
        more = _between(some, inner.ravel()) if finer > parts else None
        if miss <= FINE or more is None:
            joined = miss <= rough and len(t) > 1
            return Curve(curve if joined else knots, knots, joined)
        places = np.repeat(np.arange(1, len(t)), finer - 1)
        parts, curve = finer, _merged(knots, places, more.t, more.q, more.p)


def chords_miss(curve: Any, read: Read, some: Any) -> float:
    """Return how far chords between states miss the motion of a run, as a part of its range."""
    t = _times(curve)
    first = np.flatnonzero(~at_once(t))
    first = first[sample(len(first), CHECKED)]
    if not first.size:
        return 0.0
    a, b, span = curve[first], curve[first + 1], t[first + 1] - t[first]
    inner = _between(some, t[first] + PART * span)
    if inner is None:  # Hermite's polynomial
        rise, span = b.q - a.q, span[:, None]
        bend = (1 - PART) * (span * a.v - rise) - PART * (span * b.v - rise)
        q = a.q + PART * rise + PART * (1 - PART) * bend
        inner = a.with_states(t[first] + PART * span[:, 0], q, a.p + PART * (b.p - a.p))
    columns = zip(*map(read, (curve, a, b, inner)), strict=True)
    parts = np.array([_missed(y, u + PART * (v - u) - w) for y, u, v, w in columns]).reshape(-1, 2)
    miss, size = parts.T
    size = np.maximum(size, NOISE * size.max(initial=0.0))
    return float(np.max(miss[size > 0] / size[size > 0], initial=0.0))


def _missed(y: Any, miss: Any) -> tuple[float, float]:
    """Return the largest of what is missed, and the range of y."""
    y, miss = (np.asarray(x, dtype=np.float64).reshape(len(x), -1) for x in (y, miss))
    finite = np.isfinite(y)
    low, high = y.min(0, where=finite, initial=np.inf), y.max(0, where=finite, initial=-np.inf)
    size = max((high - low).max(), ROUNDING * np.abs(y).max(where=finite, initial=0.0))
    return np.abs(miss).max(where=np.isfinite(miss), initial=0.0), size


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


def _with_events(some: Any, most: int) -> Any:
    """Return states and, between them, those before and after each event, up to so many."""
    t, records = _times(some), getattr(some, "records", ())
    low, high, sign = t.min(initial=0), t.max(initial=0), 1.0 if t[-1:] >= t[:1] else -1.0
    records = [record for record in records if low <= record.t <= high]
    if not records or (np.diff(sign * t) < 0).any():
        return some
    records = records[:: 1 + len(records) // most]
    acted = np.array([record.t for record in records])
    q = np.array([(record.q, record.q_after) for record in records])
    p = np.array([(record.p, record.p_after) for record in records])
    places = np.searchsorted(sign * t, sign * acted)
    there = np.minimum(places, len(t) - 1)  # a state at this time may be the one before the event
    away = np.abs(np.concatenate([q - some.q[there, None], p - some.p[there, None]], axis=2))
    places += (t[there] == acted) & (away[:, 0] <= away[:, 1]).all(axis=1)
    return _merged(some, np.repeat(places, 2), np.repeat(acted, 2), *map(np.concatenate, (q, p)))


def _merged(some: Any, places: Ints, *more: Any) -> Any:
    """Return states with more of them, t, q and p, before those at some places."""
    pairs = zip((_times(some), some.q, some.p), more, strict=True)
    return some.with_states(*(np.insert(x, places, y, axis=0) for x, y in pairs))


def at_once(t: Any) -> Any:
    """Return where times follow one another without an interval, as on both sides of an event."""
    intervals = np.abs(np.diff(np.asarray(t, dtype=np.float64)))
    return intervals <= NOTHING * intervals.max(initial=0.0)


def _times(some: Any) -> Floats:
    return np.asarray(some.t, dtype=np.float64)


def sample(count: int, most: int) -> Ints:
    """Return so many numbers below a count, in order, at uneven distances: no period is hidden."""
    if count <= most:
        return np.arange(count)
    within = np.random.default_rng(0).random(most)
    places = ((np.arange(most) + within) * (count / most)).astype(np.int64)
    places[0], places[-1] = 0, count - 1
    return places


def envelope(t: Any, y: Any) -> tuple[Floats, Floats]:
    """Return a curve over time that looks the same on a screen: the extremes of many intervals."""
    t, y = (np.asarray(x, dtype=np.float64) for x in (t, y))
    if len(y) <= MOST:
        return t, y
    size = -(-2 * len(y) // MOST)
    starts = np.arange(0, len(y), size)
    rows = np.pad(np.where(np.isfinite(y), y, 0.0), (0, -len(y) % size), "edge").reshape(-1, size)
    extremes = starts + rows.argmin(axis=1), starts + rows.argmax(axis=1)
    places = np.unique(np.minimum(np.concatenate([[0, len(y)], *extremes]), len(y) - 1))
    return t[places], y[places]
