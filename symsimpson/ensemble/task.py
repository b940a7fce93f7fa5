"""Tasks of ensembles, and arrays for their results."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from symsimpson.ensemble.ensemble import Ensemble
from symsimpson.module.header import Header
from symsimpson.module.interface import MET
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, split, with_clock
from symsimpson.program.status import Status
from symsimpson.results.records import Record
from symsimpson.stepping.driving import driven
from symsimpson.stepping.recording import recorders_of
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, Ints


@dataclass(frozen=True)
class Task(RunSpec):
    """The task of an ensemble, checked; arrays have a row for each member."""

    threads: int
    progress: bool | None
    lanes: int
    retimed: bool = False

    @property
    def members(self) -> int:
        """Number of members."""
        return len(self.q0)

    def inputs_of(self, member: Any) -> Floats | None:
        """Return the inputs of a member as a run of its own takes them."""
        inputs = self.inputs[min(member, len(self.inputs) - 1)]
        return np.broadcast_to(inputs, (self.steps, *inputs.shape[1:])) if inputs.size else None

    def of_member(self, member: Any, program: Program, **more: Any) -> Request:
        """Return how a run of one member is asked for."""
        names, header = program.parameters, program.header
        values = dict(zip(names, self.parameters[member], strict=True))
        return Request(
            self.q0[member],
            **{self.given: self.other0[member]},
            h=self.h,
            t_end=self.t_end,
            steps=self.steps if self.t_end is None else None,
            t0=self.t0,
            parameters={name: values[name] for name in names if name not in header.from_start},
            inputs=self.inputs_of(member),
            events=self.run_events,
            **more,
        )

    def recorded(self, header: Header) -> tuple[Recorder, ...]:
        """Return the recorders that leave numbers beside each state, in their order."""
        count = None if self.tangents is None else self.tangents.shape[1]
        return with_clock(header, recorders_of(header, count, self.record, ()))

    @property
    def of_variations(self) -> bool:
        """Whether variations of the motions are asked for."""
        return any(r.of_variations for r in self.reductions)

    @property
    def times(self) -> Floats:
        """Times of the stored states."""
        stride, first = (self.every, 0) if self.every else (self.steps, 1)
        count = np.arange(first, self.stored + first, dtype=np.float64)
        return self.t0 + self.h * (count * stride)  # rounded as those of single runs are

    def part(self, members: slice | Ints) -> Task:
        """Return the task of some of the members."""
        return replace(
            self,
            q0=np.ascontiguousarray(self.q0[members]),
            other0=np.ascontiguousarray(self.other0[members]),
            parameters=np.ascontiguousarray(self.parameters[members]),
            inputs=self.inputs if len(self.inputs) == 1 else self.inputs[members],
        )


class Results:
    """Arrays that threads fill, each its own rows; until then members count as interrupted."""

    def __init__(self, task: Task, header: Header) -> None:
        shape, self._recorders = (task.members, task.stored, header.n), task.recorded(header)
        self.q, self.p = np.full(shape, np.nan), np.full(shape, np.nan)
        # status, steps, iterations
        self.codes = np.zeros((task.members, 3), dtype=np.int64)
        self.codes[:, 0] = Status.INTERRUPTED
        self.recorded = np.full(
            (*shape[:2], sum(recorder.rows for recorder in self._recorders)), np.nan
        )
        #: Of a step that was taken last, in tau.
        self.part = np.zeros(task.members)
        #: When members came to their ends, where they are known to be run by themselves.
        self.ended_at = np.full(task.members, np.nan)
        #: Pairs of numbers of reductions; how small pivots of M were.
        self.seen = np.full((task.members, 2 * len(task.reductions) + 1), np.nan)
        #: What events did, by member.
        self.records = dict[int, tuple[Record, ...]]()
        self._task = task

    def columns(self) -> dict[str, Any]:
        """Return the arrays as an ensemble has them."""
        task = self._task
        status, steps, iterations = (column.copy() for column in self.codes.T)
        status[status == MET] = Status.INTERRUPTED  # before it was run by itself
        q, p = (self.q, self.p) if task.every else (self.q[:, 0], self.p[:, 0])
        reduced = {r.name: self.seen[:, 2 * k] for k, r in enumerate(task.reductions)}
        columns: dict[str, Any] = {
            "q": q,
            "p": p,
            "status": status,
            "steps": steps,
            "newton_iterations": iterations,
            "reduced": reduced,
            "small_pivots": self.seen[:, -1],
        }
        recorded = self.recorded if task.every else self.recorded[:, 0]
        columns["variations"], columns["recorded"] = split(self._recorders, recorded, q.shape[-1])
        if task.run_events is not None:
            whole_steps = task.t0 + task.h * steps
            columns |= {"records": self.records, "event_names": task.run_events.names}
            columns["ended_at"] = np.where(np.isnan(self.ended_at), whole_steps, self.ended_at)
            if not task.every and not task.retimed:
                columns["t"] = columns["ended_at"]
        if task.retimed:
            whole = task.every * np.arange(task.stored) if task.every else steps
            t = recorded[..., 0]  # the clock is the first of recorders
            tau = task.h * whole + (0 if task.every else self.part)
            columns |= {"t": t, "tau": np.where(np.isfinite(t), tau, np.nan)}
        return columns


def ensemble_of(program: Program, task: Task, **columns: Any) -> Ensemble:
    """Return what a task came to as an ensemble, with what it was asked for."""
    if "t" not in columns:
        columns["t"] = task.times
    return Ensemble(
        parameters=dict(zip(program.parameters, task.parameters.T, strict=True)),
        initial={"q0": task.q0, task.given: task.other0},
        program=program,
        driven=driven(task.inputs, task.t0, task.h, task.steps),
        _ahead=1.0 if task.h > 0 else -1.0,
        note=task.note,
        **columns,
    )
