"""Members of ensembles that keep a time of their own: each has its end after steps of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.ensemble.ensemble import Ensemble
from symsimpson.ensemble.task import Results, Task
from symsimpson.module.interface import ARRIVED
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.stepping.arrival import reduced_at_ends, states_at


def take_last_parts(program: Program, task: Task, results: Results) -> None:
    """Take the parts of a step from where members have arrived to their end.

    Where states on the way are stored, their end is not.
    """
    arrived = np.flatnonzero(results.codes[:, 0] == ARRIVED)
    results.codes[arrived, 0] = Status.SUCCESS
    if task.every or not arrived.size:
        return
    states = tuple(np.ascontiguousarray(x[arrived, 0]) for x in (results.q, results.p))
    part, q, p, fine = states_at(
        program,
        task.parameters[arrived],
        task.h,
        (results.recorded[arrived, 0, 0], *states),
        np.arange(arrived.size),
        np.full(arrived.size, task.t_end),
        1,
    )
    if task.reductions:
        fine_ones, count = arrived[fine], 2 * len(task.reductions)
        before = (results.recorded[fine_ones, 0, 0], *(x[fine] for x in states))
        ends = np.full(len(fine_ones), task.t_end), q[fine], p[fine]
        seen = results.seen[fine_ones, :count:2]
        given = program, task.reductions, task.parameters[fine_ones]
        results.seen[fine_ones, :count:2] = reduced_at_ends(*given, before, ends, seen)
    results.q[arrived, 0], results.p[arrived, 0] = q, p
    results.recorded[arrived, 0, 0], results.part[arrived] = task.t_end, part
    results.codes[arrived[~fine], 0] = Status.NOT_CONVERGED


def with_ends(ensemble: Ensemble, ends: Ensemble, every: int) -> Ensemble:
    """Return members that have every so-many-th state with the state at the end behind them.

    One that did not reach its ``ends`` has the states before that and its status.
    """
    steps = np.minimum(ensemble.steps, ends.steps)
    status = np.where(ends.status == Status.SUCCESS, ensemble.status, ends.status)
    place = steps // every + 1
    last = np.take_along_axis(ensemble.t, place[:, None] - 1, axis=1)[:, 0]
    some = np.flatnonzero((status == Status.SUCCESS) & (last != ends.t))
    stored = int(max(place.max(), 1 + place[some].max(initial=0)))
    columns: dict[str, Any] = {}
    for name in ("t", "tau", "q", "p"):
        column = getattr(ensemble, name)
        columns[name] = np.full((len(column), stored, *column.shape[2:]), np.nan)
        room = min(stored, column.shape[1])
        columns[name][:, :room] = column[:, :room]
        columns[name][np.arange(stored) >= place[:, None]] = np.nan
        columns[name][some, place[some]] = getattr(ends, name)[some]
    return replace(ensemble, **columns, status=status, steps=steps, reduced=ends.reduced)
