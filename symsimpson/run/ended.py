"""States that a run keeps piece by piece, the trajectory or the error that it ends with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from symsimpson.errors import ConvergenceError, Interrupted, StorageError, reject
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.states import Outcome
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.resolution import MOST_LOOKED_AT
from symsimpson.stepping.driving import driven
from symsimpson.stepping.parts import last_part, reduced_at_ends, with_end
from symsimpson.stepping.run import KeptStates, Run
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Reals

if TYPE_CHECKING:
    from symsimpson.results.events import Events
    from symsimpson.results.sampled import Sampled, Saved

#: After so many times that states were put away, memory is asked for so many times their size: they
#: are copied when they are joined, and a lack of memory is better met before.
LOOKS, JOINING = 16, 3


class Sink:
    """Takes the states of each piece of a run; this one leaves them in the arrays of the run."""

    def __init__(self, run: Run) -> None:
        self._run = run

    def due(self, stop: int) -> int:
        """Return the step at which the piece is to end, ``stop`` or an earlier one."""
        return stop

    def take(self) -> None:
        """Take what was stored since the last call, which may be nothing."""

    def states(self) -> KeptStates:
        """Return the states that the run is judged by."""
        return self._run.stored()


class Collected(Sink):
    """All states of a run, of which nobody knows how many there will be."""

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self._parts, self._taken = list[tuple[Reals, ...]](), 0

    def take(self) -> None:
        """Put the states away, but for the last one, with which the run goes on.

        Raises StorageError if there is no memory for more states; those so far are kept.
        """
        try:
            self._parts.append(tuple(x[:-1].copy() for x in self._left()))
            self._taken += len(self._parts[-1][0])
            if len(self._parts) % LOOKS == 0:  # is there room to join them?
                np.empty(JOINING * sum(x.nbytes for part in self._parts for x in part), np.uint8)
        except MemoryError:
            run = self._run
            reject(
                f"the states of a run of {run.header.system} do not fit into memory: "
                f"{run.step} steps were taken, and those are kept.",
                remedy="Store fewer: every=1000, or "
                "every=None for the last state alone; or take a larger h.",
                error=StorageError,
            )

    def states(self) -> KeptStates:
        """Return all stored states."""
        q, p, iterations, recorded = map(
            np.concatenate, zip(*self._parts, self._left(), strict=True)
        )
        return KeptStates(q, p, iterations, recorded, self._run.every)

    def _left(self) -> tuple[Any, ...]:
        """Return columns of the states that were not put away."""
        run = self._run
        first = self._taken - run.first // run.every
        return tuple(x[first:] for x in run.stored()[:-1])


class Samples(Sink):
    """Some states of a run that nobody wants all states of.

    They are ``every`` steps apart; where there are too many, each second one is left out.
    """

    def __init__(self, run: Run, every: int) -> None:
        super().__init__(run)
        self._every, self._iterations = every, 0
        self._parts, self._number, self._seen = list[tuple[Reals, ...]](), 0, 0

    def take(self) -> None:
        """Keep some of the states."""
        run = self._run
        q, p, iterations, recorded, stride = run.stored()
        self._iterations += int(iterations[(self._seen - run.first) // stride + 1 :].sum())
        self._seen = run.first + (len(q) - 1) * stride
        first = (self._number * self._every - run.first) // stride
        some = slice(first, None, self._every // stride)
        self._parts.append(tuple(x[some].copy() for x in (q, p, recorded)))
        self._number += len(self._parts[-1][0])
        while self._number > MOST_LOOKED_AT:
            self._parts = [tuple(x[::2] for x in self._joined())]
            self._number, self._every = len(self._parts[0][0]), 2 * self._every

    def states(self) -> KeptStates:
        """Return those that were kept; iterations have shape (1,), the sum of all."""
        q, p, recorded = self._joined()
        return KeptStates(q, p, np.array([self._iterations]), recorded, self._every)

    def _joined(self) -> tuple[Reals, ...]:
        return tuple(map(np.concatenate, zip(*self._parts, strict=True)))


Result = TypeVar("Result", bound=Outcome)

#: What a run may have a row of for each state.
BY_STATE = ("t", "q", "p", "newton_iterations", "tau_values", "variations")


def trajectory_of(
    program: Program,
    run: Run,
    count: int,
    status: Status,
    spec: RunSpec,
    kept: KeptStates,
    every: int,
    left_out: int = 0,
) -> Trajectory:
    """Return what a run of so many steps has come to: each so-many-th state, or the last for 0.

    Of Newton iterations so many were ``left_out``, as they lie behind the last of the states.
    """
    done, numbers, last = run.step, program.numbers, left_out + run.last_iterations
    q, p, iterations, recorded, _ = kept
    if every:
        tau = numbers.counted(0, done + 1, every) * run.h
    else:
        tau = np.array([run.h * done], dtype=run.q.dtype)
        q, p = run.end()
        iterations = np.array([iterations.sum() + run.last_iterations], dtype=np.int64)
    t, reduced = run.t0 + tau, run.reduced(spec.reductions)
    if run.header.retimed:
        t = recorded[:, 0] if every else run.rows("TIME", 1).copy()
        if run.arrived:
            part, *end, status = last_part(program, run, spec.t_end)
            if status is Status.SUCCESS:
                if reduced:
                    reduced = _with_end(program, run, spec, reduced, end)
                tau_end = run.h * done + part
                t, tau, q, p, iterations = with_end(
                    (t, tau, q, p, iterations), (spec.t_end, tau_end, *end, last), bool(every)
                )
    recorded = recorded if every else run.left()[None]
    if run.end_within is not None:
        t_end, *end = run.end_within
        part, before = (t_end, t_end - run.t0, *np.array(end)[:, None], last), len(t)
        t, tau, q, p, iterations = with_end((t, tau, q, p, iterations), part, bool(every))
        if len(t) > before:
            recorded = np.vstack([recorded, run.left()])
        elif every:  # it is at the last state, as that was before
            q, p, recorded = (
                np.vstack([x[:-1], end_of])
                for x, end_of in ((q, end[0]), (p, end[1]), (recorded, run.left()))
            )
    message = f"{run.reason or status.message}{spec.note}"
    if status is Status.INTERRUPTED:
        where = f"t={float(run.now):g}, after step {done}. {message}"
        message = f"{program.system}, {program.scheme}: the run was interrupted at {where}"
    elif status is not Status.SUCCESS:
        of = f" of {count}" if spec.t_end is None else ""
        time, h = float(run.now), float(run.h)
        message = (
            f"{program.system}, {program.scheme}: step {done}{of} at t={time:g} with h={h:g} was "
            f"not taken. {message}"
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
        driven=driven(result(spec.inputs), single(run.t0), single(run.h), done, run.ended_by),
        **run.beside(recorded, result),
        reduced_values=reduced,
        tau_values=result(tau) if run.header.retimed else None,
        begun=None if every else (single(run.begun[0]), result(run.begun[1])),
    )


def _with_end(
    program: Program, run: Run, spec: RunSpec, reduced: Sequence[tuple[str, float]], end: Any
) -> tuple[tuple[str, float], ...]:
    """Return what observed values came to, the state at the end of a retimed run with them."""
    before, after = (run.rows("TIME", 1).copy(), *run.end()), (np.array([spec.t_end]), *end)
    names, numbers = zip(*reduced, strict=True)
    known = np.array([numbers])
    given = program, spec.reductions, run.parameters[None]
    (row,) = reduced_at_ends(*given, before, after, known).tolist()
    return tuple(zip(names, row, strict=True))


def shortened(trajectory: Trajectory, steps: int) -> dict[str, Any]:
    """Return what changes if a run ends after fewer steps; observed values are unknown then."""
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


def out_of_domain(program: Program, run: Run, t: Any, step: int) -> dict[str, Any]:
    """Return the status and the message of a run whose energy is no number after a step."""
    message = (
        f"{program.system}, {program.scheme}: the energy is no finite number at t={float(t):g}, "
        f"after step {step} with h={float(run.h):g}: T or V has no real value there, or too large "
        "a one. The motion left their domain or ran to infinity, or a step jumped across a "
        "singular point: check the state before and the sign of the potential, or try a smaller h."
    )
    return {"status": Status.NOT_FINITE, "message": message}


def uninterrupted(result: Result) -> Result:
    """Return the result of an internal run that may fail; raise Interrupted after Ctrl-C."""
    if result.status is Status.INTERRUPTED:
        raise Interrupted(result.message, trajectory=result)
    return result


def raise_failure(
    run: Run, ended: Trajectory, result: Trajectory | Events | Sampled | Saved
) -> None:
    """Raise the error of a run that did not reach its end, with what it has come to."""
    if ended.status is Status.INTERRUPTED:
        kept = "The states computed so far are in this error's .trajectory."
        raise Interrupted(f"{ended.message} {kept}", trajectory=result)
    residual, detail = run.last_correction, ""
    met = ended.status in (Status.EVENTS_ACCUMULATE, Status.BAD_INPUT)
    # else it is what was found afterwards, or an event that could not act
    if ended.steps == run.step and not met and run.last_iterations:
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
