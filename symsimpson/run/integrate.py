"""One trajectory, from what is asked for to its verdict."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from symsimpson.errors import InputError, StorageError
from symsimpson.program.input_values import read_count
from symsimpson.program.numbers import NOTHING
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.checkpoint import Checkpoint, asked, buffered
from symsimpson.run.ended import Collected, Keeper, Samples, Sink, raise_failure, trajectory_of
from symsimpson.run.resolution import each, finer_stride, sampling_stride
from symsimpson.run.short_runs import make_ready
from symsimpson.run.start import check_forces, recorders_for, started
from symsimpson.run.verdict import verdict
from symsimpson.stepping.arrival import STRIDE
from symsimpson.stepping.inputs import read_failure
from symsimpson.stepping.run import KeptStates, Run
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.files import check_folder, read_path
from symsimpson.support.progress import silence

#: Runs of fewer steps end before a bar would be drawn, and need not look for a terminal.
BRIEF = 10_000


def follow(
    program: Program,
    run: Run,
    spec: RunSpec,
    keeper: Keeper,
    sinks: Sequence[Sink] = (),
    progress: bool | None = None,
) -> tuple[Trajectory, StorageError | None]:
    """Take the steps of a run that has begun; judge its energy by the states that a keeper has.

    Of the states the trajectory has those that ``spec.every`` says, the last one for 0; ``sinks``
    take them, too. Returned are what the run came to, and the error of a sink that ended it. Raises
    InputError if forces have no value at the start.
    """
    count, problem = spec.steps, None
    shown = progress if count > BRIEF and spec.t_end is None else bool(progress)
    with run.watched(count, shown):
        try:
            _take_pieces(run, count, (keeper, *sinks))
        except StorageError as error:
            problem = error
    status = run.status if problem is None else Status.FILE_ERROR
    if status is Status.NOT_FINITE and run.step == 0:
        check_forces(program, spec)
    kept = keeper.states()
    asked, left_out = kept, 0
    if spec.every not in (0, kept.every):
        q, p, iterations, recorded = each(spec.every // kept.every, *kept[:-1])
        asked = KeptStates(q, p, iterations, recorded, spec.every)
        left_out = int(kept.iterations.sum() - iterations.sum())
    count = run.step if run.arrived else count
    trajectory = trajectory_of(program, run, count, status, spec, asked, spec.every, left_out)
    if count and status is not Status.INTERRUPTED and problem is None:
        try:
            trajectory = verdict(program, run, trajectory, kept)
        except KeyboardInterrupt:  # the states are there, what they are worth is not known
            stopped = Status.INTERRUPTED
            trajectory = replace(trajectory, status=stopped, message=stopped.message)
    return trajectory, problem


def _take_pieces(run: Run, count: int, sinks: Sequence[Sink]) -> None:
    """Take steps; hand states to the sinks when one asks for them, or there is room for no more."""
    while True:
        stop = min(count, run.room)
        try:
            run.advance(min(sink.due(stop) for sink in sinks))
        finally:  # Ctrl-C loses nothing
            for sink in sinks:
                sink.take()
        if run.step >= count or not run.alive:
            return
        run.forget()


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
