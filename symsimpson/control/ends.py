"""Conditions at both ends against one another, and against the constraints there.

Rows of a programme are to be independent: where one follows from others, multipliers have no bound.
Which do is seen at places where the others hold, come to from several sides: a row that is 0 at all
of them is left out. A constraint that is not, but whose slope there is made of those of conditions,
is touched by them, as the unit circle is by x = 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from symsimpson.control.constraint_rows import held_values, implied
from symsimpson.control.point_functions import PointFunctions
from symsimpson.control.reading import Reading
from symsimpson.errors import InputError
from symsimpson.graph.nodes import Value
from symsimpson.support.array_types import Floats

__all__ = ["Following", "following"]

#: From so many places one goes to where rows are 0, in so many of Newton's steps at most; at least
#: FEWEST get there.
PLACES, MOST_ITERATIONS, FEWEST = 8, 80, 2
#: Parameters and durations, which have bounds, are moved where states do not do: by this part.
SELDOM = 1e-2
#: Rows are 0 within EXACT, in units of sizes; one that is so within NEAR at all places follows from
#: others. Where rows touch, squares are EXACT, and slopes dependent within TOUCHING.
EXACT, NEAR, TOUCHING = 1e-12, 1e-9, 1e-4
#: A constraint has a part in what is dependent; places so far aside are on the same branch.
PART, ASIDE = 0.1, 1e-3
#: Slopes that are dependent differ by so much of rounding; sizes of less than this part of the
#: largest one are 0, as the sine of pi.
ROUNDED, TINY = 1e-11, 1e-13


class Following(NamedTuple):
    """Which rows follow from others: conditions of each end, those that tie them, constraints."""

    conditions: list[list[bool]]
    tied: list[bool]
    constraints: list[list[bool]]


def following(read: Reading) -> Following:
    """Return which rows follow from those before them; constraints stand behind all conditions.

    Raises InputError if conditions contradict a constraint, or touch it.
    """
    positions = len(read.held.phi)
    held = held_values(read)
    known = [implied(read, end, held) for end in (0, 1)]
    rows = _Rows(read, [value for _, value in held])
    out = [False] * rows.conditions + known[0] + known[1]
    if len(rows.plain) < rows.conditions or not all(known[0] + known[1]):
        places, out, touched = rows.followed(out)
        if touched is not None:
            end, k = divmod(touched - rows.conditions, len(held))
            what = rows.known(places, end, velocities=k >= positions)
            where = ("start", "end")[end]
            raise InputError(
                f"{where} touches the constraint {held[k][0]!r}: where both hold, the slope of one "
                "is that of the other, and no solver can tell an optimum.\n"
                + (f"Give {what} at the {where}, too: it follows." if what else "Give more there.")
            )
    flags = iter(out)
    conditions = [[x.low == x.high and next(flags) for x in limits] for limits in read.ends]
    tied = [next(flags) for _ in read.tied]
    return Following(conditions, tied, [[next(flags) for _ in held] for _ in range(2)])


class _Rows:
    """Rows of both ends, as functions of their states, of parameters that are found, and the time.

    First come the conditions of the start, of the end and of both, then constraints at each.
    """

    def __init__(self, read: Reading, held: list[Value]) -> None:
        self.read, n, (low, high) = read, len(read.q), read.duration
        self.equal = [[x for x in limits if x.low == x.high] for limits in read.ends]
        a, b = map(len, self.equal)
        self.conditions = a + b + len(read.tied)
        of_held = self.conditions + np.arange(2 * len(held)).reshape(2, -1)
        self.numbers = np.zeros(self.conditions + of_held.size)
        self.numbers[: a + b] = [x.low for limits in self.equal for x in limits]
        first: dict[Any, int] = {}
        ends = [(end, x.value[1]) for end in (0, 1) for x in self.equal[end]]
        for k, (end, node) in enumerate(ends):
            if node in (*read.q, *read.v):
                first.setdefault((end, node), k)
        self.plain = [*first.values()]
        free = [read.parameters[i] for i in read.found]
        self.parts: list[tuple[Any, Any, PointFunctions]] = []
        for end, conditions in enumerate((np.arange(a), np.arange(a, a + b))):
            values = [x.value for x in self.equal[end]]
            values += [(last, first)[1 - end] for _, last, first in read.tied] + held
            timed = [read.t] if end and low < high else []
            variables = [*read.q, *read.v, *free, *timed]
            rows = np.concatenate([conditions, np.arange(a + b, self.conditions), of_held[end]])
            columns = np.arange(len(variables))
            columns += np.where(columns < 2 * n, 2 * n * end, 2 * n)
            self.parts.append((rows, columns, PointFunctions(read.graph, variables, values)))
        lengths = read.extents.max(axis=0)
        q = np.where(lengths > TINY * lengths.max(), lengths, lengths.max() or 1.0)
        given = [abs(read.values[i]) or 1.0 for i in read.found]
        self.sizes = np.concatenate([q, q / high, q, q / high, given, [high] * (low < high)])
        self.light = np.where(np.arange(len(self.sizes)) < 4 * n, 1.0, SELDOM)
        bounds = [*read.found_bounds, *[read.duration] * (low < high)]
        anything = np.full(4 * n, np.inf)
        self.low, self.high = (
            np.concatenate([far, [pair[k] for pair in bounds]])
            for k, far in enumerate((-anything, anything))
        )

    def at(self, w: Floats) -> tuple[Floats, Floats]:
        """Return values and slopes of rows, by unknowns in units of their sizes."""
        read, values = self.read, -self.numbers
        slopes = np.zeros((len(values), len(w)))
        for end, (rows, columns, functions) in enumerate(self.parts):
            known = {**read.given, read.t: end * read.duration[0]}
            known |= dict(zip(functions.variables, w[columns], strict=True))
            values[rows] += functions.values(known, 1)[:, 0]
            slopes[np.ix_(rows, columns)] += functions.jacobian(known, 1)[0]
        return values, slopes * self.sizes

    def begun(self, seed: int) -> Floats:
        """Return some place, with parameters and a duration between their bounds."""
        rng = np.random.default_rng(seed)
        w: Floats = self.sizes * rng.normal(size=len(self.sizes))
        finite = np.isfinite(self.high - self.low)
        w[finite] = rng.uniform(self.low[finite], self.high[finite])
        return np.clip(w, self.low, self.high)

    def onto(self, w: Floats, rows: list[int]) -> Floats | None:
        """Return a place where rows are 0, if Newton's method gets there."""
        for _ in range(MOST_ITERATIONS):
            off, slopes = self._measured(w, rows)
            if not (np.isfinite(off).all() and np.isfinite(slopes).all()):
                return None
            if np.abs(off).max(initial=0.0) <= EXACT * (1 + np.abs(w / self.sizes).max()):
                return w
            moves = np.linalg.lstsq(slopes * self.light, off, rcond=ROUNDED)[0]
            w = np.clip(w - self.sizes * self.light * moves, self.low, self.high)
        return None

    def followed(self, out: list[bool]) -> tuple[list[Floats], list[bool], int | None]:
        """Return places where all rows are 0, which of these follow, and one that is touched.

        Those that are left out already are not looked at.
        """
        places, kept, out = [self.begun(seed) for seed in range(PLACES)], self.plain, list(out)
        for row in [None, *(k for k, left in enumerate(out) if not left and k not in kept)]:
            if row is not None:
                if all(np.abs(self._measured(w, [row])[0]).max() < NEAR for w in places):
                    out[row] = True
                    continue
                kept = [*kept, row]
            places = [w for w in (self.onto(w, kept) for w in places) if w is not None]
            if len(places) < FEWEST:
                return [], out, None
        while dependent := self.dependent(places, kept):
            begun = [self.begun(seed) for seed in range(PLACES)]
            safe = [row for row in dependent if self.follows(row, kept, begun)]
            if not safe:  # one that follows on a branch alone is left to the solver
                near = [w + ASIDE * (self.begun(0) - w) for w in places]
                branch = any(self.follows(row, kept, near) for row in dependent)
                return places, out, None if branch else dependent[0]
            out[safe[0]] = True
            kept = [k for k in kept if k != safe[0]]
        return places, out, None

    def follows(self, row: int, kept: list[int], places: list[Floats]) -> bool:
        """Return whether a row is 0 where all others are that one comes to."""
        others = [k for k in kept if k != row]
        there = [w for w in (self.onto(w, others) for w in places) if w is not None]
        off = [np.abs(self._measured(w, [row])[0]).max() for w in there]
        return len(off) >= FEWEST and max(off) < NEAR

    def dependent(self, places: list[Floats], kept: list[int]) -> list[int]:
        """Return constraints whose slopes are made of those of other rows at all places."""
        given = [k for k in kept if k < self.conditions]
        held, part = [k for k in kept if k >= self.conditions], np.zeros(0)
        for w in places if held else []:
            _, slopes = self._measured(w, [*given, *held])
            _, sizes, ways = np.linalg.svd(slopes[: len(given)], full_matrices=False)
            ways = ways[sizes > TOUCHING]
            rest = slopes[len(given) :]
            left, sizes, _ = np.linalg.svd(rest - rest @ ways.T @ ways, full_matrices=False)
            if sizes[-1] > TOUCHING:
                return []
            part = np.abs(left[:, -1])
        return [held[k] for k in np.argsort(-part) if part[k] > PART * part.max()]

    def known(self, places: list[Floats], end: int, *, velocities: bool) -> str:
        """Return what all places have of an end, and is not given, in words."""
        read, n = self.read, len(self.read.q)
        given = {x.value[1] for x in self.equal[end]}
        first, shared = 2 * n * end + n * velocities, list[str]()
        for a, node in enumerate(read.v if velocities else read.q):
            values = np.array([w[first + a] for w in places]) / self.sizes[first + a]
            if node not in given and np.ptp(values) < 10 * TOUCHING:
                number = round(float(values.mean()), 3) * self.sizes[first + a] + 0.0
                shared.append(f"{'v_' * velocities}{read.names[a]} = {number:g}")
        return ", ".join(shared)

    def _measured(self, w: Floats, rows: list[int]) -> tuple[Floats, Floats]:
        """Return how far off rows are, and their slopes, each of length 1 unless it is 0."""
        with np.errstate(all="ignore"):
            values, slopes = (x[rows] for x in self.at(w))
            lengths = np.linalg.norm(slopes, axis=1)
            lengths[lengths == 0] = 1.0
            return values / lengths, slopes / lengths[:, None]
