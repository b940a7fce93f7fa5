"""Fast short runs of one stepper in a reusable workspace.

In a run of a few steps, most time would go into checking arguments and allocating arrays. This
module runs simple requests with the same compiled functions in a prepared workspace. If a request
is not simple, or if anything fails, :func:`integrate` runs it from the start and reports errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import copyto, empty, ndarray

from symsimpson.program.input_values import MOST_STEPS, read_vector
from symsimpson.program.numbers import FLOAT64, NO_INPUTS, workspace
from symsimpson.program.program import Program
from symsimpson.program.recorders import driver_layout, with_clock
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.resolution import (
    FEWEST,
    LIMIT,
    SAMPLES,
    count_samples,
    finer_stride,
    sampling_stride,
    thin_states,
)
from symsimpson.stepping.inputs import read_steps, read_times
from symsimpson.stepping.parts import STRIDE, append_end, time_resolution
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.interpreter import compiles_late
from symsimpson.support.names import NameTable

#: Largest product of steps and workspace rows of a short run, for a known and an unknown number of
#: steps. Such a run is over before the user could press Ctrl-C.
MOST_ROWS, MOST_TO_END = 2**21, 2**22
SUCCESS_MESSAGE = Status.SUCCESS.message
#: Types of numbers that need no conversion.
PLAIN_TYPES, DOUBLE = frozenset({int, float}), np.dtype(np.float64)
#: Result of the driver function if a run has too many steps.
TOO_LONG = -2

#: q and p at stored states, shape (2, N, n, 1); iterations, shape (N, 1).
Stored = tuple[Floats, Ints]


class BriefRequest(NamedTuple):
    """Checked arguments of a short run: parameters, initial state, and stride of storage.

    ``other`` is v0 if ``velocity`` is True, else p0. ``every`` is 0 if the run stores only the last
    state.
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
        self.sampled = allocate_states(self.most // STRIDE if retimed else SAMPLES, program.n)
        self.times = np.empty((self.most + 1 if retimed else 0, 1, 1))

    def run(
        self,
        brief: BriefRequest,
        times: tuple[Any, ...],
        counts: tuple[int, int, int, float],
        results: tuple[Floats | Ints, ...],
    ) -> int:
        """Call the driver function ``run_briefly``, or ``run_to_end`` for a retimed system.

        ``times`` are the first entries of its setting. Return the count of the function, which is
        negative on failure.
        """
        count: int = self.function(
            self.kernels,
            (self.legendre if brief.velocity else 0, *self.addresses),
            (*times, self.W, self.driver_layout),
            (brief.values, brief.q, brief.other),
            counts,
            results,
            NO_INPUTS,
        )
        return count


class ShortCall:
    """A run of few steps whose arguments are written into prepared arrays.

    Runs with the same ``spec`` differ only in their ``arguments``, which have a kind, a place and
    a shape (:class:`Argument`). One thread at a time may use an object.
    """

    def __init__(self, program: Program, spec: RunSpec, arguments: Sequence[Any]) -> None:
        self.values, q, other = (x.copy() for x in (spec.parameters, spec.q0, spec.other0))
        self._n, steps, every = program.n, spec.steps, spec.every
        stride = finer_stride(every, steps) if every else sampling_stride(program, steps)
        self._stored, self._last = every // (stride or 1), steps // stride if stride else 0
        few = min(count_samples(self._last), FEWEST - 1) if program.header.conservative else 0
        inputs = np.zeros((1, steps, *spec.inputs.shape[2:]))
        if inputs.size:
            inputs[...] = spec.inputs
        places = {"parameter": self.values, "q": q, "v": other, "p": other}
        self._targets = []
        for x in arguments:
            target = places.get(x.kind, inputs)
            if x.kind == "parameter":
                target = target[x.place : x.place + 1].reshape(())
            elif x.kind == "input":
                target = (
                    inputs[0, :, :, x.place].T if len(x.shape) == 1 else inputs[0, :, :, x.place]
                )
            self._targets.append((target, x.shape, x.sign))
        runner = BriefRunner(program)
        self._function, self._sampled = runner.function, runner.sampled
        self._start = (
            runner.kernels,
            (runner.legendre if spec.velocities else 0, *runner.addresses),
            (spec.h, spec.t0, runner.W, runner.driver_layout),
            (self.values, q, other),
            (steps, stride, few, LIMIT),
        )
        self._inputs = inputs
        #: Evaluates expressions of the outputs; the caller sets it.
        self.evaluate: Any = None

    @staticmethod
    def longest(program: Program) -> int:
        """Return the largest number of steps: a longer run may wait for Ctrl-C."""
        return MOST_ROWS // program.header.rows

    def run(self, arguments: Sequence[Any]) -> tuple[Floats, Floats] | None:
        """Return q and p of the stored states, or None if :func:`integrate` must run instead.

        A value of another type or shape, and one that is not finite, lead to None.
        """
        if len(arguments) != len(self._targets):
            return None
        try:
            for (target, shape, sign), value in zip(self._targets, arguments):  # noqa: B905
                if shape:
                    if (
                        type(value) is not ndarray
                        or value.shape != shape
                        or value.dtype.kind == "b"
                    ):
                        return None
                elif (
                    not (type(value) in PLAIN_TYPES or value.shape == ())
                    or value - value != 0
                    or (sign and sign * value <= 0)
                ):
                    return None
                copyto(target, value)  # complex numbers raise TypeError
        except (AttributeError, TypeError, ValueError, OverflowError):
            return None
        end = empty((4, self._n))
        if not self._stored:
            count = self._function(*self._start, (*self._sampled, end), self._inputs)
            return None if count < 0 else (end[0], end[1])
        states, counts = allocate_states(self._last, self._n)
        if self._function(*self._start, (states, counts, end), self._inputs) < 0:
            return None
        return states[0, :: self._stored, :, 0], states[1, :: self._stored, :, 0]


def compile_all(program: Program) -> None:
    """Compile all functions that this run and later ones may need, so that later runs do not wait.

    With ``SYMSIMPSON_COMPILE=late``, each function is compiled at its first call instead. This
    suits programs that make many steppers with one run each.
    """
    if compiles_late():
        return
    program.numbers.make_ready(program.kernels)
    if program.findings.prepared == []:
        program.findings.prepared.append(BriefRunner(program))


def allocate_states(last: int, n: int) -> Stored:
    """Allocate arrays for the initial state and ``last`` further states."""
    return np.zeros((2, last + 1, n, 1)), np.zeros((last + 1, 1), dtype=np.int64)


def read_state(name: str, value: Any, coordinates: NameTable) -> Floats:
    """Read a number for each coordinate, with a fast path for plain lists and arrays."""
    kind, n = type(value), len(coordinates)  # a value that is not finite makes the run fail
    if kind is np.ndarray and value.dtype is DOUBLE and value.shape == (n,):
        return np.array(value)
    if kind in (list, tuple) and len(value) == n and PLAIN_TYPES.issuperset(map(type, value)):
        try:
            return np.array(value, DOUBLE)
        except OverflowError:
            pass
    return read_vector(name, value, coordinates, FLOAT64)


def read_brief_request(program: Program, request: Request) -> BriefRequest | None:
    """Read a simple request whose step size was checked for stability before, else return None."""
    v0, p0, every = request.v0, request.p0, request.every
    simple = (v0 is None) is not (p0 is None) and (every is None or type(every) is int)
    if program.findings.prepared is None or not simple or not isinstance(request.h, (int, float)):
        return None
    if request.parameters is not None and program.names.idle:  # integrate() warns of unused ones
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
    """Read h (checked before), t0 and the number of steps, with a fast path for t0 = 0."""
    h, steps, t0 = request.h, request.steps, request.t0
    if request.t_end is None and type(h) is type(t0) is float and t0 == 0 and type(steps) is int:
        return h, t0, steps
    h, steps, t0 = read_steps(request, FLOAT64)
    return h, t0, steps


def try_short_run(program: Program, request: Request) -> Trajectory | None:
    """Run a short request; return None if the request is not simple, or if the run fails."""
    brief = read_brief_request(program, request)
    if brief is None or (program.header.retimed and request.t_end is None):
        return None
    return run_prepared(program, brief, request)


def run_prepared(program: Program, brief: BriefRequest, request: Request) -> Trajectory | None:
    """Run a simple request whose values were checked; return None if the run fails.

    Only times and numbers of steps are read from ``request``.
    """
    prepared = program.findings.prepared
    assert prepared is not None
    try:  # other threads may take the runner first
        runner = prepared.pop()
    except IndexError:
        runner = BriefRunner(program)
    run = _run_to_end if program.header.retimed else _run_steps
    trajectory = run(program, runner, brief, request)
    prepared.append(runner)
    return trajectory


def _run_steps(
    program: Program, runner: BriefRunner, brief: BriefRequest, request: Request
) -> Trajectory | None:
    """Take a given number of steps; return None if the run is too long or must be checked."""
    h, t0, steps = read_plain_steps(request)
    if h != request.h or not 0 < steps * program.header.rows <= MOST_ROWS:
        return None
    every, n = brief.every, program.n
    stride = finer_stride(every, steps) if every else sampling_stride(program, steps)
    last = steps // stride if stride else 0
    few = count_samples(last)
    if few and not program.header.conservative:  # the check needs the work of forces
        return None
    watched = every == 1 and few and program.tools is not None and program.declared is not None
    findings, values = program.findings, brief.values
    if watched and values.tobytes() not in findings.regular:
        return None
    stored = allocate_states(last, n) if every else runner.sampled
    end = np.empty((4, n))
    count = runner.run(brief, (h, t0), (steps, stride, few, LIMIT), (*stored, end))
    if count < 0 or (watched and not findings.regular_between(values, end[2], end[3])):
        return None
    begun = None
    if every:
        (Q, P), counts = stored
        t = t0 + np.arange(0.0, steps + 1.0, every) * h
        Q, P, iterations = thin_states(every // stride, Q[:, :, 0], P[:, :, 0], counts[:, 0])
    else:
        t, iterations = np.array([t0 + h * steps]), np.array([count])
        begun = t0, stored[0][:, 0, :, 0].copy()
        Q, P = end[:1], end[1:2]
    return _make_trajectory(program, brief, (t, Q, P, iterations), h, steps, None, begun)


def _run_to_end(
    program: Program, runner: BriefRunner, brief: BriefRequest, request: Request
) -> Trajectory | None:
    """Run a retimed system up to ``t_end``: whole steps, then a partial step."""
    h, _, t0, t_end = read_times(request, FLOAT64, retimed=True)
    key = h, t_end - t0
    if key in program.findings.long:
        return None
    every, n = brief.every, program.n
    stored = allocate_states(runner.most // every, n) if every else runner.sampled
    end, tail = np.empty((2, n)), np.empty(2)
    few = SAMPLES - 1 if program.header.conservative else 0
    times = (np.array([h, t0, t_end, time_resolution(FLOAT64)]),)
    results = stored[0], runner.times, stored[1], end, tail
    steps = runner.run(brief, times, (runner.most, every or STRIDE, few, LIMIT), results)
    if steps < 0:
        if steps == TOO_LONG:
            program.findings.long.add(key)
        return None
    t, q, p = np.array([t_end]), end[:1], end[1:]
    tau, iterations = np.array([h * steps + tail[0]]), np.array([int(tail[1])])
    if every:
        last = steps // every + 1
        (Q, P), counts = stored[0][:, :last, :, 0], stored[1][:last, 0]
        before = runner.times[:last, 0, 0].copy(), h * np.arange(0.0, steps + 1.0, every)
        final = t_end, tau, q, p, iterations - counts.sum()
        t, tau, q, p, iterations = append_end((*before, Q, P, counts), final, every=True)
    begun = None if every else (t0, stored[0][:, 0, :, 0].copy())
    return _make_trajectory(program, brief, (t, q, p, iterations), h, steps, tau, begun)


def _make_trajectory(
    program: Program,
    brief: BriefRequest,
    states: tuple[Any, ...],
    h: float,
    steps: int,
    tau: Floats | None,
    begun: tuple[float, Floats] | None,
) -> Trajectory:
    """Make the trajectory of a successful run from its times, q, p and iterations."""
    t, q, p, iterations = states
    return Trajectory(
        t=t,
        q=q,
        p=p,
        newton_iterations=iterations,
        h=h,
        steps=steps,
        every=brief.every or None,
        status=Status.SUCCESS,
        message=SUCCESS_MESSAGE,
        program=program,
        parameter_values=brief.values,
        input_values=NO_INPUTS,
        driven=None,
        tau_values=tau,
        begun=begun,
    )
