"""Records of events that acted on a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from symsimpson.results.events import Events, of_event, of_run
from symsimpson.results.states import States
from symsimpson.results.tables import Variable
from symsimpson.support.array_types import Floats


class Record(NamedTuple):
    """One event that acted: its number, the time, the step, and the states on both sides."""

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

    @property
    def as_json(self) -> list[Any]:
        """The record in values of JSON."""
        return [x.tolist() if isinstance(x, np.ndarray) else x for x in self]

    def since(self, step: int) -> Record:
        """Return the record in a run that begins at a step of this one."""
        return self._replace(step=self.step - step)

    @classmethod
    def read(cls, values: list[Any]) -> Record:
        """Return the record with these values of JSON."""
        numbers: list[Any] = [np.array(x) if isinstance(x, list) else x for x in values]
        return cls(*numbers)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Actions(Events):
    """The states in which an event acted on a run; those of :class:`Events` are before it.

    Attributes
    ----------
    q_after, p_after : ndarray, shape (N, n)
        The states after it.
    impulse : ndarray, shape (N,)
        Of impacts, along the slope of the gap; 0 for others.
    simultaneous : ndarray of bool, shape (N,)
        Whether another impact acted at the same time.

    Examples
    --------
    >>> import symsimpson as ss
    >>> (z,) = ss.coordinates("z")
    >>> ball = ss.MechanicalSystem("ball", coordinates=(z,), kinetic=z.diff()**2/2, potential=10*z)
    >>> floor = ss.Event(z, name="floor", action=ss.Impact(0.8))
    >>> run = ss.compile(ball).integrate([1.0], v0=[0.0], h=0.01, t_end=2, events=[floor])
    >>> hits = run.events("floor")
    >>> hits.impulse.round(3).tolist(), (hits.after.energy - hits.energy).round(3).tolist()
    ([8.05, 6.44, 5.152], [-3.6, -2.304, -1.475])
    """

    q_after: Floats
    p_after: Floats
    impulse: Floats
    simultaneous: NDArray[np.bool_]

    @property
    def after(self) -> States:
        """The states after the actions."""
        return self.with_states(self.t, self.q_after, self.p_after)

    def _further(self) -> list[Variable]:
        further = {
            "direction": self.direction,
            "impulse": self.impulse,
            "simultaneous": self.simultaneous.astype(int),
        }
        return [of_event(name, values) for name, values in further.items()]


def actions_of(run: Any, name: str) -> Actions:
    """Return what an event of a run did, by its name."""
    number = run.event_names.index(name)
    records = [record for record in run.records if record.event == number]

    def rows(what: str) -> Floats:
        values = [getattr(record, what) for record in records]
        return np.reshape(np.array(values, dtype=np.float64), (len(records), run.program.n))

    return Actions(
        t=np.array([record.t for record in records]),
        q=rows("q"),
        p=rows("p"),
        direction=np.array([record.direction for record in records], dtype=np.int64),
        expression=name,
        **of_run(run),
        q_after=rows("q_after"),
        p_after=rows("p_after"),
        impulse=np.array([record.impulse for record in records]),
        simultaneous=np.array([record.simultaneous for record in records], dtype=np.bool_),
    )


def energies_given(run: Any) -> Floats:
    """Return the energy that events gave up to each stored state of a run."""
    _, t, step, q, p, q_after, p_after, *_ = map(np.array, zip(*run.records, strict=True))
    before, behind = run.with_states(t, q, p), run.with_states(t, q_after, p_after)
    stays = (before.q == behind.q).all(axis=1)  # and V, which may be NaN at the zero of a root
    moved, pushed = behind.energy - before.energy, behind.kinetic_energy - before.kinetic_energy
    total = np.concatenate([[0.0], np.cumsum(np.where(stays, pushed, moved))])
    # a step has in it what acts where it begins, but for the start and the end of a run
    states = (run.every or 1) * np.arange(len(run))
    acted = np.searchsorted(step, states, side="left")
    acted[0] = np.sum((step == 0) & (t == run.t[0]))
    if run.success and (run.ended_by is not None or states[-1] == run.steps):
        acted[-1] = len(run.records)
    energies: Floats = total[acted]
    return energies
