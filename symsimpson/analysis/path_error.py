"""The difference between two runs of one motion along the whole path."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from symsimpson.errors import ConvergenceError
from symsimpson.results.states import States
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
        """Return the path error for the differences ``off`` at the times ``t``."""
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
    sign, t0, scale = np.sign(duration), float(coarse.t[0]), _scale(fine)
    ends = [float(run.t[-1]) for run in (coarse, fine)]
    end = sign * min(sign * t for t in ends)
    count = STORED // coarse.program.n + 1
    stored = np.union1d(np.linspace(0, len(coarse) - 1, count).astype(int), np.arange(count))
    # the last of equidistant times is the last stored one, however it was rounded
    equidistant = t0 + duration * np.linspace(0, 1, EQUIDISTANT)[:-1]
    times = sign * np.union1d(sign * equidistant, sign * coarse.t[stored[stored < len(coarse)]])
    times = times[sign * (end - times) >= 0]
    try:
        off = _difference(coarse.at(times), fine.at(times), scale)
    except ConvergenceError as error:
        return PathError(np.inf, error.time)
    # between the times of an event one run is before it, and the other after
    for first, second in zip_longest(coarse.records, fine.records):
        if first and second and first.event != second.event:
            break
        low, high = sorted(record.t if record else t0 + duration for record in (first, second))
        slack = 8 * np.finfo(float).eps * max(abs(low), abs(high), abs(duration))
        if high - low <= bound * abs(duration):
            off[(times >= low - slack) & (times <= high + slack)] = 0.0
    if coarse.ended_by is not None or fine.ended_by is not None:
        late = abs(ends[0] - ends[1]) / abs(duration)
        if coarse.ended_by == fine.ended_by:
            late = max(late, *_difference(coarse[-1:], fine[-1:], scale))
        times, off = np.append(times, end), np.append(off, late)
    return PathError.of(times, off, bound)


def _difference(coarse: States, fine: States, scale: Floats) -> Floats:
    """Return the largest difference of each pair of states, in units of ``scale``."""
    first, second = (np.hstack([states.q, states.p]) for states in (coarse, fine))
    with np.errstate(divide="ignore", invalid="ignore"):
        off: Floats = np.where(first == second, 0.0, np.abs(first - second) / scale)
    return off.max(axis=1)


def _scale(run: Trajectory) -> Floats:
    """Return how far variables of each unit move from the start, shape (2 n,).

    A variable that stays constant has its own size as its scale. Momenta of coordinates at rest
    are rounding errors, and are not compared: their scale is infinite.
    """
    units, names, n = run.program.units, run.program.coordinates, run.program.n
    kinds: list[tuple[str, str | None, str | None]]
    kinds = [("q", units.get(name), None) for name in names]
    kinds += [("p", units.get(name), units.get(f"p_{name}")) for name in names]
    numbers = {kind: k for k, kind in enumerate(dict.fromkeys(kinds))}
    group = np.array([numbers[kind] for kind in kinds])
    same = group[:, None] == group
    states = np.hstack([run.q, run.p])
    moved, size = (
        np.where(same, np.abs(x).max(axis=0), 0.0).max(axis=1) for x in (states - states[0], states)
    )
    still = moved <= ROUNDING * np.sqrt(max(run.steps, 1)) * size
    scale = np.where(still, size, moved)
    scale[n:][(same[n:, n:] <= still[:n]).all(axis=1)] = np.inf
    return scale
