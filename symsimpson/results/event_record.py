"""The record of one event that acted on a run."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from symsimpson.support.array_types import Floats


class EventRecord(NamedTuple):
    """One event that acted: its number, time and step, and the states before and after it."""

    event: int
    t: float
    step: int
    q: Floats
    p: Floats
    q_after: Floats
    p_after: Floats
    direction: int
    impulse: float
    simultaneous: bool
    kind: str = ""  #: What a contact or friction began: "rest", "slip+", ...; "" for other events.

    @property
    def as_json(self) -> list[Any]:
        """The record as a list of JSON values."""
        return [x.tolist() if isinstance(x, np.ndarray) else x for x in self]

    def of_event(self, number: int) -> EventRecord:
        """Return the record with another number of its event."""
        return self._replace(event=number)

    def since(self, step: int) -> EventRecord:
        """Return the record with its step counted from another step of the run."""
        return self._replace(step=self.step - step)

    @classmethod
    def read(cls, values: list[Any]) -> EventRecord:
        """Return the record from the values that ``as_json`` returns."""
        numbers: list[Any] = [np.array(x) if isinstance(x, list) else x for x in values]
        return cls(*numbers)
