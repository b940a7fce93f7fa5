"""Runs with events: a step with an event is split, and the next step returns to the time grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.observed import OF_EVENTS, Reduction
from symsimpson.program.recorders import Recorder
from symsimpson.program.status import Status
from symsimpson.results.event_record import EventRecord
from symsimpson.run.event_actions import EventActions
from symsimpson.run.event_locator import (
    STEP_FAILED,
    EventLocator,
    EventSigns,
    read_plain_restitution,
)
from symsimpson.stepping.driving import interpolate_inputs
from symsimpson.stepping.event import Impact
from symsimpson.stepping.parts import SMALLEST_NUDGES, PartialSteps
from symsimpson.stepping.run import Run
from symsimpson.stepping.run_events import RunEvents
from symsimpson.support.array_types import Floats, Reals, State
from symsimpson.text.driver.impacts import NOTHING, TOGETHER
from symsimpson.text.interface import ARRIVED, MET, RECORDERS, WATCHED
from symsimpson.text.workspace_layout import DRIVER_LAYOUT

if TYPE_CHECKING:
    from symsimpson.program.program import Program
    from symsimpson.run.saltation import Saltation
    from symsimpson.stepping.spec import RunSpec


#: Largest number of actions within one step, and largest penetration of a wall by the initial
#: state, relative to the size of the gap.
MOST_ACTIONS, LARGEST_PENETRATION = 500, 1e-9
#: Number of steps before the first check for Ctrl-C.
FEW_STEPS = 16
#: Times of dissipative impacts within a step, by number of the event.
Times = dict[int, list[float]]
#: Impacts accumulate if the times still to come add up to less than ``REMAINING_TIME`` of a step.
#: The ratio of successive intervals must be constant up to the fraction ``RATIO_TOLERANCE``.
REMAINING_TIME, RATIO_TOLERANCE = 1e-6, 0.1


class EventRun(Run):
    """A run with events: it undoes a step that contains an event and repeats it in parts.

    A run may be a piece of another one. It then begins at a step and a duration within it
    (``begin_at``), ``continues`` the sums of its recorders, and ``pauses`` at a terminal event.
    """

    begin_at: tuple[int, float] = (0, 0.0)
    ending: frozenset[int] = frozenset()  #: Events at which a piece ends before they act.
    time_changes: Floats | None = None  #: Variations of the time at which a piece begins.
    continues = pauses = False

    def __init__(
        self,
        program: Program,
        spec: RunSpec,
        run_events: RunEvents,
        storage: tuple[int, int],
        inputs: Reals,
        recorders: Sequence[Recorder],
    ) -> None:
        first = program.header.rows + sum(recorder.room for recorder in recorders)
        watchers = run_events.watchers(program.header, first)
        given = spec.parameters, spec.h, spec.t0, storage
        super().__init__(program, *given, inputs=inputs, recorders=(*recorders, *watchers))
        self._events, self._steps, self._system = run_events, spec.steps, program.system
        self._actions = EventActions(program, spec, run_events)
        works = any(recorder.name == "work" for recorder in recorders)
        self._parts = PartialSteps(program, spec.parameters, float(spec.h), inputs, works=works)
        rows = self._column[first : first + WATCHED * len(run_events.events)]
        side, size, self._value, self._earlier = rows.reshape(-1, WATCHED).T
        self.sides = EventSigns((side, size), self._actions, run_events, self._parts, float(spec.h))
        self._code, self._saltation = 0, cast("Saltation | None", None)
        self._batch = FEW_STEPS
        if spec.tangents is not None:
            from symsimpson.run.saltation import Saltation  # few runs need it

            self._saltation = Saltation(program, run_events, spec.parameters, float(spec.h), inputs)
        watch = self._actions.rows
        self._locator = EventLocator(program, run_events, self._parts, watch, first, self.records)
        driven = [x.held or x.driven for x in run_events.watched[: len(run_events.events)]]
        #: Events whose expressions depend on inputs, and may jump where inputs do.
        self._driven = np.array(driven, dtype=np.bool_) & bool(inputs.size)
        self._input_step = 0  # the step whose inputs count
        if self._driven.any():
            self._actions.rows.inputs_at = partial(self._inputs_at, program)
        varies = bool(inputs.size) and inputs.shape[2] > 1
        self._varies = bool(self._driven.any()) and varies  # the compiled loop cannot watch it
        restitution = read_plain_restitution(program, run_events, spec, self._actions)
        if restitution is not None and not (inputs.size or works or self.pauses):
            self._take_steps = partial(self._locator.take_steps, restitution)

    def recorded_fields(self, recorded: Reals, result: Any) -> dict[str, Any]:
        """Split recorded rows into fields of a trajectory; add the records of events."""
        acted = {"records": tuple(self.records), "event_names": self._events.names}
        return {**super().recorded_fields(recorded, result), **acted, "ended_by": self.ended_by}

    def observe_start(self) -> None:
        """Let impacts that touch at the initial state act; reject a state inside a wall."""
        step, done = self.begin_at
        state, t = self._state(), float(self.t0 + self.h * step) + done
        self._input_step = step
        row = self._actions.row(t, state)
        sides, values = self.sides, row[: len(self._value)]
        moved, sizes = self.h * self._actions.rates(row), self._actions.sizes(row, state[0])
        h = float(self.h)
        after, _ = self._parts(state, t, h - done, step, done / h)
        ahead = np.nan_to_num(self._actions.values(t + h - done, after), posinf=0, neginf=0)
        ahead[values >= 0] = 0  # the only size of a gap that starts at rest and slightly below 0
        sides.size[:] = np.max([abs(values), abs(moved), abs(ahead), sizes], axis=0)
        sides.side[:] = 0  # a zero at the initial state is not an event
        small = sides.small_at(t, state)
        sides.events_at_start(t, state, step, small, done / h)
        sides.side[:] = sides.signs_of(values, small)
        for k, event in enumerate(self._events.events):
            if not (isinstance(event.action, Impact) and self._actions.may_act(row, k)):
                continue
            if not self.pauses and values[k] < -LARGEST_PENETRATION * sides.size[k]:
                reject(
                    f"the initial state violates the gap {event.key!r}, "
                    f"whose value is {values[k]:g}.",
                    where=self._system,
                    remedy="Start where the gap is positive, or change the sign of the gap.",
                )
            sides.side[k] = 1
        if not self.pauses and self._actions.touching_impacts(values, sides.small).any():
            self._act_at_current_state(t, step, state, [])
        if not done:
            self._store_values()
        if not self.continues:
            super().observe_start()

    def reduction_values(self, reductions: Sequence[Reduction]) -> tuple[tuple[str, float], ...]:
        """Return the names and current values of reductions, including counts of events."""
        known = dict(super().reduction_values(reductions))
        names = [self._events.names[record.event] for record in self.records]
        for candidate in reductions:
            if candidate.kind == OF_EVENTS:
                known[candidate.name] = float(names.count(candidate.expression))
        return tuple((reduction.name, known[reduction.name]) for reduction in reductions)

    def take(self, stop: int) -> None:
        """Take steps with the current kernels; split steps with events."""
        while True:
            super().take(min(stop, self.step + 1) if self._varies else stop)
            if self._varies and self.alive:
                self._check_values()
            kink = self._column[self._status] == Status.NOT_FINITE and self._events.split_alone()
            kink = kink and self._fallback + 1 == len(self._fallbacks)
            if not (kink or self._column[self._status] == MET) or self.reason:
                break
            self._split_step(completed=not kink)
        if self.step == self._steps and self.alive:
            self._finish()

    def _check_values(self) -> None:
        """Stop after a step in which an expression of inputs has changed its sign."""
        self._input_step = self.step - 1
        values = self._actions.values(float(self._grid_time()), self._state())
        new = self.sides.signs_of(values, self.sides.small)
        if (self._driven & self.sides.acting_events(new)).any():
            self._column[self._status] = MET

    @property
    def can_recover(self) -> bool:
        """True if fallback kernels may succeed at the failed step; False if an event failed."""
        return not self.reason and super().can_recover

    def position(self) -> list[Any]:
        """Return counters, message and records that, with the workspace, restore the run."""
        return [*super().position(), self.reason, [record.as_json for record in self.records]]

    def restore(self, position: Sequence[Any], workspace: Floats) -> None:
        """Restore the counters, records and workspace of another run."""
        *rest, reason, records = position
        super().restore(rest, workspace)
        self.records[:] = [EventRecord.read(entry) for entry in records]
        self._check_terminal()
        self.reason = reason

    def _state(self) -> tuple[Floats, Floats]:
        """Return the current q and p, each of shape (n,)."""
        return self.end()[0][0], self.end()[1][0]

    def _store_values(self) -> None:
        """Store current event values, and values one step earlier extrapolated by their rates."""
        row = self._actions.row(float(self._grid_time()), self._state())
        self._value[:] = row[: len(self._value)]
        self.sides.size[:] = np.fmax(self.sides.size, np.abs(self._value))
        self._earlier[:] = self._value - self.h * self._actions.rates(row)
        self.sides.mark_zeros(self._value)

    def _inputs_at(self, program: Program, t: Reals) -> Reals:
        """Return the inputs of the present step at times, shape (1, len(t), 1, m)."""
        step, h = self._input_step, float(self.h)
        at = (np.asarray(t, dtype=float) - float(self.t0 + self.h * step)) / h
        return interpolate_inputs(program, self._inputs, np.full(len(t), step), at[:, None])

    def _jumped(self, t: float, state: State) -> list[int]:
        """Return the events whose expressions have changed their signs with the inputs."""
        if not self._driven.any():
            return []
        values, side = self._actions.values(t, state), self.sides.side
        new = self.sides.signs_of(values, self.sides.small)
        return np.flatnonzero(self._driven & self.sides.acting_events(new) & (side != 0)).tolist()

    def _split_step(self, *, completed: bool, done: float = 0.0) -> None:
        """Repeat a step with its events, from the duration ``done`` on.

        If the step was ``completed``, undo it first.
        """
        self._progress[0] -= completed
        self._input_step = self.step
        workspace, rows = self.W.copy(), 4 * self.header.n
        if completed:  # otherwise the step failed at a kink
            self.rows("POSITION", rows)[:] = self.rows("PREVIOUS", rows)
        self._column[self._status] = 0
        step, acted = self.step, len(self.records)
        start, side = self._state(), self.sides.side.copy()
        worked = self._work.copy()
        state = self._split(step, start, done)
        if state is None:
            self._work[:] = worked if self.ended_by is None else self._work
            t, *end = self.end_within or (float(self._grid_time()),)
            part = t - float(self._grid_time())
            # pass the state at the end of the run to the recorders of states
            if not self.pauses and abs(part) > TOGETHER * max(abs(t), abs(float(self.h))):
                self._continue_from((end[0], end[1]))
                self._call_recorders(t, of_states=True, h=part)
            self._continue_from(start)
            self._column[self._status] = self._code
            if self._code == ARRIVED and self._saltation is not None:
                self._saltation.write_to(self._variations)
            return
        same = (np.sign(self.sides.side) == np.sign(side)).all()
        if same and completed and len(self.records) == acted:  # the step contains no event
            side, size = self.sides.side.copy(), self.sides.size.copy()
            self.W[:] = workspace
            self.sides.side[:], self.sides.size[:] = side, size
            self._column[self._status] = 0
            self._call_recorders(self._grid_time(), of_states=False)
            self._progress[0] += 1
        else:
            self._progress[0] += 1
            self._continue_from(state)
            if self._saltation is not None:
                self._saltation.write_to(self._variations)
        self._store_values()
        self._call_recorders(self._grid_time(), of_states=True)
        if self.every and self._progress.item(0) % self.every == 0:
            self.store(place := self._progress.item(0) // self.every)
            self.iterations[place, 0] = self.last_iterations
            self.rows("ITERATIONS", 1)[:] = 0

    def _continue_from(self, state: tuple[Floats, Floats]) -> None:
        """Continue from another state; rows of recorders do not change."""
        q, p = state
        self.rows("POSITION", 4 * self.header.n)[:] = 0
        self.rows("POSITION", len(q))[:], self.rows("MOMENTUM", len(p))[:] = q, p
        iterations = self.rows("ITERATIONS", 1).copy()
        self._driver("begin")(
            self._kernels(), 0, self.h, self._grid_time(), self.W, self.driver_layout
        )
        self.rows("ITERATIONS", 1)[:] = iterations

    def _call_recorders(self, time: Any, *, of_states: bool, h: Any = None) -> None:
        """Call the recorders of states, or the recorders of steps, at time ``passed``."""
        kernels, at = self._kernels(), DRIVER_LAYOUT
        first = RECORDERS + self.driver_layout[at["OF_EVENTS"]]
        last = len(kernels) - self.driver_layout[at["OF_STATES"]]
        self.rows("ACTIVE", 1)[:] = 1
        for kernel in kernels[last:] if of_states else kernels[first:last]:
            self._driver("apply")(kernel, self.h if h is None else h, time, self.W)

    def _split(self, step: int, start: Any, done: float) -> Any:
        """Take a step in parts, with its events; return the state, or None if the run ends.

        The step has already been taken for the duration ``done``.
        """
        h, t0 = float(self.h), float(self.t0 + self.h * step)
        state, times = start, Times()
        self._actions.touched.clear()
        if self._saltation is not None:
            self._saltation.begin(self._variations)
            if self.time_changes is not None:
                self._saltation.time_changes, self.time_changes = self.time_changes, None
        latest = set[int]()
        for _ in range(MOST_ACTIONS):
            rest = h - done
            if abs(rest) <= NOTHING * abs(h):
                if self._saltation is not None:
                    self._saltation.fix_time(t0 + done, state, step)
                return state
            end, status = self._parts.take_near(
                state, t0 + done, rest, step, done / h, SMALLEST_NUDGES
            )
            if status is not Status.SUCCESS:
                return self._fail(status)
            crossing = self._locate(step, t0, done, rest, state, end)
            if crossing is None:
                if self._code:
                    return None
                row = self._actions.row(t0 + h, end)
                if np.isnan(row[: len(self._value)][self._actions.impacts]).any():
                    why = "A gap has no finite value beyond its wall. "
                    return self._fail(Status.NOT_FINITE, why)
                self.sides.update(row, end[0])
                self._propagate(state, t0 + done, rest, step, None)
                return end
            part, arrived, events = crossing
            given = t0 + done, state, (step, done / h)
            why = (
                f"The state rests on {self._events.names[events[0]]!r} at t={t0 + done + part!r}. "
            )
            if {*events} <= latest and self.sides.stays_zero(crossing, *given):
                return self._fail(Status.EVENTS_ACCUMULATE, why)
            part, arrived, there, self._actions.state_beyond_kink = self.sides.split_at_kink(
                crossing, *given
            )
            self._propagate(state, t0 + done, part, step, events[0])
            done, latest = done + there, {*events}
            pressed = self._actions.stays_in_contact(
                t0 + done, arrived, part, events, self.sides.small
            )
            state = arrived if pressed else self._act(t0 + done, step, arrived, events, times)
            if state is None:
                return None
            still = pressed or (not part and state is arrived)
            if still and self._actions.may_all_hit(t0 + done, state, events):
                return self._fail(Status.EVENTS_ACCUMULATE, why)
        why = f"More than {MOST_ACTIONS} events act within one step. "
        return self._fail(Status.EVENTS_ACCUMULATE, why + "If they are distinct, use a smaller h. ")

    def _propagate(self, state: Any, t: float, part: float, step: int, event: int | None) -> None:
        """Propagate variations over a partial step, and add the work of forces in it."""
        if self._saltation is not None:
            self._saltation.propagate(state, t, part, step, event)
        share = (t - float(self.t0 + self.h * step)) / float(self.h)
        self._work[:] += self._parts.work(state, t, part, step, share)

    def _locate(
        self, step: int, t0: float, done: float, rest: float, start: Any, end: Any
    ) -> tuple[float, Any, list[int]] | None:
        """Locate the first events in the rest of a step: duration up to them, state, numbers."""
        h, t, place = float(self.h), t0 + done, (step, done / float(self.h))

        def row(part: float) -> Floats:
            state, status = self._parts.take_near(start, t, part, *place)
            state = state if status is Status.SUCCESS else (np.nan * start[0], np.nan * start[1])
            return self._actions.row(t + part, state)

        if not done and (
            due := self.sides.events_at_start(t0, start, step, self.sides.small_at(t0, start))
        ):
            return 0.0, start, due
        if jumped := self._jumped(t, start):
            return 0.0, start, jumped
        first, last = self._actions.row(t, start), self._actions.row(t0 + h, end)
        zeros = self.sides.find_end_zeros(row, rest, first, last)
        sides, ends = (self.sides.side.copy(), self.sides.size.copy()), (first, last, end[0])
        event, state = self._locator.locate(start, t, place, rest, ends, zeros, sides)
        if event == STEP_FAILED:
            self._fail(Status.NOT_FINITE, "A partial step to an event is not finite. ")
        if event < 0:
            return None
        part = zeros.item(event)
        near = TOGETHER * max(abs(t + part), abs(h))
        return part, state, np.flatnonzero(np.abs(zeros - part) <= near).tolist()

    def _act(self, t: float, step: int, state: Any, events: Sequence[int], times: Times) -> Any:
        """Let events act on a state, and record them; return None if the run ends."""
        row, small, given = self._actions.row(t, state), self.sides.small, state
        ends = [k for k in events if k in self.ending and self._actions.may_act(row, k)]
        (q, p), ways = state, -np.sign(self.sides.side).astype(int)
        for k in ends:  # they act on the whole system later
            self.records.append(EventRecord(k, t, step, q, p, q, p, int(ways[k]), 0.0, False))
        if ends:
            return None if self._check_terminal() else state
        allowed = [k for k in events if self._actions.may_act(row, k)]
        for k in events:  # only an impact that acts returns to its side of the wall
            if not (k in allowed and self._actions.impacts[k]):
                self.sides.side[k] = -np.sign(self.sides.side[k])
        done = list(self._actions.apply(t, state, allowed, small))
        several = len({k for k, *_, impulse in done if impulse}) > 1
        for k, before, after, impulse in done:
            state = after
            if self._saltation is not None:
                self._saltation.act(t, before, k, step)
            impact = bool(self._actions.impacts[k])
            direction, together = -1 if impact else int(self.sides.side[k]), several and impact
            self.records.append(
                EventRecord(k, t, step, *before, *after, direction, impulse, together)
            )
            if self._actions.dissipates(k, before, after, t):
                times.setdefault(k, []).append(t)
        if self._actions.failure:
            return self._fail(Status.BAD_INPUT, self._actions.failure)
        for k, _, (q, p), _ in done:
            if not (np.isfinite(q).all() and np.isfinite(p).all()):
                why = f"The change of {self._events.names[k]!r} is not finite at t={t:g}. "
                return self._fail(Status.NOT_FINITE, why)
        if self._check_terminal():
            return None
        if state is not given and self._actions.state_beyond_kink is None:
            share = (t - float(self.t0 + self.h * step)) / float(self.h)
            self.sides.update_after_actions(allowed, t, given, state, (step, share))
        if (limit := find_accumulation(times, abs(float(self.h)))) is None:
            return state
        k, about = limit
        why = f"{self._events.names[k]!r} acts ever faster up to t={about!r}. "
        return self._fail(Status.EVENTS_ACCUMULATE, why)

    @property
    def saltation(self) -> Saltation | None:
        """The propagation of variations through events, if the run has variations."""
        return self._saltation

    @property
    def _work(self) -> Floats:
        """Rows with the work of forces; empty if the run does not record work."""
        return self.rows("WORK", self.header.powers) if self._parts.works else self._column[:0]

    @property
    def _variations(self) -> Floats:
        """Rows with the variations of the state, one variation after another."""
        return self.rows("TANGENT", 2 * self.header.n * int(self.value("TANGENTS")))

    def _check_terminal(self) -> bool:
        """Check whether a terminal event has ended the run, and store its time and state."""
        last = self._events.last_of(self.records)
        if last is not None:
            self.ended_by, self._code = self._events.names[last.event], ARRIVED
            self.end_within = last.t, last.q_after, last.p_after
            self.reason = f"{self.ended_by!r} ended the run at t={last.t:g}."
        return last is not None

    def _finish(self) -> None:
        """Let events with a zero at the final state act, unless they have just acted."""
        t, state = float(self._grid_time()), self._state()
        here = self.sides.events_at_end(t, state, self.step)
        near = TOGETHER * max(abs(t), abs(float(self.h)))
        here[[record.event for record in self.records if abs(record.t - t) <= near]] = False
        if events := np.flatnonzero(here).tolist():
            self._act_at_current_state(t, self.step, state, events)

    def _act_at_current_state(self, t: float, step: int, state: Any, events: list[int]) -> None:
        """Let events act on the current state, which is on the time grid."""
        if self._saltation is not None:
            self._saltation.begin(self._variations)
        self._actions.state_beyond_kink = None
        new_state = self._act(t, step, state, events, {})
        if new_state is None and self.end_within is not None:
            new_state = self.end_within[1:]
        if new_state is not None:
            self._continue_from(new_state)
            if self._saltation is not None:
                if self.ended_by is None:
                    self._saltation.fix_time(t, new_state, step)
                self._saltation.write_to(self._variations)
            if self.every and self._progress.item(0) % self.every == 0:
                self.store(self._progress.item(0) // self.every)
        self._column[self._status] = self._code

    def _fail(self, status: Status, why: str = "") -> None:
        general = status.message if status is Status.EVENTS_ACCUMULATE or not why else ""
        self._code, self.reason = int(status), f"{why}{general}".strip()


def find_accumulation(times: Mapping[int, Sequence[float]], h: float) -> tuple[int, float] | None:
    """Return an impact that accumulates within a step h and its limit time, or None.

    The intervals between its hits form an infinite geometric series.
    """
    for k, hits in times.items():
        if len(hits) >= 4:
            first, late, later = np.diff(hits[-4:]).tolist()
            before, ratio = (late / first, later / late) if first and late else (1.0, 1.0)
            left = ratio / (1 - ratio) * later if 0 <= ratio < 1 else np.inf
            if (
                abs(ratio - before) <= RATIO_TOLERANCE * abs(before)
                and abs(left) < REMAINING_TIME * h
            ):
                return k, float(hits[-1] + left)
    return None
