"""Requests for runs, read and checked once."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_vector
from symsimpson.program.observed import Reduction, observers, read_reductions
from symsimpson.program.program import Program
from symsimpson.program.recorders import NAMED, Recorder, tangents
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.driving import read_driving
from symsimpson.stepping.inputs import read_every, read_given, read_tangents, read_times, step_taken
from symsimpson.stepping.request import Request
from symsimpson.stepping.run_events import RunEvents, read_run_events
from symsimpson.support.array_types import Reals
from symsimpson.support.names import did_you_mean
from symsimpson.text.header import Header


@dataclass(frozen=True)
class RunSpec:
    """Where a run begins, and how far it goes; for an ensemble with one row for each member."""

    #: Positions; velocities or momenta, shape (n,) or (K, n).
    q0: Reals
    other0: Reals
    given: Literal["v0", "p0"]  #: Which of them ``other0`` are.
    parameters: Reals  #: shape (m,) or (K, m)
    h: Any
    t0: Any
    steps: int
    every: int  #: Each so-many-th state is stored; 0 for the last one alone.
    #: By member, step, node and input; an axis of one entry stands for all, shape (K, N, s, u).
    inputs: Reals
    #: Variations of the initial state; those of parameters begin by themselves, shape (2 n, k).
    tangents: Reals | None = field(default=None, kw_only=True)
    #: Where a run of unknown length ends; ``steps`` are then the most.
    t_end: Any = field(default=None, kw_only=True)
    record: tuple[str, ...] = field(default=(), kw_only=True)  #: What is added up over steps.
    #: What values of states are reduced to.
    reductions: tuple[Reduction, ...] = field(default=(), kw_only=True)
    run_events: RunEvents | None = field(default=None, kw_only=True)  #: Events that act on it.
    note: str = field(default="", kw_only=True)  #: What its message says of the step.

    @property
    def velocities(self) -> bool:
        """Whether the run begins with velocities."""
        return self.given == "v0"

    @property
    def stored(self) -> int:
        """Number of stored states."""
        return self.steps // self.every + 1 if self.every else 1

    def as_json(self) -> dict[str, Any]:
        """Return the numbers that are the same for all members, for files."""
        numbers = {"h": self.h, "t0": self.t0, "steps": self.steps, "every": self.every}
        numbers |= {} if self.t_end is None else {"t_end": self.t_end}
        if self.inputs.size:
            content = repr(self.inputs.shape).encode() + np.ascontiguousarray(self.inputs).tobytes()
            numbers["inputs"] = hashlib.sha256(content).hexdigest()
        return numbers


def read_run(program: Program, request: Request) -> RunSpec:
    """Read what a single run is asked for; raises InputError if it makes no sense."""
    numbers, names = program.numbers, program.names.coordinates
    with numbers.working():
        values = program.values(request.parameters, (request.events, request.reduce))
        h, steps, t0, end = read_times(request, numbers, retimed=program.header.retimed)
        stride = read_every(request.every)
        how = "Pass initial velocities v0=[...] or initial momenta p0=[...]."
        given, other = read_given("a run", how, request)
        q = read_vector("q0", request.q0, names, numbers)
        second = read_vector(given, other, names, numbers)
        q, second = (
            x[0] for x in project_start(program, q[None], second[None], given, values[None], t0)
        )
        inputs, carried = read_driving(program, request.inputs, h, steps, t0), request.carried
        tangents = None if carried is None else read_tangents(program, carried)
        run_events = read_run_events(program, request)
        plain = q, second, given, values, h, t0, steps, stride, inputs
        return RunSpec(
            *plain,
            tangents=tangents,
            t_end=end,
            record=read_record(program, request.record),
            reductions=_reductions(program, request.reduce, run_events.names if run_events else ()),
            run_events=run_events,
            note=step_taken(request, h, steps, numbers),
        )


def _reductions(
    program: Program, given: Any, event_names: tuple[str, ...]
) -> tuple[Reduction, ...]:
    """Read what values of the states of one run are reduced to."""
    if isinstance(given, tuple) and all(isinstance(x, Reduction) for x in given):
        return given  # read for all members of an ensemble
    reductions = read_reductions(program, given, event_names)
    for reduction in reductions:
        if reduction.of_variations:
            reject(
                f"reduce[{reduction.name!r}] is {reduction.kind!r}, which ensembles tell.",
                remedy="Ask for that of one motion: stepper.lyapunov.",
            )
    return reductions


def read_record(program: Program, given: Any) -> tuple[str, ...]:
    """Read names of what is recorded; raise InputError for an unknown name."""
    names = tuple(given) if isinstance(given, (list, tuple, set)) else (given,)
    names = () if given is None else names
    for name in names:
        if not isinstance(name, str) or name not in NAMED:
            reject(
                f"record={name!r} is nothing that a run adds up over its steps."
                f"{did_you_mean(str(name), NAMED)}",
                remedy="Pass record='work', or reduce= for values of states.",
            )
    header = program.header
    return tuple(name for name in dict.fromkeys(names) if NAMED[name](header, header.rows))


def recorders_of(
    header: Header,
    variations: int | None,
    record: Sequence[str],
    reductions: Sequence[Reduction],
    more: Sequence[Recorder] = (),
) -> tuple[Recorder, ...]:
    """Return the recorders of a run that carries so many variations along, or none."""
    carried = (*more, *(() if variations is None else (tangents(header, variations),)))
    first, named = header.rows + sum(carrier.room for carrier in carried), list[Recorder]()
    for name in record:
        if (recorder := NAMED[name](header, first)) is not None:
            named.append(recorder)
            first += recorder.room
    return *carried, *named, *observers(header, reductions, first)
