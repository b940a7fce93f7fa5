"""The compiled loop over steps that are taken again, to add up the work of forces.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.interface import (
    ACTIVE,
    ADVANCE,
    COUNT,
    DIMENSION,
    EXPLICIT,
    ITERATE,
    MODE,
    MOMENTUM,
    POSITION,
)
from symsimpson.runtime.driver.between import GIVEN, TIMES
from symsimpson.runtime.driver.steps import (
    DRIVER_OPTIONS,
    INPUTS,
    SET,
    SIGNATURES,
    TOLD_ROWS,
    WORKSPACE,
    begin,
    call,
    give,
    solve,
)

SIGNATURES |= {
    "add_up_work": types.int64(
        SET, types.int64, types.float64, TIMES, WORKSPACE, TOLD_ROWS, GIVEN, GIVEN,
        types.int64, types.int64, WORKSPACE, INPUTS,
    ),
}  # fmt: skip
#: Another solution of a step ends elsewhere by more than so much of the way, beside rounding.
SAME_WAY, ROUNDED = 1e-3, 1e-9


@njit(**DRIVER_OPTIONS)
def reached(W, at, before, after):
    """Return whether steps that began at a stored state ended at the next one."""
    gap, change, size = 0.0, 0.0, 0.0
    for a in range(at[DIMENSION]):
        gap = max(gap, abs(W[at[POSITION] + a, 0] - after[a]))
        change = max(change, abs(after[a] - before[a]))
        size = max(size, abs(after[a]))
    return gap <= SAME_WAY * change + ROUNDED * size


@njit(**DRIVER_OPTIONS)
def add_up_work(kernels, work, h, t, W, at, q, p, every, row, out, inputs):
    """Integrate powers from stored state to stored state, ``every`` steps apart.

    ``inputs`` are those of all steps. Integrals are found from ``row`` of the workspace on; ``out``
    takes their sums from the first state on. Returns how many states could be reached: whether a
    step was the run's is seen where it ends.
    """
    n, count = at[DIMENSION], out.shape[1]
    low = np.zeros(count)
    for i in range(1, q.shape[0]):
        for k in range(at[POSITION], at[POSITION] + 4 * n):
            W[k, 0] = 0.0
        for a in range(n):
            W[at[POSITION] + a, 0] = q[i - 1, a]
            W[at[MOMENTUM] + a, 0] = p[i - 1, a]
        for k in range(count):
            W[row + k, 0] = 0.0
        begin(kernels, 0, h, t[i - 1], W, at)
        for step in range(every):
            now = t[i - 1] + h * step
            give(W, at, inputs, (i - 1) * every + step)
            W[at[ACTIVE], 0] = 1.0
            if kernels[MODE] == EXPLICIT:
                W[at[COUNT], 0] = 1.0
            elif solve(kernels[ITERATE], h, now, W, at) != 0:
                return i
            W[at[ACTIVE], 0] = 1.0
            call(work, h, now, W)
            call(kernels[ADVANCE], h, now, W)
        if not reached(W, at, q[i - 1], q[i]):
            return i
        for k in range(count):
            before = out[i - 1, k]
            change = W[row + k, 0] + low[k]
            after = before + change
            low[k] = change - (after - before)
            out[i, k] = after
    return q.shape[0]
