"""Partial steps: shorter steps of the same scheme, from any state or up to any time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.program.evaluation import make_evaluator
from symsimpson.program.numbers import NO_INPUTS, Numbers, workspace
from symsimpson.program.observed import Reduction
from symsimpson.program.program import Program
from symsimpson.program.recorders import with_clock, work
from symsimpson.program.status import Status
from symsimpson.stepping.driving import interpolate_inputs, node_places
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Floats, Ints, Reals

#: Changes of the length of a partial step, as fractions of a step, tried one after another.
NUDGES = [sign * 2.0**k for k in range(-50, -16, 4) for sign in (-1, 1)]
#: Over a smaller part of a step, forces do no work: velocities of its path are only round-off.
NO_WORK = 1e-10
#: The smallest of these changes: with them, a whole step ends at its grid time up to round-off.
SMALLEST_NUDGES = NUDGES[:8]


class PartialSteps:
    """Integrator of partial steps of a run with its inputs.

    With ``works``, it also computes the work of forces over partial steps.
    """

    def __init__(
        self, program: Program, parameters: Floats, h: float, inputs: Floats, *, works: bool = False
    ) -> None:
        numbers, header = program.numbers, program.header
        self._program, self.parameters, self._h, self._inputs = program, parameters, h, inputs
        kernels = program.kernels.set(program.kernels.fallbacks[0], again=True)
        #: The kernels for a partial step, their workspace, and the layout for the driver.
        W = workspace(header, numbers, numbers.read(parameters))
        self.setup = kernels, W, header.driver_layout
        self._between = numbers.driver("between")
        self._places = node_places(program)
        self.works = works

    def __call__(self, state: Any, t: float, size: float, step: int, share: float) -> Any:
        """Take a partial step; return the state (q, p) after it and the status.

        The partial step starts at time t and has the duration ``size``. ``share`` is the place of
        its start within step number ``step``, from 0 to 1.
        """
        q, p = state
        if size == 0.0:
            return (q, p), Status.SUCCESS
        (kernels, W, driver_layout), n = self.setup, len(q)
        inputs = self.inputs(size, step, share)
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
            inputs,
        )
        if fine[0]:
            return (ends[0, 0], ends[1, 0]), Status.SUCCESS
        return take_steps_from(self._program, self.parameters, t, state, size, 1, inputs)

    def take_near(
        self,
        state: Any,
        t: float,
        size: float,
        step: int,
        share: float,
        nudges: Sequence[float] = NUDGES,
    ) -> tuple[Any, Status]:
        """Take a partial step; if it fails, try slightly different lengths.

        The equations have no value on a kink such as sqrt(x**2), where an event may be located.
        """
        end, status = self(state, t, size, step, share)
        for nudge in nudges:
            if status is Status.SUCCESS:
                break
            end, status = self(state, t, size + nudge * self._h, step, share)
        return end, status

    def work(self, state: Any, t: float, size: float, step: int, share: float) -> Floats:
        """Return the work of forces and the integral of dL/dt over a partial step, if enabled."""
        program, recorder = self._program, work(self._program.header) if self.works else None
        if recorder is None or abs(size) <= NO_WORK * abs(self._h):
            return np.zeros(self.works * program.header.powers)
        inputs = self.inputs(size, step, share)
        run = Run(program, self.parameters, size, t, inputs=inputs, recorders=[recorder])
        run.begin(*state, velocity=False)
        run.advance(1)
        return run.rows("WORK", program.header.powers).copy()

    def inputs(self, size: float, step: int, share: float) -> Floats:
        """Return the inputs at the nodes of a partial step."""
        if not self._inputs.size:
            return self._inputs
        at = share + size / self._h * self._places
        return interpolate_inputs(self._program, self._inputs, np.array([step]), at[None])


def take_steps_from(
    program: Program, parameters: Any, t: Any, state: Any, h: Any, steps: int, inputs: Any
) -> tuple[Any, Status]:
    """Take steps from a state with all fallback kernels of a run.

    Return the last state (q, p) that was reached, and the status.
    """
    numbers = program.numbers
    run = Run(program, numbers.read(parameters), numbers.read(h).item(), t, inputs=inputs)
    run.begin(*state, velocity=False)
    run.advance(steps)
    return [x[0] for x in run.end()], run.status


#: Number of steps between states that a run examines if it stores none.
STRIDE = 16


def take_last_part(program: Program, run: Run, t_end: Any) -> tuple[Any, Reals, Reals, Status]:
    """Take the partial step from the current state of a run with time transformation to ``t_end``.

    Return its duration in tau, q and p at ``t_end``, each of shape (1, n), and the status.
    """
    q, p = run.end()
    states, start = (run.rows("TIME", 1).copy(), q, p), np.zeros(1, dtype=np.int64)
    ends = np.full(1, t_end)
    part, q, p, fine = compute_states_at(program, run.parameters, run.h, states, start, ends, 1)
    return part[0], q, p, Status.SUCCESS if fine[0] else Status.NOT_CONVERGED


def compute_states_at(
    program: Program,
    values: Reals,
    h: Any,
    states: tuple[Reals, Reals, Reals],
    start: Ints,
    times: Reals,
    every: int,
) -> tuple[Reals, Reals, Reals, NDArray[np.bool_]]:
    """Compute states of a run with time transformation at ``times`` between its stored states.

    ``states`` are the stored times, q and p. ``start`` has the index of the stored state before
    each time. ``values`` are parameters, one row for each time or one row for all. Return the
    duration in tau of each partial step, then q and p, and whether each partial step succeeded.
    """
    numbers, header, kernels = (program.numbers, program.header, program.kernels)
    many, near, rows = start.size, time_resolution(numbers), np.atleast_2d(values)
    part, (q, p) = numbers.zeros(many), numbers.zeros((2, many, header.n))
    fine = np.zeros(many, dtype=np.bool_)
    for name in kernels.fallbacks:  # each one takes the times at which the one before failed
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
            (start[some], times[some], near),
            (q_out, p_out, part_out, well),
            every,
            (NO_INPUTS, rows if len(rows) == 1 else rows[some]),
        )
        part[some], q[some], p[some], fine[some] = part_out, q_out[:-1], p_out[:-1], well
    return part, q, p, fine


def update_reductions(
    program: Program,
    reductions: Sequence[Reduction],
    values: Reals,
    before: tuple[Reals, ...],
    ends: tuple[Reals, ...],
    reduced: Reals,
) -> Reals:
    """Update the reductions of K runs, shape (K, ...), with their final states.

    ``before`` has t, q and p of the last states that the runs observed. ``ends`` has t, q and p of
    the final states, which follow partial steps. ``values`` are the parameters, shape (K, m).
    """
    watched, known = [k for k, x in enumerate(reductions) if x.of_states], reduced.copy()
    if not (watched and len(known)):
        return known
    watch = make_evaluator(program, [reductions[k] for k in watched], values)
    pairs = (np.stack(pair, axis=1) for pair in zip(before, ends, strict=True))
    seen = watch(*(x.reshape(2 * len(values), *x.shape[2:]) for x in pairs))
    earlier, late = seen.reshape(len(values), 2, -1).swapaxes(0, 1)
    begin, end = before[0][:, None], ends[0][:, None]
    kind = np.array([reductions[k].kind for k in watched])
    values_so_far, rise = known[:, watched], late - earlier
    crossed = (kind == "first") & np.isnan(values_so_far) & (late > 0)
    values_so_far = np.where(
        crossed, end - (end - begin) * late / np.where(rise == 0, 1.0, rise), values_so_far
    )
    values_so_far = np.where(kind == "max", np.fmax(values_so_far, late), values_so_far)
    known[:, watched] = np.where(kind == "min", np.fmin(values_so_far, late), values_so_far)
    return known


def append_end(states: tuple[Reals, ...], end: tuple[Any, ...], every: bool) -> tuple[Reals, ...]:
    """Append the end of a run to its times, tau, positions, momenta and iterations.

    ``end`` has one value for each, with the iterations since the last stored state. If ``every`` is
    False, the run stores only its final state, and the end replaces the stored state.
    """
    t, tau, q, p, iterations = states
    t_end, tau_end, q_end, p_end, last = end
    if not every:
        return np.append(t[:0], t_end), np.append(tau[:0], tau_end), q_end, p_end, iterations
    if t_end == t[-1]:
        return states
    t, tau = np.append(t, t_end), np.append(tau, tau_end)
    return t, tau, np.vstack([q, q_end]), np.vstack([p, p_end]), np.append(iterations, last)


def time_resolution(numbers: Numbers) -> float:
    """Return the relative round-off of a time."""
    digits = getattr(numbers, "digits", None)
    return 4e-16 if digits is None else 10.0 ** (1 - digits)
