"""Short runs of one stepper, one after another, in the same workspace.

Most of a call for a few steps would go into reading what is asked for, and into making workspace
and arrays. What is asked for in the plainest way, and goes as it should, is done here, by the same
compiled functions; anything else is left to :func:`integrate`, which begins anew and says what is
wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.runtime.driver.compiled import driver
from symsimpson.runtime.inputs import read_steps
from symsimpson.runtime.kernels.numbers import FLOAT64
from symsimpson.runtime.results.status import Status
from symsimpson.runtime.results.trajectory import Trajectory
from symsimpson.runtime.runs.driving import NO_INPUTS
from symsimpson.runtime.runs.resolution import LIMIT, SAMPLES, count_looked_at, sampling_stride
from symsimpson.runtime.runs.run import workspace

if TYPE_CHECKING:
    from symsimpson.runtime.evaluator import Evaluator

__all__ = ["MOST_ROWS", "Prepared", "brief_run"]

#: Steps times rows of the workspace: so much is over before anybody presses Ctrl-C.
MOST_ROWS = 2**18
#: What states are given as; of others somebody may have to be told something.
PLAIN = (list, tuple, np.ndarray)
DONE = Status.SUCCESS.message

Floats = NDArray[np.float64]
#: h, t0 and the number of steps.
Times = tuple[float, float, int]
#: q and p at stored states, shape (2, N, n, 1); iterations, shape (N, 1).
Stored = tuple[Floats, NDArray[np.int64]]


class Prepared:
    """What a run needs that nobody sees: workspace, kernels, functions of the driver."""

    def __init__(self, stepper: Evaluator) -> None:
        header, kernels = stepper._module.header, stepper._module.kernels
        self.W, self.told = workspace(header, FLOAT64, stepper._defaults), header.told
        self.kernels = kernels.set(kernels.fallbacks[0])
        self.legendre, self.energy = kernels.address("legendre"), kernels.address("energy")
        self.run_briefly = driver("run_briefly", iterated=header.newton_unknowns > 0)
        #: Where states go that are looked at and forgotten.
        self.sampled = room(SAMPLES, stepper.n)

    def run(
        self, values: Floats, start: tuple[Floats, Floats, bool], times: Times, every: int,
        few: int, stored: Stored, end: Floats,
    ) -> int:  # fmt: skip
        """Take steps, and return how many iterations they took; -1 if not all is well."""
        (q, other, velocity), (h, t0, steps) = start, times
        found: int = self.run_briefly(
            self.kernels, self.legendre if velocity else 0, self.energy, h, t0, self.W, self.told,
            values, q, other, steps, every, few, LIMIT, *stored, end, NO_INPUTS,
        )  # fmt: skip
        return found


def room(last: int, n: int) -> Stored:
    """Return room for so many states behind the first."""
    return np.zeros((2, last + 1, n, 1)), np.zeros((last + 1, 1), dtype=np.int64)


def read_plainly(value: Any, n: int) -> Floats | None:
    """Return a list or an array of n doubles as an array; None if it is anything else."""
    if type(value) not in PLAIN:
        return None
    try:
        found = np.array(value)
    except (TypeError, ValueError):
        return None
    return found if found.dtype.char == "d" and found.shape == (n,) else None


def brief_run(
    stepper: Evaluator, given: tuple[Any, Any, Any], times: tuple[Any, Any, Any, Any],
    parameters: Any, every: Any,
) -> Trajectory | None:  # fmt: skip
    """Run, and return what it has come to; None if it is not short, or something came up.

    Parameters
    ----------
    stepper : Stepper
    given, times, parameters, every
        As for :func:`symsimpson.runtime.runs.spec.read_run`.
    """
    (q0, v0, p0), h, prepared = given, times[0], stepper._prepared
    one = (v0 is None) is not (p0 is None) and (every is None or type(every) is int)
    if prepared is None or not one or not isinstance(h, float):
        return None
    values, n = stepper._values(parameters), len(stepper.coordinates)
    if (h, values.tobytes()) not in stepper._looked_at:
        return None
    h, steps, t0 = read_steps(*times, FLOAT64)
    short = 0 < steps * stepper._module.header.rows <= MOST_ROWS and (every is None or every > 0)
    q, other = read_plainly(q0, n), read_plainly(p0 if v0 is None else v0, n)
    if not short or q is None or other is None:
        return None
    try:  # threads may do this at the same time
        made = prepared.pop()
    except IndexError:
        made = Prepared(stepper)
    stride = every or sampling_stride(stepper, steps)
    last = steps // stride if stride else 0
    (Q, P), counts = stored = room(last, n) if every else made.sampled
    end, few = np.empty((2, n)), count_looked_at(stepper, last)
    start = q, other, v0 is not None
    count = made.run(values, start, (h, t0, steps), stride, few, stored, end)
    if count < 0:
        return None
    prepared.append(made)
    if every:
        t = t0 + np.arange(0.0, steps + 1.0, every) * h
        Q, P, iterations = Q[:, :, 0], P[:, :, 0], counts[:, 0]
    else:
        t, iterations = np.array([t0 + h * steps]), np.array([count])
        Q, P = end[:1], end[1:]
    return Trajectory(
        t=t, q=Q, p=P, newton_iterations=iterations, h=h, steps=steps, every=every,
        status=Status.SUCCESS, message=DONE, _stepper=stepper, _values=values, _inputs=NO_INPUTS,
        _tangents=None,
    )  # fmt: skip
