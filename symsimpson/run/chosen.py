"""Runs that store selected output only: chosen times, chosen quantities, or zeros."""

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
from symsimpson.results.events import Events, ZeroQuery, find_zeros, merge_zeros, run_fields
from symsimpson.results.mode_history import quantity_names
from symsimpson.results.sampled import Sampled, Saved
from symsimpson.results.states import States
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import Sink, StateSampler, raise_failure
from symsimpson.run.integrate import follow_run, start_run
from symsimpson.run.resolution import sampling_stride
from symsimpson.stepping.driving import inputs_from_step, make_input_history
from symsimpson.stepping.inputs import check_on_failure, read_step, reject_too_many_steps
from symsimpson.stepping.parts import STRIDE
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Reals
from symsimpson.support.names import spelled


def run_with_selection(
    program: Program, spec: RunSpec, t_eval: Any, save: Any, progress: bool | None, on_failure: str
) -> Sampled | Saved:
    """Run, and store the states at times ``t_eval``, the quantities ``save``, or both.

    Raises InputError, ConvergenceError or Interrupted.
    """
    check_on_failure(on_failure)
    names = None if save is None else _read_names(save)
    times = None if t_eval is None else _read_times(program, spec, t_eval)
    sign, slack = (1 if spec.h > 0 else -1), SLACK * abs(spec.h)
    done = 0

    def take(piece: Trajectory, before: int) -> Selection:
        nonlocal done
        if times is None:
            states: States = _select_stored(piece, before, spec)
        else:
            first, limit = done, sign * piece.t[-1] + slack
            done = int(np.searchsorted((sign * times).astype(float), float(limit), "right"))
            states = piece.at(times[first:done]) if done > first else piece[:0]
        if names is None:
            return states.t, states.q, states.p
        return states.t, *(np.asarray(states[name]) for name in names)

    if names is not None:
        _check_names(program, spec, names)
    run, last, pieces = run_by_pieces(program, spec, take, progress)
    columns = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    if times is None and not spec.every and not columns[0].size:  # the run failed
        columns = [last.t, *(np.asarray(last[name]) for name in names or ())]
    t = columns[0]
    if times is None and last.ended_by is not None and t.size > 1 and t[-1] == t[-2]:
        columns = [np.delete(x, -2, axis=0) for x in columns]  # the end replaces a stored state
    about = run_fields(last) | {"h": last.h, "steps": last.steps, "records": tuple(run.records)}
    about["reduced_values"] = last.reduced_values
    about["event_names"] = spec.run_events.names if spec.run_events else ()
    result: Sampled | Saved
    if names is None:
        result = Sampled(**dict(zip("tqp", columns, strict=True)), **about)
    else:
        values = dict(zip(names, columns[1:], strict=True))
        del about["history"]
        result = Saved(t=columns[0], values=values, **about)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, result)
    return result


def find_run_length(program: Program, request: Request) -> tuple[Any, int | None]:
    """Return the end and the number of steps of the shortest run that reaches all ``t_eval``.

    Only one of them is not None: the end for a retimed system, else the number of steps.
    """
    numbers = program.numbers
    with numbers.working():
        step, start = read_step(request.h, numbers), read_number("t0", request.t0, numbers)
        times = _read_finite_times(request.t_eval, numbers)
        far = (max if step > 0 else min)(times, default=start)
        if program.header.retimed:
            return far, None
        with np.errstate(over="ignore"):
            exact = float((far - start) / step)
        reject_too_many_steps(exact)
        return None, max(0, int(np.ceil(exact - SLACK)))


def _read_finite_times(given: Any, numbers: Numbers) -> Reals:
    """Read finite times in any order, shape (N,)."""
    times = np.atleast_1d(numbers.result(read_array("t_eval", given, numbers)))
    if times.ndim > 1:
        reject(
            f"t_eval has shape {times.shape}, but must have one axis.",
            remedy="Pass a list of times.",
        )
    if not np.isfinite(times.astype(float)).all():
        reject("t_eval contains times that are not finite.", remedy="Remove them.")
    return times


