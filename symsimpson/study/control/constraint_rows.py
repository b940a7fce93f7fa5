"""Constraints in a problem of optimal control: their rows at steps, at ends, beside conditions.

Steps are those of a stepper: multipliers act at all control points but the last, positions are
held at all but the first, and A v = b at the Gauss points of the step. Momenta between steps are
not projected: what they have along the constraints is taken up by the next multiplier.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from symsimpson.errors import reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import UNIT, Value, exact, scaled
from symsimpson.graph.rebuild import rebuilt
from symsimpson.study.control.reading import Limits, Reading
from symsimpson.study.control.transcription import PointFunctions, lagrange
from symsimpson.support.array_types import Floats

#: Ends that are given by numbers may be off their constraints by this part of what these change by
#: over the motion.
CONSISTENT = 1e-9
#: Between control points paths may miss constraints by this part of the length of a step, times
#: the slope of the constraint: one that goes round by 0.8 of a radian in a step of degree 1 does.
AWAY = 0.1
#: So many of Newton's steps bring a guess onto its constraints, or near them.
MOST_ITERATIONS = 30


def held_rates(read: Reading) -> list[Value]:
    """Write Phi v, then A v - b."""
    graph, held = read.graph, read.held
    turned = [graph.add(graph.products(gradient(graph, x, read.q), read.v)) for x in held.phi]
    return [*turned, *held.rates(graph, read.v)]


def held_values(read: Reading) -> list[tuple[str, Value]]:
    """Return phi of constraints of positions, and what all hold of velocities, with their names."""
    names = [*read.constraints[: len(read.held.phi)], *read.constraints]
    return list(zip(names, [*read.held.phi, *held_rates(read)], strict=True))


def numbers_at(read: Reading, end: int) -> dict[int, Value]:
    """Return what is known at an end by numbers: parameters, the time, what conditions give."""
    state, (low, high) = {*read.q, *read.v}, read.duration

    def number(x: float) -> Value:
        return exact(Fraction(x)), UNIT

    given = {x: number(y) for x, y in read.given.items()}
    if not end or low == high:
        given[read.t] = number(end * low)
    for limit in read.ends[end]:
        c, n = limit.value
        if limit.low == limit.high and c == 1 and n in state:
            given[n] = number(limit.low)
    return given


def pressed(read: Reading, end: int, limits: Iterable[Limits]) -> list[bool]:
    """Return which limits are at a bound at an end since its conditions say so by numbers.

    Rows that say it again have no room beside these, and take multipliers their bound.
    """
    given, flags = numbers_at(read, end), []
    for limit in limits:
        off = np.subtract([limit.low, limit.high], _number(read, limit.value, given))
        flags.append(bool(np.abs(off).min() <= _rounding(read, limit.value, given)))
    return flags


def _number(read: Reading, value: Value, given: dict[int, Value]) -> float:
    """Return a value for given numbers; NaN if it depends on anything else."""
    (there,) = rebuilt(read.graph, [value], given)
    known = not there[0] or not read.graph.nodes[there[1]].symbols
    return read.number(there) if known else np.nan


def _rounding(read: Reading, value: Value, given: dict[int, Value]) -> float:
    """Return what is rounding of a value where numbers are given."""
    graph, lengths = read.graph, read.extents.max(axis=0)
    slopes = rebuilt(graph, gradient(graph, value, [*read.q, *read.v]), given)
    sizes = [*lengths, *lengths / read.duration[0]]
    changes = [
        abs(read.number(slope)) * size
        for slope, size in zip(slopes, sizes, strict=True)
        if slope[0] and not graph.nodes[slope[1]].symbols
    ]
    return CONSISTENT * sum(changes)


def implied(read: Reading, end: int, values: Iterable[tuple[str, Value]]) -> list[bool]:
    """Return which constraints hold at an ``end``, 0 or 1, since its conditions say so.

    ``values`` are names of constraints, and what is 0. Raises InputError if conditions contradict
    one.
    """
    graph, given = read.graph, numbers_at(read, end)
    tied = {last[1]: (-c, n) for _, last, (c, n) in read.tied if end and last[0] == 1}
    flags = []
    for name, value in values:
        off = _number(read, value, given)
        if abs(off) > _rounding(read, value, given):
            reject(
                f"{('start', 'end')[end]} contradicts the constraint {name!r}: what is to be 0 is "
                f"{off:.3g} there.",
                remedy="Give values that satisfy it, as system.consistent(q0, v0) finds them.",
            )
        # one that has the same form in the state of the start, where it holds
        moved = graph.nodes[value[1]].symbols & {*read.q, *read.v, read.t}
        same = moved <= tied.keys() and rebuilt(graph, [value], tied) == [value]
        flags.append(not np.isnan(off) or (bool(moved) and same))
    return flags


def held_blocks(layout: Any, rows: Any) -> list[Any]:
    """Return functions at the control points and Gauss points of steps, with maps and rows.

    Multipliers are those of rows times h, so that the matrix of a step does not depend on h.
    """
    read, graph, N, d = layout.read, layout.read.graph, layout.steps, layout.degree
    phi, rates = read.held.phi, read.held.rates(graph, read.v)
    names, blocks = [*read.constraints], []
    k, j = (x.ravel() for x in np.mgrid[:N, :d])
    count = np.arange(N * d)
    forces = layout.block(
        read.held.pulls(graph, read.q, read.multipliers),
        [*read.q, *read.multipliers],
        [*map(layout.of, layout.points[k, j].T), *map(layout.of, layout.multipliers[k, j].T)],
        k,
        layout.places[j],
    )
    parts = []
    for a in range(layout.n):
        at = np.concatenate([layout.step_rows[k, j, a], layout.step_rows[k, -1, a]])
        factors = np.repeat([-1.0, layout.end_scale / layout.scale], N * d)
        parts.append((at, np.tile(count, 2), factors))
    blocks.append((*forces, parts))
    if phi:
        points = layout.block(
            phi, read.q, [*map(layout.of, layout.points[k, j + 1].T)], k, layout.places[j + 1]
        )
        left_out = layout.following.constraints[1]
        parts = []
        for name, out in zip(names, left_out[: len(phi)], strict=False):
            some = count[: N * d - out]
            at = rows.add(len(some), 0.0, 0.0, f"constraint {name!r}", 1.0 / N)
            parts.append((at, some, np.full(len(some), 1.0 / N)))
        blocks.append((*points, parts))
    if rates:
        places, *tables = (np.array(x, dtype=np.float64) for x in layout.scheme.at_gauss_points)
        maps = [matrix for table in tables for matrix in layout.on_path(table[j], k)]
        inner = layout.block(rates, [*read.q, *read.v], maps, k, places[j], len(rates))
        parts = []
        for name in names[len(phi) :]:
            at = rows.add(N * d, 0.0, 0.0, f"velocity constraint {name!r}")
            parts.append((at, count, np.ones(N * d)))
        blocks.append((*inner, parts))
    return blocks


def resolved(layout: Any, x: Floats) -> bool:
    """Return whether the path is near its constraints between the points where they hold.

    Near against how far a step goes along them. A path that jumps to another branch is not.
    """
    read, (N, d, n) = layout.read, (layout.steps, layout.degree, layout.n)
    m, values = len(read.held.phi), layout.parameter_values(x)
    if not m:
        return True
    middle = (layout.places[:-1] + layout.places[1:]) / 2
    q = x[layout.points]
    between = np.einsum("ij,kja->kia", lagrange(layout.places, middle), q).reshape(-1, n)
    functions = PointFunctions(read.graph, read.q, read.held.phi)
    at = {**values, **dict(zip(read.q, between.T, strict=True))}
    off = functions.values(at, N * d).reshape(m, N, d)
    ends = {**values, **dict(zip(read.q, q[:, 0].T, strict=True))}
    slopes = np.linalg.norm(functions.jacobian(ends, N), axis=2).T
    moved = np.linalg.norm(np.diff(q, axis=1), axis=2).sum(axis=1)
    near = slopes * (AWAY * moved + CONSISTENT * np.abs(q).max())
    return bool((np.abs(off).max(axis=2) <= near).all())


def onto(layout: Any, x: Floats) -> Floats:
    """Return points of a guess, shape (..., n), on the constraints of positions, or near them."""
    read, q, values = layout.read, x[layout.points], layout.parameter_values(x)
    functions = PointFunctions(read.graph, read.q, read.held.phi)
    flat = q.reshape(-1, layout.n).copy()
    for _ in range(MOST_ITERATIONS if read.held.phi else 0):
        at = {**values, **dict(zip(read.q, flat.T, strict=True))}
        off = functions.values(at, len(flat)).T
        slopes = functions.jacobian(at, len(flat))
        # least squares: where slopes are dependent, or 0, they are followed as far as they go
        moves = np.einsum("kac,kc->ka", np.linalg.pinv(slopes, rcond=1e-9), off)
        if not np.isfinite(moves).all():
            return q
        flat -= moves
        if np.abs(moves).max() <= CONSISTENT * np.abs(flat).max():
            break
    return flat.reshape(q.shape)


def projected(layout: Any, x: Floats) -> Floats:
    """Return momenta at the ends of steps, of the nearest velocities that constraints allow.

    They are what a step ends with: M v + a, with M v + W^T mu = p - a and W v = b.
    """
    read, rates, p = layout.read, held_rates(layout.read), x[layout.momenta]
    m, (count, n) = len(rates), p.shape
    functions = PointFunctions(read.graph, read.v, [*read.momenta, *rates])
    at = layout.at_ends(x, np.zeros_like(p))
    rest = functions.values(at, count).T
    slopes = functions.jacobian(at, count)
    matrix = np.zeros((count, n + m, n + m))
    matrix[:, :, :n] = slopes
    matrix[:, :n, n:] = slopes[:, n:].swapaxes(1, 2)
    right = np.concatenate([p, np.zeros((count, m))], axis=1) - rest
    try:
        v = np.linalg.solve(matrix, right[..., None])[:, :n]
    except np.linalg.LinAlgError:  # a constraint without a slope, where an iterate stands
        v = (np.linalg.pinv(matrix) @ right[..., None])[:, :n]
    return np.asarray((slopes[:, :n] @ v)[..., 0] + rest[:, :n])


def turned(layout: Any, x: Floats, along: Floats, by_p: Floats) -> Floats:
    """Return how the cost changes with q as momenta along the constraints, W^T mu, turn with them.

    Momenta between steps have such parts, which do nothing: the projection of p + W(q)^T mu is that
    of p. Held fixed while q changes, W^T mu gets a part that does something, - mu dW/dq.
    """
    read, graph, count = layout.read, layout.read.graph, len(by_p)
    rates = held_rates(read)
    rest = rebuilt(graph, rates, {v: (exact(Fraction(0)), UNIT) for v in read.v})
    moved = [graph.add([a, scaled(-1, b)]) for a, b in zip(rates, rest, strict=True)]
    at = layout.at_ends(x, by_p)
    rows = PointFunctions(graph, read.v, moved).jacobian(at, count)
    weights = np.einsum("kac,ka->kc", np.linalg.pinv(rows), along)
    slopes = PointFunctions(graph, read.q, moved).jacobian(at, count)
    return np.asarray(np.einsum("kc,kca->ka", weights, slopes))


#: From so many places one goes to where rows are 0, in so many of Newton's steps at most; at least
#: FEWEST get there.
PLACES, MOST_CORRECTIONS, FEWEST = 8, 80, 2
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

    Multipliers of such a row have no bound. It is 0 at several places where the others hold. A
    constraint whose slope there is made of those of conditions is touched by them, as the unit
    circle is by x = 1.

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
            reject(
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
        for _ in range(MOST_CORRECTIONS):
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
