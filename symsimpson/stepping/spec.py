"""Specification of a run: the checked arguments in the form that the run uses."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_vector
from symsimpson.program.observed import Reduction, read_reductions, reduction_recorders
from symsimpson.program.program import Program
from symsimpson.program.recorders import RECORDERS, Recorder, tangents
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.driving import read_input_values
from symsimpson.stepping.inputs import (
    choose_v0_or_p0,
    describe_changed_step,
    read_every,
    read_tangents,
    read_times,
)
from symsimpson.stepping.request import Request
from symsimpson.stepping.run_events import RunEvents, read_run_events
from symsimpson.support.array_types import Reals
from symsimpson.support.names import did_you_mean
from symsimpson.text.header import Header


@dataclass(frozen=True)
class RunSpec:
    """Checked arguments of a run; of an ensemble, arrays have one row for each of K members."""

    #: Initial positions, and initial velocities or momenta, shape (n,) or (K, n).
    q0: Reals
    other0: Reals
    given: Literal["v0", "p0"]  #: Whether ``other0`` has velocities or momenta.
    parameters: Reals  #: Values of the parameters, shape (m,) or (K, m).
    h: Any  #: Step size.
    t0: Any  #: Initial time.
    steps: int  #: Number of steps, or the upper limit if ``t_end`` is set.
    every: int  #: Number of steps between stored states; 0 for the last state only.
    #: Member, step, node and input, shape (K, N, s, u); axes of length 1 are broadcast.
    inputs: Reals
    #: Variations of the initial state, shape (2 n, k); the run adds those by parameters.
    tangents: Reals | None = field(default=None, kw_only=True)
    #: Final time of a retimed run, whose number of steps is unknown; None for other runs.
    t_end: Any = field(default=None, kw_only=True)
    record: tuple[str, ...] = field(default=(), kw_only=True)  #: Sums over steps to record.
    reductions: tuple[Reduction, ...] = field(default=(), kw_only=True)  #: Reductions of values.
    run_events: RunEvents | None = field(default=None, kw_only=True)  #: Events that act on the run.
    #: Sentence for the message of the result if h differs from the requested step size.
    note: str = field(default="", kw_only=True)
    checked: bool = field(default=False, kw_only=True)  #: Whether a run has checked the step size.

    @property
    def velocities(self) -> bool:
        """True if ``other0`` has velocities."""
        return self.given == "v0"

    @property
    def stored(self) -> int:
        """Number of stored states."""
        return self.steps // self.every + 1 if self.every else 1

    def as_json(self) -> dict[str, Any]:
        """Return the values that all members share, as JSON, with a digest of the inputs."""
        numbers = {"h": self.h, "t0": self.t0, "steps": self.steps, "every": self.every}
        numbers |= {} if self.t_end is None else {"t_end": self.t_end}
        if self.inputs.size:
            content = repr(self.inputs.shape).encode() + np.ascontiguousarray(self.inputs).tobytes()
            numbers["inputs"] = hashlib.sha256(content).hexdigest()
        return numbers


def read_run(program: Program, request: Request) -> RunSpec:
    """Check the arguments of a single run; raise InputError if one is invalid."""
    with program.numbers.working():
        spec = read_settings(program, request)
        start = spec.q0[None], spec.other0[None], spec.given, spec.parameters[None], spec.t0
        q, second = (x[0] for x in project_start(program, *start, h=spec.h))
        return replace(spec, q0=q, other0=second)


def read_settings(program: Program, request: Request) -> RunSpec:
    """Check the arguments of a run without a projection of q0 onto the constraints."""
    numbers, names = program.numbers, program.names.coordinates
    with numbers.working():
        values = program.values(request.parameters, (request.events, request.reduce))
        h, steps, t0, end = read_times(request, numbers, retimed=program.header.retimed)
        stride = read_every(request.every)
        how = "Pass initial velocities v0=[...] or initial momenta p0=[...]."
        given, other = choose_v0_or_p0("a run", how, request)
        q = read_vector("q0", request.q0, names, numbers)
        second = read_vector(given, other, names, numbers)
        inputs, carried = read_input_values(program, request.inputs, h, steps, t0), request.carried
        tangents = None if carried is None else read_tangents(program, carried)
        run_events = read_run_events(program, request)
        plain = q, second, given, values, h, t0, steps, stride, inputs
        return RunSpec(
            *plain,
            tangents=tangents,
            t_end=end,
            record=read_record_names(program, request.record),
            reductions=_reductions(program, request.reduce, event_names(program, run_events)),
            run_events=run_events,
            note=describe_changed_step(request, h, steps, numbers),
        )


def event_names(program: Program, run_events: RunEvents | None) -> tuple[str, ...]:
    """Return the names of what acts on a run: contacts, friction elements and events."""
    acting = () if run_events is None else run_events.names
    return acting if program.modes is None else (*program.modes.names, *acting)


def _reductions(
    program: Program, given: Any, event_names: tuple[str, ...]
) -> tuple[Reduction, ...]:
    """Read the reductions of a single run; reject those that only ensembles have."""
    if isinstance(given, tuple) and all(isinstance(x, Reduction) for x in given):
        return given  # read for all members of an ensemble
    reductions = read_reductions(program, given, event_names)
    for reduction in reductions:
        if reduction.of_variations:
            reject(
                f"reduce[{reduction.name!r}] is {reduction.kind!r}, which only ensembles support.",
                remedy="For a single run, use stepper.lyapunov.",
            )
    return reductions


def read_record_names(program: Program, given: Any) -> tuple[str, ...]:
    """Read the names of sums over steps; raise InputError for an unknown name."""
    names = tuple(given) if isinstance(given, (list, tuple, set)) else (given,)
    names = () if given is None else names
    for name in names:
        if not isinstance(name, str) or name not in RECORDERS:
            reject(
                f"record={name!r} is not a quantity that a run sums over its steps."
                f"{did_you_mean(str(name), RECORDERS)}",
                remedy="Pass record='work'. For values at states, use reduce=.",
            )
    some = dict.fromkeys(names)
    return tuple(x for x in some if program.modes is not None or RECORDERS[x](program.header))


def make_recorders(
    header: Header,
    variations: int | None,
    record: Sequence[str],
    reductions: Sequence[Reduction],
    more: Sequence[Recorder] = (),
) -> tuple[Recorder, ...]:
    """Return the recorders of a run with ``variations`` variations of the state (None: without).

    ``more`` are recorders that come first.
    """
    carried = (*more, *(() if variations is None else (tangents(header, variations),)))
    first, named = header.rows + sum(carrier.room for carrier in carried), list[Recorder]()
    for name in record:
        if (recorder := RECORDERS[name](header)) is not None:
            named.append(recorder)
            first += recorder.room
    return *carried, *named, *reduction_recorders(header, reductions, first)
