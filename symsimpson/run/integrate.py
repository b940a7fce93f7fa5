"""One trajectory, from its start to its verdict."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import InputError, StorageError, reject
from symsimpson.program.input_values import read_count
from symsimpson.program.numbers import NOTHING
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.checkpoint import Checkpoint, asked, buffered
from symsimpson.run.ended import Collected, Samples, Sink, raise_failure, trajectory_of
from symsimpson.run.resolution import each, finer_stride, real_energies, sampling_stride
from symsimpson.run.short_runs import make_ready
from symsimpson.run.verdict import verdict
from symsimpson.stepping.inputs import read_failure, refused_start
from symsimpson.stepping.parts import STRIDE
from symsimpson.stepping.run import KeptStates, Run
from symsimpson.stepping.spec import RunSpec, recorders_of
from symsimpson.support.array_types import Reals
from symsimpson.support.files import check_folder, read_path
from symsimpson.support.progress import silence


def started(
    program: Program,
    spec: RunSpec,
    stride: int,
    stored: int,
    inputs: Reals | None = None,
    recorders: Sequence[Recorder] = (),
) -> Run:
    """Make a run at its start; warn of its step.

    There is room for ``stored`` states, ``stride`` steps apart, 0 for none. Inputs and recorders
    are those of the request unless given. Raises InputError if the states do not fit into memory,
    M(q0) is not positive definite, the energy has no value there, or time does not advance.
    """
    given = spec.inputs if inputs is None else inputs
    asked = tuple(recorders) or recorders_for(program, spec)
    try:
        if spec.run_events is not None:
            from symsimpson.run.event_run import EventRun  # few runs need it

            run: Run = EventRun(program, spec, spec.run_events, stride, stored, given, asked)
        else:
            how = spec.parameters, spec.h, spec.t0, stride, stored, program.kernels.fallbacks
            run = Run(program, *how, given, asked)
    except InputError:
        raise
    except (MemoryError, ValueError):
        reject(
            f"{stored} stored states of {2 * program.n} numbers do not fit into memory.",
            remedy="Store fewer: every=1000, or every=None for the last state only; or "
            "keep them on disk: "
            "checkpoint='run.ckpt'.",
        )
    _begin(program, run, spec)
    if spec.steps:
        _warn_of_step(program, run, spec)
    return run


def recorders_for(program: Program, spec: RunSpec) -> tuple[Recorder, ...]:
    """Return the recorders that a run is asked for."""
    header, count = program.header, None
    if spec.tangents is not None:
        count = spec.tangents.shape[1] + len(header.varied_by or ())
    return recorders_of(header, count, spec.record, spec.reductions)


def _begin(program: Program, run: Run, spec: RunSpec) -> None:
    """Put the initial state, and the variations that are asked for, into a run."""
    numbers, q = program.numbers, spec.q0
    run.begin(q, spec.other0, velocity=spec.velocities, t_end=spec.t_end)
    pivot, velocities = float(run.value("MASS_PIVOT")), run.rows("VELOCITY", program.n)
    if program.header.fast_sines and not numbers.all_finite(velocities):
        run.begin(q, spec.other0, velocity=spec.velocities, any_angle=True, t_end=spec.t_end)
        pivot = float(run.value("MASS_PIVOT"))
    if pivot < 0 or not numbers.all_finite(velocities):
        values = map(float, run.rows("PARAMETER", len(program.parameters)))
        named = dict(zip(program.parameters, values, strict=True))
        where = f"q0={q.tolist()} with the parameters {named}"
        zero = [name for name, value in named.items() if value == 0]
        finite, everywhere = numbers.all_finite(q), pivot == 0 and _singular_elsewhere(run, spec)
        raise refused_start(program.system, where, pivot, finite, zero=zero if everywhere else None)
    if run.header.retimed and not run.parameters[-1] > 0:
        reject(
            f"{program.system}: the rate dt/dtau is {float(run.parameters[-1]):g} at "
            f"q0={q.tolist()}.",
            remedy="Time must advance: start where it is positive, or change the rate.",
        )
    run.apply("energy")
    # no value may mean an angle that is too large for fast sines: check_start takes others
    position, momentum = (run.rows(name, program.n) for name in ("POSITION", "MOMENTUM"))
    if not numbers.all_finite(run.rows("ENERGY", 1)):
        check_start(program, spec.t0, position, momentum, spec.parameters)
    run.begun = run.t0, np.array([position, momentum])
    if spec.tangents is not None:
        _begin_variations(program, run, spec.tangents, velocity=spec.velocities)
    run.look()


def _begin_variations(program: Program, run: Run, tangents: Reals, *, velocity: bool) -> None:
    """Let variations of the state and of parameters begin.

    Those of parameters leave q0 as it is, and p0 or, where that was given, v0: then
    p0 = L_v(q0, v0) changes with the parameters.
    """
    n, given = program.n, tangents.shape[1]
    varied = len(program.header.varied_by or ())
    count = given + varied
    run.rows("TANGENTS", 1)[:] = count
    run.rows("TANGENT", 2 * n * given)[:] = tangents.T.ravel()
    if velocity and varied:
        run.apply("momentum_slopes")
    run.store(0)


def _singular_elsewhere(run: Run, spec: RunSpec) -> bool:
    """Return whether M is singular at another position, too; the state of the run is lost."""
    # irrational distances from the start, so that no symmetry keeps M singular; h gives the kind of
    # number, which has many digits as well
    elsewhere = spec.q0 + run.h * 0 + np.sqrt(np.arange(2.0, run.header.n + 2)) / 7
    run.begin(elsewhere, spec.other0, velocity=spec.velocities, any_angle=True, t_end=spec.t_end)
    return not np.isfinite(run.rows("VELOCITY", run.header.n).astype(np.float64)).all()


def _warn_of_step(program: Program, run: Run, spec: RunSpec) -> None:
    """Warn once of a step beyond the limit of linear stability."""
    key = spec.h, spec.parameters.tobytes()
    plain = run.W.dtype == np.float64
    if not plain or key in program.findings.checked_steps:
        return
    program.findings.checked_steps.add(key)
    system, tools = program.declared, program.tools
    if system is not None and tools is not None:
        q, v = (run.rows(name, program.n) for name in ("POSITION", "VELOCITY"))
        values = np.concatenate([run.parameters, spec.inputs[0, 0, 0]])
        tools.check_step(program, system, q, v, values, run.h, run.t0)


def check_start(program: Program, t: Any, q: Reals, p: Reals, values: Reals) -> None:
    """Refuse a state at which the energy is not a finite real number; raises InputError."""
    if not real_energies(program, (t, q, p), values):
        reject(
            f"{program.system}: the energy is not a finite real number at q0 = "
            f"({', '.join(f'{float(x):g}' for x in q)}): T or V has no value there "
            "(the logarithm or the root of a negative number, a root of zero, or a division by "
            "zero, for example).",
            remedy="Start from a state at which both are defined, or check the formulas.",
        )


def check_forces(program: Program, spec: RunSpec) -> None:
    """Raise InputError if a force has no value, or no slope, at the start."""
    tools, system, t0 = program.tools, program.declared, float(spec.t0)
    if tools is None or system is None:
        return
    values = [*map(float, spec.parameters), *map(float, spec.inputs[0, 0, 0])]
    q = list(map(float, spec.q0))
    bad = np.flatnonzero(~np.isfinite(tools.force_terms(system, q, values, t0)))
    if bad.size:
        reject(
            f"{program.system}: the force on {program.coordinates[bad[0]]} has no finite value at "
            f"q0 = ({', '.join(f'{x:g}' for x in q)}), though T and V have.",
            remedy="A derivative of a root at zero or a quotient 0/0 makes it so. Start "
            "beside it, or "
            "write V and forces in a form that is smooth there.",
        )
    v = spec.other0
    if not spec.velocities:
        start = spec.t0, spec.q0, spec.other0
        v = evaluate(program, "energy", "VELOCITY", program.n, start, spec.parameters)
    bad = np.flatnonzero(~np.isfinite(tools.force_terms(system, q, values, t0, v)))
    if bad.size:
        reject(
            f"{program.system}: the force on {program.coordinates[bad[0]]} has a value at the "
            f"velocities of the start, ({', '.join(f'{x:g}' for x in v.tolist())}), but no slope.",
            remedy="A root that is 0 makes it so, as sqrt(v) at v = 0. Begin with another "
            "velocity, or "
            "write a force that is smooth there, as sqrt(v**2 + eps**2) with a small eps.",
        )


#: Runs of fewer steps end before a bar would be drawn, and need not look for a terminal.
BRIEF = 10_000


def follow(
    program: Program,
    run: Run,
    spec: RunSpec,
    keeper: Sink,
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
            keeper: Sink = _checkpoint(checkpoint, checkpoint_every, program, run, spec)
        elif spec.t_end is not None:
            keeper = Collected(run) if spec.every else Samples(run, stride)
        else:
            keeper = Sink(run)
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
        reject(
            "a run with many digits cannot be kept in a checkpoint.",
            remedy="Leave checkpoint out, or compile without precision.",
        )
    steps = None if every is None else read_count("checkpoint_every", every, least=1)
    return Checkpoint(place, asked(program, run, spec), run, steps)
