"""One trajectory, from what is asked for to what it has come to."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from symsimpson.errors import InputError
from symsimpson.program.input_values import read_count
from symsimpson.program.numbers import NOTHING
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.checkpoint import Checkpoint, asked, buffered
from symsimpson.run.ended import raise_failure
from symsimpson.run.follow import follow
from symsimpson.run.keeping import Collected, Keeper, Samples
from symsimpson.run.resolution import finer_stride, sampling_stride
from symsimpson.run.short_runs import make_ready
from symsimpson.run.start import recorders_for, started
from symsimpson.stepping.arrival import STRIDE
from symsimpson.stepping.inputs import read_failure
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.files import check_folder, read_path
from symsimpson.support.progress import silence

#: Where the number of steps is not known before, so many states behind the first are put away at
#: a time: few enough to cost no memory, many enough to cost no time.
ROOM = 4096


def integrate(
    program: Program,
    spec: RunSpec,
    progress: bool | None = None,
    on_failure: str = "raise",
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: int | None = None,
) -> Trajectory:
    """Run, and return what it has come to.

    Raises InputError; StorageError, ConvergenceError or Interrupted unless ``on_failure`` is
    ``"return"``.
    """
    read_failure(on_failure)
    with program.numbers.working(), silence() if progress is False else NOTHING:
        stride = _stride(program, spec, to_disk=checkpoint is not None)
        run = started(program, spec, stride, _room(program, spec, stride, checkpoint is not None))
        if spec.steps:
            make_ready(program)
        if checkpoint is not None:
            keeper: Keeper = _checkpoint(checkpoint, checkpoint_every, program, run, spec)
        elif spec.t_end is not None:
            keeper = Collected(run) if spec.every else Samples(run, stride)
        else:
            keeper = Keeper(run)
        trajectory, problem = follow(program, run, spec, keeper, progress=progress)
        if isinstance(keeper, Checkpoint) and trajectory.status is Status.INTERRUPTED:
            message = f"{trajectory.message} Go on with symsimpson.resume({str(keeper.path)!r})."
            trajectory = replace(trajectory, message=message)
        if problem is not None and on_failure == "raise":
            problem.trajectory = trajectory
            raise problem
        if not trajectory.success and on_failure == "raise":
            raise_failure(run, trajectory, trajectory)
    return trajectory


def _stride(program: Program, spec: RunSpec, *, to_disk: bool) -> int:
    """Return the steps between states to store; some to look at where none or few are asked for."""
    count, header = spec.steps, program.header
    if not spec.every:
        return sampling_stride(program, count) if spec.t_end is None else STRIDE
    free = not to_disk and spec.t_end is None and spec.tangents is None
    if free and header.real_everywhere and not header.constraints:
        return finer_stride(spec.every, count)
    return spec.every


def _room(program: Program, spec: RunSpec, stride: int, to_disk: bool) -> int:
    """Return the number of states that stand in the arrays of a run at a time."""
    stored = spec.steps // stride + 1 if stride else 1
    if spec.t_end is not None:
        stored = min(stored, ROOM + 1)
    if to_disk:
        width = sum(recorder.rows for recorder in recorders_for(program, spec))
        stored = buffered(stride, stored, 2 * program.n + width)
    return stored


def _checkpoint(
    path: str | os.PathLike[str], every: int | None, program: Program, run: Run, spec: RunSpec
) -> Checkpoint:
    """Return what keeps a run on disk; raises InputError or StorageError."""
    place = read_path("checkpoint", path)
    check_folder(place, "checkpoint")
    if run.W.dtype != np.float64:
        raise InputError(
            "a run with many digits cannot be kept in a checkpoint.\n"
            "Leave checkpoint out, or compile without precision."
        )
    steps = None if every is None else read_count("checkpoint_every", every, least=1)
    return Checkpoint(place, asked(program, run, spec), run, steps)
