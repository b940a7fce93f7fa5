"""Parts of steps: shorter steps of the same scheme, from any state or up to any time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.program.numbers import NO_INPUTS, Numbers, workspace
from symsimpson.program.observed import Reduction, watching
from symsimpson.program.program import Program
from symsimpson.program.recorders import with_clock, work
from symsimpson.program.status import Status
from symsimpson.stepping.driving import at_places, places
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Floats, Ints, Reals

#: Parts of steps that end beside a place are shorter, or longer, by so much of a step.
NUDGES = [sign * 2.0**k for k in range(-50, -16, 4) for sign in (-1, 1)]
#: Those of whole steps: their ends are those of the grid, but for rounding.
LEAST = NUDGES[:8]


class Parts:
    """Takes parts of the steps of a run with their inputs, and their work if it ``works``."""

    def __init__(
        self, program: Program, parameters: Floats, h: float, inputs: Floats, *, works: bool = False
    ) -> None:
        numbers, header = program.numbers, program.header
        self._program, self.parameters, self._h, self._inputs = program, parameters, h, inputs
        kernels = program.kernels.set(program.kernels.fallbacks[0], again=True)
        #: The kernels that take a part, their workspace, and the layout for the driver.
        W = workspace(header, numbers, numbers.read(parameters))
        self.parting = kernels, W, header.driver_layout
        self._between = numbers.driver("between")
        self._places = places(program)
        self.works = works

    def __call__(self, state: Any, t: float, size: float, step: int, share: float) -> Any:
        """Return q and p after a part of a step, and whether it could be taken.

        The part begins at t, and is as long as ``size``; ``share`` says where in the step it
        begins, from 0 to 1.
        """
        q, p = state
        if size == 0.0:
            return (q, p), Status.SUCCESS
        (kernels, W, driver_layout), n = self.parting, len(q)
        rests = self.inputs(size, step, share)
        ends, fine = np.zeros((2, 2, n)), np.zeros(1, dtype=np.bool_)
        zero = np.zeros(1, dtype=np.int64)
        self._between(
            kernels,
            (self._h, np.array([t]), W, driver_layout),
            (np.ascontiguousarray(q[None]), np.ascontiguousarray(p[None])),
            (zero, zero, np.array([size])),
            (ends[0], ends[1], fine),
            1,
            self._inputs,
            rests,
        )
        if fine[0]:
            return (ends[0, 0], ends[1, 0]), Status.SUCCESS
        return steps_from(self._program, self.parameters, t, state, size, 1, rests)

    def beside(
        self,
        state: Any,
        t: float,
        size: float,
        step: int,
        share: float,
        nudges: Sequence[float] = NUDGES,
    ) -> tuple[Any, Status]:
        """Take a part of a step, or one that ends beside it where the equations have no value.

        They have none on a kink that is written as sqrt(x**2), and events are looked for there.
        """
        end, status = self(state, t, size, step, share)
        for nudge in nudges:
            if status is Status.SUCCESS:
                break
            end, status = self(state, t, size + nudge * self._h, step, share)
        return end, status

    def work(self, state: Any, t: float, size: float, step: int, share: float) -> Floats:
        """Return the work of forces and the integral of dL/dt, if that is asked for."""
        program, recorder = self._program, work(self._program.header) if self.works else None
        if recorder is None or size == 0.0:
            return np.zeros(self.works * program.header.powers)
        inputs = self.inputs(size, step, share)
        run = Run(program, self.parameters, size, t, 0, 1, inputs=inputs, recorders=[recorder])
        run.begin(*state, velocity=False)
        run.advance(1)
        return run.rows("WORK", program.header.powers).copy()

    def inputs(self, size: float, step: int, share: float) -> Floats:
        """Return the inputs of a part of a step, at its own nodes."""
        if not self._inputs.size:
            return self._inputs
        at = share + size / self._h * self._places
        return at_places(self._program, self._inputs, np.array([step]), at[None])


def steps_from(
    program: Program, parameters: Any, t: Any, state: Any, h: Any, steps: int, inputs: Any
) -> tuple[Any, Status]:
    """Take steps from a state with all that a run has against what goes wrong.

    Returned are q and p behind them, or where they ended, and the status.
    """
    numbers = program.numbers
    run = Run(program, numbers.read(parameters), numbers.read(h).item(), t, 0, 1, inputs=inputs)
    run.begin(*state, velocity=False)
    run.advance(steps)
    return [x[0] for x in run.end()], run.status


#: Where no states are asked for, each so-many-th step is stored to be looked at.
STRIDE = 16


def last_part(program: Program, run: Run, t_end: Any) -> tuple[Any, Reals, Reals, Status]:
    """Take the part of a step from where a run has arrived to its end.

    Returned are the part, of tau, q and p there, each of shape (1, n), and the status.
    """
    q, p = run.end()
    states, start = (run.rows("TIME", 1).copy(), q, p), np.zeros(1, dtype=np.int64)
    ends = np.full(1, t_end)
    part, q, p, fine = states_at(program, run.parameters, run.h, states, start, ends, 1)
    return part[0], q, p, Status.SUCCESS if fine[0] else Status.NOT_CONVERGED


def states_at(
    program: Program,
    values: Reals,
    h: Any,
    states: tuple[Reals, Reals, Reals],
    start: Ints,
    asked: Reals,
    every: int,
) -> tuple[Reals, Reals, Reals, NDArray[np.bool_]]:
    """Find states at times behind some of the stored ones, t, q and p.

    ``values`` are parameters, a row of them for each state or one for all. Returned are how far
    each is into its step, in tau, then q and p, and whether its steps could be taken as usual.
    """
    numbers, header, kernels = (program.numbers, program.header, program.kernels)
    many, near, rows = start.size, resolution(numbers), np.atleast_2d(values)
    part, (q, p) = numbers.zeros(many), numbers.zeros((2, many, header.n))
    fine = np.zeros(many, dtype=np.bool_)
    for name in kernels.fallbacks:  # each where the one before fails
        some = np.flatnonzero(~fine)
        if not some.size:
            break
        q_out, p_out = numbers.zeros((2, some.size + 1, header.n))
        part_out, well = numbers.zeros(some.size), np.zeros(some.size, dtype=np.bool_)
        numbers.driver("states_at")(
            kernels.set(name, with_clock(header, ()), again=True),
            kernels.address("energy"),
            (h, states[0], workspace(header, numbers, rows[0]), header.driver_layout),
            states[1:],
            (start[some], asked[some], near),
            (q_out, p_out, part_out, well),
            every,
            (NO_INPUTS, rows if len(rows) == 1 else rows[some]),
        )
        part[some], q[some], p[some], fine[some] = part_out, q_out[:-1], p_out[:-1], well
    return part, q, p, fine


def reduced_at_ends(
    program: Program,
    reductions: Sequence[Reduction],
    values: Reals,
    before: tuple[Reals, ...],
    ends: tuple[Reals, ...],
    reduced: Reals,
) -> Reals:
    """Return what observed values came to, shape (K, ...), with those at ends within a step.

    ``before`` and ``ends`` are t, q and p of K runs, the last ones that were looked at and those
    behind them; ``values`` are their parameters, shape (K, m).
    """
    watched, known = [k for k, x in enumerate(reductions) if x.of_states], reduced.copy()
    if not (watched and len(known)):
        return known
    watch = watching(program, [reductions[k] for k in watched], values)
    pairs = (np.stack(pair, axis=1) for pair in zip(before, ends, strict=True))
    seen = watch(*(x.reshape(2 * len(values), *x.shape[2:]) for x in pairs))
    earlier, late = seen.reshape(len(values), 2, -1).swapaxes(0, 1)
    begin, end = before[0][:, None], ends[0][:, None]
    kind = np.array([reductions[k].kind for k in watched])
    kept, rise = known[:, watched], late - earlier
    met = (kind == "first") & np.isnan(kept) & (late > 0)
    kept = np.where(met, end - (end - begin) * late / np.where(rise == 0, 1.0, rise), kept)
    kept = np.where(kind == "max", np.fmax(kept, late), kept)
    known[:, watched] = np.where(kind == "min", np.fmin(kept, late), kept)
    return known


def with_end(states: tuple[Reals, ...], end: tuple[Any, ...], every: bool) -> tuple[Reals, ...]:
    """Return times, tau, positions, momenta and iterations with the end of the run behind them.

    The ``end`` has the iterations since the last stored state, too. It takes the place of the state
    before it where that alone is kept.
    """
    t, tau, q, p, iterations = states
    t_end, tau_end, q_end, p_end, last = end
    if not every:
        return np.append(t[:0], t_end), np.append(tau[:0], tau_end), q_end, p_end, iterations
    if t_end == t[-1]:
        return states
    t, tau = np.append(t, t_end), np.append(tau, tau_end)
    return t, tau, np.vstack([q, q_end]), np.vstack([p, p_end]), np.append(iterations, last)


def resolution(numbers: Numbers) -> float:
    """Return the relative size of what rounding makes of a time."""
    digits = getattr(numbers, "digits", None)
    return 4e-16 if digits is None else 10.0 ** (1 - digits)
