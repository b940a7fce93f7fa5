"""A long run of which nobody keeps all states: each piece of it is looked at and forgotten."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.events import Events, Zeros, gather, zeros
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import raise_failure
from symsimpson.run.follow import follow
from symsimpson.run.keeping import Samples, Sink
from symsimpson.run.resolution import sampling_stride
from symsimpson.run.start import started
from symsimpson.stepping.arrival import STRIDE
from symsimpson.stepping.driving import driven, since
from symsimpson.stepping.inputs import read_failure
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run

#: So many states are held at a time, but no more numbers than that.
PIECE, MOST_NUMBERS = 8192, 2**23
#: Times that are so small a part of a step behind the end are that of the end, rounded.
SLACK = 1e-9

#: Takes from a piece, which begins with the last state of the one before, what is to be kept: rows
#: of which the first column is the time. It gets the number of steps done before.
Take = Callable[[Trajectory, int], "Taken"]
Taken = tuple[Any, ...]


def by_pieces(
    program: Program, spec: RunSpec, take: Take, progress: bool | None
) -> tuple[Run, Trajectory, list[Taken]]:
    """Run, and keep what is taken of each piece.

    Returned are the run, its last state and how it ended, and what was taken, up to where it went
    well. Raises InputError if the run cannot begin.
    """
    piece = min(PIECE, max(16, MOST_NUMBERS // (2 * program.n)))
    with program.numbers.working():
        run = started(program, spec, 1, piece + 1)
        stride = STRIDE if spec.t_end is not None else sampling_stride(program, spec.steps)
        pieces = Pieces(program, run, spec, take)
        samples = Samples(run, stride or max(1, spec.steps))
        last, _ = follow(program, run, replace(spec, every=0), samples, [pieces], progress)
        return run, last, pieces.up_to(last)


class Pieces(Sink):
    """A sink that keeps what is taken of each piece of a run, which stores each state."""

    def __init__(self, program: Program, run: Run, spec: RunSpec, take: Take) -> None:
        self._program, self._run, self._spec, self._take = program, run, spec, take
        self._taken, self._step = list[Taken](), -1

    def take(self) -> None:
        """Take what is to be kept of a piece."""
        if self._run.step > self._step:
            self._taken.append(self._take(self._piece(), self._run.first))
            self._step = self._run.step

    def up_to(self, last: Trajectory) -> list[Taken]:
        """Return all that was taken, up to where the run went well."""
        run, h = self._run, self._spec.h
        ends_there = last.ended_by is None and last.t[-1] == run.now  # with the last of its states
        if run.arrived and last.success and not ends_there:
            self._taken.append(self._take(self._piece(last), run.step))
        if last.success or last.status is Status.INTERRUPTED:
            return self._taken
        sign, slack = (1 if h > 0 else -1), abs(h) * SLACK
        return [
            tuple(x[sign * (part[0] - last.t[-1]) <= slack] for x in part) for part in self._taken
        ]

    def _piece(self, end: Trajectory | None = None) -> Trajectory:
        """Return the states that a run has stored, or the last one and the end."""
        program, run = self._program, self._run
        kept = run.step - run.first + 1
        tau = np.arange(run.first, run.step + 1) * run.h
        t = run.recorded[:kept, 0, 0] if run.header.retimed else run.t0 + tau
        columns: tuple[Any, ...] = t, tau, run.q[:kept, :, 0], run.p[:kept, :, 0]
        within = run.end_within
        if within is not None and within[0] == t[-1]:  # an event ended the run at the last of them
            ends = zip(columns[2:], within[1:], strict=True)
            columns = t, tau, *(np.vstack([x[:-1], y]) for x, y in ends)
        if end is not None:
            past = end.tau if run.header.retimed else end.t - run.t0
            behind = end.t, past, end.q, end.p
            columns = tuple(
                np.concatenate([x[-1:], y]) for x, y in zip(columns, behind, strict=True)
            )
        numbers = program.numbers
        t, tau, q, p = map(numbers.result, columns)
        first = run.step if end is not None else run.first
        inputs, h = numbers.result(since(self._spec.inputs, first)), numbers.single(run.h)
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


def poincare(
    program: Program, request: Request, wanted: Zeros, progress: bool | None, on_failure: str
) -> Events:
    """Run, and keep the zeros of an expression.

    Raises InputError, ConvergenceError or Interrupted.
    """
    read_failure(on_failure)
    spec = read_run(program, request)
    run, last, crossings = by_pieces(
        program, spec, lambda piece, before: zeros(piece, wanted), progress
    )
    events = gather(last, wanted, crossings)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events
