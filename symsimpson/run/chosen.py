"""Runs that keep some states alone: at chosen times, or what each piece is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import UnknownNameError, reject
from symsimpson.program.input_values import read_array, read_number
from symsimpson.program.numbers import Numbers
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.events import Events, Zeros, gather, of_run, zeros
from symsimpson.results.sampled import Sampled, Saved
from symsimpson.results.states import States
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import Samples, Sink, raise_failure
from symsimpson.run.integrate import follow, started
from symsimpson.run.resolution import sampling_stride
from symsimpson.stepping.driving import driven, since
from symsimpson.stepping.inputs import read_failure, read_step, refuse_too_many
from symsimpson.stepping.parts import STRIDE
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.names import spelled


def chosen_run(
    program: Program, spec: RunSpec, t_eval: Any, save: Any, progress: bool | None, on_failure: str
) -> Sampled | Saved:
    """Run, and keep the states at these times, or these quantities, or these there.

    Raises InputError, ConvergenceError or Interrupted.
    """
    read_failure(on_failure)
    names = None if save is None else _read_names(save)
    times = None if t_eval is None else _read_times(program, spec, t_eval)
    sign, slack = (1 if spec.h > 0 else -1), SLACK * abs(spec.h)
    done = 0

    def take(piece: Trajectory, before: int) -> Taken:
        nonlocal done
        if times is None:
            states: States = _stored(piece, before, spec)
        else:
            first, limit = done, sign * piece.t[-1] + slack
            done = int(np.searchsorted((sign * times).astype(float), float(limit), "right"))
            states = piece.at(times[first:done]) if done > first else piece[:0]
        if names is None:
            return states.t, states.q, states.p
        return states.t, *(np.asarray(states[name]) for name in names)

    if names is not None:  # before anything is computed
        _check_names(program, spec, names)
    run, last, taken = by_pieces(program, spec, take, progress)
    columns = [np.concatenate(parts) for parts in zip(*taken, strict=True)]
    if times is None and not spec.every and not columns[0].size:  # it did not come to its end
        columns = [last.t, *(np.asarray(last[name]) for name in names or ())]
    t = columns[0]
    if times is None and last.ended_by is not None and t.size > 1 and t[-1] == t[-2]:
        columns = [np.delete(x, -2, axis=0) for x in columns]  # the end takes the place of a state
    about = of_run(last) | {"h": last.h, "steps": last.steps, "records": tuple(run.records)}
    about["reduced_values"] = last.reduced_values
    about["event_names"] = spec.run_events.names if spec.run_events else ()
    result: Sampled | Saved
    if names is None:
        result = Sampled(**dict(zip("tqp", columns, strict=True)), **about)
    else:
        values = dict(zip(names, columns[1:], strict=True))
        result = Saved(t=columns[0], values=values, **about)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, result)
    return result


def last_time(program: Program, request: Request) -> tuple[Any, int | None]:
    """Return the end of a run that goes as far as it must, and the number of its steps."""
    numbers = program.numbers
    with numbers.working():
        step, start = read_step(request.h, numbers), read_number("t0", request.t0, numbers)
        times = _as_times(request.t_eval, numbers)
        far = (max if step > 0 else min)(times, default=start)
        if program.header.retimed:
            return far, None
        with np.errstate(over="ignore"):
            exact = float((far - start) / step)
        refuse_too_many(exact)
        return None, max(0, int(np.ceil(exact - SLACK)))


def _as_times(given: Any, numbers: Numbers) -> Reals:
    """Read finite times in any order."""
    times = np.atleast_1d(numbers.result(read_array("t_eval", given, numbers)))
    if times.ndim > 1:
        reject(f"t_eval has shape {times.shape}.", remedy="Pass a list of times.")
    if not np.isfinite(times.astype(float)).all():
        reject("t_eval holds times that are not finite.", remedy="Leave them out.")
    return times


def _read_times(program: Program, spec: RunSpec, given: Any) -> Reals:
    """Read times in the order of the run, within it."""
    numbers = program.numbers
    with numbers.working():
        times = _as_times(given, numbers)
    rough, sign = times.astype(float), 1 if spec.h > 0 else -1
    if not (np.diff(sign * rough) >= 0).all():
        back = "fall" if sign < 0 else "rise"
        reject(
            f"the times in t_eval do not {back} all along.",
            remedy=f"Pass numpy.sort(times){'[::-1], as h is negative' if sign < 0 else ''}.",
        )
    first = float(spec.t0)
    last = float(spec.t0 + spec.h * spec.steps if spec.t_end is None else spec.t_end)
    slack = SLACK * abs(float(spec.h))
    outside = (sign * (rough - first) < -slack) | (sign * (rough - last) > slack)
    if outside.any():
        reject(
            f"t_eval holds t = {rough[outside][0]:g}, which lies outside of the run, from "
            f"{first:g} to {last:g}.",
            remedy="Integrate further, or leave it out.",
        )
    return times


def _read_names(save: Any) -> list[str]:
    """Read names of quantities."""
    single = isinstance(save, str) or hasattr(save, "free_symbols")
    if not single and not isinstance(save, (Sequence, set, frozenset)):
        reject(
            f"save is {type(save).__name__}, not a list of names.",
            remedy="Pass names of quantities as in run['energy']: save=('q', 'energy').",
        )
    names = list(dict.fromkeys(spelled(name) for name in ([save] if single else save)))
    if not names:
        reject("save names nothing.", remedy="Pass names: save=('q', 'energy').")
    return names


def _check_names(program: Program, spec: RunSpec, names: list[str]) -> None:
    """Refuse names of quantities that states do not have."""
    q, t = spec.q0[None], np.array([spec.t0])
    begin = driven(spec.inputs, spec.t0, spec.h, spec.steps)
    states = States(
        t=t, q=q, p=0 * q, program=program, parameter_values=spec.parameters, driven=begin
    )
    for name in names:
        try:
            states[name]
        except UnknownNameError as error:
            reject(
                f"save: {error}",
                remedy="Name quantities of the run; run.save('run.nc') writes a file.",
                error=UnknownNameError,
            )


def _stored(piece: Trajectory, before: int, spec: RunSpec) -> States:
    """Return each so-many-th state of a run, of which a piece begins so many steps later."""
    last, every = piece.steps, spec.every
    if every:
        places = np.arange(-before % every, last + 1, every)
        places = places[(places > 0) | (before == 0)]
        # the end of a run to a time, or at an event, is behind part of a step
        ended = spec.t_end is not None and last == 1 and piece.t[1] == spec.t_end != piece.t[0]
        if ended or piece.ended_by is not None:
            places = np.array([1])
    else:
        end = spec.steps == before + last or (spec.t_end is not None and piece.t[-1] == spec.t_end)
        end = end or piece.ended_by is not None
        places = np.array([last] if end else [], dtype=np.int64)
    return piece[places]


#: So many states are held at a time, but no more numbers than that.
PIECE, MOST_NUMBERS = 8192, 2**23
#: Times that are so small a part of a step behind the end are that of the end, rounded.
SLACK = 1e-9

#: Takes from a piece, which begins with the last state of the one before, what is to be kept: rows
#: of which the first column is the time. It gets the number of steps done before.
Take = Callable[[Trajectory, int], "Taken"]
Taken = tuple[Any, ...]


def by_pieces(
    program: Program, spec: RunSpec, take: Take, progress: bool | None
) -> tuple[Run, Trajectory, list[Taken]]:
    """Run, and keep what is taken of each piece.

    Returned are the run, its last state and how it ended, and what was taken, up to where it went
    well. Raises InputError if the run cannot begin.
    """
    piece = min(PIECE, max(16, MOST_NUMBERS // (2 * program.n)))
    with program.numbers.working():
        run = started(program, spec, 1, piece + 1)
        stride = STRIDE if spec.t_end is not None else sampling_stride(program, spec.steps)
        pieces = Pieces(program, run, spec, take)
        samples = Samples(run, stride or max(1, spec.steps))
        last, _ = follow(program, run, replace(spec, every=0), samples, [pieces], progress)
        return run, last, pieces.up_to(last)


class Pieces(Sink):
    """A sink that keeps what is taken of each piece of a run, which stores each state."""

    def __init__(self, program: Program, run: Run, spec: RunSpec, take: Take) -> None:
        super().__init__(run)
        self._program, self._spec, self._take = program, spec, take
        self._taken, self._step = list[Taken](), -1

    def take(self) -> None:
        """Take what is to be kept of a piece."""
        if self._run.step > self._step:
            self._taken.append(self._take(self._piece(), self._run.first))
            self._step = self._run.step

    def up_to(self, last: Trajectory) -> list[Taken]:
        """Return all that was taken, up to where the run went well."""
        run, h = self._run, self._spec.h
        ends_there = last.ended_by is None and last.t[-1] == run.now  # with the last of its states
        if run.arrived and last.success and not ends_there:
            self._taken.append(self._take(self._piece(last), run.step))
        if last.success or last.status is Status.INTERRUPTED:
            return self._taken
        sign, slack = (1 if h > 0 else -1), abs(h) * SLACK
        return [
            tuple(x[sign * (part[0] - last.t[-1]) <= slack] for x in part) for part in self._taken
        ]

    def _piece(self, end: Trajectory | None = None) -> Trajectory:
        """Return the states that a run has stored, or the last one and the end."""
        program, run = self._program, self._run
        kept = run.step - run.first + 1
        tau = np.arange(run.first, run.step + 1) * run.h
        t = run.recorded[:kept, 0, 0] if run.header.retimed else run.t0 + tau
        columns: tuple[Any, ...] = t, tau, run.q[:kept, :, 0], run.p[:kept, :, 0]
        within = run.end_within
        if within is not None and within[0] == t[-1]:  # an event ended the run at the last of them
            ends = zip(columns[2:], within[1:], strict=True)
            columns = t, tau, *(np.vstack([x[:-1], y]) for x, y in ends)
        if end is not None:
            past = end.tau if run.header.retimed else end.t - run.t0
            behind = end.t, past, end.q, end.p
            columns = tuple(
                np.concatenate([x[-1:], y]) for x, y in zip(columns, behind, strict=True)
            )
        numbers = program.numbers
        t, tau, q, p = map(numbers.result, columns)
        first = run.step if end is not None else run.first
        inputs, h = numbers.result(since(self._spec.inputs, first)), numbers.single(run.h)
        acted = (record.since(first) for record in run.records if record.step >= first)
        return Trajectory(
            t=t,
            q=q,
            p=p,
            newton_iterations=run.iterations[:kept, 0],
            h=h,
            steps=len(t) - 1,
            every=1,
            status=Status.SUCCESS,
            message="",
            program=program,
            parameter_values=numbers.result(run.parameters),
            input_values=inputs,
            driven=driven(inputs, t[0], h, len(t) - 1),
            tau_values=tau if run.header.retimed else None,
            records=tuple(acted),
            ended_by=None if end is None else end.ended_by,
        )


def poincare(
    program: Program, request: Request, wanted: Zeros, progress: bool | None, on_failure: str
) -> Events:
    """Run, and keep the zeros of an expression.

    Raises InputError, ConvergenceError or Interrupted.
    """
    read_failure(on_failure)
    spec = read_run(program, request)
    run, last, crossings = by_pieces(
        program, spec, lambda piece, before: zeros(piece, wanted), progress
    )
    events = gather(last, wanted, crossings)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events
