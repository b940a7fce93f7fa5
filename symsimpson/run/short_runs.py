"""Short runs of one stepper, one after another, in the same workspace.

Most of a call for a few steps would go into reading what is asked for, and into making workspace
and arrays. What is asked for in the plainest way, and goes as it should, is done here, by the same
compiled functions; anything else is left to :func:`integrate`, which begins anew and says what is
wrong.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from symsimpson.program.input_values import MOST_STEPS, read_vector
from symsimpson.program.numbers import FLOAT64, NO_INPUTS, workspace
from symsimpson.program.program import Program
from symsimpson.program.recorders import driver_layout, with_clock
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.resolution import (
    LIMIT,
    SAMPLES,
    count_looked_at,
    each,
    finer_stride,
    sampling_stride,
)
from symsimpson.stepping.inputs import read_steps, read_times
from symsimpson.stepping.parts import STRIDE, resolution, with_end
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.interpreter import compiles_late
from symsimpson.support.names import Named

#: Steps times rows of the workspace: so much is over before anybody presses Ctrl-C; and so much
#: where the number of steps is not known before.
MOST_ROWS, MOST_TO_END = 2**21, 2**22
DONE = Status.SUCCESS.message
#: Numbers that need no reading.
PLAIN, DOUBLE = frozenset({int, float}), np.dtype(np.float64)
#: What is returned of a run with too many steps for this.
TOO_LONG = -2

#: q and p at stored states, shape (2, N, n, 1); iterations, shape (N, 1).
Stored = tuple[Floats, Ints]


class BriefRequest(NamedTuple):
    """Checked input of a short run: values of parameters, initial state, and stride of storage.

    ``other`` is v0 where ``velocity`` says so, else p0; ``every`` is 0 where only the last state
    is stored.
    """

    values: Floats
    q: Floats
    other: Floats
    velocity: bool
    every: int


class BriefRunner:
    """Reusable workspace, kernels and the driver function of short runs."""

    def __init__(self, program: Program) -> None:
        header, kernels, numbers = program.header, program.kernels, program.numbers
        recorders, retimed = with_clock(header, ()), header.retimed
        name, called = "run_briefly", ["energy"]
        if retimed:
            name, called = "run_to_end", ["energy", "retime"]
        self.W = workspace(header, numbers, program.defaults)
        self.driver_layout = driver_layout(header, recorders)
        self.kernels = kernels.set(kernels.fallbacks[0], recorders)
        self.legendre = kernels.address("legendre")
        self.addresses = tuple(map(kernels.address, called))
        self.function = numbers.driver(name, iterated=header.newton_unknowns > 0)
        self.most = MOST_TO_END // header.rows
        #: Buffer for sampled states that only the check of the energy reads.
        self.sampled = room(self.most // STRIDE if retimed else SAMPLES, program.n)
        self.times = np.empty((self.most + 1 if retimed else 0, 1, 1))

    def run(
        self,
        asked: BriefRequest,
        times: tuple[Any, ...],
        wanted: tuple[int, int, int, float],
        results: tuple[Floats | Ints, ...],
    ) -> int:
        """Call the function of the driver: ``run_briefly``, or ``run_to_end`` of retimed systems.

        ``times`` are what its setting begins with. Returns a number below 0 on failure.
        """
        count: int = self.function(
            self.kernels,
            (self.legendre if asked.velocity else 0, *self.addresses),
            (*times, self.W, self.driver_layout),
            (asked.values, asked.q, asked.other),
            wanted,
            results,
            NO_INPUTS,
        )
        return count


def make_ready(program: Program) -> None:
    """Compile all that a run may need, and a short one after it, so that no later one waits.

    Programs that make many steppers for a run each set ``SYMSIMPSON_COMPILE=late``: then each
    function is compiled when it is first called.
    """
    if compiles_late():
        return
    program.numbers.make_ready(program.kernels)
    if program.findings.prepared == []:
        program.findings.prepared.append(BriefRunner(program))


def room(last: int, n: int) -> Stored:
    """Return room for so many states behind the first."""
    return np.zeros((2, last + 1, n, 1)), np.zeros((last + 1, 1), dtype=np.int64)


def read_state(name: str, value: Any, coordinates: Named) -> Floats:
    """Read a number for each coordinate; quickly, if these are plain ones in their order."""
    kind, n = type(value), len(coordinates)  # what is not finite is told of where the run ends
    if kind is np.ndarray and value.dtype is DOUBLE and value.shape == (n,):
        return np.array(value)
    if kind in (list, tuple) and len(value) == n and PLAIN.issuperset(map(type, value)):
        try:
            return np.array(value, DOUBLE)
        except OverflowError:
            pass
    return read_vector(name, value, coordinates, FLOAT64)


def read_brief_request(program: Program, request: Request) -> BriefRequest | None:
    """Read a simple request whose step was checked for stability; else return None."""
    v0, p0, every = request.v0, request.p0, request.every
    simple = (v0 is None) is not (p0 is None) and (every is None or type(every) is int)
    if program.findings.prepared is None or not simple or not isinstance(request.h, (int, float)):
        return None
    if request.parameters is not None and program.names.idle:  # which may be warned of, once
        return None
    values = program.values(request.parameters)
    known = (request.h, values.tobytes()) in program.findings.checked_steps
    if not known or not (every is None or 0 < every <= MOST_STEPS):
        return None
    names = program.names.coordinates
    q = read_state("q0", request.q0, names)
    other = read_state("p0", p0, names) if v0 is None else read_state("v0", v0, names)
    return BriefRequest(values, q, other, v0 is not None, every or 0)


def read_plain_steps(request: Request) -> tuple[float, float, int]:
    """Read h, which was looked at before, t0 and the number of steps; quickly if t0 is 0."""
    h, steps, t0 = request.h, request.steps, request.t0
    if request.t_end is None and type(h) is type(t0) is float and t0 == 0 and type(steps) is int:
        return h, t0, steps
    h, steps, t0 = read_steps(request, FLOAT64)
    return h, t0, steps


def brief_run(program: Program, request: Request) -> Trajectory | None:
    """Run, and return what it has come to; None if it is not short, or something came up."""
    asked, retimed = read_brief_request(program, request), program.header.retimed
    if asked is None or (retimed and request.t_end is None):
        return None
    prepared = program.findings.prepared
    assert prepared is not None
    try:  # threads may do this at the same time
        runner = prepared.pop()
    except IndexError:
        runner = BriefRunner(program)
    trajectory = (_to_end if retimed else _of_steps)(program, runner, asked, request)
    prepared.append(runner)
    return trajectory


def _of_steps(
    program: Program, runner: BriefRunner, asked: BriefRequest, request: Request
) -> Trajectory | None:
    """Take a given number of steps."""
    h, t0, steps = read_plain_steps(request)
    if h != request.h or not 0 < steps * program.header.rows <= MOST_ROWS:
        return None
    every, n = asked.every, program.n
    stride = finer_stride(every, steps) if every else sampling_stride(program, steps)
    last = steps // stride if stride else 0
    few = count_looked_at(last)
    if few and not program.header.conservative:  # an energy that changes needs another judge
        return None
    watched = every == 1 and few and program.tools is not None and program.declared is not None
    findings, values = program.findings, asked.values
    if watched and values.tobytes() not in findings.regular:
        return None
    stored = room(last, n) if every else runner.sampled
    end = np.empty((4, n))
    count = runner.run(asked, (h, t0), (steps, stride, few, LIMIT), (*stored, end))
    if count < 0 or (watched and not findings.regular_between(values, end[2], end[3])):
        return None
    begun = None
    if every:
        (Q, P), counts = stored
        t = t0 + np.arange(0.0, steps + 1.0, every) * h
        Q, P, iterations = each(every // stride, Q[:, :, 0], P[:, :, 0], counts[:, 0])
    else:
        t, iterations = np.array([t0 + h * steps]), np.array([count])
        begun = t0, stored[0][:, 0, :, 0].copy()
        Q, P = end[:1], end[1:2]
    return _trajectory(program, asked, (t, Q, P, iterations), h, steps, None, begun)


def _to_end(
    program: Program, runner: BriefRunner, asked: BriefRequest, request: Request
) -> Trajectory | None:
    """Take as many steps as lead to a time, and a part of one."""
    h, _, t0, t_end = read_times(request, FLOAT64, retimed=True)
    key = h, t_end - t0
    if key in program.findings.long:
        return None
    every, n = asked.every, program.n
    stored = room(runner.most // every, n) if every else runner.sampled
    end, tail = np.empty((2, n)), np.empty(2)
    few = SAMPLES - 1 if program.header.conservative else 0
    times = (np.array([h, t0, t_end, resolution(FLOAT64)]),)
    results = stored[0], runner.times, stored[1], end, tail
    steps = runner.run(asked, times, (runner.most, every or STRIDE, few, LIMIT), results)
    if steps < 0:
        if steps == TOO_LONG:
            program.findings.long.add(key)
        return None
    t, q, p = np.array([t_end]), end[:1], end[1:]
    tau, iterations = np.array([h * steps + tail[0]]), np.array([int(tail[1])])
    if every:
        last = steps // every + 1
        (Q, P), kept = stored[0][:, :last, :, 0], stored[1][:last, 0]
        before = runner.times[:last, 0, 0].copy(), h * np.arange(0.0, steps + 1.0, every)
        behind = t_end, tau, q, p, iterations - kept.sum()
        t, tau, q, p, iterations = with_end((*before, Q, P, kept), behind, every=True)
    begun = None if every else (t0, stored[0][:, 0, :, 0].copy())
    return _trajectory(program, asked, (t, q, p, iterations), h, steps, tau, begun)


def _trajectory(
    program: Program,
    asked: BriefRequest,
    states: tuple[Any, ...],
    h: float,
    steps: int,
    tau: Floats | None,
    begun: tuple[float, Floats] | None,
) -> Trajectory:
    """Return a run that has come to its end, with these times, q, p and iterations."""
    t, q, p, iterations = states
    return Trajectory(
        t=t,
        q=q,
        p=p,
        newton_iterations=iterations,
        h=h,
        steps=steps,
        every=asked.every or None,
        status=Status.SUCCESS,
        message=DONE,
        program=program,
        parameter_values=asked.values,
        input_values=NO_INPUTS,
        driven=None,
        tau_values=tau,
        begun=begun,
    )
