"""The compiled location of events in a run, and the plain impacts that its loop takes by itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from itertools import repeat
from typing import Any, cast

import numpy as np
from numba import types

from symsimpson.driver.impacts import EVENT, IMPULSE, STATES_OF, STEP_OF, TIME_OF
from symsimpson.module.binding import bind
from symsimpson.program.driver import driver_text
from symsimpson.program.evaluating import observer
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.records import Record
from symsimpson.run.event_actions import EventActions
from symsimpson.stepping.parts import Parts
from symsimpson.stepping.run_events import RunEvents
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, State

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
        known = span, ends, zeros, sides, self._events, (np.zeros(len(ends[0])), state)
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
