"""One trajectory: how it begins, and what it has come to."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import ConvergenceError, InputError, Interrupted, StorageError
from symsimpson.program.numbers import NOTHING
from symsimpson.program.recorders import Recorder
from symsimpson.program.status import Status
from symsimpson.program.values import read_count
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.brief import make_ready
from symsimpson.run.checkpoint import Checkpoint, asked, buffered
from symsimpson.run.resolution import check_forces, check_start, each, finer_stride, sampling_stride
from symsimpson.run.verdict import verdict
from symsimpson.stepping.arrival import ROOM, STRIDE, Collected, last_part, with_end
from symsimpson.stepping.driving import driven
from symsimpson.stepping.inputs import read_failure, refused_start
from symsimpson.stepping.recording import recorders_of
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec
from symsimpson.stepping.variations import begin_variations
from symsimpson.support.files import check_folder, read_path
from symsimpson.support.progress import silence

if TYPE_CHECKING:
    from symsimpson.program.program import Program
    from symsimpson.results.events import Events
    from symsimpson.results.sampled import Sampled, Saved

__all__ = ["integrate"]

Reals = NDArray[Any]

#: So many steps are done before anybody looks for a bar.
BRIEF = 10_000


def integrate(
    program: Program,
    spec: RunSpec,
    checkpoint: str | os.PathLike[str] | None,
    checkpoint_every: int | None,
    progress: bool | None,
    on_failure: str,
) -> Trajectory:
    """Run, and return what it has come to.

    Raises
    ------
    InputError, StorageError, ConvergenceError, Interrupted
    """
    read_failure(on_failure)
    count = spec.steps
    with program.numbers.working(), silence() if progress is False else NOTHING:
        # where no states are asked for, some are kept to look at
        stride = spec.every or (sampling_stride(program, count) if spec.t_end is None else STRIDE)
        header = program.header
        free = checkpoint is None and spec.t_end is None and spec.tangents is None
        if spec.every and free and header.real_everywhere and not header.constraints:
            stride = finer_stride(spec.every, count)
        stored = count // stride + 1 if stride else 1
        if spec.t_end is not None:
            stored = min(stored, ROOM + 1)
        if checkpoint is not None:
            width = sum(recorder.rows for recorder in _recorders(program, spec))
            stored = buffered(stride, stored, 2 * program.n + width)
        run = new_run(program, spec, stride, stored)
        begin_run(program, run, spec)
        if count:
            make_ready(program)
            look_at_step(program, run, spec)
        keeper: Checkpoint | Collected | None = None
        if spec.t_end is not None and checkpoint is None:
            keeper = Collected(run, asked=bool(spec.every))
        if checkpoint is not None:
            checkpoint = read_path("checkpoint", checkpoint)
            check_folder(checkpoint, "checkpoint")
            keeper = _checkpoint(checkpoint, checkpoint_every, asked(program, run, spec), run)
        problem = None
        shown = progress if count > BRIEF and spec.t_end is None else bool(progress)
        with run.watched(count, shown):
            try:
                (keeper or run).advance(count)
            except StorageError as error:
                problem = error
        status = run.status if problem is None else Status.FILE_ERROR
        if status is Status.NOT_FINITE and run.step == 0:
            check_forces(program, spec)
        count = run.step if run.arrived else count
        stored_states = keeper.states() if keeper is not None and run.every else run.stored()
        asked_for = stored_states
        if spec.every and spec.every > stride:
            asked_for = each(spec.every // stride, *stored_states)
        trajectory = trajectory_of(program, run, count, status, spec, asked_for, spec.every, keeper)
        if count and status is not Status.INTERRUPTED and problem is None:
            trajectory = verdict(program, run, trajectory, stored_states)
        if problem is not None and on_failure == "raise":
            problem.trajectory = trajectory
            raise problem
        if not trajectory.success and on_failure == "raise":
            raise_failure(run, trajectory, trajectory)
    return trajectory


def _checkpoint(
    path: str | os.PathLike[str], every: int | None, what: dict[str, Any], run: Run
) -> Checkpoint:
    if run.W.dtype != np.float64:
        raise InputError(
            "a run with many digits cannot be kept in a checkpoint.\n"
            "Leave checkpoint out, or compile without precision."
        )
    steps = None if every is None else read_count("checkpoint_every", every, least=1)
    return Checkpoint(path, what, run, steps)


def new_run(
    program: Program,
    spec: RunSpec,
    stride: int,
    stored: int,
    inputs: Reals | None = None,
    recorders: Sequence[Recorder] = (),
) -> Run:
    """Make a run that has room for so many states, and for what recorders leave beside them.

    Raises
    ------
    InputError
        If they do not fit into memory.
    """
    given = spec.inputs if inputs is None else inputs
    asked = tuple(recorders) or _recorders(program, spec)
    try:
        if spec.run_events is not None:
            from symsimpson.run.event_run import EventRun  # few runs need it

            return EventRun(program, spec, spec.run_events, stride, stored, given, asked)
        return Run(
            program,
            spec.parameters,
            spec.h,
            spec.t0,
            stride,
            stored,
            program.kernels.fallbacks,
            given,
            asked,
        )
    except InputError:
        raise
    except (MemoryError, ValueError):
        raise InputError(
            f"{stored} stored states of {2 * program.n} numbers do not fit into memory.\n"
            "Store fewer: every=1000, or every=None for the last state only; or keep them on disk: "
            "checkpoint='run.ckpt'."
        ) from None


def _recorders(program: Program, spec: RunSpec) -> tuple[Recorder, ...]:
    """Return the recorders that a run is asked for."""
    header, count = program.header, None
    if spec.tangents is not None:
        count = spec.tangents.shape[1] + len(header.varied_by or ())
    return recorders_of(header, count, spec.record, spec.reductions)


def begin_run(program: Program, run: Run, spec: RunSpec) -> None:
    """Put the initial state into a run.

    Raises
    ------
    InputError
        If M(q0) is not positive definite, or the energy has no value there.
    """
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
        finite, everywhere = numbers.all_finite(q), pivot == 0 and _singular_beside(run, spec)
        raise refused_start(program.system, where, pivot, finite, zero=zero if everywhere else None)
    if run.header.retimed and not run.parameters[-1] > 0:
        raise InputError(
            f"{program.system}: the rate dt/dtau is {float(run.parameters[-1]):g} at "
            f"q0={q.tolist()}.\nTime must advance: start where it is positive, or change the rate."
        )
    run.apply("energy")
    if not numbers.all_finite(run.rows("ENERGY", 1)):  # but for angles that fast sines do not take
        position, momentum = (run.rows(name, program.n) for name in ("POSITION", "MOMENTUM"))
        check_start(program, spec.t0, position, momentum, spec.parameters)
    if spec.tangents is not None:
        begin_variations(program, run, spec.tangents, velocity=spec.velocities)
    run.look()


def _singular_beside(run: Run, spec: RunSpec) -> bool:
    """Return whether M is singular at a position beside the start, too; the run ends with this."""
    beside = spec.q0 + run.h * 0 + np.sqrt(np.arange(2.0, run.header.n + 2)) / 7
    run.begin(beside, spec.other0, velocity=spec.velocities, any_angle=True, t_end=spec.t_end)
    return not np.isfinite(run.rows("VELOCITY", run.header.n).astype(np.float64)).all()


def look_at_step(program: Program, run: Run, spec: RunSpec) -> None:
    """Look once whether a step is within the limit of linear stability, and warn of it if not."""
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


def trajectory_of(
    program: Program,
    run: Run,
    count: int,
    status: Status,
    spec: RunSpec,
    stored: tuple[Reals, ...],
    every: int,
    keeper: Checkpoint | Collected | None = None,
) -> Trajectory:
    """Return what a run of so many steps has come to: each so-many-th state, or the last for 0."""
    done, numbers = run.step, program.numbers
    q, p, iterations, *more = stored
    if every:
        tau = numbers.counted(0, done + 1, every) * run.h
    else:
        tau = np.array([run.h * done], dtype=run.q.dtype)
        q, p = run.end()
        iterations = np.array([iterations.sum() + run.last_iterations], dtype=np.int64)
    t = run.t0 + tau
    if run.header.retimed:
        t = more[0][:, 0] if every else run.rows("TIME", 1).copy()
        if run.arrived:
            part, *end, status = last_part(program, run, spec.t_end)
            if status is Status.SUCCESS:
                tau_end = run.h * done + part
                t, tau, q, p, iterations = with_end(
                    (t, tau, q, p, iterations), (spec.t_end, tau_end, *end), bool(every)
                )
    recorded = more[0] if every else run.left()[None]
    if run.end_within is not None:
        t_end, *end = run.end_within
        states = (t, tau, q, p, iterations), (t_end, t_end - run.t0, *np.array(end)[:, None])
        before = len(t)
        t, tau, q, p, iterations = with_end(*states, bool(every))
        if len(t) > before:
            recorded = np.vstack([recorded, run.left()])
        elif every:  # it is at the last state, as that was before
            q, p, recorded = (
                np.vstack([x[:-1], end_of])
                for x, end_of in ((q, end[0]), (p, end[1]), (recorded, run.left()))
            )
    message = run.reason or status.message
    if status is not Status.SUCCESS:
        of = f" of {count}" if spec.t_end is None else ""
        time, h = float(run.now), float(run.h)
        message = (
            f"{program.system}, {program.scheme}: step {done}{of} at t={time:g} with h={h:g} was "
            f"not taken. {message}"
        )
        if isinstance(keeper, Checkpoint) and status is Status.INTERRUPTED:
            message += f" Go on with symsimpson.resume({os.fspath(keeper.path)!r})."
    result, single = program.numbers.result, program.numbers.single
    t, q, p, values = result(t), result(q), result(p), result(run.parameters)
    return Trajectory(
        t=t,
        q=q,
        p=p,
        newton_iterations=iterations,
        h=program.numbers.single(run.h),
        steps=done,
        every=every or None,
        status=status,
        message=message,
        program=program,
        parameter_values=values,
        input_values=result(spec.inputs),
        driven=driven(result(spec.inputs), single(run.t0), single(run.h), done, run.ended_by),
        **run.beside(recorded, result),
        reduced_values=run.reduced(spec.reductions),
        tau_values=result(tau) if run.header.retimed else None,
    )


def raise_failure(
    run: Run, ended: Trajectory, result: Trajectory | Events | Sampled | Saved
) -> None:
    """Raise the error of a run that did not reach its end, with what it has come to."""
    if ended.status is Status.INTERRUPTED:
        raise Interrupted(ended.message, trajectory=result)
    residual, detail = run.last_correction, ""
    met = ended.status in (Status.EVENTS_ACCUMULATE, Status.BAD_INPUT)
    if ended.steps == run.step and not met:  # else it is what was found afterwards
        detail = (
            f"The last of {run.last_iterations} iterations changed the step by a fraction of "
            f"{residual:.1e}. "
        )
    raise ConvergenceError(
        f"{ended.message} {detail}The states before are in this error's .trajectory.",
        trajectory=result,
        step=ended.steps,
        time=float(ended.t[-1] if run.header.retimed else run.t0 + run.h * ended.steps),
        residual=residual,
        status=ended.status,
    )
