"""Runs with events that act: steps are split where one is, and the grid of times is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.observed import OF_EVENTS, Reduction
from symsimpson.program.recorders import Recorder
from symsimpson.program.status import Status
from symsimpson.results.events import Record
from symsimpson.run.event_actions import EventActions
from symsimpson.run.event_locator import LOST, EventLocator, Sides, plain_restitution
from symsimpson.stepping.event import Impact
from symsimpson.stepping.parts import LEAST, Parts
from symsimpson.stepping.run import Run
from symsimpson.stepping.run_events import RunEvents
from symsimpson.support.array_types import Floats, Reals
from symsimpson.text.driver.impacts import NOTHING, TOGETHER
from symsimpson.text.interface import ARRIVED, MET, RECORDERS, WATCHED
from symsimpson.text.workspace_layout import DRIVER_LAYOUT

if TYPE_CHECKING:
    from symsimpson.program.program import Program
    from symsimpson.run.saltation import Saltation
    from symsimpson.stepping.spec import RunSpec


#: So many actions within one step are too many; a start may be so far behind a wall, relative to
#: its size.
MOST_ACTIONS, BEHIND = 500, 1e-9
#: So many steps are taken at first before Ctrl-C is heard.
FEW_STEPS = 16
#: When impacts that lose energy have acted within a step, by their numbers.
Times = dict[int, list[float]]
#: Impacts whose times add up to less than this part of a step from the last one on accumulate; from
#: one to the next they have one ratio then, but for that part of it.
ACCUMULATED, STEADY = 1e-6, 0.1


class EventRun(Run):
    """A run in which events act: a step in which one is, is taken back, and anew in parts."""

    def __init__(
        self,
        program: Program,
        spec: RunSpec,
        run_events: RunEvents,
        stride: int,
        stored: int,
        inputs: Reals,
        recorders: Sequence[Recorder],
    ) -> None:
        first = program.header.rows + sum(recorder.room for recorder in recorders)
        watchers = run_events.watchers(program.header, first)
        given = spec.parameters, spec.h, spec.t0, stride, stored
        super().__init__(program, *given, inputs=inputs, recorders=(*recorders, *watchers))
        self._events, self._steps, self._system = run_events, spec.steps, program.system
        self._actions = EventActions(program, spec, run_events)
        works = any(recorder.name == "work" for recorder in recorders)
        self._parts = Parts(program, spec.parameters, float(spec.h), inputs, works=works)
        rows = self._column[first : first + WATCHED * len(run_events.events)]
        side, size, self._value, self._earlier = rows.reshape(-1, WATCHED).T
        self.sides = Sides((side, size), self._actions, run_events, self._parts, float(spec.h))
        self._code, self._saltation = 0, cast("Saltation | None", None)
        self._stretch = FEW_STEPS
        if spec.tangents is not None:
            from symsimpson.run.saltation import Saltation  # few runs need it

            self._saltation = Saltation(program, run_events, spec.parameters, float(spec.h), inputs)
        watch = self._actions.rows
        self._locator = EventLocator(program, run_events, self._parts, watch, first, self.records)
        restitution = plain_restitution(program, run_events, spec, self._actions)
        if restitution is not None and not (inputs.size or works):
            self._take_steps = partial(self._locator.take_steps, restitution)

    def beside(self, recorded: Reals, result: Any) -> dict[str, Any]:
        """Return what is known beside states, with what events did."""
        acted = {"records": tuple(self.records), "event_names": self._events.names}
        return {**super().beside(recorded, result), **acted, "ended_by": self.ended_by}

    def look(self) -> None:
        """Look at the start: impacts that touch act there, none may be behind its wall."""
        state, t = self._state(), float(self.t0)
        row = self._actions.row(t, state)
        sides, values = self.sides, row[: len(self._value)]
        moved, sizes = self.h * self._actions.rates(row), self._actions.sizes(row, state[0])
        sides.size[:] = np.max([abs(values), abs(moved), sizes], axis=0)
        sides.side[:] = 0  # a zero there is no event
        small = sides.small_at(t, state)
        sides.due(t, state, 0, small)
        sides.side[:] = sides.of(values, small)
        for k, event in enumerate(self._events.events):
            if not (isinstance(event.action, Impact) and self._actions.allowed(row, k)):
                continue
            if values[k] < -BEHIND * sides.size[k]:
                reject(
                    f"{self._system}: the initial state violates the gap {event.key!r}: its value "
                    f"is {values[k]:g}.",
                    remedy="Begin where it is positive, or turn its sign.",
                )
            sides.side[k] = 1
        if self._actions.touching(values, sides.small).any():
            self._act_here(t, 0, state, [])
        self._remember()
        super().look()

    def reduced(self, reductions: Sequence[Reduction]) -> tuple[tuple[str, float], ...]:
        """Return what observed values came to, and how often events acted."""
        known = dict(super().reduced(reductions))
        names = [self._events.names[record.event] for record in self.records]
        for candidate in reductions:
            if candidate.kind == OF_EVENTS:
                known[candidate.name] = float(names.count(candidate.expression))
        return tuple((reduction.name, known[reduction.name]) for reduction in reductions)

    def take(self, stop: int) -> None:
        """Take steps with the same kernels, in parts where there is an event."""
        while True:
            super().take(stop)
            kink = self._column[self._status] == Status.NOT_FINITE and self._events.split_alone()
            kink = kink and self._set + 1 == len(self._fallbacks)
            if not (kink or self._column[self._status] == MET) or self.reason:
                break
            self._split_step(taken=not kink)
        if self.step == self._steps and self.alive:
            self._finish()

    @property
    def hopeful(self) -> bool:
        """Whether other kernels may take a step that failed: not one in which events are."""
        return not self.reason and super().hopeful

    def position(self) -> list[Any]:
        """Return what tells, beside the workspace, where the run is."""
        return [*super().position(), self.reason, [record.as_json for record in self.records]]

    def put_back(self, position: Sequence[Any], workspace: Floats) -> None:
        """Go on where another run was."""
        *rest, reason, records = position
        super().put_back(rest, workspace)
        self.records[:] = [Record.read(entry) for entry in records]
        self._look_for_end()
        self.reason = reason

    def _state(self) -> tuple[Floats, Floats]:
        """Return q and p where the run is."""
        return self.end()[0][0], self.end()[1][0]

    def _remember(self) -> None:
        """Keep the values of expressions where the run is, and those before, by their rates."""
        row = self._actions.row(float(self._time()), self._state())
        self._value[:] = row[: len(self._value)]
        self.sides.size[:] = np.fmax(self.sides.size, np.abs(self._value))
        self._earlier[:] = self._value - self.h * self._actions.rates(row)
        self.sides.mark(self._value)

    def _split_step(self, *, taken: bool) -> None:
        """Take a step again, with the events in it; first undo the step if it was taken."""
        self._progress[0] -= taken
        behind, rows = self.W.copy(), 4 * self.header.n
        if taken:  # else it ends on a kink
            self.rows("POSITION", rows)[:] = self.rows("PREVIOUS", rows)
        self._column[self._status] = 0
        step, acted = self.step, len(self.records)
        start, side = self._state(), self.sides.side.copy()
        worked = self._worked.copy()
        state = self._split(step, start)
        if state is None:
            self._worked[:] = worked if self.ended_by is None else self._worked
            t, *end = self.end_within or (float(self._time()),)
            part = t - float(self._time())
            if abs(part) > TOGETHER * max(abs(t), abs(float(self.h))):  # recorders of states see it
                self._go_on((end[0], end[1]))
                self._call(t, of_states=True, h=part)
            self._go_on(start)
            self._column[self._status] = self._code
            if self._code == ARRIVED and self._saltation is not None:
                self._saltation.put(self._variations)
            return
        same = (np.sign(self.sides.side) == np.sign(side)).all()
        if same and taken and len(self.records) == acted:  # nothing was there
            side, size = self.sides.side.copy(), self.sides.size.copy()
            self.W[:] = behind
            self.sides.side[:], self.sides.size[:] = side, size
            self._column[self._status] = 0
            self._call(self._time(), of_states=False)
            self._progress[0] += 1
        else:
            self._progress[0] += 1
            self._go_on(state)
            if self._saltation is not None:
                self._saltation.put(self._variations)
        self._remember()
        self._call(self._time(), of_states=True)
        if self.every and self._progress.item(0) % self.every == 0:
            self.store(place := self._progress.item(0) // self.every)
            self.iterations[place, 0] = self.last_iterations
            self.rows("ITERATIONS", 1)[:] = 0

    def _go_on(self, state: tuple[Floats, Floats]) -> None:
        """Go on from another state; recorders keep what they have."""
        q, p = state
        self.rows("POSITION", 4 * self.header.n)[:] = 0
        self.rows("POSITION", len(q))[:], self.rows("MOMENTUM", len(p))[:] = q, p
        kept = self.rows("ITERATIONS", 1).copy()
        self._driver("begin")(self._kernels(), 0, self.h, self._time(), self.W, self.driver_layout)
        self.rows("ITERATIONS", 1)[:] = kept

    def _call(self, passed: Any, *, of_states: bool, h: Any = None) -> None:
        """Call recorders of states, or those of steps."""
        kernels, at = self._kernels(), DRIVER_LAYOUT
        first = RECORDERS + self.driver_layout[at["OF_EVENTS"]]
        last = len(kernels) - self.driver_layout[at["OF_STATES"]]
        self.rows("ACTIVE", 1)[:] = 1
        for kernel in kernels[last:] if of_states else kernels[first:last]:
            self._driver("apply")(kernel, self.h if h is None else h, passed, self.W)

    def _split(self, step: int, start: Any) -> Any:
        """Take a step with events in it; None where the run ends within it."""
        h, t0, done = float(self.h), float(self.t0 + self.h * step), 0.0
        state, times = start, Times()
        self._actions.touched.clear()
        if self._saltation is not None:
            self._saltation.begin(self._variations)
        latest = set[int]()
        for _ in range(MOST_ACTIONS):
            rest = h - done
            if abs(rest) <= NOTHING * abs(h):
                if self._saltation is not None:
                    self._saltation.settle(t0 + done, state, step)
                return state
            end, status = self._parts.beside(state, t0 + done, rest, step, done / h, LEAST)
            if status is not Status.SUCCESS:
                return self._fail(status)
            crossing = self._located(step, t0, done, rest, state, end)
            if crossing is None:
                if self._code:
                    return None
                row = self._actions.row(t0 + h, end)
                if np.isnan(row[: len(self._value)][self._actions.impacts]).any():
                    return self._fail(Status.NOT_FINITE, "A gap has no value beyond its wall. ")
                self.sides.settle(row, end[0])
                self._flow(state, t0 + done, rest, step, None)
                return end
            part, behind, events = crossing
            given = t0 + done, state, (step, done / h)
            why = (
                f"{self._events.names[events[0]]!r} is touched at rest at t={t0 + done + part!r}. "
            )
            if {*events} <= latest and self.sides.stays(crossing, *given):
                return self._fail(Status.EVENTS_ACCUMULATE, why)
            part, behind, there, self._actions.beyond = self.sides.astride(crossing, *given)
            self._flow(state, t0 + done, part, step, events[0])
            done, latest = done + there, {*events}
            pressed = self._actions.pressed(t0 + done, behind, part, events, self.sides.small)
            state = behind if pressed else self._act(t0 + done, step, behind, events, times)
            if state is None:
                return None
            still = pressed or (not part and state is behind)
            if still and self._actions.may_all_hit(t0 + done, state, events):
                return self._fail(Status.EVENTS_ACCUMULATE, why)
        why = f"More than {MOST_ACTIONS} events act within one step, or one acts for ever. "
        return self._fail(Status.EVENTS_ACCUMULATE, why + "Take a smaller h if they do not. ")

    def _flow(self, state: Any, t: float, part: float, step: int, event: int | None) -> None:
        """Carry variations through a part of a step, and add up the work in it."""
        if self._saltation is not None:
            self._saltation.flow(state, t, part, step, event)
        share = (t - float(self.t0 + self.h * step)) / float(self.h)
        self._worked[:] += self._parts.work(state, t, part, step, share)

    def _located(
        self, step: int, t0: float, done: float, rest: float, start: Any, end: Any
    ) -> tuple[float, Any, list[int]] | None:
        """Find the first events of the rest of a step: when, where, and which."""
        h, t, place = float(self.h), t0 + done, (step, done / float(self.h))

        def row(part: float) -> Floats:
            state, status = self._parts.beside(start, t, part, *place)
            state = state if status is Status.SUCCESS else (np.nan * start[0], np.nan * start[1])
            return self._actions.row(t + part, state)

        if not done and (due := self.sides.due(t0, start, step, self.sides.small_at(t0, start))):
            return 0.0, start, due
        first, last = self._actions.row(t, start), self._actions.row(t0 + h, end)
        zeros = self.sides.between(row, rest, first, last)
        sides, ends = (self.sides.side.copy(), self.sides.size.copy()), (first, last, end[0])
        event, state = self._locator.locate(start, t, place, rest, ends, zeros, sides)
        if event == LOST:
            self._fail(Status.NOT_FINITE, "A part of a step to an event has no value. ")
        if event < 0:
            return None
        part = zeros.item(event)
        near = TOGETHER * max(abs(t + part), abs(h))
        return part, state, np.flatnonzero(np.abs(zeros - part) <= near).tolist()

    def _act(self, t: float, step: int, state: Any, events: Sequence[int], times: Times) -> Any:
        """Let events act on a state, and keep records; None where the run ends with them."""
        row, small, given = self._actions.row(t, state), self.sides.small, state
        allowed = [k for k in events if self._actions.allowed(row, k)]
        for k in events:  # an impact leads back to its side, unless it is not allowed
            if not (k in allowed and self._actions.impacts[k]):
                self.sides.side[k] = -np.sign(self.sides.side[k])
        done = list(self._actions.acted(t, state, allowed, small))
        several = len({k for k, *_, impulse in done if impulse}) > 1
        for k, before, behind, impulse in done:
            state = behind
            if self._saltation is not None:
                self._saltation.act(t, before, k, step)
            impact = bool(self._actions.impacts[k])
            direction, together = -1 if impact else int(self.sides.side[k]), several and impact
            self.records.append(Record(k, t, step, *before, *behind, direction, impulse, together))
            if self._actions.loses(k, before, behind, t):
                times.setdefault(k, []).append(t)
        if self._actions.failed:
            return self._fail(Status.BAD_INPUT, self._actions.failed)
        for k, _, (q, p), _ in done:
            if not (np.isfinite(q).all() and np.isfinite(p).all()):
                why = f"The change of {self._events.names[k]!r} has no value at t={t:g}. "
                return self._fail(Status.NOT_FINITE, why)
        if self._look_for_end():
            return None
        if state is not given and self._actions.beyond is None:
            share = (t - float(self.t0 + self.h * step)) / float(self.h)
            self.sides.renew(allowed, t, given, state, (step, share))
        if (limit := accumulation(times, abs(float(self.h)))) is None:
            return state
        k, about = limit
        why = f"{self._events.names[k]!r} acts ever faster up to t={about!r}. "
        return self._fail(Status.EVENTS_ACCUMULATE, why)

    @property
    def _worked(self) -> Floats:
        """Rows of the work of forces, if it is recorded."""
        return self.rows("WORK", self.header.powers) if self._parts.works else self._column[:0]

    @property
    def _variations(self) -> Floats:
        """Rows in which variations of the state stand, one after the other."""
        return self.rows("TANGENT", 2 * self.header.n * int(self.value("TANGENTS")))

    def _look_for_end(self) -> bool:
        """Look whether an event has ended the run."""
        last = self._events.last_of(self.records)
        if last is not None:
            self.ended_by, self._code = self._events.names[last.event], ARRIVED
            self.end_within = last.t, last.q_after, last.p_after
            self.reason = f"{self.ended_by!r} ended the run at t={last.t:g}."
        return last is not None

    def _finish(self) -> None:
        """Let events act whose zero is the last state, unless they have just done so."""
        t, state = float(self._time()), self._state()
        here = self.sides.ending(t, state, self.step)
        near = TOGETHER * max(abs(t), abs(float(self.h)))
        here[[record.event for record in self.records if abs(record.t - t) <= near]] = False
        if events := np.flatnonzero(here).tolist():
            self._act_here(t, self.step, state, events)

    def _act_here(self, t: float, step: int, state: Any, events: list[int]) -> None:
        """Let events act on the state where the run is, which is one of the grid."""
        if self._saltation is not None:
            self._saltation.begin(self._variations)
        self._actions.beyond = None
        new_state = self._act(t, step, state, events, {})
        if new_state is None and self.end_within is not None:
            new_state = self.end_within[1:]
        if new_state is not None:
            self._go_on(new_state)
            if self._saltation is not None:
                if self.ended_by is None:
                    self._saltation.settle(t, new_state, step)
                self._saltation.put(self._variations)
            if self.every and self._progress.item(0) % self.every == 0:
                self.store(self._progress.item(0) // self.every)
        self._column[self._status] = self._code

    def _fail(self, status: Status, why: str = "") -> None:
        general = status.message if status is Status.EVENTS_ACCUMULATE or not why else ""
        self._code, self.reason = int(status), f"{why}{general}".strip()


def accumulation(times: Mapping[int, Sequence[float]], h: float) -> tuple[int, float] | None:
    """Return the impact that accumulates within a step of length h, and up to when; or None.

    The times between its hits form an infinite geometric series.
    """
    for k, hits in times.items():
        if len(hits) >= 4:
            first, late, later = np.diff(hits[-4:]).tolist()
            before, ratio = (late / first, later / late) if first and late else (1.0, 1.0)
            left = ratio / (1 - ratio) * later if 0 <= ratio < 1 else np.inf
            if abs(ratio - before) <= STEADY * abs(before) and abs(left) < ACCUMULATED * h:
                return k, float(hits[-1] + left)
    return None
