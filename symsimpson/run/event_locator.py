"""Location of events in a step: sides of zero, the compiled loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import repeat
from typing import Any, cast

import numpy as np
from numba import types
from numpy.typing import NDArray

from symsimpson.program.driver import driver_text
from symsimpson.program.observed import observer
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.events import BESIDE, Record, signs_beside
from symsimpson.run.event_actions import EventActions
from symsimpson.stepping.parts import Parts
from symsimpson.stepping.run_events import RunEvents
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, State
from symsimpson.targets.binding import bind
from symsimpson.text.driver.impacts import EVENT, IMPULSE, STATES_OF, STEP_OF, TIME_OF
from symsimpson.text.interface import FADED, ZERO

#: Forces are taken on their own side of a kink up to these parts of a step from it.
LITTLE = [2.0**k for k in range(-50, -15, 2)]
#: Expressions that are zero at both ends of a step, or of its rest, are evaluated at these parts.
PLACES = (0.8625, 0.6125, 0.3625, 0.1125)

#: How long a part of a step is up to events, the state there, and the events.
Crossing = tuple[float, State, list[int]]


class Sides:
    """Sides of zero, and the sizes that bound round-off, in rows of a workspace.

    ``side`` has the side of zero of each expression, ``size`` its recent size. Steps have the
    length ``h``.
    """

    def __init__(
        self,
        rows: Sequence[Floats],
        actions: EventActions,
        events: RunEvents,
        parts: Parts,
        h: float,
    ) -> None:
        self.side, self.size = rows
        self._seen_of_late = self._arriving = 0 * self.size
        self._actions, self._events, self._parts, self._h = actions, events, parts, h
        self._signs = np.array([event.sign for event in events.events])

    def ahead(self, t: float, state: State, place: tuple[int, float]) -> Floats:
        """Return signs of expressions a little after a state; a place is a step and where in it.

        Their sizes are at least what is seen there, up to the end of the step.
        """

        def values(part: float) -> Floats:
            size = part * self._h
            soon, status = self._parts(state, t, size, *place)
            there = soon if status is Status.SUCCESS else (np.nan * state[0], np.nan * state[1])
            values = self._seen(self._actions.row(t + size, there))
            self._seen_of_late = np.fmax(self._seen_of_late, np.abs(values[0]))
            return values

        return signs_beside(values, self.small_at(t, state))

    def renew(
        self, acted: Sequence[int], t: float, before: State, behind: State, place: tuple[int, float]
    ) -> None:
        """Find the sides after actions; a look ahead decides for expressions that are zero."""
        if self._actions.impacts.all():
            return
        small, values = self.small_at(t, behind), self._actions.values(t, behind).copy()
        same = np.abs(values - self._actions.values(t, before)) <= small
        values[[k for k in acted if same[k]]] = 0
        fresh = self.of(values, small, self.ahead(t, behind, place))
        self.side[:] = np.where(self._actions.impacts, self.side, fresh)

    def mark(self, values: Floats) -> None:
        """Mark where a step begins at a zero: it is twice the side, and the next step stops."""
        marked = ~self._actions.impacts & (np.abs(values) <= self.small)
        self.side[marked & (np.abs(self.side) == 1.0)] *= 2.0

    def due(self, t: float, state: State, step: int, small: Floats) -> list[int]:
        """Return events other than impacts whose zero is the state where a step begins."""
        values, self._seen_of_late = self._actions.values(t, state), 0 * self.size
        zeros = ~self._actions.impacts & (np.abs(values) <= small)
        if not zeros.any():
            return []
        ahead = np.where(zeros, self.ahead(t, state, (step, 0.0)), 0.0)
        acting = self.acts(ahead)
        others = np.where(ahead == 0, np.sign(self.side) / 2, ahead)
        self.side[:] = np.where(zeros & ~acting, others, self.side)
        return np.flatnonzero(acting).tolist()

    def ending(self, t: float, state: State, step: int) -> NDArray[np.bool_]:
        """Return which events act at the last state, where expressions pass through zero."""
        here = np.abs(self._actions.values(t, state)) <= self.small_at(t, state)
        ahead = self.ahead(t, state, (step, 0.0)) if here.any() else 0 * self.side
        return here & self.acts(np.where(ahead == 0, -np.trunc(self.side), ahead))

    def stays(self, crossing: Crossing, t: float, state: State, place: tuple[int, float]) -> bool:
        """Return whether events are no impacts, and stay zero, but for rounding, up to there."""
        part, _, events = crossing
        middle, _ = self._parts(state, t, part / 2, *place)
        seen = np.abs(self._actions.values(t + part / 2, (middle[0], middle[1])))
        clear = self._actions.impacts | (seen > self.small_at(t, state))
        return not clear[[*events]].any()

    def astride(
        self, crossing: Crossing, t: float, state: State, place: tuple[int, float]
    ) -> tuple[float, State, float, State | None]:
        """Return how long a part of a step is up to events, its end, and where the next one begins.

        Forces may have a kink where a step is split: one part ends shortly before it, and the next
        one begins shortly after it, on the line through states before.
        """
        part, end, events = crossing
        side = np.sign(self.side)
        for little in [self._h * x for x in LITTLE if self._events.split_alone(events)]:
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

    def between(
        self, row: Callable[[float], Floats], rest: float, first: Floats, last: Floats
    ) -> Floats:
        """Return places up to which events act whose expressions end at zero, NaN for others.

        ``row`` computes all that is asked for after a part of a rest of a step; ``first`` and
        ``last`` are the rows at both ends.
        """
        count, sizes = len(self.size), np.fmax(self.size, self._seen_of_late)
        small = ZERO * np.fmax(sizes, np.abs(last[: len(sizes)]))
        ended = ~self._actions.impacts & (np.abs(last[:count]) <= small)
        self._arriving, zeros = np.zeros(count), np.full(count, np.nan)
        if ended.any():
            self._arriving = signs_beside(lambda x: self._seen(row(rest - x * rest)), small)
            zeros[self.acts(self._arriving) & ended] = (1 - BESIDE[1]) * rest
            both = ended & (np.abs(first[:count]) <= small)
            for x in PLACES if both.any() else ():  # the first one counts
                there = self.of(row(x * rest)[:count], small)
                zeros[self.acts(there) & both] = x * rest
        return zeros

    @property
    def small(self) -> Floats:
        """Values below these are zeros: rounding."""
        return ZERO * self.size

    def small_at(self, t: float, state: State) -> Floats:
        """Return below what a value is a zero, where time and state are rounded."""
        return np.maximum(self.small, self._actions.rounding(t, state))

    def _seen(self, row: Floats) -> Floats:
        """Return values of expressions, and the sizes of their terms."""
        return np.array([row[: len(self.size)], row[[*self._events.sizes]]])

    def settle(self, row: Floats, q: Floats) -> None:
        """Update the sides and sizes after a step."""
        seen = np.where(np.abs(row[: len(self.size)]) <= self.small, self._seen_of_late, 0.0)
        self.size[:] = np.fmax(self.faded(row, q), seen)
        before = np.where(self._arriving, self._arriving, self.side)
        self.side[:] = self.of(row[: len(self.size)], self.small, before)

    def faded(self, row: Floats, q: Floats) -> Floats:
        """Return sizes after a step: sizes of terms, or the faded sizes before it."""
        left = np.where(self._actions.impacts, 1.0, FADED) * self.size
        return np.fmax(left, self._actions.sizes(row, q))

    def of(self, values: Floats, small: Floats, before: Floats | None = None) -> Floats:
        """Return on which sides of zero values are; near it they stay where they were."""
        before = self.side if before is None else before
        return np.where(values > small, 1.0, np.where(values < -small, -1.0, before))

    def acts(self, behind: Floats) -> NDArray[np.bool_]:
        """Return which events act as sides change to others."""
        changed = self.side * behind < 0
        return np.asarray(changed & ((self._signs == 0) | (np.sign(behind) == self._signs)))


#: So many impacts are kept before Python takes their records.
ROOM = 1024
#: What ``locate`` returns where a part of a step cannot be taken.
LOST = -2


def plain_restitution(
    program: Program, run_events: RunEvents, spec: RunSpec, actions: EventActions
) -> Floats | None:
    """Return the restitution of each event, if all are impacts that the state alone decides.

    Constraints, variations and changes are Python's; so are impacts without restitution, of which
    many may act at one time. Then it is None.
    """
    numbers = [actions.restitution(k) for k in range(len(run_events.events))]
    fine = all(e is not None and 0.0 < e <= 1.0 and (spec.h > 0 or e == 1.0) for e in numbers)
    free = not any(event.terminal for event in run_events.events)
    held = program.header.constraints or spec.tangents is not None
    return np.array(numbers, dtype=np.float64) if fine and free and not held else None


class EventLocator:
    """Locates events within steps, and takes steps with plain impacts.

    ``parts`` take parts of the steps of the run, ``rows`` evaluates what is watched at states. That
    begins with the row ``first`` of the run; ``records`` take what plain impacts did.
    """

    def __init__(
        self,
        program: Program,
        run_events: RunEvents,
        parts: Parts,
        rows: Callable[[Floats, Floats, Floats], Floats],
        first: int,
        records: list[Record],
    ) -> None:
        header, numbers, events = program.header, program.numbers, run_events
        self._driver = partial(numbers.driver, iterated=header.newton_unknowns > 0)
        self._parts, self._rows, self._first = parts, rows, first
        addresses, W = observer(program, events.watched, parts.parameters)
        self._looking = addresses, W, header.driver_layout, len(events.watched)
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

        It is -1 without an event, ``LOST`` if a part of the step cannot be taken. The ``place`` is
        a step and where in it, ``ends`` is all that is watched at both ends, and q at the last one.
        Zeros are put into ``zeros``, which has ends of the span for some events, NaN for others.
        """
        state, until = (np.zeros_like(start[0]), np.zeros_like(start[1])), zeros.copy()
        known = span, ends, (*sides, zeros), self._events, (np.zeros(len(ends[0])), state)
        inputs, event = self._parts.inputs(span, *place), LOST
        room = np.zeros(4, np.int64), np.zeros((1, 1, 1)), np.zeros((1, 1), np.int64), inputs
        if inputs.shape[2] == 1:  # they are held over the step
            compiled = self._parts.parting, self._looking, room
            event = self._driver("locate")(compiled, start, t, *known)
        if event == LOST:  # Python takes parts by other kernels, too
            zeros[:] = until
            with np.errstate(all="ignore"):
                means = partial(self._part, place), self._look, room
                event = _in_python()(means, start, t, *known)
        return event, state

    def _part(
        self, place: tuple[int, float], start: State, t: float, size: float, state: State, room: Any
    ) -> bool:
        """Go from a state through a part of a step, to the other state; tells if it went."""
        end, status = self._parts.beside(start, t, size, *place)
        state[0][:], state[1][:] = end
        return status is Status.SUCCESS

    def _look(self, t: float, q: Floats, p: Floats, row: Floats) -> None:
        """Evaluate all that is watched at a state."""
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
        """Take steps as the driver does; it is left at an impact that is not plain."""
        sets = kernels, self._parts.parting, self._looking
        impacts = self._events, restitution, self._first, self._records, self._count
        self._driver("take_bouncing")(sets, setting, progress, (stop, every), *rest, impacts)
        if self._count[0]:
            self._all_records += self._acted()
            self._count[0] = 0

    def _acted(self) -> list[Record]:
        """Return the records of impacts in the rows for them."""
        rows = self._records[: self._count[0]].copy()
        events, steps = rows[:, [EVENT, STEP_OF]].T.astype(int).tolist()
        times, impulses = rows[:, [TIME_OF, IMPULSE]].T.tolist()
        states = np.split(rows[:, STATES_OF:], 4, axis=1)
        every = zip(events, times, steps, *states, repeat(-1), impulses, repeat(False))
        return [Record(*fields) for fields in every]


@cache
def _in_python() -> Callable[..., int]:
    """Return ``locate`` as Python runs it, where functions take parts and look at states."""

    def called(function: Any, *given: Any) -> Any:
        return function(*given)

    replaced = {"through_part": called, "look": called, "call": called, "np": np, "types": types}
    text = bind(driver_text(), {**replaced, "njit": lambda **options: lambda function: function})
    return cast(Callable[..., int], text.locate)
