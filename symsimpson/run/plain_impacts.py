"""Plain impacts of a run: those that the compiled loop takes without leaving it."""

from __future__ import annotations

from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.driver.impacts import EVENT, IMPULSE, STATES_OF, STEP_OF, TIME_OF
from symsimpson.program.evaluating import observer
from symsimpson.program.workspace import workspace
from symsimpson.results.records import Record
from symsimpson.run.event_actions import constant_restitution
from symsimpson.stepping.run_events import RunEvents

if TYPE_CHECKING:
    from symsimpson.program.program import Program
    from symsimpson.stepping.spec import RunSpec

__all__ = ["PlainImpacts", "plain_impacts"]

#: So many impacts are kept before Python takes their records.
ROOM = 1024


def plain_impacts(program: Program, run_events: RunEvents, spec: RunSpec) -> bool:
    """Return whether impacts alone are waited for, and what each does depends on the state alone.

    Constraints, variations and changes are Python's; so are impacts without restitution, of which
    many may act at one time.
    """
    numbers = [constant_restitution(program, one, spec.parameters) for one in run_events.events]
    fine = all(e is not None and 0.0 < e <= 1.0 and (spec.h > 0 or e == 1.0) for e in numbers)
    free = not any(one.terminal for one in run_events.events)
    held = program.header.constraints or spec.tangents is not None
    return fine and free and not held


class PlainImpacts:
    """Takes steps of a run, and the plain impacts in them.

    Parameters
    ----------
    program : Program
    run_events : RunEvents
    spec : RunSpec
    first : int
        The first row of what is watched.
    records : list of Record
        Takes what impacts did.
    """

    def __init__(
        self,
        program: Program,
        run_events: RunEvents,
        spec: RunSpec,
        first: int,
        records: list[Record],
    ) -> None:
        header, numbers, kernels = program.header, program.numbers, program.kernels
        iterated = header.newton_unknowns > 0
        self._driver = numbers.driver("take_bouncing", iterated=iterated)
        parameters = numbers.read(spec.parameters)
        again = kernels.set(kernels.fallbacks[0], again=True)
        self._parting = again, workspace(header, numbers, parameters), header.told
        addresses, W = observer(program, run_events.watched, spec.parameters)
        self._looking = addresses, W, header.told, len(run_events.watched)
        places = [
            (rate, slopes, -1 if when is None else when, size, event.sign)
            for rate, slopes, when, size, event in zip(
                run_events.rate,
                run_events.slopes,
                run_events.when,
                run_events.sizes,
                run_events.events,
                strict=True,
            )
        ]
        restitution = [
            constant_restitution(program, one, spec.parameters) for one in run_events.events
        ]
        self._count, self._told = np.zeros(1, dtype=np.int64), records
        self._records = np.zeros((ROOM, STATES_OF + 4 * header.n))
        self._impacts = (
            np.array(places, dtype=np.int64),
            np.array(restitution, dtype=np.float64),
            first,
            self._records,
            self._count,
        )

    def take_steps(
        self, kernels: Any, setting: Any, progress: Any, stop: int, every: int, *rest: Any
    ) -> None:
        """Take steps as the driver does; it is left at an impact that is not plain."""
        sets = kernels, self._parting, self._looking
        self._driver(sets, setting, progress, (stop, every), *rest, self._impacts)
        if self._count[0]:
            self._told += self._acted()
            self._count[0] = 0

    def _acted(self) -> list[Record]:
        """Return the records of impacts in the rows for them."""
        rows = self._records[: self._count[0]].copy()
        numbers = (
            rows[:, EVENT].astype(int).tolist(),
            rows[:, TIME_OF].tolist(),
            rows[:, STEP_OF].astype(int).tolist(),
        )
        states = np.split(rows[:, STATES_OF:], 4, axis=1)
        impulses = rows[:, IMPULSE].tolist()
        # there may be many
        every = zip(*numbers, *states, repeat(-1), impulses, repeat(False))
        return [Record(*one) for one in every]
