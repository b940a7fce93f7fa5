"""The one way through a run: pieces, which sinks take, what it came to, and a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from symsimpson.errors import StorageError
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import trajectory_of
from symsimpson.run.keeping import Keeper, Sink
from symsimpson.run.resolution import each
from symsimpson.run.start import check_forces
from symsimpson.run.verdict import verdict
from symsimpson.stepping.kept import KeptStates
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec

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