def _read_times(program: Program, spec: RunSpec, given: Any) -> Reals:
    """Read ``t_eval``: times in the order of the run, between its start and its end."""
    numbers = program.numbers
    with numbers.working():
        times = _read_finite_times(given, numbers)
    rough, sign = times.astype(float), 1 if spec.h > 0 else -1
    if not (np.diff(sign * rough) >= 0).all():
        order = "decreasing" if sign < 0 else "increasing"
        reject(
            f"the times in t_eval are not in {order} order.",
            remedy=f"Pass numpy.sort(times){'[::-1], as h is negative' if sign < 0 else ''}.",
        )
    first = float(spec.t0)
    last = float(spec.t0 + spec.h * spec.steps if spec.t_end is None else spec.t_end)
    slack = SLACK * abs(float(spec.h))
    outside = (sign * (rough - first) < -slack) | (sign * (rough - last) > slack)
    if outside.any():
        reject(
            f"t_eval contains t = {rough[outside][0]:g}, but the run goes from {first:g} to "
            f"{last:g}.",
            remedy="Extend the run, or remove this time.",
        )
    return times


def _read_names(save: Any) -> list[str]:
    """Read the names of quantities in ``save``, without duplicates."""
    single = isinstance(save, str) or hasattr(save, "free_symbols")
    if not single and not isinstance(save, (Sequence, set, frozenset)):
        reject(
            f"save is {type(save).__name__}, not a list of names.",
            remedy="Pass names of quantities as in run['energy']: save=('q', 'energy').",
        )
    names = list(dict.fromkeys(spelled(name) for name in ([save] if single else save)))
    if not names:
        reject("save contains no names.", remedy="Pass names: save=('q', 'energy').")
    return names


def _check_names(program: Program, spec: RunSpec, names: list[str]) -> None:
    """Reject names of quantities that states do not have."""
    q, t = spec.q0[None], np.array([spec.t0])
    begin = make_input_history(spec.inputs, spec.t0, spec.h, spec.steps)
    states = States(
        t=t, q=q, p=0 * q, program=program, parameter_values=spec.parameters, driven=begin
    )
    for name in names:
        if program.modes is not None and name in quantity_names(program):
            continue
        try:
            states[name]
        except UnknownNameError as error:
            reject(
                f"save: {error}",
                remedy="Pass names of quantities of the run. To write a file, use "
                "run.save('run.nc').",
                error=UnknownNameError,
            )


def _select_stored(piece: Trajectory, before: int, spec: RunSpec) -> States:
    """Select the states of a piece that ``spec.every`` asks to store.

    ``before`` is the number of steps before the piece.
    """
    last, every = piece.steps, spec.every
    if every:
        places = np.arange(-before % every, last + 1, every)
        places = places[(places > 0) | (before == 0)]
        # a run up to a time or to an event ends with a partial step
        ended = spec.t_end is not None and last == 1 and piece.t[1] == spec.t_end != piece.t[0]
        if ended or piece.ended_by is not None:
            places = np.array([1])
    else:
        end = spec.steps == before + last or (spec.t_end is not None and piece.t[-1] == spec.t_end)
        end = end or piece.ended_by is not None
        places = np.array([last] if end else [], dtype=np.int64)
    return piece[places]


#: Largest number of states in a piece of a run, and of numbers in its arrays.
PIECE, MOST_NUMBERS = 8192, 2**23
#: A time beyond the end by less than this fraction of a step counts as the end.
SLACK = 1e-9

#: Selects the output of a piece: columns, the first with times. A piece starts with the last state
#: of the piece before. The second argument is the number of steps before the piece.
Select = Callable[[Trajectory, int], "Selection"]
Selection = tuple[Any, ...]


