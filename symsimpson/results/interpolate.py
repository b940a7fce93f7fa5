"""States between the steps of a run."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import ConvergenceError, reject
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import workspace
from symsimpson.program.status import Status
from symsimpson.results.states import Stored
from symsimpson.stepping.driving import at_places, places, since
from symsimpson.stepping.parts import Parts, states_at, steps_from
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.markup import box

#: A part of a step as small as this is none.
NOTHING = 1e-14
#: So many steps are taken before Ctrl-C is heard.
AT_ONCE = 16384
#: Into so many parts the rest of a step is divided, one after the other, until they can be taken.
DIVISIONS = (1, 4, 16, 64)
#: A path is straight to rounding over so much of a step.
LITTLE = 1e-10


class DenseOutput:
    """The states of a run at any time of it; made by ``run.sol``.

    Between two steps the scheme itself takes part of a step from the state before. That is
    continuous, gives stored states as they are, and has the order of the scheme in positions and
    momenta everywhere. (The polynomial of a Galerkin scheme, which is found on the way, has
    degree d and therefore at most order d + 1 between its ends: 3 for Simpson's scheme of order 4,
    9 for 8 Gauss nodes of order 16.) Each such map is symplectic. It costs a step for each time.

    Parameters
    ----------
    run : Stored

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> run.sol(0.25).shape, run.sol([0.25, 0.5, 1.234]).shape
    ((2,), (2, 3))
    >>> bool((run.sol(run.t) == run.y).all())
    True
    """

    def __init__(self, run: Stored) -> None:
        if run.every is None and run.steps:
            reject(
                "a run that keeps its last state alone (every=None) has no states between.",
                remedy="Store states: every=1, or every=100.",
            )
        self._run = run
        numbers = run.program.numbers
        with numbers.working():  # float64 as it is, without a copy
            whole = [
                np.ascontiguousarray(x) if x.dtype == np.float64 else numbers.read(x)
                for x in (run.t, run.q, run.p, run.input_values)
            ]
        self._t, self._q, self._p, self.input_values = whole
        self._retimed = run.program.header.retimed
        uneven = self._retimed or run.ended_by is not None
        self._end = run.t[-1] if uneven else run.t[0] + run.h * run.steps
        self._sign = 1.0 if run.h > 0 else -1.0
        self._forward = self._sign * np.asarray(run.t, dtype=float)
        digits = getattr(numbers, "digits", None)
        self._nothing = NOTHING if digits is None else 10.0 ** (2 - digits)

    def __call__(self, t: ArrayLike) -> Reals:
        """Return positions and momenta, shape (2 n,) for a number and (2 n, m) for m of them."""
        q, p = self.states(t)
        return np.concatenate([q, p], axis=-1).T

    def states(self, t: ArrayLike) -> tuple[Reals, Reals]:
        """Return q and p, each of shape (n,) for a number and (m, n) for m of them.

        Raises
        ------
        InputError
            If a time lies outside of the run.
        ConvergenceError
            If part of a step cannot be taken where the whole could.
        """
        run = self._run
        numbers = run.program.numbers
        with numbers.working():
            times = read_array("t", t, numbers)
        if times.ndim > 1:
            reject(f"t has shape {times.shape}.", remedy="Pass a number, or a list of them.")
        asked = np.atleast_1d(numbers.result(times))
        first, last = float(run.t[0]), float(self._end)
        low, high = min(first, last), max(first, last)
        slack = 1e-12 * max(abs(low), abs(high), abs(float(run.h)))
        rough = asked.astype(float)
        inside = (low - slack <= rough) & (rough <= high + slack)  # NaN is not
        if not inside.all():
            reject(
                f"t = {rough[~inside][0]:g} lies outside of the run, {low:g} <= t <= {high:g}.",
                remedy="Integrate further, or ask for times within.",
            )
        start = self._starts(rough)
        q, p, codes = self.after(start, asked - run.t[start])
        if codes.any():
            worst = int(np.argmax(codes != 0))
            raise ConvergenceError(
                f"{run.program.system}: part of a step, to t = {rough[worst]:g}, could not be "
                f"taken. {Status(int(codes[worst])).message}",
                trajectory=run,
                step=int(start[worst]),
                time=float(rough[worst]),
                residual=np.nan,
                status=Status(int(codes[worst])),
            )
        return (q, p) if times.ndim else (q[0], p[0])

    def _starts(self, t: Floats) -> NDArray[np.int64]:
        """Return the numbers of the stored states before times."""
        start = np.searchsorted(self._forward, self._sign * t, side="right") - 1
        return np.clip(start, 0, self._forward.size - 1)

    def cost(self, t: Floats) -> int:
        """Return how many steps :meth:`states` takes at most for times within the run."""
        begun = np.unique(self._starts(t)).size
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
        """Return q, p and a status so much later than stored states, by their numbers.

        Where events acted, from the last of them on; stored states are given as they are.
        """
        if not self._run.records:
            return self._after_states(start, later)
        asked, sign = np.asarray(self._run.t[start] + later, dtype=float), self._sign
        acted = sign * np.array([record.t for record in self._run.records])
        last = np.searchsorted(acted, sign * asked, side="right") - 1
        behind = (last >= 0) & (acted[last] >= sign * np.asarray(self._run.t[start], dtype=float))
        behind &= np.asarray(later != 0, dtype=bool)  # stored states are as they are
        q, p = np.zeros((2, len(start), self._run.program.n))
        codes = np.zeros(len(start), dtype=np.int64)
        plain = np.flatnonzero(~behind)
        q[plain], p[plain], codes[plain] = self._after_states(start[plain], later[plain])
        for i in np.flatnonzero(behind):
            (q[i], p[i]), codes[i] = self._after_record(self._run.records[last[i]], float(asked[i]))
        return q, p, codes

    @cached_property
    def _parts(self) -> Parts:
        run = self._run
        return Parts(run.program, run.parameter_values, float(run.h), run.input_values)

    def _after_record(self, record: Any, t: float) -> tuple[Any, Status]:
        """Return the state at a time behind an event, before the next one."""
        run, h = self._run, float(self._run.h)
        begin = float(run.t[0]) + h * record.step
        parts = self._parts
        state, share = (record.q_after, record.p_after), (record.t - begin) / h
        if self._sign * (t - begin - h) <= 0:
            return parts(state, record.t, t - record.t, record.step, share)
        state, status = parts(state, record.t, begin + h - record.t, record.step, share)
        whole = int(np.floor((t - begin) / h)) - 1
        if status is Status.SUCCESS and whole:
            inputs = since(run.input_values, record.step + 1)
            state, status = self._run_on(begin + h, state, h, whole, inputs)
        step = record.step + 1 + whole
        left = t - float(run.t[0]) - h * step
        if status is not Status.SUCCESS or abs(left) <= self._nothing * abs(h):
            return state, status
        return parts(state, t - left, left, step, 0.0)

    def _after_states(
        self, start: NDArray[np.int64], later: Reals
    ) -> tuple[Reals, Reals, NDArray[np.int64]]:
        """Return the same where no events acted in between."""
        if self._retimed:
            return self._after_in_time(start, later)
        run, program = self._run, self._run.program
        numbers, header, kernels = (program.numbers, program.header, program.kernels)
        h = run.h
        whole = np.maximum(np.floor(np.asarray(later / h, dtype=float)), 0).astype(np.int64)
        rest = later - whole * h
        none = np.abs(np.asarray(rest / h, dtype=float)) <= self._nothing
        order = np.lexsort((whole, start))
        with numbers.working():
            W = workspace(header, numbers, numbers.read(run.parameter_values))
            t, q, p, step = self._t, self._q, self._p, numbers.read(h)
            rest = numbers.read(np.where(none, 0 * rest, rest))
            first = start * (run.every or 1)
            at = (rest / step)[:, None] * places(program)
            rests = at_places(program, self.input_values, first + whole, at)
            found_q, found_p = numbers.zeros((2, len(order), header.n))
            fine = np.zeros(len(order), dtype=np.bool_)
            between = numbers.driver("between")
            at_once = max(1, AT_ONCE // (run.every or 1))
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
                state, codes[i] = self._robustly(int(start[i]), int(whole[i]), rest[i])
                found_q[i], found_p[i] = state
            return numbers.result(found_q), numbers.result(found_p), codes

    def _after_in_time(
        self, start: NDArray[np.int64], later: Reals
    ) -> tuple[Reals, Reals, NDArray[np.int64]]:
        """Return states after steps that are fixed in another time."""
        run, program = self._run, self._run.program
        numbers = program.numbers
        with numbers.working():
            values, h = numbers.read(run.parameter_values), numbers.read(run.h).item()
            asked, states = self._t[start] + numbers.read(later), (self._t, self._q, self._p)
            _, q, p, fine = states_at(program, values, h, states, start, asked, run.every or 1)
            codes = np.where(fine, Status.SUCCESS, Status.NOT_CONVERGED).astype(np.int64)
            return numbers.result(q), numbers.result(p), codes

    def _robustly(self, start: int, whole: int, rest: Any) -> tuple[Any, Status]:
        """Take the steps with all that a run has against what goes wrong.

        Where part of a step does not resolve the motion it is divided further.
        """
        program = self._run.program
        h, first = program.numbers.read(self._run.h).item(), start * (self._run.every or 1)
        t, state = self._t[start], (self._q[start], self._p[start])
        (q, p), status = self._run_on(t, state, h, whole, since(self.input_values, first))
        if status is not Status.SUCCESS or rest == 0:
            return (q, p), status
        t, last = t + whole * h, first + whole
        for parts in DIVISIONS:
            at = (np.arange(parts)[:, None] + places(program)) * (rest / h / parts)
            inputs = at_places(program, self.input_values, np.full(parts, last), at)
            state, status = self._run_on(t, (q, p), rest / parts, parts, inputs)
            if status is Status.SUCCESS:
                return state, status
        if abs(float(rest / h)) < LITTLE:  # near enough to the line to the next state
            ahead, status = self._run_on(t, (q, p), h, 1, since(self.input_values, last))
            part = rest / h
            return [a + part * (b - a) for a, b in zip((q, p), ahead, strict=True)], status
        return state, status

    def _run_on(self, t: Any, state: Any, h: Any, steps: int, inputs: Reals) -> tuple[Any, Status]:
        return steps_from(self._run.program, self._run.parameter_values, t, state, h, steps, inputs)
