"""Derivatives of a run through events: event times, partial steps and actions (saltation).

A variation of the state changes the time of an event. The partial step before the event becomes
longer, and the partial step after it shorter. This module differentiates the scheme itself by the
duration of a partial step. The vector field would differ from that by the discretisation error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from symsimpson.errors import ResolutionWarning
from symsimpson.program.digits import read_precision
from symsimpson.program.evaluation import make_evaluator
from symsimpson.program.observed import observing_kernel
from symsimpson.program.program import Program
from symsimpson.program.recorders import tangents
from symsimpson.run.event_actions import EventMaps, read_restitution
from symsimpson.stepping.driving import inputs_from_step
from symsimpson.stepping.event import Impact
from symsimpson.stepping.inputs import STEP_ITSELF, program_with_derivatives
from symsimpson.stepping.run import Run
from symsimpson.stepping.run_events import RunEvents, check_variations
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.support.calling import warn

#: A crossing is grazing if its rate, relative to the mean rate of the partial step, is below this.
GRAZING_RATE = 1e-3
#: Duration of the partial steps, as a fraction of a step, whose derivatives give the vector field.
FIELD_STEP = 1e-4
#: An expression is zero if it would vanish within this fraction of a step.
ZERO_WITHIN = 1e-6
#: Partial steps below this fraction of a step have zero duration.
ZERO_DURATION = 1e-12
#: Number of digits, and the increment of differences: both give more than double precision.
DIGITS, DIFFERENCE = 60, "1e-25"


class Saltation:
    """Propagation of variations of the state through a step with events.

    The program must have the derivatives of the request. Raises InputError if the program has no
    T and V, or if inputs vary within a step.
    """

    def __init__(
        self, program: Program, run_events: RunEvents, parameters: Floats, h: float, inputs: Floats
    ) -> None:
        check_variations(program, inputs)
        varied = program.header.varied_by or ()
        by = STEP_ITSELF[:1] if program.header.autonomous else STEP_ITSELF
        self._program, self._by = program_with_derivatives(program, (*varied, *by)), by
        self._events, self._parameters = run_events, parameters
        self._h, self._inputs, self._variables = h, inputs, varied
        self._derivatives = EventDerivatives(program, run_events, parameters)
        #: Variations of the state (those by parameters and inputs last), and of the current time.
        self.columns, self.time_changes = np.zeros((2 * program.n, 0)), np.zeros(0)
        #: Number of the event that determines the current time, or None on the time grid.
        self._time_event: int | None = None

    def begin(self, rows: Floats) -> None:
        """Start a step with the variations in ``rows``; the time does not vary."""
        self.columns = rows.reshape(-1, 2 * self._program.n).T.copy()
        self.time_changes, self._time_event = np.zeros(self.columns.shape[1]), None

    def write_to(self, rows: Floats) -> None:
        """Write the variations to ``rows``, one after another."""
        rows[:] = self.columns.T.ravel()

    def propagate(self, state: State, t: float, size: float, step: int, event: int | None) -> None:
        """Propagate the variations over a partial step, up to an event or the end of the step."""
        if abs(size) <= ZERO_DURATION * abs(self._h):
            if event is not None:
                self._change_time_event(t, state, event, step)
            return
        columns, by_length, by_time, end = self._take_partial_step(state, t, size, step)
        columns = columns + np.outer(by_time, self.time_changes)
        if event is None:
            longer = -self.time_changes
        else:
            initial = self._derivatives.value(event, self._derivatives.point(t, *state))
            longer = self._event_time_changes(
                event, t + size, end, columns, by_length, initial / size
            )
        self.columns = columns + np.outer(by_length, longer)
        self.time_changes, self._time_event = self.time_changes + longer, event

    def fix_time(self, t: float, state: State, step: int) -> None:
        """Convert the variations to a fixed time after events whose time varies."""
        if self.time_changes.any():
            self.columns = self.columns - np.outer(
                self._vector_field(t, state, step), self.time_changes
            )
            self.time_changes = 0 * self.time_changes

    def _change_time_event(self, t: float, state: State, event: int, step: int) -> None:
        """Let another event at the same time determine the current time.

        An impact has no zero at this time if a change has moved the state into the wall. It then
        does not determine the time.
        """
        field, self._time_event = self._vector_field(t, state, step), event
        value, at, rate = self._event_at(event, t, state, field)
        if abs(value(at)) > ZERO_WITHIN * abs(rate * self._h):
            return
        self.fix_time(t, state, step)
        later = self._event_time_changes(event, t, state, self.columns, field, 0.0)
        self.columns = self.columns + np.outer(field, later)
        self.time_changes = later

    def _event_at(self, event: int, t: float, state: State, field: Floats) -> tuple[Any, Any, Any]:
        """Return the expression of an event as a function, the point of a state, and the rate."""
        at = self._derivatives.point(t, *state)
        value: Callable[[Any], Any] = partial(self._derivatives.value, event)
        motion = self._derivatives.point_variations(np.ones(1), field[:, None], ())
        return value, at, self._derivatives.slopes(value, at, motion)[0]

    def _vector_field(self, t: float, state: State, step: int) -> Floats:
        """Return the vector field: the derivative by the duration of a very short partial step."""
        sizes = FIELD_STEP * self._h, -FIELD_STEP * self._h
        fields = (self._take_partial_step(state, t, size, step)[1] for size in sizes)
        return np.asarray(sum(fields) / 2)

    def act(self, t: float, state: State, event: int, step: int) -> None:
        """Apply the derivative of the action of an event to the variations."""
        if event != self._time_event:
            self._change_time_event(t, state, event, step)
        at, act = self._derivatives.point(t, *state), partial(self._derivatives.act, event)
        variations = self._derivatives.point_variations(
            self.time_changes, self.columns, self._variables
        )
        slopes = self._derivatives.slopes(act, at, variations)
        self.columns = np.array(slopes, dtype=np.float64).T.reshape(self.columns.shape)

    def _event_time_changes(
        self, event: int, t: float, end: State, columns: Floats, by_length: Floats, mean: Any
    ) -> Floats:
        """Return the change of the time of an event for each variation.

        ``mean`` is the mean rate of the event expression over the partial step.
        """
        value, at, rate = self._event_at(event, t, end, by_length)
        variations = self._derivatives.point_variations(self.time_changes, columns, self._variables)
        if abs(rate) <= GRAZING_RATE * abs(mean):
            warn(
                f"{self._program.system}: the motion grazes {self._events.names[event]!r} at "
                f"t={t:g}. There the derivative of the event time by the state is unbounded.\n"
                "Later derivatives hold for this run, but hardly for runs nearby.",
                ResolutionWarning,
            )
        if rate == 0:
            return np.full(self.time_changes.shape, np.nan)
        slopes = self._derivatives.slopes(value, at, variations)
        return np.array([float(-slope / rate) for slope in slopes])

    def _take_partial_step(
        self, state: State, t: float, size: float, step: int
    ) -> tuple[Floats, Floats, Floats, State]:
        """Take a partial step with variations.

        Return the variations after it, the derivatives of its end by its duration and by its time,
        and the end state (q, p).
        """
        program, count = self._program, self.columns.shape[1]
        n, more = program.n, len(self._by)
        inputs = inputs_from_step(self._inputs, min(step, self._inputs.shape[1] - 1))[:, :1]
        recorders = (tangents(program.header, count + more),)
        run = Run(program, self._parameters, size, t, inputs=inputs, recorders=recorders)
        run.begin(*state, velocity=False)
        run.rows("TANGENTS", 1)[:] = count + more
        initial = np.concatenate([self.columns, np.zeros((2 * n, more))], axis=1)
        run.rows("TANGENT", initial.size)[:] = initial.T.ravel()
        run.advance(1)
        columns = run.recorder_rows().reshape(count + more, 2 * n).T
        if not run.alive:
            columns = np.full_like(columns, np.nan)
        by_time = columns[:, count + 1] if more > 1 else np.zeros(2 * n)
        q, p = (x[0] for x in run.end())
        return columns[:, :count], columns[:, count], by_time, (q, p)


class EventDerivatives:
    """Event expressions and states after events, in multiprecision, with their derivatives.

    A point is an array of t, q, p and the parameters.
    """

    def __init__(self, program: Program, run_events: RunEvents, parameters: Floats) -> None:
        numbers, header = read_precision(DIGITS, "mpmath"), program.header
        text = f"{program.source}\n\n{observing_kernel(header, run_events.watched)}"
        known = program.findings.many_digits
        if text not in known:  # parsing takes 50 ms
            known[text] = numbers.kernels(text, header)
        self._program = replace(program, numbers=numbers, kernels=known[text])
        self._events, self._parameters = run_events, parameters
        self._difference = numbers.read(DIFFERENCE).item()
        self._known: dict[tuple[Any, ...], EventMaps] = {}

    def point(self, t: float, q: Floats, p: Floats) -> Reals:
        """Return the point of a state, in multiprecision."""
        return self._program.numbers.read([t, *q, *p, *self._parameters])

    def point_variations(self, moved: Floats, columns: Floats, varied: Sequence[str]) -> Floats:
        """Return variations of points, one row each, from variations of time and state.

        The last rows also vary the parameters ``varied``.
        """
        names = self._program.header.parameters
        rows = np.zeros((columns.shape[1], 1 + len(columns) + len(names)))
        rows[:, 0], rows[:, 1 : 1 + len(columns)] = moved, columns.T
        for row, name in zip(rows[len(rows) - len(varied) :], varied, strict=True):
            if name in names:
                row[1 + len(columns) + names.index(name)] = 1.0
        return rows

    def value(self, event: int, z: Reals) -> Any:
        """Return the value of the expression of an event at a point."""
        maps, t, state = self._maps_at(z)
        return maps.row(t, state)[event]

    def act(self, event: int, z: Reals) -> Reals:
        """Return the state after an event as one array of q and p."""
        maps, t, state = self._maps_at(z)
        action, row = self._events.events[event].action, maps.row(t, state)
        if isinstance(action, Impact):
            values = z[1 + 2 * self._program.n :]
            law = read_restitution(self._program, action.restitution, values)
            state, _ = maps.apply_impact(t, state, row, event, law)
        elif self._events.changes[event]:
            state, _ = maps.apply_change(t, state, row, event)
        return np.concatenate(state)

    def slopes(self, function: Callable[[Reals], Any], at: Reals, variations: Floats) -> list[Any]:
        """Return the derivatives of a function along ``variations``, by differences.

        The error of a forward difference is far below the rounding of double precision.
        """
        here, slopes = function(at), []
        for variation in variations:
            size = np.abs(variation).max()
            d = self._difference / (size or 1)
            slopes.append((function(at + variation * d) - here) / d if size else 0 * here)
        return slopes

    def _maps_at(self, z: Reals) -> tuple[EventMaps, Any, tuple[Reals, Reals]]:
        """Split a point; return the event maps for its parameters, its time and its state."""
        program, n = self._program, self._program.n
        q, p, values = np.split(z[1:], [n, 2 * n])
        key = tuple(values)
        if key not in self._known:
            kernel = program.kernels.address("observe")
            rows = make_evaluator(program, self._events.watched, values, kernel)
            self._known[key] = EventMaps(program, self._events, values, rows)
        return self._known[key], z[0], (q, p)
