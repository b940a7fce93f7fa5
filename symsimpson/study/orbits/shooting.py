"""The equations of an orbit by multiple shooting, and Newton's method for them.

The unknowns are the states at the start of all segments, the period if it is free, parameters and
other symbols, and one unfolding number for each first integral. The rows are the gaps between the
segments and the conditions. The numbers of unfolding vanish at a solution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

from symsimpson.results.trajectory import Trajectory
from symsimpson.study.orbits.conditions import Closing, Condition
from symsimpson.study.orbits.flow import Flow, Leg
from symsimpson.study.orbits.integrals import Integrals
from symsimpson.support.array_types import Floats
from symsimpson.support.interpreter import catch_interrupts

#: Newton's method stops after a correction below ``LAST``, if the one before was below ``CLOSE``.
LAST, CLOSE = 1e-8, 1e-4
MOST_ITERATIONS, MOST_HALVINGS = 40, 10
#: Largest correction of the period, and of the states, as parts of the period and of the scale.
PERIOD_PART, STATE_PART = 0.2, 0.5
#: A correction may raise the residual by this factor.
GROWTH = 10.0
#: Singular values below this part of the largest one are zeros.
RANK = 1e-13


@dataclass(frozen=True)
class OrbitUnknowns:
    """Values of all unknowns."""

    states: Floats  #: At the start of each segment, shape (m, 2 n).
    period: float
    values: Floats  #: Of all parameters.
    extra: Floats  #: Of the symbols of the closing.
    unfolding: Floats


@dataclass(frozen=True)
class Sweep:
    """The rows at a point, and their derivatives in scaled units."""

    point: OrbitUnknowns
    legs: tuple[Leg, ...]
    residual: Floats
    matrix: Floats

    @property
    def failure(self) -> Leg | None:
        """The first segment that failed."""
        return next((x for x in self.legs if not np.isfinite(x.end).all()), None)

    @property
    def size(self) -> float:
        """The largest residual, relative to the scale; infinite after a failure."""
        largest = float(abs(self.residual).max()) if self.residual.size else 0.0
        return largest if np.isfinite(largest) else np.inf


#: Further rows and their derivatives, from the unknowns in scaled units.
More = Callable[[Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class Solution:
    """The end of Newton's method."""

    sweep: Sweep
    converged: bool
    corrections: tuple[float, ...]
    failed: Trajectory | None = None
    interrupted: bool = False


