"""A long run of which nobody keeps all states: each piece of it is looked at and forgotten."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.integrate import begin_run, look_at_step, new_run, trajectory_of
from symsimpson.run.resolution import sampling_stride
from symsimpson.run.verdict import verdict
from symsimpson.stepping.arrival import STRIDE
from symsimpson.stepping.driving import driven, since
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec

__all__ = ["Taken", "by_pieces"]

#: So many states are held at a time, but no more numbers than that.
PIECE, MOST_NUMBERS = 8192, 2**23
#: Times that are so small a part of a step behind the end are that of the end, rounded.
SLACK = 1e-9

#: Takes from a piece, which begins with the last state of the one before, what is to be kept: rows
#: of which the first column is the time. It is told how many steps were done before.
Taken = tuple[Any, ...]


def by_pieces(
    program: Program, spec: RunSpec, take: Callable[[Trajectory, int], Taken], progress: bool | None
) -> tuple[Run, Trajectory, list[Taken]]:
    """Run, and keep what is taken of each piece.

    Returns
    -------
    Run, Trajectory, list
        The run, its last state and how it ended, and what was taken, up to where it went well.

    Raises
    ------
    InputError
        If the run cannot begin.
    """
    with program.numbers.working():
        return _by_pieces(program, spec, take, progress)


def _by_pieces(
    program: Program, spec: RunSpec, take: Callable[[Trajectory, int], Taken], progress: bool | None
) -> tuple[Run, Trajectory, list[Taken]]:
    count, piece = spec.steps, min(PIECE, max(16, MOST_NUMBERS // (2 * program.n)))
    run = new_run(program, spec, 1, piece + 1)
    begin_run(program, run, spec)
    look_at_step(program, run, spec)
    stride = STRIDE if spec.t_end is not None else sampling_stride(program, count)
    taken, seen = [], [tuple(x[:1, ..., 0].copy() for x in (run.q, run.p, run.recorded))]
    if not count:
        taken.append(take(_piece(program, run, spec), 0))
    with run.watched(count, progress if spec.t_end is None else bool(progress)):
        while run.step < count and run.alive:
            run.advance(min(run.step + piece, count))
            taken.append(take(_piece(program, run, spec), run.first))
            if stride:  # states to look at, behind those of the piece before
                first = stride - run.first % stride
                here = slice(first, run.step - run.first + 1, stride)
                seen.append(tuple(x[here, :, 0].copy() for x in (run.q, run.p, run.recorded)))
            run.forget()
    # the states are gone, but for the last and those to look at
    run.every = stride
    q, p, kept = (np.concatenate(states) for states in zip(*seen, strict=True))
    stored = q, p, np.zeros(0, dtype=np.int64), kept
    last = trajectory_of(program, run, count, run.status, spec, stored, 0)
    if run.arrived and last.success:
        taken.append(take(_piece(program, run, spec, last), run.step))
    if stride and run.status is not Status.INTERRUPTED and count:
        last = verdict(program, run, last, stored)
        sign, slack = (1 if spec.h > 0 else -1), abs(spec.h) * SLACK
        taken = [tuple(x[sign * (part[0] - last.t[-1]) <= slack] for x in part) for part in taken]
    return run, last, taken


def _piece(program: Program, run: Run, spec: RunSpec, end: Trajectory | None = None) -> Trajectory:
    """Return the states that a run has stored, or the last one and the end."""
    kept = run.step - run.first + 1
    tau = np.arange(run.first, run.step + 1) * run.h
    t = run.recorded[:kept, 0, 0] if run.header.retimed else run.t0 + tau
    columns: tuple[Any, ...] = t, tau, run.q[:kept, :, 0], run.p[:kept, :, 0]
    if end is not None:
        ends = end.t, end.tau, end.q, end.p
        columns = tuple(np.concatenate([x[-1:], y]) for x, y in zip(columns, ends, strict=True))
    numbers = program.numbers
    t, tau, q, p = map(numbers.result, columns)
    inputs, h = numbers.result(since(spec.inputs, run.first)), numbers.single(run.h)
    first = run.step if end is not None else run.first
    acted = (record.since(first) for record in run.records if record.step >= first)
    return Trajectory(
        t=t,
        q=q,
        p=p,
        newton_iterations=run.iterations[:kept, 0],
        h=h,
        steps=len(t) - 1,
        every=1,
        status=Status.SUCCESS,
        message="",
        program=program,
        parameter_values=numbers.result(run.parameters),
        input_values=inputs,
        driven=driven(inputs, t[0], h, len(t) - 1),
        tau_values=tau if run.header.retimed else None,
        records=tuple(acted),
        ended_by=None if end is None else end.ended_by,
    )
