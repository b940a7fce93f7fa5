"""Storage of states during a run, and the trajectory or the error at its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from symsimpson.errors import ConvergenceError, Interrupted, StorageError, reject
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.states import RunOutcome
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.resolution import MOST_SAMPLES
from symsimpson.stepping.driving import make_input_history
from symsimpson.stepping.parts import append_end, take_last_part, update_reductions
from symsimpson.stepping.run import Run, StoredStates
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Reals

if TYPE_CHECKING:
    from symsimpson.results.events import Events
    from symsimpson.results.sampled import Sampled, Saved

#: After each ``PIECES_PER_CHECK`` pieces, a trial allocation of ``JOIN_FACTOR`` times their size
#: shows whether memory is sufficient to join the pieces at the end.
PIECES_PER_CHECK, JOIN_FACTOR = 16, 3


class Sink:
    """Receives the states of each piece of a run; the base class leaves them in the run."""

    def __init__(self, run: Run) -> None:
        self._run = run

    def next_stop(self, stop: int) -> int:
        """Return the step at which the piece must end, at most ``stop``."""
        return stop

    def take(self) -> None:
        """Receive the states that the run has stored since the last call, if any."""

    def states(self) -> StoredStates:
        """Return the states from which the run is judged."""
        return self._run.stored_states()


class StateCollector(Sink):
    """Sink that stores all states of a run whose number of steps is unknown."""

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self._parts, self._taken = list[tuple[Reals, ...]](), 0

    def take(self) -> None:
        """Copy all states but the last, from which the run continues.

        Raises StorageError if memory is full; the states so far remain available.
        """
        try:
            self._parts.append(tuple(x[:-1].copy() for x in self._new_columns()))
            self._taken += len(self._parts[-1][0])
            if len(self._parts) % PIECES_PER_CHECK == 0:  # is there enough memory to join them?
                np.empty(
                    JOIN_FACTOR * sum(x.nbytes for part in self._parts for x in part), np.uint8
                )
        except MemoryError:
            run = self._run
            reject(
                f"the states of the run do not fit into memory after {run.step} steps.",
                where=run.header.system,
                why="The states so far are available.",
                remedy="Store fewer states: every=1000, or every=None for the last state only. Or "
                "use a larger h.",
                error=StorageError,
            )

    def states(self) -> StoredStates:
        """Return all stored states."""
        q, p, iterations, recorded = map(
            np.concatenate, zip(*self._parts, self._new_columns(), strict=True)
        )
        return StoredStates(q, p, iterations, recorded, self._run.every)

    def _new_columns(self) -> tuple[Any, ...]:
        """Return the columns of the states that are not copied yet."""
        run = self._run
        first = self._taken - run.first // run.every
        return tuple(x[first:] for x in run.stored_states()[:-1])


class StateSampler(Sink):
    """Sink that stores a sample of the states, for the verdict on a run that stores none.

    The states are ``every`` steps apart. If there are too many, every second one is discarded.
    """

    def __init__(self, run: Run, every: int) -> None:
        super().__init__(run)
        self._every, self._iterations = every, 0
        self._parts, self._number, self._seen = list[tuple[Reals, ...]](), 0, 0

    def take(self) -> None:
        """Copy a sample of the new states."""
        run = self._run
        q, p, iterations, recorded, stride = run.stored_states()
        self._iterations += int(iterations[(self._seen - run.first) // stride + 1 :].sum())
        self._seen = run.first + (len(q) - 1) * stride
        first = (self._number * self._every - run.first) // stride
        some = slice(first, None, self._every // stride)
        self._parts.append(tuple(x[some].copy() for x in (q, p, recorded)))
        self._number += len(self._parts[-1][0])
        while self._number > MOST_SAMPLES:
            self._parts = [tuple(x[::2] for x in self._join())]
            self._number, self._every = len(self._parts[0][0]), 2 * self._every

    def states(self) -> StoredStates:
        """Return the sampled states; ``iterations`` has shape (1,), the total over all steps."""
        q, p, recorded = self._join()
        return StoredStates(q, p, np.array([self._iterations]), recorded, self._every)

    def _join(self) -> tuple[Reals, ...]:
        return tuple(map(np.concatenate, zip(*self._parts, strict=True)))


Result = TypeVar("Result", bound=RunOutcome)

#: Fields of a trajectory with one row for each state.
BY_STATE = ("t", "q", "p", "newton_iterations", "tau_values", "variations")


def make_trajectory(
    program: Program,
    run: Run,
    count: int,
    status: Status,
    spec: RunSpec,
    stored: StoredStates,
    every: int,
    left_out: int = 0,
) -> Trajectory:
    """Make the trajectory of a run of ``count`` steps from its stored states.

    ``every`` is the number of steps between the states, 0 for the final state only. ``left_out`` is
    the number of Newton iterations after the last stored state.
    """
    done, numbers, last = run.step, program.numbers, left_out + run.last_iterations
    q, p, iterations, recorded, _ = stored
    if every:
        tau = numbers.counted(0, done + 1, every) * run.h
    else:
        tau = np.array([run.h * done], dtype=run.q.dtype)
        q, p = run.end()
        iterations = np.array([iterations.sum() + run.last_iterations], dtype=np.int64)
    t, reduced = run.t0 + tau, run.reduction_values(spec.reductions)
    if run.header.retimed:
        t = recorded[:, 0] if every else run.rows("TIME", 1).copy()
        if run.has_arrived:
            part, *end, status = take_last_part(program, run, spec.t_end)
            if status is Status.SUCCESS:
                if reduced:
                    reduced = _reduce_end(program, run, spec, reduced, end)
                tau_end = run.h * done + part
                t, tau, q, p, iterations = append_end(
                    (t, tau, q, p, iterations), (spec.t_end, tau_end, *end, last), bool(every)
                )
    recorded = recorded if every else run.recorder_rows()[None]
    if run.end_within is not None:
        t_end, *end = run.end_within
        part, before = (t_end, t_end - run.t0, *np.array(end)[:, None], last), len(t)
        t, tau, q, p, iterations = append_end((t, tau, q, p, iterations), part, bool(every))
        if len(t) > before:
            recorded = np.vstack([recorded, run.recorder_rows()])
        elif every:  # the end replaces the last state: the event changed it
            q, p, recorded = (
                np.vstack([x[:-1], end_of])
                for x, end_of in ((q, end[0]), (p, end[1]), (recorded, run.recorder_rows()))
            )
    message = f"{run.reason or status.message}{spec.note}"
    if status is Status.INTERRUPTED:
        where = f"t={float(run.current_time):g}, after step {done}. {message}"
        message = f"{program.system}, {program.scheme}: the run was interrupted at {where}"
    elif status is not Status.SUCCESS:
        of = f" of {count}" if spec.t_end is None else ""
        time, h = float(run.current_time), float(run.h)
        message = (
            f"{program.system}, {program.scheme}: step {done}{of} at t={time:g} with h={h:g} "
            f"failed. {message}"
        )
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
        driven=make_input_history(
            result(spec.inputs), single(run.t0), single(run.h), done, run.ended_by
        ),
        **run.recorded_fields(recorded, result),
        reduced_values=reduced,
        tau_values=result(tau) if run.header.retimed else None,
        begun=None if every else (single(run.begun[0]), result(run.begun[1])),
    )


def _reduce_end(
    program: Program, run: Run, spec: RunSpec, reduced: Sequence[tuple[str, float]], end: Any
) -> tuple[tuple[str, float], ...]:
    """Update the reductions of a retimed run with its state at ``t_end``."""
    before, after = (run.rows("TIME", 1).copy(), *run.end()), (np.array([spec.t_end]), *end)
    names, numbers = zip(*reduced, strict=True)
    known = np.array([numbers])
    given = program, spec.reductions, run.parameters[None]
    (row,) = update_reductions(*given, before, after, known).tolist()
    return tuple(zip(names, row, strict=True))


def shorten(trajectory: Trajectory, steps: int) -> dict[str, Any]:
    """Return the changed fields of a trajectory that ends after fewer steps.

    Reductions are NaN, because they include the discarded states.
    """
    inputs, every = trajectory.driven, trajectory.every
    unknown = tuple((name, np.nan) for name, _ in trajectory.reduced_values)
    about: dict[str, Any] = {"steps": steps, "reduced_values": unknown}
    about["driven"] = None if inputs is None else replace(inputs, steps=steps)
    if every is not None:
        some = slice(steps // every + 1)
        columns = {name: getattr(trajectory, name) for name in BY_STATE}
        about |= {name: rows[some] for name, rows in columns.items() if rows is not None}
        recorded = trajectory.recorded_values
        about["recorded_values"] = tuple((name, rows[some]) for name, rows in recorded)
    return about


def describe_domain_error(program: Program, run: Run, t: Any, step: int) -> dict[str, Any]:
    """Return the status and the message of a run whose energy is not finite after a step."""
    message = (
        f"{program.system}, {program.scheme}: the energy is not a finite real number at "
        f"t={float(t):g}, after step {step} with h={float(run.h):g}. The motion left the domain of "
        "T or V or ran to infinity, or a step jumped across a singular point. Check the state "
        "before this step and the sign of the potential, or try a smaller h."
    )
    return {"status": Status.NOT_FINITE, "message": message}


def raise_if_interrupted(result: Result) -> Result:
    """Return the result of an internal run, successful or not; raise Interrupted after Ctrl-C."""
    if result.status is Status.INTERRUPTED:
        raise Interrupted(result.message, trajectory=result)
    return result


def raise_failure(
    run: Run, ended: Trajectory, result: Trajectory | Events | Sampled | Saved
) -> None:
    """Raise ConvergenceError or Interrupted for an unfinished run, with its result attached."""
    available = "The states computed so far are in this error's .trajectory."
    if ended.status is Status.INTERRUPTED:
        raise Interrupted(f"{ended.message} {available}", trajectory=result)
    residual, detail = run.last_correction, ""
    of_event = ended.status in (Status.EVENTS_ACCUMULATE, Status.BAD_INPUT)
    # iterations explain neither a failed event nor a failure found after the run
    if ended.steps == run.step and not of_event and run.last_iterations:
        detail = (
            f"The last of {run.last_iterations} iterations changed the step by a fraction of "
            f"{residual:.1e}. "
        )
    raise ConvergenceError(
        f"{ended.message} {detail}{available}",
        trajectory=result,
        step=ended.steps,
        time=float(ended.t[-1] if run.header.retimed else run.t0 + run.h * ended.steps),
        residual=residual,
        status=ended.status,
    )
