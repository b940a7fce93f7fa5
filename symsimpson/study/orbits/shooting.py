"""The equations of an orbit by multiple shooting, and Newton's method for them.

The unknowns are the states at the start of all segments, the period if it is free, parameters and
other symbols, and one unfolding number for each first integral. The rows are the gaps between the
segments and the conditions. The numbers of unfolding vanish at a solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy as sp

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
        largest = float(abs(self.residual).max(initial=0.0))
        return largest if np.isfinite(largest) else np.inf


@dataclass(frozen=True)
class Solution:
    """The end of Newton's method."""

    sweep: Sweep
    converged: bool
    corrections: tuple[float, ...]
    interrupted: bool = False


@dataclass(frozen=True)
class Shooting:
    """The equations of an orbit, or of a path between two boundaries if ``closing`` is None."""

    flow: Flow
    closing: Closing | None
    conditions: tuple[Condition, ...]
    integrals: Integrals
    scale: Floats  #: Of (q, p), shape (2 n,).
    reference_period: float
    sizes: Floats  #: Of parameters and symbols.
    last: tuple[Condition, ...] = ()  #: Conditions on the final state, in place of the closing.

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        """Unknowns that are no parameters."""
        return () if self.closing is None else self.closing.symbols

    @property
    def unfolded(self) -> int:
        """Number of unfolding numbers."""
        return 0 if self.closing is None else self.integrals.count

    @cached_property
    def ends(self) -> list[int]:
        """Ends of the columns of states, the period, parameters, symbols and unfolding numbers."""
        flow = self.flow
        states, others = flow.segments * 2 * flow.n, (len(flow.places), len(self.symbols))
        counts = [states, int(flow.free_period), *others, self.unfolded]
        return np.cumsum(counts).tolist()

    @property
    def columns(self) -> int:
        """Number of unknowns."""
        return self.ends[-1]

    @property
    def rows(self) -> int:
        """Number of equations."""
        gaps = self.flow.segments - (self.closing is None)
        return gaps * 2 * self.flow.n + len(self.conditions) + len(self.last)

    @cached_property
    def units(self) -> Floats:
        """The scale of each unknown."""
        period = np.full(int(self.flow.free_period), self.reference_period)
        states = np.tile(self.scale, self.flow.segments)
        return np.concatenate([states, period, self.sizes, np.ones(self.unfolded)])

    def scaled(self, point: OrbitUnknowns) -> Floats:
        """Return the unknowns as a vector in scaled units."""
        period = np.full(int(self.flow.free_period), point.period)
        others = point.values[list(self.flow.places)], point.extra, point.unfolding
        return np.concatenate([point.states.ravel(), period, *others]) / self.units

    def moved(self, point: OrbitUnknowns, change: Floats) -> OrbitUnknowns:
        """Return a point after a change of its unknowns, in scaled units."""
        parts = np.split(change * self.units, self.ends[:-1])
        states, period, parameters, extra, unfolding = parts
        values = point.values.copy()
        values[list(self.flow.places)] += parameters
        length = point.period + float(period.sum())  # empty if it is not free
        if self.flow.period_of is not None:
            length, _ = self.flow.period_of(values)
        starts = point.states + states.reshape(point.states.shape)
        extra, unfolding = point.extra + extra, point.unfolding + unfolding
        return OrbitUnknowns(starts, length, values, extra, unfolding)

    def sweep(self, point: OrbitUnknowns) -> Sweep:
        """Run all segments, and evaluate the rows and their derivatives."""
        flow, n = self.flow, 2 * self.flow.n
        legs: list[Leg] = []
        for number, state in enumerate(point.states):
            legs.append(flow.leg(number, state, point.period, point.values))
            if not np.isfinite(legs[-1].end).all():
                matrix = np.zeros((self.rows, self.columns))
                return Sweep(point, tuple(legs), np.full(self.rows, np.inf), matrix)
        rows, blocks = [np.zeros(0)], [np.zeros((0, self.columns))]
        for j, leg in enumerate(legs if self.closing is not None else legs[:-1]):
            block = self.spread(point.values, j, leg.slopes)
            if j < flow.segments - 1:
                gap = leg.end - point.states[j + 1]
                block[:, (j + 1) * n : (j + 2) * n] -= np.eye(n)
            else:
                gap = self._close(leg, point, block)
            rows.append(gap / self.scale)
            blocks.append(block * self.units / self.scale[:, None])
        first = Leg(point.states[0], np.eye(n, legs[0].slopes.shape[1]), np.nan)
        last = legs[-1]
        for j, leg, end, conditions in (
            (0, first, None, self.conditions),
            (-1, last, last.t, self.last),
        ):
            for condition in conditions:
                value, slopes = condition.row(flow, leg.end, point.period, point.values, end)
                through = slopes[:n] @ leg.slopes
                through[n:] += slopes[n:]
                row = self.spread(point.values, j % flow.segments, through) * self.units
                size = abs(row).max() or 1.0  # the change over the scale of the unknowns
                rows.append(np.array([value / size]))
                blocks.append(row / size)
        return Sweep(point, tuple(legs), np.concatenate(rows), np.concatenate(blocks))

    def spread(self, values: Floats, number: int, slopes: Floats) -> Floats:
        """Return derivatives by all unknowns, a row for each row of ``slopes``.

        ``slopes`` has the derivatives by the state at the start of a segment, by the period and by
        parameters.
        """
        n, (states, period, parameters, *_) = 2 * self.flow.n, self.ends
        by_state, by_period, by_parameter = np.split(np.atleast_2d(slopes), [n, n + 1], axis=1)
        if self.flow.period_of is not None:
            by_parameter = by_parameter + by_period * self.flow.period_of(values)[1]
        rows = np.zeros((len(by_state), self.columns))
        rows[:, number * n : (number + 1) * n] = by_state
        rows[:, states:period] = by_period  # no column if the period is not free
        rows[:, period:parameters] = by_parameter
        return rows

    def _close(self, leg: Leg, point: OrbitUnknowns, block: Floats) -> Floats:
        """Return the gap of the last segment, and complete its derivatives."""
        assert self.closing is not None
        n, (_, period, parameters, symbols, _) = 2 * self.flow.n, self.ends
        whole, first = self.closing.matrix, point.states[0]
        shift, slopes = self.closing.at(point.values, point.extra)
        block[:, :n] -= whole
        block[:, period:parameters] -= slopes[:, list(self.flow.places)]
        block[:, parameters:symbols] -= slopes[:, len(point.values) :]
        gap = leg.end - whole @ first - shift
        if self.unfolded:
            gradients = self.integrals.gradients(self.flow, first, point.values)
            # unfolding numbers are in units of the scale
            sizes = abs(gradients * self.scale).max(axis=1)
            fields = gradients * self.scale**2 / np.where(sizes > 0, sizes, 1.0)[:, None]
            block[:, symbols:] = whole @ fields.T
            gap = gap + block[:, symbols:] @ point.unfolding
        return gap

    def phases(self, sweep: Sweep) -> Floats:
        """Return rows along the symmetries of the orbit: corrections are orthogonal to them."""
        point, m, n = sweep.point, self.flow.segments, 2 * self.flow.n
        moved = [leg.slopes[:, n] * m for leg in sweep.legs]  # at the ends of segments
        if self.closing is not None:
            moved = [np.asarray(np.linalg.solve(self.closing.matrix, moved[-1])), *moved[:-1]]
        rows = [
            self.integrals.fields(self.flow, z, point.values, rate)
            for z, rate in zip(point.states, moved, strict=True)
        ]
        whole = np.zeros((len(rows[0]), self.columns))
        whole[:, : m * n] = np.concatenate(rows, axis=1) / np.tile(self.scale, m)
        sizes = np.linalg.norm(whole, axis=1)
        return whole[sizes > 0] / sizes[sizes > 0, None]

    def solve(
        self, start: OrbitUnknowns, across: Floats | None = None, most: int = MOST_ITERATIONS
    ) -> Solution:
        """Solve the equations by Newton's method with the smallest corrections.

        In scaled units, all corrections are orthogonal to the rows of ``across``. Ctrl-C returns
        the last iterate.
        """
        across = np.zeros((0, self.columns)) if across is None else across
        corrections = list[float]()
        with catch_interrupts() as stopped:
            sweep = self.sweep(start)
            while np.isfinite(sweep.size) and len(corrections) < most:
                change = self._correction(sweep, across)
                size = float(abs(change).max())
                close = size < LAST and corrections and corrections[-1] < CLOSE
                following = self._improved(sweep, change)
                if stopped or following is None:
                    break
                corrections.append(size)
                sweep = following
                if close:
                    return Solution(sweep, True, tuple(corrections))
            return Solution(sweep, False, tuple(corrections), interrupted=bool(stopped))

    def _correction(self, sweep: Sweep, across: Floats) -> Floats:
        """Return Newton's correction in scaled units, limited to a part of the scale."""
        rows = np.append(sweep.residual, np.zeros(len(across)))
        matrix = np.concatenate([sweep.matrix, across])
        change = np.linalg.lstsq(matrix, -rows, rcond=RANK)[0]
        states, period, *_ = self.ends
        limits = abs(change[:states]).max() / STATE_PART, *abs(change[states:period]) / PERIOD_PART
        return change / max(1.0, *limits)

    def _improved(self, sweep: Sweep, change: Floats) -> Sweep | None:
        """Return the rows after a correction or a part of it, if they do not grow much."""
        for halvings in range(MOST_HALVINGS):
            following = self.sweep(self.moved(sweep.point, change / 2**halvings))
            if following.size <= GROWTH * max(sweep.size, LAST):
                return following
        return None
