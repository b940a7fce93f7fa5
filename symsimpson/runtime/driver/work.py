"""The compiled loops over steps that are taken again: the work of forces, costs of steps.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.module.interface import *
from symsimpson.runtime.driver.between import BETWEEN, STATES_GIVEN, begin_again
from symsimpson.runtime.driver.solving import DRIVER_OPTIONS, RARE, call, solve
from symsimpson.runtime.driver.steps import INPUTS, SET, SIGNATURES, WORKSPACE, give

SIGNATURES |= {
    "add_up_work": types.int64(
        SET, types.int64, BETWEEN, STATES_GIVEN, types.int64, types.int64, WORKSPACE, INPUTS
    ),
    "step_costs": types.int64(
        SET, types.int64, BETWEEN, STATES_GIVEN, types.int64, types.float64[::1], INPUTS
    ),
}
#: Another solution of a step ends elsewhere by more than so much of the way, beside rounding.
SAME_WAY, ROUNDED = 1e-3, 1e-9


@njit(**RARE)
def reached(W, at, before, after):
    """Return whether steps that began at a stored state ended at the next one."""
    gap, change, size = 0.0, 0.0, 0.0
    for a in range(at[DIMENSION]):
        gap = max(gap, abs(W[at[POSITION] + a, 0] - after[a]))
        change = max(change, abs(after[a] - before[a]))
        size = max(size, abs(after[a]))
    return gap <= SAME_WAY * change + ROUNDED * size


@njit(**DRIVER_OPTIONS)
def add_up_work(kernels, work, setting, states, every, row, out, inputs):
    """Integrate powers from stored state to stored state, ``every`` steps apart.

    ``inputs`` are those of all steps. Integrals are found from ``row`` of the workspace on; ``out``
    takes their sums from the first state on. Returns how many states could be reached: whether a
    step was the run's is seen where it ends.
    """
    (h, t, W, at), (q, p) = setting, states
    count = out.shape[1]
    low = np.zeros(count)
    for i in range(1, q.shape[0]):
        begin_again(kernels, (h, t[i - 1], W, at), q[i - 1], p[i - 1])
        for k in range(count):
            W[row + k, 0] = 0.0
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


@njit(**DRIVER_OPTIONS)
def step_costs(kernels, cost, setting, states, row, out, inputs):
    """Integrate a running cost over the step behind each state but the last.

    It is found in a ``row`` of the workspace. Returns how many states could be reached.
    """
    (h, t, W, at), (q, p) = setting, states
    n = at[DIMENSION]
    for i in range(out.shape[0]):
        begin_again(kernels, (h, t[i], W, at), q[i], p[i])
        W[row, 0], W[row + 1, 0] = 0.0, 0.0
        give(W, at, inputs, i)
        W[at[ACTIVE], 0] = 1.0
        if kernels[MODE] == EXPLICIT:
            W[at[COUNT], 0] = 1.0
        elif solve(kernels[ITERATE], h, t[i], W, at) != 0:
            return i + 1
        W[at[ACTIVE], 0] = 1.0
        call(kernels[ADVANCE], h, t[i], W)
        if not reached(W, at, q[i], q[i + 1]):
            return i + 1
        for a in range(n):  # steps without iteration do not keep where they began
            W[at[PREVIOUS] + a, 0], W[at[PREVIOUS] + 2 * n + a, 0] = q[i, a], p[i, a]
        W[at[ACTIVE], 0] = 1.0
        call(cost, h, t[i], W)
        out[i] = W[row, 0]
    return q.shape[0]
