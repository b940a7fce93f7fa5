"""States to draw a curve through: stored states, both sides of events, and states between."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from symsimpson.errors import ConvergenceError, InputError
from symsimpson.results.states import States
from symsimpson.support.array_types import Floats, Ints

__all__ = ["FINE", "MOST", "ROUGH", "Curve", "curve_of", "envelope", "resolution", "sample"]

#: A curve has at most so many points; a screen has some thousand columns.
MOST = 8000
#: Chords that miss the motion by more than FINE of the range are refined, and by more than ROUGH
#: are not drawn.
FINE, ROUGH = 0.002, 0.02
#: The part of an interval at which its chord is checked, and how many intervals are.
PART, CHECKED = 0.381966, 1000
#: A curve takes at most so many steps, divided by the number of coordinates, and by DIGITS for
#: numbers that have many digits.
STEPS, DIGITS = 300_000, 1000
#: Ranges smaller than this part of the values are rounding.
ROUNDING = 1e-6

#: How the ends of a range are found among numbers of which some are not finite.
LIMITS = ((np.max, -np.inf), (np.min, np.inf))

Read = Callable[[Any], list[Any]]


class Curve(NamedTuple):
    """States along a curve, those of them that are stored or of events, and if lines join them."""

    states: Any
    knots: Any
    connected: bool


def curve_of(some: Any, read: Read, *, thin: bool = False) -> Curve:
    """Return states such that straight lines between them follow what ``read`` gives of states.

    Runs take steps again for states between theirs. If that takes too many steps, or is not
    possible, and lines would mislead, the curve is not connected. ``thin`` leaves out states of
    long runs.
    """
    if thin and len(some) > MOST:
        some = some[sample(len(some), MOST)]
    if not hasattr(some, "q"):  # saved quantities
        return Curve(some, some, _miss_of_each_second(some.t, read(some)) <= ROUGH)
    knots = curve = _with_events(some)
    parts, between = 1, _Between(some)
    while True:
        miss = _miss(curve, read, between)
        most = MOST // max(1, len(knots) - 1) if math.isfinite(miss) else 0
        finer = min(most, parts * math.ceil(math.sqrt(min(miss, 1.0) / FINE)))
        if miss <= FINE or finer <= parts:
            break
        inner = np.diff(_times(knots))[:, None] * np.arange(1, finer) / finer
        found = between((_times(knots)[:-1, None] + inner).ravel())
        if found is None:
            break
        parts, curve = finer, _merged(knots, found, finer - 1)
    return Curve(curve, knots, True) if miss <= ROUGH else Curve(knots, knots, False)


def resolution(some: Any, t: Floats, read: Read) -> float:
    """Return how far chords between times miss the motion, as a part of its range."""
    return _miss(some.at(t), read, _Between(some))


class _Between:
    """States of a run between those that it stored, as far as it has them."""

    def __init__(self, some: Any) -> None:
        try:
            self._dense = some.sol
        except (AttributeError, InputError):
            self._dense = None
        program = some.program
        digits = DIGITS if hasattr(program.numbers, "digits") else 1
        self._most = STEPS // (digits * program.n)

    def checked(self, t: Floats) -> int:
        """Return in how many intervals it can be evaluated, those that begin at t."""
        return (
            CHECKED if self._dense is None else min(CHECKED, self._most // self._dense.cost(t[:1]))
        )

    def __call__(self, t: Floats) -> tuple[Any, ...] | None:
        """Return t, q and p at times; None if there are none, or they take too many steps."""
        if self._dense is None or self._dense.cost(t) > self._most:
            return None
        try:
            return t, *self._dense.states(t)
        except ConvergenceError:
            self._dense = None
            return None


def _with_events(some: Any) -> Any:
    """Return states and, between them, those before and after each event."""
    t, records = _times(some), getattr(some, "records", ())
    sign = 1.0 if len(t) < 2 or t[-1] >= t[0] else -1.0
    if len(t) < 2 or not records or (np.diff(sign * t) < 0).any():
        return some
    low, high = sorted((t[0], t[-1]))
    records = [record for record in records if low <= record.t <= high]
    records = records[:: 1 + len(records) // MOST]
    if not records:
        return some
    acted = np.array([record.t for record in records])
    q, p = (
        np.array([[getattr(record, side) for side in (x, f"{x}_after")] for record in records])
        for x in "qp"
    )
    place = np.searchsorted(sign * t, sign * acted)
    there = np.minimum(place, len(t) - 1)  # a state at this time may be the one before the event
    place += (t[there] == acted) & (np.asarray(some.p[there]) == p[:, 0]).all(axis=1)
    return _merged(some, (np.repeat(acted, 2), *(np.concatenate(x) for x in (q, p))), 2, place)


def _merged(some: Any, more: tuple[Any, ...], count: int, place: Any = None) -> Any:
    """Return states with ``count`` more at each place, behind all but the last unless given."""
    place = np.repeat(np.arange(1, len(some)) if place is None else place, count)
    stored = _times(some), some.q, some.p
    return _states(
        some, *(np.insert(a, place, b, axis=0) for a, b in zip(stored, more, strict=True))
    )


def _states(some: Any, t: Any, q: Any, p: Any) -> States:
    values, driven = some.parameter_values, some.driven
    return States(t=t, q=q, p=p, program=some.program, parameter_values=values, driven=driven)


def _miss(curve: Any, read: Read, between: _Between) -> float:
    """Return how far chords miss the motion, of its range; infinity if that is not known."""
    t = _times(curve)
    first = np.flatnonzero(np.diff(t))
    if not first.size:
        return 0.0
    checked = between.checked(t)
    if not checked:
        return math.inf
    first = first[sample(len(first), checked)]
    span = t[first + 1] - t[first]
    a, b = curve[first], curve[first + 1]
    inner = between(t[first] + PART * span)
    if inner is None:
        rise, whole = b.q - a.q, span[:, None]  # Hermite's polynomial
        bend = (1 - PART) * (whole * a.v - rise) - PART * (whole * b.v - rise)
        q = a.q + PART * rise + PART * (1 - PART) * bend
        inner = t[first] + PART * span, q, a.p + PART * (b.p - a.p)
    columns = zip(read(curve), read(a), read(b), read(_states(curve, *inner)), strict=True)
    return max((_part(y, u + PART * (v - u) - w) for y, u, v, w in columns), default=0.0)


def _miss_of_each_second(t: Any, columns: list[Any]) -> float:
    """Return the same for numbers alone: a chord over two intervals misses four times as much."""
    misses = []
    for y in columns if len(t) > 2 else ():
        part = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
        misses.append(_part(y, y[:-2] + part * (y[2:] - y[:-2]) - y[1:-1]) / 4)
    return max(misses, default=0.0)


def _part(y: Any, miss: Any) -> float:
    """Return the largest of what is missed, as a part of the range of y."""
    y, miss = (x.reshape(len(x), -1) for x in _floats(y, miss))
    finite = np.isfinite(y)
    high, low = (limit(y, axis=0, where=finite, initial=far) for limit, far in LIMITS)
    size = (high - low).max(initial=0.0)
    size = max(size, ROUNDING * np.abs(y).max(where=finite, initial=0.0))
    largest = np.abs(miss).max(where=np.isfinite(miss), initial=0.0)
    return float(largest / size) if size > 0 else 0.0


def _floats(*arrays: Any) -> tuple[Floats, ...]:
    return tuple(np.asarray(x, dtype=np.float64) for x in arrays)


def _times(some: Any) -> Floats:
    return np.asarray(some.t, dtype=np.float64)


def sample(count: int, most: int) -> Ints:
    """Return so many numbers below a count, in order, at uneven distances: no period is hidden."""
    if count <= most:
        return np.arange(count)
    k = np.arange(most)
    places = ((k + (PART * k) % 1) * (count / most)).astype(np.int64)
    places[-1] = count - 1
    return np.unique(places)


def envelope(t: Any, y: Any) -> tuple[Floats, Floats]:
    """Return a curve over time that looks the same on a screen: the extremes of many intervals."""
    t, y = _floats(t, y)
    if len(y) <= MOST:
        return t, y
    size = -(-2 * len(y) // MOST)
    starts = np.arange(0, len(y), size)
    rows = np.pad(np.where(np.isfinite(y), y, 0.0), (0, size * len(starts) - len(y)), "edge")
    rows = rows.reshape(-1, size)
    extremes = [starts + rows.argmin(axis=1), starts + rows.argmax(axis=1)]
    places = np.unique(np.minimum(np.concatenate([[0], *extremes]), len(y) - 1))
    return t[places], y[places]
