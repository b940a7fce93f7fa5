"""Dense output: the states of a run at any time."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import ConvergenceError, reject
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import workspace
from symsimpson.program.status import Status
from symsimpson.results.states import FinishedRun
from symsimpson.stepping.driving import inputs_from_step, interpolate_inputs, node_places
from symsimpson.stepping.parts import PartialSteps, compute_states_at, take_steps_from
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.markup import box

#: Smaller parts of a step, relative to the step size, count as zero.
SMALLEST_PART = 1e-14
#: Number of steps between two checks for Ctrl-C.
BATCH = 16384
#: Numbers of parts to divide the rest of a step into, until all parts converge.
DIVISIONS = (1, 4, 16, 64)
#: Over this part of a step, the path is straight up to round-off.
LINEAR_PART = 1e-10


class DenseOutput:
    """The states of a run at any time between its ends; ``run.sol`` returns it.

    Between two steps, a shorter step of the same scheme starts from the previous stored state. The
    result is continuous, and equals the stored states at their times. Positions and momenta have
    the order of the scheme everywhere, and each map is symplectic. A time costs one step.

    The polynomial of a Galerkin scheme would be less accurate. Its degree is d, and its order
    between the ends is at most d + 1. This is 3 for Simpson's scheme, whose order is 4. It is 9
    for 8 Gauss nodes, whose order is 16.

    Parameters
    ----------
    run : Trajectory
        A run that stores states, not only its final one.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> run.sol(0.25).shape, run.sol([0.25, 0.5, 1.234]).shape
    ((2,), (2, 3))
    >>> bool((run.sol(run.t) == run.y).all())
    True
    """

    def __init__(self, run: FinishedRun) -> None:
        if run.every is None and run.steps:
            reject(
                "dense output needs stored states, but this run stored only its final state.",
                remedy="Pass every=1 or every=100 instead of every=None.",
            )
        self._run = run
        numbers = run.program.numbers
        with numbers.working():  # float64 arrays are not copied
            arrays = [
                np.ascontiguousarray(x) if x.dtype == np.float64 else numbers.read(x)
                for x in (run.t, run.q, run.p, run.input_values)
            ]
        self._t, self._q, self._p, self.input_values = arrays
        self._retimed = run.program.header.retimed
        uneven = self._retimed or run.ended_by is not None
        self._end = run.t[-1] if uneven else run.t[0] + run.h * run.steps
        self._sign = 1.0 if run.h > 0 else -1.0
        self._forward = self._sign * np.asarray(run.t, dtype=float)
        digits = getattr(numbers, "digits", None)
        self._smallest_part = SMALLEST_PART if digits is None else 10.0 ** (2 - digits)

    def __call__(self, t: ArrayLike) -> Reals:
        """Return positions and momenta, shape (2 n,) for one time and (2 n, m) for m times."""
        q, p = self.states(t)
        return np.concatenate([q, p], axis=-1).T

    def states(self, t: ArrayLike) -> tuple[Reals, Reals]:
        """Return q and p, each of shape (n,) for one time and (m, n) for m times.

        Parameters
        ----------
        t : float or array_like, shape (m,)
            Times within the run.

        Returns
        -------
        q, p : ndarray
            Positions and conjugate momenta.

        Raises
        ------
        InputError
            If a time lies outside the run.
        ConvergenceError
            If part of a step fails, although the whole step did not.
        """
        run = self._run
        numbers = run.program.numbers
        with numbers.working():
            times = read_array("t", t, numbers)
        if times.ndim > 1:
            reject(f"t has shape {times.shape}.", remedy="Pass a number, or a list of numbers.")
        exact = np.atleast_1d(numbers.result(times))
        first, last = float(run.t[0]), float(self._end)
        low, high = min(first, last), max(first, last)
        slack = 1e-12 * max(abs(low), abs(high), abs(float(run.h)))
        rough = exact.astype(float)
        inside = (low - slack <= rough) & (rough <= high + slack)  # False for NaN
        if not inside.all():
            reject(
                f"t = {rough[~inside][0]:g} lies outside the run, {low:g} <= t <= {high:g}.",
                remedy="Integrate further, or pass times within the run.",
            )
        start = self._stored_before(rough)
        q, p, codes = self.after(start, exact - run.t[start])
        if codes.any():
            worst = int(np.argmax(codes != 0))
            raise ConvergenceError(
                f"{run.program.system}: the part of a step to t = {rough[worst]:g} failed. "
                f"{Status(int(codes[worst])).message}",
                trajectory=run,
                step=int(start[worst]),
                time=float(rough[worst]),
                residual=np.nan,
                status=Status(int(codes[worst])),
            )
        return (q, p) if times.ndim else (q[0], p[0])

    def _stored_before(self, t: Floats) -> NDArray[np.int64]:
        """Return the indices of the last stored states before the times."""
        start = np.searchsorted(self._forward, self._sign * t, side="right") - 1
        return np.clip(start, 0, self._forward.size - 1)

    def cost(self, t: Floats) -> int:
        """Return the largest number of steps that :meth:`states` needs for these times."""
        begun = np.unique(self._stored_before(t)).size
        return len(t) + begun * ((self._run.every or 1) - 1)

    def __repr__(self) -> str:
        run, last = self._run, float(self._end)
        times = f"{float(run.t[0]):g} to {last:g}"
        return f"DenseOutput({run.program.system}, {run.program.scheme}: t from {times})"

    def _repr_html_(self) -> str:
        return box(repr(self))

    def after(
        self, start: NDArray[np.int64], later: Reals
    ) -> tuple[Reals, Reals, NDArray[np.int64]]:
        """Return q, p and a status at the times ``later`` after the stored states ``start``.

        If an event acted in between, the steps start from the state after the last event. Stored
        states (``later`` is 0) are returned unchanged.
        """
        if not self._run.records:
            return self._after_states(start, later)
        t, sign = np.asarray(self._run.t[start] + later, dtype=float), self._sign
        event_times = sign * np.array([record.t for record in self._run.records])
        last = np.searchsorted(event_times, sign * t, side="right") - 1
        stored = sign * np.asarray(self._run.t[start], dtype=float)
        after_event = (last >= 0) & (event_times[last] >= stored)
        after_event &= np.asarray(later != 0, dtype=bool)
        q, p = np.zeros((2, len(start), self._run.program.n))
        codes = np.zeros(len(start), dtype=np.int64)
        plain = np.flatnonzero(~after_event)
        q[plain], p[plain], codes[plain] = self._after_states(start[plain], later[plain])
        for i in np.flatnonzero(after_event):
            (q[i], p[i]), codes[i] = self._after_record(self._run.records[last[i]], float(t[i]))
        return q, p, codes

    @cached_property
    def _parts(self) -> PartialSteps:
        run = self._run
        return PartialSteps(run.program, run.parameter_values, float(run.h), run.input_values)

    def _after_record(self, record: Any, t: float) -> tuple[Any, Status]:
        """Return the state at a time between an event and the next one."""
        run, h = self._run, float(self._run.h)
        begin = float(run.t[0]) + h * record.step
        parts = self._parts
        state, share = (record.q_after, record.p_after), (record.t - begin) / h
        if self._sign * (t - begin - h) <= 0:
            return parts(state, record.t, t - record.t, record.step, share)
        state, status = parts(state, record.t, begin + h - record.t, record.step, share)
        whole = int(np.floor((t - begin) / h)) - 1
        if status is Status.SUCCESS and whole:
            inputs = inputs_from_step(run.input_values, record.step + 1)
            state, status = self._take_steps(begin + h, state, h, whole, inputs)
        step = record.step + 1 + whole
        left = t - float(run.t[0]) - h * step
        if status is not Status.SUCCESS or abs(left) <= self._smallest_part * abs(h):
            return state, status
        return parts(state, t - left, left, step, 0.0)

    def _after_states(
        self, start: NDArray[np.int64], later: Reals
    ) -> tuple[Reals, Reals, NDArray[np.int64]]:
        """Return q, p and a status like :meth:`after`, if no event acted in between."""
        if self._retimed:
            return self._after_retimed(start, later)
        run, program = self._run, self._run.program
        numbers, header, kernels = program.numbers, program.header, program.kernels
        h = run.h
        whole = np.maximum(np.floor(np.asarray(later / h, dtype=float)), 0).astype(np.int64)
        rest = later - whole * h
        none = np.abs(np.asarray(rest / h, dtype=float)) <= self._smallest_part
        order = np.lexsort((whole, start))
        with numbers.working():
            W = workspace(header, numbers, numbers.read(run.parameter_values))
            t, q, p, step = self._t, self._q, self._p, numbers.read(h)
            rest = numbers.read(np.where(none, 0 * rest, rest))
            first = start * (run.every or 1)
            at = (rest / step)[:, None] * node_places(program)
            rests = interpolate_inputs(program, self.input_values, first + whole, at)
            found_q, found_p = numbers.zeros((2, len(order), header.n))
            fine = np.zeros(len(order), dtype=np.bool_)
            between = numbers.driver("between")
            at_once = max(1, BATCH // (run.every or 1))
            for some in (order[i : i + at_once] for i in range(0, order.size, at_once)):
                q_out, p_out = numbers.zeros((2, some.size + 1, header.n))
                well = np.zeros(some.size, dtype=np.bool_)
                between(
                    kernels.set(kernels.fallbacks[0], again=True),
                    (step.item(), t, W, header.driver_layout),
                    (q, p),
                    (start[some], whole[some], rest[some]),
                    (q_out, p_out, well),
                    run.every or 1,
                    self.input_values,
                    rests[:, some],
                )
                found_q[some], found_p[some], fine[some] = q_out[:-1], p_out[:-1], well
            codes = np.zeros(len(order), dtype=np.int64)
            for i in np.flatnonzero(~fine):
                state, codes[i] = self._take_robust_steps(int(start[i]), int(whole[i]), rest[i])
                found_q[i], found_p[i] = state
            return numbers.result(found_q), numbers.result(found_p), codes

    def _after_retimed(
        self, start: NDArray[np.int64], later: Reals
    ) -> tuple[Reals, Reals, NDArray[np.int64]]:
        """Return q, p and a status like :meth:`_after_states`, for a time-transformed system."""
        run, program = self._run, self._run.program
        numbers = program.numbers
        with numbers.working():
            values, h = numbers.read(run.parameter_values), numbers.read(run.h).item()
            t, states = self._t[start] + numbers.read(later), (self._t, self._q, self._p)
            _, q, p, fine = compute_states_at(program, values, h, states, start, t, run.every or 1)
            codes = np.where(fine, Status.SUCCESS, Status.NOT_CONVERGED).astype(np.int64)
            return numbers.result(q), numbers.result(p), codes

    def _take_robust_steps(self, start: int, whole: int, rest: Any) -> tuple[Any, Status]:
        """Take the steps with all recovery methods of a run.

        If part of a step does not resolve the motion, the method divides it further.
        """
        program = self._run.program
        h, first = program.numbers.read(self._run.h).item(), start * (self._run.every or 1)
        t, state = self._t[start], (self._q[start], self._p[start])
        (q, p), status = self._take_steps(
            t, state, h, whole, inputs_from_step(self.input_values, first)
        )
        if status is not Status.SUCCESS or rest == 0:
            return (q, p), status
        t, last = t + whole * h, first + whole
        for parts in DIVISIONS:
            at = (np.arange(parts)[:, None] + node_places(program)) * (rest / h / parts)
            inputs = interpolate_inputs(program, self.input_values, np.full(parts, last), at)
            state, status = self._take_steps(t, (q, p), rest / parts, parts, inputs)
            if status is Status.SUCCESS:
                return state, status
        if abs(float(rest / h)) < LINEAR_PART:  # interpolate linearly to the next state
            ahead, status = self._take_steps(
                t, (q, p), h, 1, inputs_from_step(self.input_values, last)
            )
            part = rest / h
            return [a + part * (b - a) for a, b in zip((q, p), ahead, strict=True)], status
        return state, status

    def _take_steps(
        self, t: Any, state: Any, h: Any, steps: int, inputs: Reals
    ) -> tuple[Any, Status]:
        return take_steps_from(
            self._run.program, self._run.parameter_values, t, state, h, steps, inputs
        )
