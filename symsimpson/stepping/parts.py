"""Parts of a step: shorter steps of the same scheme, from any state and with its inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from symsimpson.program.numbers import workspace
from symsimpson.program.program import Program
from symsimpson.program.recorders import work
from symsimpson.program.status import Status
from symsimpson.stepping.driving import at_places, places
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Floats

#: Parts of steps that end beside a place are shorter, or longer, by so much of a step.
NUDGES = [sign * 2.0**k for k in range(-50, -16, 4) for sign in (-1, 1)]
#: Those of whole steps: their ends are those of the grid, but for rounding.
LEAST = NUDGES[:8]


class Parts:
    """Takes parts of the steps of a run, each with the inputs of its step.

    With ``works`` the work of forces is asked for.
    """

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