def run_by_pieces(
    program: Program, spec: RunSpec, take: Select, progress: bool | None
) -> tuple[Run, Trajectory, list[Selection]]:
    """Run piece by piece, and store the output that ``take`` selects from each piece.

    Return the run, a trajectory with its final state and status, and the selected output up to a
    failure. Raises InputError if the run cannot start.
    """
    piece = min(PIECE, max(16, MOST_NUMBERS // (2 * program.n)))
    with program.numbers.working():
        run = start_run(program, spec, 1, piece + 1)
        stride = STRIDE if spec.t_end is not None else sampling_stride(program, spec.steps)
        pieces = OutputCollector(program, run, spec, take)
        samples = StateSampler(run, stride or max(1, spec.steps))
        last, _ = follow_run(program, run, replace(spec, every=0), samples, [pieces], progress)
        return run, last, pieces.collect(last)


class OutputCollector(Sink):
    """Sink that stores the selected output of each piece of a run."""

    def __init__(self, program: Program, run: Run, spec: RunSpec, take: Select) -> None:
        super().__init__(run)
        self._program, self._spec, self._select = program, spec, take
        self._selected, self._step = list[Selection](), -1

    def take(self) -> None:
        """Store the selected output of the current piece, once."""
        if self._run.step > self._step:
            self._selected.append(self._select(self._piece(), self._run.first))
            self._step = self._run.step

    def collect(self, last: Trajectory) -> list[Selection]:
        """Return the selected output of all pieces, without times after a failure."""
        run, h = self._run, self._spec.h
        # whether the end is the last stored state
        ends_there = last.ended_by is None and last.t[-1] == run.current_time
        if run.has_arrived and last.success and not ends_there:
            self._selected.append(self._select(self._piece(last), run.step))
        if last.success or last.status is Status.INTERRUPTED:
            return self._selected
        sign, slack = (1 if h > 0 else -1), abs(h) * SLACK
        return [
            tuple(x[sign * (part[0] - last.t[-1]) <= slack] for x in part)
            for part in self._selected
        ]

    def _piece(self, end: Trajectory | None = None) -> Trajectory:
        """Return the stored states as a trajectory, or the last one and the end of the run."""
        program, run = self._program, self._run
        count = run.step - run.first + 1
        tau = np.arange(run.first, run.step + 1) * run.h
        t = run.recorded[:count, 0, 0] if run.header.retimed else run.t0 + tau
        columns: tuple[Any, ...] = t, tau, run.q[:count, :, 0], run.p[:count, :, 0]
        within = run.end_within
        if within is not None and within[0] == t[-1]:  # an event ended the run at the last state
            ends = zip(columns[2:], within[1:], strict=True)
            columns = t, tau, *(np.vstack([x[:-1], y]) for x, y in ends)
        if end is not None:
            past = end.tau if run.header.retimed else end.t - run.t0
            ends = zip(columns, (end.t, past, end.q, end.p), strict=True)
            columns = tuple(np.concatenate([x[-1:], y]) for x, y in ends)
        numbers = program.numbers
        t, tau, q, p = map(numbers.result, columns)
        first = run.step if end is not None else run.first
        inputs, h = (
            numbers.result(inputs_from_step(self._spec.inputs, first)),
            numbers.single(run.h),
        )
        acted = (record.since(first) for record in run.records if record.step >= first)
        return Trajectory(
            t=t,
            q=q,
            p=p,
            newton_iterations=run.iterations[:count, 0],
            h=h,
            steps=len(t) - 1,
            every=1,
            status=Status.SUCCESS,
            message="",
            program=program,
            parameter_values=numbers.result(run.parameters),
            input_values=inputs,
            driven=make_input_history(inputs, t[0], h, len(t) - 1),
            tau_values=tau if run.header.retimed else None,
            records=tuple(acted),
            ended_by=None if end is None else end.ended_by,
            history=None if run.history is None else run.history.since(first),
        )


def poincare(
    program: Program, request: Request, wanted: ZeroQuery, progress: bool | None, on_failure: str
) -> Events:
    """Run, and store only the zeros of an expression (a Poincaré section).

    Raises InputError, ConvergenceError or Interrupted.
    """
    check_on_failure(on_failure)
    spec = read_run(program, request)
    run, last, crossings = run_by_pieces(
        program, spec, lambda piece, before: find_zeros(piece, wanted), progress
    )
    events = merge_zeros(last, wanted, crossings)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events