@dataclass(frozen=True)
class Shooting:
    """The equations of an orbit.

    ``middle`` has conditions after half a period, which replace the closing. ``ends`` has
    conditions at the end of a path between two boundaries.
    """

    flow: Flow
    closing: Closing | None
    conditions: tuple[Condition, ...]
    integrals: Integrals
    scale: Floats  #: Of (q, p), shape (2 n,).
    reference_period: float
    last: tuple[Condition, ...] = ()  #: Conditions on the final state; then nothing else closes.
    sizes: Floats = field(default_factory=lambda: np.zeros(0))  #: Of parameters and symbols.

    @property
    def unfolded(self) -> int:
        """Number of unfolding numbers."""
        return 0 if self.closing is None else self.integrals.count

    @property
    def unknowns(self) -> int:
        """Number of parameters and symbols to solve for."""
        return len(self.flow.places) + (0 if self.closing is None else len(self.closing.symbols))

    @property
    def columns(self) -> int:
        """Number of unknowns."""
        free = self.flow.free_period
        return self.flow.segments * 2 * self.flow.n + free + self.unknowns + self.unfolded

    @property
    def freedom(self) -> int:
        """Number of unknowns that the equations leave free."""
        closed = 2 * self.flow.n if self.closing is not None else 0
        inner = (self.flow.segments - 1) * 2 * self.flow.n
        return self.columns - inner - closed - len(self.conditions) - len(self.last)

    @property
    def units(self) -> Floats:
        """The scale of each unknown."""
        period = [self.reference_period] if self.flow.free_period else []
        states = np.tile(self.scale, self.flow.segments)
        return np.concatenate([states, period, self.sizes, np.ones(self.unfolded)])

    def pack(self, point: OrbitUnknowns) -> Floats:
        """Return the unknowns as a vector."""
        period = [point.period] if self.flow.free_period else []
        parameters = point.values[list(self.flow.places)]
        extra = point.extra if self.closing is not None else np.zeros(0)
        return np.concatenate([point.states.ravel(), period, parameters, extra, point.unfolding])

    def moved(self, point: OrbitUnknowns, change: Floats) -> OrbitUnknowns:
        """Return a point after a change of its unknowns, in their own units."""
        n, m, k = 2 * self.flow.n, self.flow.segments, len(self.flow.places)
        states, rest = np.split(change, [n * m])
        free = int(self.flow.free_period)
        period, parameters, extra, unfolding = np.split(
            rest, [free, free + k, free + self.unknowns]
        )
        values = point.values.copy()
        values[list(self.flow.places)] += parameters
        length = point.period + (float(period[0]) if free else 0.0)
        if self.flow.period_of is not None:
            length, _ = self.flow.period_of(values)
        return OrbitUnknowns(
            point.states + states.reshape(m, n),
            length,
            values,
            point.extra + extra,
            point.unfolding + unfolding,
        )

    def sweep(self, point: OrbitUnknowns) -> Sweep:
        """Run all segments, and evaluate the rows and their derivatives."""
        flow, n = self.flow, 2 * self.flow.n
        m, k, free = flow.segments, len(flow.places), int(flow.free_period)
        legs: list[Leg] = []
        for number in range(m):
            legs.append(flow.leg(number, point.states[number], point.period, point.values))
            if not np.isfinite(legs[-1].end).all():
                rows = np.full(self.columns - self.freedom, np.inf)
                return Sweep(point, tuple(legs), rows, np.zeros((len(rows), self.columns)))
        matrix, rows = np.zeros((0, self.columns)), np.zeros(0)
        after = m * n + free
        _, by_parameter = (
            (0.0, np.zeros(k)) if flow.period_of is None else (flow.period_of(point.values))
        )
        closed = m if self.closing is not None else m - 1
        for j in range(closed):
            leg, block = legs[j], np.zeros((n, self.columns))
            block[:, j * n : (j + 1) * n] = leg.by_state
            if free:
                block[:, m * n] = leg.by_period
            block[:, after : after + k] = leg.by_unknown + np.outer(leg.by_period, by_parameter)
            if j < m - 1:
                gap = leg.end - point.states[j + 1]
                block[:, (j + 1) * n : (j + 2) * n] -= np.eye(n)
            else:
                gap = self._close(leg, point, block)
            rows = np.concatenate([rows, gap / self.scale])
            matrix = np.concatenate([matrix, block / self.scale[:, None]])
        for condition in self.conditions:
            value, slopes = condition.row(flow, point.states[0], point.period, point.values)
            whole = np.zeros(self.columns)
            whole[:n] = slopes[:n]
            if free:
                whole[m * n] = slopes[n]
            whole[after : after + k] = slopes[n + 1 :] + slopes[n] * by_parameter
            rows, matrix = self._add(rows, matrix, value, whole)
        for condition in self.last:
            leg = legs[-1]
            value, slopes = condition.row(flow, leg.end, point.period, point.values)
            whole, by_end = np.zeros(self.columns), slopes[:n]
            whole[(m - 1) * n : m * n] = by_end @ leg.by_state
            if free:
                whole[m * n] = by_end @ leg.by_period + slopes[n]
            whole[after : after + k] = by_end @ leg.by_unknown + slopes[n + 1 :]
            whole[after : after + k] += (by_end @ leg.by_period + slopes[n]) * by_parameter
            rows, matrix = self._add(rows, matrix, value, whole)
        return Sweep(point, tuple(legs), rows, matrix * self.units)

    def _add(
        self, rows: Floats, matrix: Floats, value: float, slopes: Floats
    ) -> tuple[Floats, Floats]:
        """Append a row, divided by its change over the scale of the unknowns."""
        size = abs(slopes * self.units).max() or 1.0
        return np.append(rows, value / size), np.concatenate([matrix, slopes[None] / size])

    def _close(self, leg: Leg, point: OrbitUnknowns, block: Floats) -> Floats:
        """Return the gap of the last segment, and set its derivatives."""
        assert self.closing is not None
        n, k = 2 * self.flow.n, len(self.flow.places)
        after = self.flow.segments * n + self.flow.free_period
        whole, first = self.closing.matrix, point.states[0]
        shift, slopes = self.closing.at(point.values, point.extra)
        block[:, :n] -= whole
        block[:, after : after + k] -= slopes[:, list(self.flow.places)]
        symbols = len(self.closing.symbols)
        block[:, after + k : after + k + symbols] -= slopes[:, len(point.values) :]
        gap = leg.end - whole @ first - shift
        if self.unfolded:
            gradients = self.integrals.gradients(self.flow, first, point.values)
            # unfolding numbers are in units of the scale
            sizes = abs(gradients * self.scale).max(axis=1)
            fields = gradients * self.scale**2 / np.where(sizes > 0, sizes, 1.0)[:, None]
            directions = whole @ fields.T
            block[:, after + self.unknowns :] = directions
            gap = gap + directions @ point.unfolding
        return gap

    def phases(self, sweep: Sweep) -> Floats:
        """Return rows along the symmetries of the orbit: corrections are orthogonal to them."""
        point, m, n = sweep.point, self.flow.segments, 2 * self.flow.n
        starts = point.states
        moved = [leg.by_period * m for leg in sweep.legs]  # at the ends of segments
        if self.closing is not None:
            moved = [np.asarray(np.linalg.solve(self.closing.matrix, moved[-1])), *moved[:-1]]
        rows = [
            self.integrals.fields(self.flow, z, point.values, rate)
            for z, rate in zip(starts, moved, strict=True)
        ]
        whole = np.zeros((len(rows[0]), self.columns))
        whole[:, : m * n] = np.concatenate(rows, axis=1) / np.tile(self.scale, m)
        sizes = np.linalg.norm(whole, axis=1, keepdims=True)
        return whole[sizes[:, 0] > 0] / sizes[sizes[:, 0] > 0]

    def solve(
        self, start: OrbitUnknowns, more: More | None = None, most: int = MOST_ITERATIONS
    ) -> Solution:
        """Solve the equations by Newton's method with the smallest corrections.

        ``more`` returns further rows and derivatives, from scaled unknowns. Ctrl-C returns the
        last iterate.
        """
        corrections = list[float]()
        with catch_interrupts() as stopped:
            sweep = self.sweep(start)
            while np.isfinite(sweep.size) and len(corrections) < most:
                change = self._correction(sweep, more)
                size = float(abs(change).max())
                close = size < LAST and corrections and corrections[-1] < CLOSE
                following = self._improved(sweep, change, more)
                if stopped or following is None:
                    break
                corrections.append(size)
                sweep = following
                if close:
                    return Solution(sweep, True, tuple(corrections))
            failure = sweep.failure
            run = None if failure is None else failure.failure
            return Solution(sweep, False, tuple(corrections), run, interrupted=bool(stopped))

    def _correction(self, sweep: Sweep, more: More | None) -> Floats:
        """Return Newton's correction in scaled units, limited to a part of the scale."""
        rows, matrix = sweep.residual, sweep.matrix
        if more is not None:
            extra, slopes = more(self.pack(sweep.point) / self.units)
            rows, matrix = np.concatenate([rows, extra]), np.concatenate([matrix, slopes])
        change = np.linalg.lstsq(matrix, -rows, rcond=RANK)[0]
        states = self.flow.segments * 2 * self.flow.n
        limit = abs(change[:states]).max() / STATE_PART
        if self.flow.free_period:
            limit = max(limit, abs(change[states]) / PERIOD_PART)
        return change / max(1.0, limit)

    def _improved(self, sweep: Sweep, change: Floats, more: More | None) -> Sweep | None:
        """Return the rows after a correction or a part of it, if they do not grow much."""

        def size(sweep: Sweep) -> float:
            others = () if more is None else more(self.pack(sweep.point) / self.units)[0]
            return max(sweep.size, abs(np.asarray(others)).max(initial=0.0))

        part, before = 1.0, max(size(sweep), LAST)
        for _ in range(MOST_HALVINGS):
            following = self.sweep(self.moved(sweep.point, part * change * self.units))
            if size(following) <= GROWTH * before:
                return following
            part /= 2
        return None

    def period_map(self, sweep: Sweep) -> Floats:
        """Return the derivative of the map over a period, R^-1 D_m ... D_1."""
        whole = reduce(lambda D, leg: leg.by_state @ D, sweep.legs, np.eye(2 * self.flow.n))
        if self.closing is None:
            return whole
        return np.asarray(np.linalg.solve(self.closing.matrix, whole))

    def with_flow(self, flow: Flow) -> Shooting:
        """Return the same equations with other steps."""
        return replace(self, flow=flow)


def sizes_of_unknowns(values: Floats, extra: Sequence[float], scale: float) -> Floats:
    """Return the scales of parameters and symbols; a value of 0 has the scale of the state."""
    return np.array([abs(x) or scale for x in (*values, *extra)])
