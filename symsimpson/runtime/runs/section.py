"""Sections: a long run of which only the crossings of a surface are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.runtime.inputs import read_failure
from symsimpson.runtime.results.events import Events, Zeros, gather, read_zeros, zeros
from symsimpson.runtime.results.status import Status
from symsimpson.runtime.results.trajectory import Trajectory
from symsimpson.runtime.runs.driving import since
from symsimpson.runtime.runs.integrate import (
    begin_run,
    look_at_step,
    looked_at,
    new_run,
    raise_failure,
    trajectory_of,
)
from symsimpson.runtime.runs.resolution import sampling_stride
from symsimpson.runtime.runs.run import Run
from symsimpson.runtime.runs.spec import RunSpec

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
    q, p = (run.rows(name, stepper.n).copy() for name in ("POSITION", "MOMENTUM"))
    stride = sampling_stride(stepper, count)
    found, seen = [], [(q[None], p[None])]
    with run.watched(count, progress):
        while run.step < count and run.alive:
            run.advance(min(run.step + PIECE, count))
            found.append(_zeros(stepper, run, spec, wanted))
            if stride:  # states to look at, behind those of the piece before
                first = stride - run.first % stride
                here = slice(first, run.step - run.first + 1, stride)
                seen.append((run.q[here, :, 0].copy(), run.p[here, :, 0].copy()))
            run.forget()
    # the states are gone, but for the last and those to look at
    run.every = stride
    q, p = (np.concatenate(states) for states in zip(*seen, strict=True))
    none = np.zeros(0, dtype=np.int64)
    last = trajectory_of(stepper, run, count, run.status, spec, (q, p, none), 0)
    if stride and run.status is not Status.INTERRUPTED and count:
        last = looked_at(stepper, run, last, q, p)
        sign = 1 if h > 0 else -1
        found = [tuple(x[sign * (part[0] - last.t[-1]) <= 0] for x in part) for part in found]
    events = gather(last, wanted, found)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events


def _zeros(stepper: Stepper, run: Run, spec: RunSpec, wanted: Zeros) -> tuple[Any, ...]:
    kept = run.step - run.first + 1
    piece = Trajectory(
        t=run.t0 + np.arange(run.first, run.step + 1) * run.h, q=run.q[:kept, :, 0],
        p=run.p[:kept, :, 0], newton_iterations=run.iterations[:kept, 0], h=run.h, steps=kept - 1,
        every=1, status=Status.SUCCESS, message="", _stepper=stepper,
        _values=spec.parameters, _inputs=since(spec.inputs, run.first),
    )  # fmt: skip
    return zeros(piece, wanted, begins=run.first == 0)
