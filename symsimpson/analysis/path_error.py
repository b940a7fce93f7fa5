"""The difference between two runs of one motion along the whole path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from symsimpson.errors import ConvergenceError
from symsimpson.results.trajectory import Trajectory
from symsimpson.support.array_types import Floats

__all__ = ["PathError", "path_error"]

#: The path is compared at so many equidistant times, the ends included.
EQUIDISTANT = 21
#: It is also compared at so many stored states, divided by the number of coordinates, and at as
#: many of the first ones.
STORED = 2**13
#: A variable is constant if it changes by this part of its size times the root of the steps.
ROUNDING = 2.0**-49


@dataclass(frozen=True)
class PathError:
    """The largest difference, and the time from which differences exceed the bound."""

    largest: float
    since: float | None = None

    @classmethod
    def of(cls, t: Floats, off: Floats, bound: float) -> PathError:
        """Return that of differences at times."""
        off = np.where(np.isnan(off), np.inf, off)
        beyond = np.flatnonzero(off > bound)
        return cls(float(off.max(initial=0.0)), float(t[beyond[0]]) if beyond.size else None)


def path_error(coarse: Trajectory, fine: Trajectory, duration: float, bound: float) -> PathError:
    """Compare a run with one of smaller steps, relative to how far each variable moves.

    ``duration`` is the planned length of both runs, negative if they go backwards.
    """
    for run in (coarse, fine):
        if not run.success:
            return PathError(np.inf, float(run.t[-1]))
    sign, t0 = np.sign(duration), float(coarse.t[0])
    ends = [float(run.t[-1]) for run in (coarse, fine)]
    end = min(ends, key=lambda t: float(sign * t))
    times = _times(coarse, duration)
    times = times[sign * (end - times) >= 0]
    scale = _scale(fine)
    try:
        states = [run.at(times) for run in (coarse, fine)]
    except ConvergenceError as error:
        return PathError(np.inf, error.time)
    off = _difference(*(np.hstack([x.q, x.p]) for x in states), scale)
    for first, last in _windows(coarse, fine, t0 + duration):
        low, high = min(first, last), max(first, last)
        slack = 8 * np.finfo(float).eps * max(abs(low), abs(high), abs(duration))
        if high - low <= bound * abs(duration):
            off[(times >= low - slack) & (times <= high + slack)] = 0.0
    if coarse.ended_by is not None or fine.ended_by is not None:
        late = abs(ends[0] - ends[1]) / abs(duration)
        last_states = [np.hstack([run.q[-1:], run.p[-1:]]) for run in (coarse, fine)]
        if coarse.ended_by == fine.ended_by:
            late = max(late, float(_difference(*last_states, scale)[0]))
        times, off = np.append(times, end), np.append(off, late)
    return PathError.of(times, off, bound)


def _times(run: Trajectory, duration: float) -> Floats:
    """Return the times at which a run is compared, in order."""
    count = STORED // run.program.n + 1
    some = np.linspace(0, len(run) - 1, count).astype(int)
    stored = run.t[np.union1d(some, np.arange(min(len(run), count)))]
    # the last of equidistant times is the last stored one, however it was rounded
    equidistant = float(run.t[0]) + duration * np.linspace(0, 1, EQUIDISTANT)[:-1]
    times = np.union1d(equidistant, stored)
    return times if duration > 0 else times[::-1]


def _difference(coarse: Floats, fine: Floats, scale: Floats) -> Floats:
    """Return the largest difference of each pair of states, in units of ``scale``."""
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(coarse - fine) / scale
    off[coarse == fine] = 0.0
    largest: Floats = off.max(axis=1)
    return largest


def _scale(run: Trajectory) -> Floats:
    """Return how far variables of each unit move from the start, shape (2 n,).

    A variable that stays constant has its own size as its scale. Momenta of coordinates at rest
    are rounding errors, and are not compared: their scale is infinite.
    """
    units, names, n = run.program.units, run.program.coordinates, run.program.n
    of_q = [(units.get(name), None) for name in names]
    of_p = [(units.get(name), units.get(f"p_{name}")) for name in names]
    states = np.hstack([run.q, run.p])
    moved, size = np.abs(states - states[0]).max(axis=0), np.abs(states).max(axis=0)
    for first, groups in ((0, of_q), (n, of_p)):
        for group in set(groups):
            same = [first + k for k, other in enumerate(groups) if other == group]
            moved[same], size[same] = moved[same].max(), size[same].max()
    still = moved <= ROUNDING * np.sqrt(max(run.steps, 1)) * size
    scale = np.where(still, size, moved)
    for k in range(n):
        same = [j for j in range(n) if of_p[j] == of_p[k]]
        if still[same].all():
            scale[n + k] = np.inf
    return scale


def _windows(coarse: Trajectory, fine: Trajectory, t_end: float) -> Iterator[tuple[float, float]]:
    """Return the times between which one of two runs is before an event, and the other after."""
    pairs = list(zip(coarse.records, fine.records, strict=False))
    for one, other in pairs:
        if one.event != other.event:
            return
        yield one.t, other.t
    for record in (*coarse.records[len(pairs) :], *fine.records[len(pairs) :])[:1]:
        yield record.t, t_end
