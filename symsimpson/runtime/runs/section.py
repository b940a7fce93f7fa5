"""Sections: a long run of which only the crossings of a surface are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.runtime.inputs import read_failure
from symsimpson.runtime.results.events import Events, Zeros, gather, read_zeros, zeros
from symsimpson.runtime.results.status import Status
from symsimpson.runtime.results.trajectory import Trajectory
from symsimpson.runtime.runs.arrival import STRIDE
from symsimpson.runtime.runs.driving import since
from symsimpson.runtime.runs.integrate import (
    begin_run,
    look_at_step,
    new_run,
    raise_failure,
    trajectory_of,
)
from symsimpson.runtime.runs.resolution import sampling_stride
from symsimpson.runtime.runs.run import Run
from symsimpson.runtime.runs.spec import RunSpec
from symsimpson.runtime.runs.verdict import looked_at

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["poincare"]

#: So many states are held at a time.
PIECE = 8192


def poincare(
    stepper: Stepper,
    expression: Any,
    spec: RunSpec,
    direction: int,
    wrap: Any,
    progress: bool | None,
    on_failure: str,
) -> Events:
    """Run, and keep the zeros of an expression.

    Raises
    ------
    InputError, ConvergenceError, Interrupted
    """
    read_failure(on_failure)
    wanted = read_zeros(stepper, expression, direction, wrap)
    count, h = spec.steps, spec.h
    run = new_run(stepper, spec, 1, PIECE + 1)
    begin_run(stepper, run, spec)
    look_at_step(stepper, run, spec)
    stride = STRIDE if spec.t_end is not None else sampling_stride(stepper, count)
    found, seen = [], [tuple(x[:1, ..., 0].copy() for x in (run.q, run.p, run.kept))]
    with run.watched(count, progress if spec.t_end is None else bool(progress)):
        while run.step < count and run.alive:
            run.advance(min(run.step + PIECE, count))
            found.append(_zeros(stepper, run, spec, wanted))
            if stride:  # states to look at, behind those of the piece before
                first = stride - run.first % stride
                here = slice(first, run.step - run.first + 1, stride)
                seen.append(tuple(x[here, :, 0].copy() for x in (run.q, run.p, run.kept)))
            run.forget()
    # the states are gone, but for the last and those to look at
    run.every = stride
    q, p, kept = (np.concatenate(states) for states in zip(*seen, strict=True))
    stored = q, p, np.zeros(0, dtype=np.int64), kept
    last = trajectory_of(stepper, run, count, run.status, spec, stored, 0)
    if run.arrived and last.success:
        found.append(_zeros(stepper, run, spec, wanted, last))
    if stride and run.status is not Status.INTERRUPTED and count:
        last = looked_at(stepper, run, last, stored)
        sign = 1 if h > 0 else -1
        found = [tuple(x[sign * (part[0] - last.t[-1]) <= 0] for x in part) for part in found]
    events = gather(last, wanted, found)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events


def _zeros(
    stepper: Stepper, run: Run, spec: RunSpec, wanted: Zeros, end: Trajectory | None = None
) -> tuple[Any, ...]:  # fmt: skip
    """Find the zeros in the states that a run has stored, or between the last one and the end."""
    kept = run.step - run.first + 1
    tau = np.arange(run.first, run.step + 1) * run.h
    t = run.kept[:kept, 0, 0] if run.header.retimed else run.t0 + tau
    columns: tuple[Any, ...] = t, tau, run.q[:kept, :, 0], run.p[:kept, :, 0]
    if end is not None:
        ends = end.t, end.tau, end.q, end.p
        columns = tuple(np.concatenate([x[-1:], y]) for x, y in zip(columns, ends, strict=True))
    t, tau, q, p = columns
    piece = Trajectory(
        t=t, q=q, p=p, newton_iterations=run.iterations[:kept, 0], h=run.h, steps=len(t) - 1,
        every=1, status=Status.SUCCESS, message="", _stepper=stepper, _values=run.parameters,
        _inputs=since(spec.inputs, run.first), _tau=tau if run.header.retimed else None,
    )  # fmt: skip
    return zeros(piece, wanted, begins=run.first == 0)
