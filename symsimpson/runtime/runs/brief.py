"""Short runs of one stepper, one after another, in the same workspace.

Most of a call for a few steps would go into reading what is asked for, and into making workspace
and arrays. What is asked for in the plainest way, and goes as it should, is done here, by the same
compiled functions; anything else is left to :func:`integrate`, which begins anew and says what is
wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.runtime.inputs import read_steps
from symsimpson.runtime.kernels.numbers import FLOAT64
from symsimpson.runtime.results.status import Status
from symsimpson.runtime.results.trajectory import Trajectory
from symsimpson.runtime.runs.driving import NO_INPUTS
from symsimpson.runtime.runs.resolution import LIMIT, SAMPLES, looked_at_of, sampling_stride
from symsimpson.runtime.runs.run import workspace

if TYPE_CHECKING:
    from symsimpson.runtime.evaluator import Evaluator

__all__ = ["MOST_ROWS", "Prepared", "brief_run"]

#: Steps times rows of the workspace: so much is over before anybody presses Ctrl-C.
MOST_ROWS = 2**18
#: What states are given as; of others somebody may have to be told something.
PLAIN = (list, tuple, np.ndarray)
DONE = Status.SUCCESS.message


class Prepared:
    """What a run needs that nobody sees: workspace, kernels, functions of the driver."""

    def __init__(self, stepper: Evaluator) -> None:
        header, kernels, n = stepper._module.header, stepper._module.kernels, stepper.n
        at, self.told = header.layout, header.told
        self.W = workspace(header, FLOAT64, stepper._defaults)
        rows = self.W[:, 0]
        self.q, self.p = (self.W[at[name] :][:n].T for name in ("POSITION", "MOMENTUM"))
        self.pivot, self.status, self.iterations = (
            rows[at[name] :][:1] for name in ("MASS_PIVOT", "STATUS", "ITERATIONS")
        )
        self.kernels = kernels.set(kernels.fallbacks[0])
        self.legendre, self.energy = kernels.address("legendre"), kernels.address("energy")
        explicit = header.newton_unknowns == 0
        self.begin, self.steady = FLOAT64.driver("begin_anew"), FLOAT64.driver("steady")
        self.take = FLOAT64.driver("take_explicit_steps" if explicit else "take_steps")
        self.progress, self.kept = np.zeros(3, dtype=np.int64), np.zeros((1, 0, 1))
        #: Where states go that are looked at and forgotten.
        self.sampled = np.zeros((2, SAMPLES + 1, n, 1)), np.zeros((SAMPLES + 1, 1), dtype=np.int64)


def brief_run(
    stepper: Evaluator, start: tuple[Any, Any, Any], times: tuple[Any, Any, Any, Any],
    parameters: Any, every: Any,
) -> Trajectory | None:  # fmt: skip
    """Run, and return what it has come to; None if it is not short, or something came up.

    Parameters
    ----------
    stepper : Stepper
    start, times, parameters, every
        As for :func:`symsimpson.runtime.runs.spec.read_run`.
    """
    (q0, v0, p0), (h, t_end, steps, t0), prepared = start, times, stepper._prepared
    second = p0 if v0 is None else v0
    given = type(q0) in PLAIN and type(second) in PLAIN and (v0 is None or p0 is None)
    if prepared is None or not given or type(h) is not float or type(every or 1) is not int:
        return None
    values = stepper._values(parameters)
    if (h, values.tobytes()) not in stepper._looked_at:
        return None
    h, steps, t0 = read_steps(h, t_end, steps, t0, FLOAT64)
    q, other, n = np.array(q0), np.array(second), len(stepper.coordinates)
    double = q.dtype.char == other.dtype.char == "d" and q.shape == other.shape == (n,)
    short = 0 < steps * stepper._module.header.rows <= MOST_ROWS
    if not double or not short or (every is not None and every < 1):
        return None
    try:  # threads may do this at the same time
        made = prepared.pop()
    except IndexError:
        made = Prepared(stepper)
    stride = every or sampling_stride(stepper, steps)
    last = steps // stride if stride else 0
    (Q, P), iterations = made.sampled
    if every:
        (Q, P), iterations = np.zeros((2, last + 1, n, 1)), np.zeros((last + 1, 1), dtype=np.int64)
    legendre, W, told, progress = (
        0 if v0 is None else made.legendre,
        made.W,
        made.told,
        made.progress,
    )
    made.begin(made.kernels, legendre, h, t0, W, told, values, q, other)
    Q[0], P[0] = made.q.T, made.p.T
    progress[:] = 0
    made.take(
        made.kernels, h, t0, W, told, progress, steps, stride, Q, P, made.kept, iterations,
        NO_INPUTS,
    )  # fmt: skip
    if progress.item(0) != steps or made.status.item() or not made.pivot.item() >= 0:
        return None
    q, p = made.q.copy(), made.p.copy()
    if not (FLOAT64.all_finite(q[0]) and FLOAT64.all_finite(p[0])):
        return None
    counted = int(made.iterations.item())
    few = looked_at_of(stepper, last)
    if few and not made.steady(made.energy, h, W, told, Q, P, last, few, LIMIT):
        return None
    prepared.append(made)
    if every:
        t = t0 + np.arange(0.0, steps + 1.0, every) * h
        q, p, counts = Q[:, :, 0], P[:, :, 0], iterations[:, 0]
    else:
        before = int(iterations[1 : last + 1].sum()) if last else 0
        t, counts = np.array([t0 + h * steps]), np.array([before + counted])
    return Trajectory(
        t=t, q=q, p=p, newton_iterations=counts, h=h, steps=steps, every=every,
        status=Status.SUCCESS, message=DONE, _stepper=stepper, _values=values, _inputs=NO_INPUTS,
        _tangents=None,
    )  # fmt: skip
