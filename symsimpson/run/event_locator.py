"""Location of events within a step: signs of event expressions, and the compiled search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import repeat
from typing import Any, cast

import numpy as np
from numba import types
from numpy.typing import NDArray

from symsimpson.program.driver import driver_text
from symsimpson.program.evaluation import prepare_observation
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.event_record import EventRecord
from symsimpson.results.events import BESIDE, signs_near
from symsimpson.run.event_actions import EventActions
from symsimpson.stepping.parts import PartialSteps
from symsimpson.stepping.run_events import RunEvents
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, State
from symsimpson.targets.binding import bind
from symsimpson.text.driver.impacts import EVENT, IMPULSE, STATES_OF, STEP_OF, TIME_OF
from symsimpson.text.interface import FADED, ZERO
from symsimpson.text.workspace_layout import DRIVER_LAYOUT

#: Distances from a kink, as fractions of a step, at which a step may be split on one side of it.
KINK_DISTANCES = [2.0**k for k in range(-50, -15, 2)]
#: Places within a step at which expressions are evaluated that are zero at both of its ends.
PLACES = (0.8625, 0.6125, 0.3625, 0.1125)

#: Duration of the partial step up to the first events, the state there, and their numbers.
Crossing = tuple[float, State, list[int]]


class EventSigns:
    """Signs and sizes of the event expressions, in rows of a workspace.

    ``side`` is the sign of each expression. It is doubled if the next step must stop at a zero, and
    halved while an expression remains zero. ``size`` is the recent size of the expression, which
    bounds its round-off. The step size is ``h``.
    """

    def __init__(
        self,
        rows: Sequence[Floats],
        actions: EventActions,
        events: RunEvents,
        parts: PartialSteps,
        h: float,
    ) -> None:
        self.side, self.size = rows
        self._recent_sizes = self._signs_before_end = 0 * self.size
        self._actions, self._events, self._parts, self._h = actions, events, parts, h
        self._signs = np.array([event.sign for event in events.events])

    def signs_after(self, t: float, state: State, place: tuple[int, float]) -> Floats:
        """Return the signs of expressions shortly after a state.

        ``place`` is the number of a step and the place in it, from 0 to 1. The method stores the
        sizes that it finds, up to the end of the step.
        """

        def values(part: float) -> Floats:
            size = part * self._h
            soon, status = self._parts(state, t, size, *place)
            there = soon if status is Status.SUCCESS else (np.nan * state[0], np.nan * state[1])
            values = self._seen(self._actions.row(t + size, there))
            self._recent_sizes = np.fmax(self._recent_sizes, np.abs(values[0]))
            return values

        return signs_near(values, self.small_at(t, state))

    def update_after_actions(
        self, acted: Sequence[int], t: float, before: State, after: State, place: tuple[int, float]
    ) -> None:
        """Update the signs after actions; for zeros, the sign shortly after the event decides."""
        if self._actions.impacts.all():
            return
        small, values = self.small_at(t, after), self._actions.values(t, after).copy()
        same = np.abs(values - self._actions.values(t, before)) <= small
        values[[k for k in acted if same[k]]] = 0
        fresh = self.signs_of(values, small, self.signs_after(t, after, place))
        self.side[:] = np.where(self._actions.impacts, self.side, fresh)

    def mark_zeros(self, values: Floats) -> None:
        """Double the sign of expressions that are zero now, so that the next step stops."""
        marked = ~self._actions.impacts & (np.abs(values) <= self.small)
        self.side[marked & (np.abs(self.side) == 1.0)] *= 2.0

    def events_at_start(
        self, t: float, state: State, step: int, small: Floats, share: float = 0.0
    ) -> list[int]:
        """Return the events, other than impacts, that act at the initial state of a step.

        ``share`` is the place of this state within the step.
        """
        values, self._recent_sizes = self._actions.values(t, state), 0 * self.size
        zeros = ~self._actions.impacts & (np.abs(values) <= small)
        if not zeros.any():
            return []
        ahead = np.where(zeros, self.signs_after(t, state, (step, share)), 0.0)
        acting = self.acting_events(ahead)
        others = np.where(ahead == 0, np.sign(self.side) / 2, ahead)
        self.side[:] = np.where(zeros & ~acting, others, self.side)
        return np.flatnonzero(acting).tolist()

    def events_at_end(self, t: float, state: State, step: int) -> NDArray[np.bool_]:
        """Return which events act at the final state, because their expressions change sign."""
        here = np.abs(self._actions.values(t, state)) <= self.small_at(t, state)
        ahead = self.signs_after(t, state, (step, 0.0)) if here.any() else 0 * self.side
        return here & self.acting_events(np.where(ahead == 0, -np.trunc(self.side), ahead))

    def stays_zero(
        self, crossing: Crossing, t: float, state: State, place: tuple[int, float]
    ) -> bool:
        """Return whether the events are no impacts and remain zero up to the crossing."""
        part, _, events = crossing
        middle, _ = self._parts(state, t, part / 2, *place)
        seen = np.abs(self._actions.values(t + part / 2, (middle[0], middle[1])))
        clear = self._actions.impacts | (seen > self.small_at(t, state))
        return not clear[[*events]].any()

    def split_at_kink(
        self, crossing: Crossing, t: float, state: State, place: tuple[int, float]
    ) -> tuple[float, State, float, State | None]:
        """Split a step at a crossing so that no partial step contains a kink of the forces.

        Return the duration of the first part and its end state, then the duration up to the second
        part and its initial state or None. At a kink, the first part ends shortly before it. The
        second part starts shortly after it, at a state that is extrapolated linearly.
        """
        part, end, events = crossing
        side = np.sign(self.side)
        for little in [self._h * x for x in KINK_DISTANCES if self._events.split_alone(events)]:
            (near, first), (before, second) = (
                self._parts(state, t, part - k * little, *place) for k in (1, 2)
            )
            beyond = 3 * near[0] - 2 * before[0], 3 * near[1] - 2 * before[1]
            if not first is second is Status.SUCCESS:
                continue
            here = side * self._actions.values(t + part - little, near)
            there = -side * self._actions.values(t + part + little, beyond)
            clear = np.minimum(here, there) > self._actions.rounding(t + part, near) / 4
            if clear[[*events]].all():
                return part - little, near, part + little, beyond
        return part, end, part, None

    def find_end_zeros(
        self, row: Callable[[float], Floats], rest: float, first: Floats, last: Floats
    ) -> Floats:
        """Return the durations up to events whose expressions are zero at the end of a step.

        The result is NaN for other events. ``row`` evaluates all expressions after a duration.
        ``rest`` is the duration of the rest of the step; ``first`` and ``last`` are the rows at its
        ends.
        """
        count, sizes = len(self.size), np.fmax(self.size, self._recent_sizes)
        small = ZERO * np.fmax(sizes, np.abs(last[: len(sizes)]))
        ended = ~self._actions.impacts & (np.abs(last[:count]) <= small)
        self._signs_before_end, zeros = np.zeros(count), np.full(count, np.nan)
        if ended.any():
            self._signs_before_end = signs_near(lambda x: self._seen(row(rest - x * rest)), small)
            zeros[self.acting_events(self._signs_before_end) & ended] = (1 - BESIDE[1]) * rest
            both = ended & (np.abs(first[:count]) <= small)
            for x in PLACES if both.any() else ():  # the earliest place counts
                there = self.signs_of(row(x * rest)[:count], small)
                zeros[self.acting_events(there) & both] = x * rest
        return zeros

    @property
    def small(self) -> Floats:
        """Round-off of each expression; a smaller value counts as zero."""
        return ZERO * self.size

    def small_at(self, t: float, state: State) -> Floats:
        """Return the round-off of each expression at a state with rounded t, q and p."""
        return np.maximum(self.small, self._actions.rounding(t, state))

    def _seen(self, row: Floats) -> Floats:
        """Return the values of the event expressions and the sizes of their terms, shape (2, m)."""
        return np.array([row[: len(self.size)], row[[*self._events.sizes]]])

    def update(self, row: Floats, q: Floats) -> None:
        """Update the signs and sizes after a step."""
        seen = np.where(np.abs(row[: len(self.size)]) <= self.small, self._recent_sizes, 0.0)
        self.size[:] = np.fmax(self.faded_sizes(row, q), seen)
        before = np.where(self._signs_before_end, self._signs_before_end, self.side)
        self.side[:] = self.signs_of(row[: len(self.size)], self.small, before)

    def faded_sizes(self, row: Floats, q: Floats) -> Floats:
        """Return the sizes after a step: the current ones, or earlier ones times ``FADED``."""
        earlier = np.where(self._actions.impacts, 1.0, FADED) * self.size
        return np.fmax(earlier, self._actions.sizes(row, q))

    def signs_of(self, values: Floats, small: Floats, before: Floats | None = None) -> Floats:
        """Return the signs of values; a value that is zero up to ``small`` keeps its old sign."""
        before = self.side if before is None else before
        return np.where(values > small, 1.0, np.where(values < -small, -1.0, before))

    def acting_events(self, new: Floats) -> NDArray[np.bool_]:
        """Return which events act when the signs change to ``new``."""
        changed = self.side * new < 0
        return np.asarray(changed & ((self._signs == 0) | (np.sign(new) == self._signs)))


#: Number of impacts that compiled code records in one call.
ROOM = 1024
#: Result of ``locate`` if a partial step fails.
STEP_FAILED = -2


def read_plain_restitution(
    program: Program, run_events: RunEvents, spec: RunSpec, actions: EventActions
) -> Floats | None:
    """Return the restitution of each event if compiled code can handle all of them, else None.

    Compiled code handles impacts with a constant, positive restitution. Python handles other
    events, terminal events, plastic impacts, constraints and variations.
    """
    numbers = [actions.restitution(k) for k in range(len(run_events.events))]
    constant = all(e is not None and 0.0 < e <= 1.0 and (spec.h > 0 or e == 1.0) for e in numbers)
    terminal = any(event.terminal for event in run_events.events)
    if not constant or terminal or program.header.constraints or spec.tangents is not None:
        return None
    return np.array(numbers, dtype=np.float64)


class EventLocator:
    """Locates events within steps; compiled code takes the steps with plain impacts.

    ``parts`` takes partial steps of the run. ``rows`` evaluates all expressions at states; their
    rows in the workspace of the run start at ``first``. New records are appended to ``records``.
    """

    def __init__(
        self,
        program: Program,
        run_events: RunEvents,
        parts: PartialSteps,
        rows: Callable[[Floats, Floats, Floats], Floats],
        first: int,
        records: list[EventRecord],
    ) -> None:
        header, numbers, events = program.header, program.numbers, run_events
        self._driver = partial(numbers.driver, iterated=header.newton_unknowns > 0)
        self._parts, self._rows, self._first = parts, rows, first
        addresses, W = prepare_observation(program, events.watched, parts.parameters)
        self._evaluation = addresses, W, header.driver_layout, len(events.watched)
        numbers.driver("apply")(addresses[0], 1.0, 0.0, W)
        rates = [k if place is None else place for k, place in enumerate(events.rate)]
        others = [[-1 if x is None else x for x in row] for row in (events.slopes, events.when)]
        columns = rates, *others, events.sizes, [event.sign for event in events.events]
        self._events = np.array([*zip(*columns, strict=True)], dtype=np.int64)
        self._count, self._all_records = np.zeros(1, dtype=np.int64), records
        self._records = np.zeros((ROOM, STATES_OF + 4 * header.n))

    def locate(
        self,
        start: State,
        t: float,
        place: tuple[int, float],
        span: float,
        ends: tuple[Floats, Floats, Floats],
        zeros: Floats,
        sides: tuple[Floats, Floats],
    ) -> tuple[int, State]:
        """Return the number of the first event in a span of a step, and the state there.

        The number is -1 without an event, and ``STEP_FAILED`` if a partial step fails. ``place`` is
        the number of the step and the place in it. ``ends`` has the values of all expressions at
        both ends, and q at the second end. ``zeros`` has known durations up to events, or NaN; the
        method stores the durations that it finds there.
        """
        state, until = (np.zeros_like(start[0]), np.zeros_like(start[1])), zeros.copy()
        known = span, ends, (*sides, zeros), self._events, (np.zeros(len(ends[0])), state)
        inputs, event = self._parts.inputs(span, *place), STEP_FAILED
        room = np.zeros(4, np.int64), np.zeros((1, 1, 1)), np.zeros((1, 1), np.int64), inputs
        if inputs.shape[2] == 1:  # inputs are constant over the step
            if inputs.size:
                self._set_inputs(inputs[0, 0])
            compiled = self._parts.setup, self._evaluation, room
            event = self._driver("locate")(compiled, start, t, *known)
        if event == STEP_FAILED:  # Python can use fallback kernels for partial steps
            zeros[:] = until
            with np.errstate(all="ignore"):
                means = partial(self._part, place), self._evaluate, room
                event = _locate_in_python()(means, start, t, *known)
        return event, state

    def _set_inputs(self, inputs: Floats) -> None:
        """Set the inputs for the evaluation of expressions, shape (1, number of inputs)."""
        _, W, layout, _ = self._evaluation
        first, stride = layout[DRIVER_LAYOUT["INPUT"]], layout[DRIVER_LAYOUT["INPUT_STRIDE"]]
        W[first : first + inputs.shape[1] * stride, 0] = np.repeat(inputs[0], stride)

    def _part(
        self, place: tuple[int, float], start: State, t: float, size: float, state: State, room: Any
    ) -> bool:
        """Take a partial step from ``start``, store its end in ``state``; return if it worked."""
        end, status = self._parts.take_near(start, t, size, *place)
        state[0][:], state[1][:] = end
        return status is Status.SUCCESS

    def _evaluate(self, t: float, q: Floats, p: Floats, row: Floats) -> None:
        """Evaluate all expressions at a state into ``row``."""
        row[:] = self._rows(np.array([t]), q[None], p[None])[0]

    def take_steps(
        self,
        restitution: Floats,
        kernels: Any,
        setting: Any,
        progress: Any,
        stop: int,
        every: int,
        *rest: Any,
    ) -> None:
        """Take steps in compiled code; stop at an event that Python must handle."""
        sets = kernels, self._parts.setup, self._evaluation
        impacts = self._events, restitution, self._first, self._records, self._count
        self._driver("take_bouncing")(sets, setting, progress, (stop, every), *rest, impacts)
        if self._count[0]:
            self._all_records += self._read_records()
            self._count[0] = 0

    def _read_records(self) -> list[EventRecord]:
        """Convert the rows that compiled code has written to records."""
        rows = self._records[: self._count[0]].copy()
        events, steps = rows[:, [EVENT, STEP_OF]].T.astype(int).tolist()
        times, impulses = rows[:, [TIME_OF, IMPULSE]].T.tolist()
        states = np.split(rows[:, STATES_OF:], 4, axis=1)
        every = zip(events, times, steps, *states, repeat(-1), impulses, repeat(False))
        return [EventRecord(*fields) for fields in every]


@cache
def _locate_in_python() -> Callable[..., int]:
    """Return the text of ``locate`` as a Python function, which accepts Python callbacks."""

    def called(function: Any, *given: Any) -> Any:
        return function(*given)

    replaced = {
        "try_part_of_step": called,
        "look": called,
        "call": called,
        "np": np,
        "types": types,
    }
    text = bind(driver_text(), {**replaced, "njit": lambda **options: lambda function: function})
    return cast(Callable[..., int], text.locate)
