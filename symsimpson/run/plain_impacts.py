"""Plain impacts of a run: those that the compiled loop takes without leaving it."""

from __future__ import annotations

from itertools import repeat
from typing import Any

import numpy as np

from symsimpson.driver.impacts import EVENT, IMPULSE, STATES_OF, STEP_OF, TIME_OF
from symsimpson.program.evaluating import observer
from symsimpson.program.program import Program
from symsimpson.results.records import Record
from symsimpson.run.event_actions import constant_restitution
from symsimpson.stepping.parts import Parts
from symsimpson.stepping.run_events import RunEvents
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats

__all__ = ["PlainImpacts", "plain_restitution"]

#: So many impacts are kept before Python takes their records.
ROOM = 1024


def plain_restitution(program: Program, run_events: RunEvents, spec: RunSpec) -> Floats | None:
    """Return the restitution of each event, if all are impacts that the state alone decides.

    Constraints, variations and changes are Python's; so are impacts without restitution, of which
    many may act at one time. Then it is None.
    """
    numbers = [constant_restitution(program, event, spec.parameters) for event in run_events.events]
    fine = all(e is not None and 0.0 < e <= 1.0 and (spec.h > 0 or e == 1.0) for e in numbers)
    free = not any(event.terminal for event in run_events.events)
    held = program.header.constraints or spec.tangents is not None
    return np.array(numbers, dtype=np.float64) if fine and free and not held else None


class PlainImpacts:
    """Takes steps of a run, and the plain impacts in them.

    ``parts`` take parts of the steps of the run. Each event has its ``restitution``; what is
    watched begins with the row ``first``, and ``records`` take what impacts did.
    """

    def __init__(
        self,
        program: Program,
        run_events: RunEvents,
        parts: Parts,
        restitution: Floats,
        first: int,
        records: list[Record],
    ) -> None:
        header, numbers, events = program.header, program.numbers, run_events
        iterated = header.newton_unknowns > 0
        self._driver = numbers.driver("take_bouncing", iterated=iterated)
        self._parting = parts.parting
        addresses, W = observer(program, events.watched, parts.parameters)
        self._looking = addresses, W, header.driver_layout, len(events.watched)
        when = [-1 if place is None else place for place in events.when]
        signs = [event.sign for event in events.events]
        columns = events.rate, events.slopes, when, events.sizes, signs
        places = np.array([*zip(*columns, strict=True)], dtype=np.int64)
        self._count, self._all_records = np.zeros(1, dtype=np.int64), records
        self._records = np.zeros((ROOM, STATES_OF + 4 * header.n))
        self._impacts = places, restitution, first, self._records, self._count

    def take_steps(
        self, kernels: Any, setting: Any, progress: Any, stop: int, every: int, *rest: Any
    ) -> None:
        """Take steps as the driver does; it is left at an impact that is not plain."""
        sets = kernels, self._parting, self._looking
        self._driver(sets, setting, progress, (stop, every), *rest, self._impacts)
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
