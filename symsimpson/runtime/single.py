"""One trajectory: how it begins, and what it has come to."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import ConvergenceError, InputError, Interrupted, StorageError
from symsimpson.runtime.checkpoint import Checkpoint, buffered, question_of
from symsimpson.runtime.inputs import (
    read_count,
    read_every,
    read_failure,
    read_given,
    read_steps,
    read_vector,
    refused_start,
)
from symsimpson.runtime.machine import Run
from symsimpson.runtime.numbers import NOTHING
from symsimpson.runtime.progress import Watcher, silence
from symsimpson.runtime.status import Status
from symsimpson.runtime.trajectory import Trajectory

if TYPE_CHECKING:
    from symsimpson.runtime.events import Events
    from symsimpson.runtime.stepper import Stepper

__all__ = ["integrate"]

Reals = NDArray[Any]

#: So many steps are done before anybody looks for a bar.
BRIEF = 10_000


def integrate(
    stepper: Stepper,
    q0: ArrayLike,
    v0: ArrayLike | None,
    p0: ArrayLike | None,
    times: tuple[Any, Any, Any, Any],
    parameters: Mapping[Any, Any] | None,
    every: int | None,
    checkpoint: str | os.PathLike[str] | None,
    checkpoint_every: int | None,
    progress: bool | None,
    on_failure: str,
) -> Trajectory:
    """Check what is asked for, run, and give what it has come to; ``times`` is h, t_end, steps, t0.

    Raises
    ------
    InputError, StorageError, ConvergenceError, Interrupted
    """
    read_failure(on_failure)
    numbers = stepper._numbers
    with numbers.working(), silence() if progress is False else NOTHING:
        values = stepper._values(parameters)
        h, count, t0 = read_steps(*times, numbers)
        stride = read_every(every)
        stored = count // stride + 1 if stride else 1
        if checkpoint is not None:
            stored = buffered(stride, stored, stepper.n)
        run = new_run(stepper, values, h, t0, stride, stored)
        begin_run(stepper, run, q0, v0, p0)
        if count:
            look_at_step(stepper, run, values)
        keeper = None
        if checkpoint is not None:
            keeper = _checkpoint(checkpoint, checkpoint_every, stepper, run, count, values)
        if progress or (progress is None and count > BRIEF):
            run.listener = Watcher(count, progress)
        ended, problem = None, None
        try:
            (keeper or run).advance(count)
        except KeyboardInterrupt:
            ended = Status.INTERRUPTED
        except StorageError as error:
            ended, problem = Status.FILE_ERROR, error
        finally:
            if isinstance(run.listener, Watcher):
                run.listener.close()
        status = run.status if ended is None else ended
        trajectory = trajectory_of(stepper, run, count, status, values, keeper)
        if problem is not None and on_failure == "raise":
            problem.trajectory = trajectory
            raise problem
        if status is not Status.SUCCESS and on_failure == "raise":
            raise_failure(run, trajectory)
    return trajectory


def _checkpoint(
    path: str | os.PathLike[str],
    every: int | None,
    stepper: Stepper,
    run: Run,
    count: int,
    values: Reals,
) -> Checkpoint:
    if run.W.dtype != np.float64:
        raise InputError(
            "a run with many digits cannot be kept in a checkpoint.\n"
            "Leave checkpoint out, or compile without precision."
        )
    steps = None if every is None else read_count("checkpoint_every", every, least=1)
    return Checkpoint(path, question_of(stepper, run, count, values), run, steps)


def new_run(stepper: Stepper, values: Reals, h: Any, t0: Any, stride: int, stored: int) -> Run:
    """Make a run that has room for so many states.

    Raises
    ------
    InputError
        If they do not fit into memory.
    """
    try:
        return Run(
            stepper._facts, stepper._kernels, stepper._numbers, values, h, t0, stride, stored
        )
    except (MemoryError, ValueError):
        raise InputError(
            f"{stored} stored states of {2 * stepper.n} numbers do not fit into memory.\n"
            "Store fewer: every=1000, or every=None for the last state only; or keep them on disk: "
            "checkpoint='run.ckpt'."
        ) from None


def begin_run(
    stepper: Stepper, run: Run, q0: ArrayLike, v0: ArrayLike | None, p0: ArrayLike | None
) -> None:
    """Put the initial state into a run.

    Raises
    ------
    InputError
        If it makes no sense, or M(q0) is not positive definite.
    """
    how = "Pass initial velocities v0=[...] or initial momenta p0=[...]."
    name, given = read_given("a run", how, v0, p0)
    numbers = stepper._numbers
    q = read_vector("q0", q0, stepper.coordinates, numbers)
    other = read_vector(name, given, stepper.coordinates, numbers)
    run.begin(q, other, velocity=name == "v0")
    pivot = float(run.value("MASS_PIVOT"))
    if pivot < 0 or not numbers.all_finite(run.rows("VELOCITY", stepper.n)):
        values = map(float, run.rows("PARAMETER", len(stepper.parameters)))
        named = dict(zip(stepper.parameters, values, strict=True))
        where = f"q0={q.tolist()} with the parameters {named}"
        raise refused_start(stepper.system, where, pivot, numbers.all_finite(q))


def look_at_step(stepper: Stepper, run: Run, values: Reals) -> None:
    """Look once whether a step is within the limit of linear stability, and warn of it if not."""
    key = (run.h, values.tobytes())
    plain = run.W.dtype == np.float64
    if plain and stepper._declared is not None and key not in stepper._looked_at:
        stepper._looked_at.add(key)
        from symsimpson.analysis.stability.frequency import warn_of_step  # loads SymPy

        warn_of_step(stepper, stepper._declared, run.rows("POSITION", stepper.n), values, run.h)


def trajectory_of(
    stepper: Stepper,
    run: Run,
    count: int,
    status: Status,
    values: Reals,
    keeper: Checkpoint | None = None,
) -> Trajectory:
    """Give what a run of so many steps has come to."""
    done = run.step
    if run.every:
        kept = done // run.every + 1
        t = run.t0 + stepper._numbers.counted(0, done + 1, run.every) * run.h
        if keeper is not None:
            q, p, iterations = keeper.states()
        else:
            q, p, iterations = run.q[:kept, :, 0], run.p[:kept, :, 0], run.iterations[:kept, 0]
    else:
        t = np.array([run.t0 + run.h * done], dtype=run.q.dtype)
        q, p = (run.rows(name, stepper.n)[None].copy() for name in ("POSITION", "MOMENTUM"))
        iterations = np.array([run.last_iterations], dtype=np.int64)
    message = status.message
    if status is not Status.SUCCESS:
        time, h = float(run.t0 + run.h * done), float(run.h)
        message = (
            f"{stepper.system}, {stepper.scheme}: step {done} of {count} at t={time:g} with "
            f"h={h:g} was not taken. {message}"
        )
        if keeper is not None and status is Status.INTERRUPTED:
            message += f" Go on with symsimpson.resume({os.fspath(keeper.path)!r})."
    result = stepper._numbers.result
    t, q, p, values = result(t), result(q), result(p), result(values)
    return Trajectory(
        t=t, q=q, p=p, newton_iterations=iterations, h=stepper._numbers.single(run.h), steps=done,
        every=run.every or None, status=status, message=message,
        _stepper=stepper, _values=values,
    )  # fmt: skip


def raise_failure(run: Run, trajectory: Trajectory | Events) -> None:
    """Raise the error of a run that did not reach its end."""
    status = trajectory.status
    if status is Status.INTERRUPTED:
        raise Interrupted(trajectory.message, trajectory=trajectory)
    residual = run.last_correction
    raise ConvergenceError(
        f"{trajectory.message} The last of {run.last_iterations} iterations changed the step "
        f"by a fraction of {residual:.1e}. The states before are in this error's .trajectory.",
        trajectory=trajectory,
        step=run.step,
        time=float(run.t0 + run.h * run.step),
        residual=residual,
        status=status,
    )
