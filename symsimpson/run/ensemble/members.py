"""Tasks of ensembles: checked arguments of all members, and arrays for their results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.configuration import available_threads, lanes_for
from symsimpson.program.input_values import read_array, read_parameters, whole_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.program.observed import read_reductions
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder, split, with_clock
from symsimpson.program.status import Status
from symsimpson.results.event_record import EventRecord
from symsimpson.run.ensemble.ensemble import Ensemble
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.driving import make_input_history, read_input_values
from symsimpson.stepping.inputs import (
    choose_v0_or_p0,
    describe_changed_step,
    read_every,
    read_tangents,
    read_times,
)
from symsimpson.stepping.request import Request
from symsimpson.stepping.run_events import check_variations, read_run_events
from symsimpson.stepping.spec import RunSpec, event_names, make_recorders, read_record_names
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.names import as_mapping
from symsimpson.text.header import Header
from symsimpson.text.interface import MET


@dataclass(frozen=True)
class EnsembleSpec(RunSpec):
    """Checked arguments of an ensemble; arrays have one row for each member."""

    threads: int
    progress: bool | None
    lanes: int
    retimed: bool = False
    #: Names of the records: contacts, friction elements and events.
    event_names: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    def members(self) -> int:
        """Number of members."""
        return len(self.q0)

    def request_of_member(self, member: Any, program: Program, **more: Any) -> Request:
        """Return the request for a single run of one member."""
        names, header = program.parameters, program.header
        values = dict(zip(names, self.parameters[member], strict=True))
        given = self.inputs[min(member, len(self.inputs) - 1)]
        inputs = np.broadcast_to(given, (self.steps, *given.shape[1:])) if given.size else None
        return Request(
            self.q0[member],
            **{self.given: self.other0[member]},
            h=self.h,
            t_end=self.t_end,
            steps=self.steps if self.t_end is None else None,
            t0=self.t0,
            parameters={name: values[name] for name in names if name not in header.from_start},
            inputs=inputs,
            events=self.run_events,
            **more,
        )

    def state_recorders(self, header: Header) -> tuple[Recorder, ...]:
        """Return the recorders whose rows are stored with each state."""
        count = None if self.tangents is None else self.tangents.shape[1]
        return with_clock(header, make_recorders(header, count, self.record, ()))

    @property
    def of_variations(self) -> bool:
        """True if the task includes reductions of variations (Lyapunov, MEGNO, SALI)."""
        return any(r.of_variations for r in self.reductions)

    @property
    def times(self) -> Floats:
        """Times of the stored states, shape (stored,)."""
        stride, first = (self.every, 0) if self.every else (self.steps, 1)
        count = np.arange(first, self.stored + first, dtype=np.float64)
        return self.t0 + self.h * (count * stride)  # same round-off as in single runs

    def part(self, members: slice | Ints) -> EnsembleSpec:
        """Return the task for some of the members."""
        return replace(
            self,
            q0=np.ascontiguousarray(self.q0[members]),
            other0=np.ascontiguousarray(self.other0[members]),
            parameters=np.ascontiguousarray(self.parameters[members]),
            inputs=self.inputs if len(self.inputs) == 1 else self.inputs[members],
        )


class MemberResults:
    """Arrays for the results of an ensemble; each thread writes the rows of its own members.

    Members have the status INTERRUPTED until a thread has run them.
    """

    def __init__(self, task: EnsembleSpec, header: Header) -> None:
        shape, self._recorders = (task.members, task.stored, header.n), task.state_recorders(header)
        self.q, self.p = np.full(shape, np.nan), np.full(shape, np.nan)
        #: Status, steps and iterations of each member.
        self.codes = np.zeros((task.members, 3), dtype=np.int64)
        self.codes[:, 0] = Status.INTERRUPTED
        self.recorded = np.full(
            (*shape[:2], sum(recorder.rows for recorder in self._recorders)), np.nan
        )
        #: Duration of the last partial step, in tau.
        self.part = np.zeros(task.members)
        #: Times at which members ended, for members that ran singly, else NaN.
        self.ended_at = np.full(task.members, np.nan)
        #: Two numbers for each reduction, then the smallest pivot of M.
        self.seen = np.full((task.members, 2 * len(task.reductions) + 1), np.nan)
        #: Records of events by member.
        self.records = dict[int, tuple[EventRecord, ...]]()
        self._task = task

    def take(self, other: MemberResults, order: Ints) -> None:
        """Take the results of members from a task that has them in another order."""
        for name in ("q", "p", "codes", "recorded", "part", "ended_at", "seen"):
            getattr(self, name)[order] = getattr(other, name)

    def columns(self) -> dict[str, Any]:
        """Return the arrays as fields of :class:`Ensemble`."""
        task = self._task
        status, steps, iterations = (column.copy() for column in self.codes.T)
        status[status == MET] = Status.INTERRUPTED  # met an event, and did not run singly yet
        q, p = (self.q, self.p) if task.every else (self.q[:, 0], self.p[:, 0])
        reduced = {r.name: self.seen[:, 2 * k] for k, r in enumerate(task.reductions)}
        columns: dict[str, Any] = {
            "q": q,
            "p": p,
            "status": status,
            "steps": steps,
            "newton_iterations": iterations,
            "reduced": reduced,
            "small_pivots": self.seen[:, -1],
        }
        recorded = self.recorded if task.every else self.recorded[:, 0]
        columns["variations"], columns["recorded"] = split(self._recorders, recorded, q.shape[-1])
        if task.event_names:
            whole_steps = task.t0 + task.h * steps
            columns |= {"records": self.records, "event_names": task.event_names}
            columns["ended_at"] = np.where(np.isnan(self.ended_at), whole_steps, self.ended_at)
            if not task.every and not task.retimed:
                columns["t"] = columns["ended_at"]
        if task.retimed:
            whole = task.every * np.arange(task.stored) if task.every else steps
            t = recorded[..., 0]  # the clock is the first recorder
            tau = task.h * whole + (0 if task.every else self.part)
            columns |= {"t": t, "tau": np.where(np.isfinite(t), tau, np.nan)}
        return columns


def make_ensemble(program: Program, task: EnsembleSpec, **columns: Any) -> Ensemble:
    """Make the ensemble of a task from the fields of its results."""
    if "t" not in columns:
        columns["t"] = task.times
    return Ensemble(
        parameters=dict(zip(program.parameters, task.parameters.T, strict=True)),
        initial={"q0": task.q0, task.given: task.other0},
        program=program,
        driven=make_input_history(task.inputs, task.t0, task.h, task.steps),
        _ahead=1.0 if task.h > 0 else -1.0,
        note=task.note,
        **columns,
    )


MOST_THREADS = 1024


def read_ensemble_spec(
    program: Program, request: Request, threads: int | None, progress: bool | None, *, on_disk: bool
) -> EnsembleSpec:
    """Check the arguments of an ensemble.

    Raises InputError if one is invalid, or if the stored states do not fit into memory.
    """
    if not program.numbers.compiled:
        reject(
            "an ensemble needs double precision, but this stepper has another precision.",
            remedy="Compile a stepper without precision=.",
        )
    retimed = program.header.retimed
    h, count, t0, end = read_times(request, FLOAT64, retimed=retimed)
    how = "Pass initial velocities v0=... or initial momenta p0=..., of shape (K, n)."
    second, other0 = choose_v0_or_p0("an ensemble", how, request)
    names = ("q0", second)
    pairs = zip(names, (request.q0, other0), strict=True)
    states = [_read_states(name, given, program) for name, given in pairs]
    columns = _read_parameter_columns(program, request.parameters, (request.events, request.reduce))
    sizes = {name: len(rows) for name, rows in zip(names, states, strict=True) if rows.ndim == 2}
    sizes |= {f"parameter {name}": x.size for name, x in columns.items() if x.ndim == 1}
    driving = read_input_values(
        program, request.inputs, h, count, t0, max(sizes.values(), default=1)
    )
    sizes |= {"inputs": len(driving)} if len(driving) > 1 else {}
    members = max(sizes.values(), default=1)
    for name, size in sizes.items():
        if size != members:
            reject(
                f"{name} has {size} members, but another argument has {members}.",
                remedy="Pass one row for each member in each argument, or one row for all.",
            )
    stride, run_events = read_every(request.every), read_run_events(program, request)
    names_of_events = event_names(program, run_events)
    reductions = read_reductions(program, request.reduce, names_of_events)
    if program.modes is not None and request.record is not None:
        reject(
            "an ensemble with contacts or dry friction does not record the work.",
            where=program.system,
            remedy="Run a member alone: stepper.integrate(..., record='work').",
        )
    if run_events is not None and request.varied:
        check_variations(program, driving)
    workers = _read_threads(threads)
    lanes = lanes_for(program.header.rows, members)
    stored = count // stride + 1 if stride and end is None else 1
    try:
        values = np.empty((members, len(program.parameters)))
        shape = (members, program.n)
        q, other = (np.array(np.broadcast_to(x, shape), order="C") for x in states)
        np.empty((2, lanes if on_disk else members, stored, program.n))  # is there enough memory?
    except (MemoryError, ValueError):
        reject(
            f"{members} members with the states that every={request.every!r} stores do not fit "
            "into memory.",
            remedy="Store fewer states: every=1000, or every=None for the last states only. Or "
            "store them on disk: store='folder'.",
        )
    for k, name in enumerate(program.parameters):
        values[:, k] = columns[name]
    q, other = project_start(program, q, other, second, values, t0)
    tangents = None
    if request.carried is not None:  # zeros are the initial variations by parameters
        varied = len(program.header.varied_by or ())
        tangents = np.pad(read_tangents(program, request.carried), ((0, 0), (0, varied)))
    plain = q, other, second, values, h, t0, count, stride, driving, workers, progress, lanes
    return EnsembleSpec(
        *plain,
        retimed,
        tangents=tangents,
        t_end=end,
        record=read_record_names(program, request.record),
        reductions=reductions,
        run_events=run_events,
        event_names=names_of_events,
        note=describe_changed_step(request, h, count, FLOAT64),
    )


def _read_states(name: str, value: Any, program: Program) -> Floats:
    """Read initial positions, velocities or momenta, shape (n,) or (K, n)."""
    names, value = program.names.coordinates, as_mapping(value)
    if isinstance(value, Mapping):
        rows = names.in_order(name, value)
        columns = [
            read_array(f"{name} of {q}", x, FLOAT64) for q, x in zip(names.shown, rows, strict=True)
        ]
        try:
            value = np.stack(np.broadcast_arrays(*columns), axis=-1)
        except ValueError:
            sizes = ", ".join(f"{q} {x.shape}" for q, x in zip(names.shown, columns, strict=True))
            reject(
                f"{name} has columns of different shapes: {sizes}.",
                remedy="Pass one number for each coordinate, or one for each member.",
            )
    states = read_array(name, value, FLOAT64)
    n = len(names)
    if states.ndim not in (1, 2) or states.shape[-1] != n or states.size == 0:
        reject(
            f"{name} has shape {states.shape}, but must have shape (K, {n}) or ({n},).",
            why=f"Each member needs a row with {', '.join(names.shown)}.",
            remedy="For a single coordinate, pass a column: x[:, None].",
        )
    if not np.isfinite(states).all():
        row = int(np.argmin(np.isfinite(np.atleast_2d(states)).all(axis=1)))
        reject(
            f"{name} is not finite for member {row}.",
            why="A run must start from a finite state.",
            remedy="Check how you compute this value.",
        )
    return states


def _read_parameter_columns(
    program: Program, given: Mapping[Any, Any] | None, beside: Any
) -> dict[str, Floats]:
    """Read parameter values by name; each has shape () or (K,)."""
    program.check_given(given)
    names = program.names.parameters
    columns = dict(zip(names.shown, (np.asarray(x) for x in program.defaults), strict=True))
    if given is not None and not isinstance(given, Mapping):
        reject(
            f"parameters is {type(given).__name__}, not a mapping.",
            remedy="Pass parameters={'m': 1.0}.",
        )
    for place, value in names.values_by_place(given or {}).items():
        key = names.shown[place]
        column = read_array(f"parameter {key}", value, FLOAT64)
        if column.ndim > 1 or column.size == 0:
            reject(
                f"parameter {key} has shape {column.shape}, but must have shape () or (K,).",
                remedy="Pass one number, or one for each member.",
            )
        for extreme in (column.min(), column.max()):  # check signs as for a single run
            read_parameters(names, program.header.signs, program.defaults, {key: extreme}, FLOAT64)
        columns[key] = column
    if program.names.idle:
        places = enumerate(zip(columns.values(), program.defaults, strict=True))
        changed = [i for i, (x, default) in places if (x != default).any()]
        program.names.warn_of_idle(program.system, changed, beside)
    return columns


def _read_threads(threads: int | None) -> int:
    """Read the number of threads; the default is all processors that are available."""
    if threads is None:
        return available_threads()
    number = whole_number(threads) or 0
    if not 1 <= number <= MOST_THREADS:
        reject(
            f"threads is {threads!r}, not a whole number from 1 to {MOST_THREADS}.",
            remedy="Omit it to use all processors.",
        )
    return number
