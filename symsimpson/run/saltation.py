"""Derivatives of a run through events: of the length of parts of steps, and of what events do.

Where a variation of the state moves the time of an event, the part of the step before it becomes
longer, and that behind it shorter. Both are differentiated as they were computed: by the length of
the step, not by the vector field, which differs from that by the error of the scheme.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from symsimpson.errors import ResolutionWarning
from symsimpson.program.digits import read_precision
from symsimpson.program.observed import observing_kernel, watching
from symsimpson.program.program import Program
from symsimpson.program.recorders import tangents
from symsimpson.run.event_actions import EventMaps, read_restitution
from symsimpson.stepping.driving import since
from symsimpson.stepping.event import Impact
from symsimpson.stepping.inputs import STEP_ITSELF, varied_program
from symsimpson.stepping.run import Run
from symsimpson.stepping.run_events import RunEvents, check_variations
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.support.calling import warn

#: What is zero with a rate below this part of that over the part of the step is grazed.
GRAZED = 1e-3
#: The part of a step over which the vector field is a mean of two derivatives by the length.
SHORT = 1e-4
#: What would be zero, or was, within this part of a step is zero, but for rounding.
AWAY = 1e-6
#: Parts of a step that are shorter than this part of it have no length.
NOTHING = 1e-12
#: So many digits, and differences that leave as many of a derivative as doubles have, and more.
DIGITS, DIFFERENCE = 60, "1e-20"


class Saltation:
    """Carries variations of the state through a step in which events act.

    The program is one whose module differentiates by what ``sensitivities`` are asked for. Raises
    InputError if the system is not known, or inputs vary within a step.
    """

    def __init__(
        self, program: Program, run_events: RunEvents, parameters: Floats, h: float, inputs: Floats
    ) -> None:
        check_variations(program, inputs)
        varied = program.header.varied_by or ()
        by = STEP_ITSELF[:1] if program.header.autonomous else STEP_ITSELF
        self._program, self._by = varied_program(program, (*varied, *by)), by
        self._events, self._parameters = run_events, parameters
        self._h, self._inputs, self._own = h, inputs, varied
        self._jumps = Jumps(program, run_events, parameters)
        #: Variations of the state, those by parameters and inputs last, and of the time at hand.
        self.columns, self.moved = np.zeros((2 * program.n, 0)), np.zeros(0)
        #: The event whose time it is that has come.
        self._timed: int | None = None

    def begin(self, rows: Floats) -> None:
        """Begin a step with variations, one after the other, whose time does not vary."""
        self.columns = rows.reshape(-1, 2 * self._program.n).T.copy()
        self.moved, self._timed = np.zeros(self.columns.shape[1]), None

    def put(self, rows: Floats) -> None:
        """Put the variations there, one after the other."""
        rows[:] = self.columns.T.ravel()

    def flow(self, state: State, t: float, size: float, step: int, event: int | None) -> None:
        """Carry them through a part of a step, up to an event or to the end of the step."""
        if abs(size) <= NOTHING * abs(self._h):
            if event is not None:
                self._retime(t, state, event, step)
            return
        columns, by_length, by_time, end = self._carried(state, t, size, step)
        columns = columns + np.outer(by_time, self.moved)
        if event is None:
            longer = -self.moved
        else:
            begun = self._jumps.value(event, self._jumps.point(t, *state))
            longer = self._later(event, t + size, end, columns, by_length, begun / size)
        self.columns = columns + np.outer(by_length, longer)
        self.moved, self._timed = self.moved + longer, event

    def settle(self, t: float, state: State, step: int) -> None:
        """Carry them back to the time itself, behind events that are there and move with them."""
        if self.moved.any():
            self.columns = self.columns - np.outer(self._field(t, state, step), self.moved)
            self.moved = 0 * self.moved

    def _retime(self, t: float, state: State, event: int, step: int) -> None:
        """Let the time that has come be that of another event, which is there, too.

        An impact on a wall behind which a change has led has no zero there, and no time of its own.
        """
        field, self._timed = self._field(t, state, step), event
        value, at, rate = self._watched(event, t, state, field)
        if abs(value(at)) > AWAY * abs(rate * self._h):
            return
        self.settle(t, state, step)
        later = self._later(event, t, state, self.columns, field, 0.0)
        self.columns = self.columns + np.outer(field, later)
        self.moved = later

    def _watched(self, event: int, t: float, state: State, field: Floats) -> tuple[Any, Any, Any]:
        """Return the expression of an event, the point of a state, and its rate there."""
        at = self._jumps.point(t, *state)
        value: Callable[[Any], Any] = partial(self._jumps.value, event)
        (motion,) = self._jumps.ways(np.ones(1), field[:, None], ())
        return value, at, self._jumps.slope(value, at, motion)

    def _field(self, t: float, state: State, step: int) -> Floats:
        """Return the derivative by the length of parts of no length: the vector field."""
        sizes = SHORT * self._h, -SHORT * self._h
        ways = (self._carried(state, t, size, step)[1] for size in sizes)
        return np.asarray(sum(ways) / 2)

    def act(self, t: float, state: State, event: int, step: int) -> None:
        """Let an event act on them, at a time of its own."""
        if event != self._timed:
            self._retime(t, state, event, step)
        at, act = self._jumps.point(t, *state), partial(self._jumps.act, event)
        ways = self._jumps.ways(self.moved, self.columns, self._own)
        slopes = [self._jumps.slope(act, at, way) for way in ways]
        self.columns = np.array(slopes, dtype=np.float64).T.reshape(self.columns.shape)

    def _later(
        self, event: int, t: float, end: State, columns: Floats, by_length: Floats, mean: Any
    ) -> Floats:
        """Return by how much the event comes later, for each of the variations.

        ``mean`` is the rate at which the expression came to be zero, over the part of the step.
        """
        value, at, rate = self._watched(event, t, end, by_length)
        ways = self._jumps.ways(self.moved, columns, self._own)
        if abs(rate) <= GRAZED * abs(mean):
            warn(
                f"{self._program.system}: at t={t:g} {self._events.names[event]!r} is grazed: the "
                "time of the event depends on the state without bound, and so do derivatives "
                "after it.\nThey are those of the run, and tell little of runs nearby.",
                ResolutionWarning,
            )
        if rate == 0:
            return np.full(self.moved.shape, np.nan)
        return np.array([float(-self._jumps.slope(value, at, way) / rate) for way in ways])

    def _carried(
        self, state: State, t: float, size: float, step: int
    ) -> tuple[Floats, Floats, Floats, State]:
        """Return variations behind a part of a step, derivatives by its length and its time."""
        program, count = self._program, self.columns.shape[1]
        n, more = program.n, len(self._by)
        held = since(self._inputs, min(step, self._inputs.shape[1] - 1))[:, :1]
        recorders = (tangents(program.header, count + more),)
        run = Run(program, self._parameters, size, t, 0, 1, inputs=held, recorders=recorders)
        run.begin(*state, velocity=False)
        run.rows("TANGENTS", 1)[:] = count + more
        begun = np.concatenate([self.columns, np.zeros((2 * n, more))], axis=1)
        run.rows("TANGENT", begun.size)[:] = begun.T.ravel()
        run.advance(1)
        columns = run.left().reshape(count + more, 2 * n).T
        if not run.alive:
            columns = np.full_like(columns, np.nan)
        by_time = columns[:, count + 1] if more > 1 else np.zeros(2 * n)
        q, p = (x[0] for x in run.end())
        return columns[:, :count], columns[:, count], by_time, (q, p)


class Jumps:
    """Values of expressions of events, and states after them, in many digits.

    A point is an array of t, q, p and the parameters.
    """

    def __init__(self, program: Program, run_events: RunEvents, parameters: Floats) -> None:
        numbers, header = read_precision(DIGITS, "mpmath"), program.header
        text = f"{program.source}\n\n{observing_kernel(header, run_events.watched)}"
        known = program.findings.many_digits
        if text not in known:  # reading a text takes 50 ms
            known[text] = numbers.kernels(text, header)
        self._program = replace(program, numbers=numbers, kernels=known[text])
        self._events, self._parameters = run_events, parameters
        self._difference = numbers.read(DIFFERENCE).item()

    def point(self, t: float, q: Floats, p: Floats) -> Reals:
        """Return the point of a state."""
        return self._program.numbers.read([t, *q, *p, *self._parameters])

    def ways(self, moved: Floats, columns: Floats, varied: Sequence[str]) -> Floats:
        """Return variations of points: of the time, the state, and of parameters by the last."""
        names = self._program.header.parameters
        ways = np.zeros((columns.shape[1], 1 + len(columns) + len(names)))
        ways[:, 0], ways[:, 1 : 1 + len(columns)] = moved, columns.T
        for way, name in zip(ways[len(ways) - len(varied) :], varied, strict=True):
            if name in names:
                way[1 + len(columns) + names.index(name)] = 1.0
        return ways

    def value(self, event: int, z: Reals) -> Any:
        """Return the expression of an event at a point."""
        maps, t, state = self._at(z)
        return maps.row(t, state)[event]

    def act(self, event: int, z: Reals) -> Reals:
        """Return q and p after an event."""
        maps, t, state = self._at(z)
        action, row = self._events.events[event].action, maps.row(t, state)
        if isinstance(action, Impact):
            values = z[1 + 2 * self._program.n :]
            law = read_restitution(self._program, action.restitution, values)
            state, _ = maps.hit(t, state, row, event, law)
        elif self._events.changes[event]:
            state, _ = maps.change(t, state, row, event)
        return np.concatenate(state)

    def slope(self, function: Callable[[Reals], Any], at: Reals, way: Floats) -> Any:
        """Return the derivative of a function along a way, by a central difference."""
        size = np.abs(way).max()
        if size == 0:
            return 0 * function(at)
        d = self._difference / size
        return (function(at + way * d) - function(at - way * d)) / (2 * d)

    def _at(self, z: Reals) -> tuple[EventMaps, Any, tuple[Reals, Reals]]:
        """Return the maps for the parameters of a point, its time and its state."""
        program, n = self._program, self._program.n
        q, p, values = np.split(z[1:], [n, 2 * n])
        kernel = program.kernels.address("observe")
        rows = watching(program, self._events.watched, values, kernel)
        return EventMaps(program, self._events, values, rows), z[0], (q, p)
