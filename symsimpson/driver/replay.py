"""The compiled loop over steps that are taken again, for what a recorder adds up over them.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.driver.between import BETWEEN, STATES_GIVEN, take
from symsimpson.driver.solving import DRIVER_OPTIONS, RARE
from symsimpson.driver.steps import INPUTS, SET, SIGNATURES, WORKSPACE
from symsimpson.module.interface import *

SIGNATURES |= {
    "replay": types.int64(SET, BETWEEN, STATES_GIVEN, types.int64, types.boolean, WORKSPACE, INPUTS)
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
def replay(kernels, setting, states, every, anew, out, inputs):
    """Take the steps between stored states again, and store a recorder's sums at each state.

    There are ``every`` steps from one to the next. ``out[i]`` takes the sums over the steps from
    state 0, or from state i - 1 where each begins ``anew``. In the workspace they are followed by
    what rounding took from them. ``inputs`` are those of all steps. Returns how many states were
    reached, the first one included: a replay that ends away from a stored state stops there.
    """
    (h, t, W, at), (q, p) = setting, states
    n, row, count = at[DIMENSION], at[RECORDED], out.shape[1]
    here_q, here_p = np.empty(n), np.empty(n)
    room = np.zeros(4, dtype=np.int64), np.empty((1, 1, 1)), np.empty((1, 1), dtype=np.int64)
    for i in range(1, q.shape[0]):
        for a in range(n):
            here_q[a], here_p[a] = q[i - 1, a], p[i - 1, a]
        if anew:
            for k in range(2 * count):
                W[row + k, 0] = 0.0
        here, driving = (h, t[i - 1], W, at), (inputs, (i - 1) * every)
        if not take(kernels, here, every, (here_q, here_p), driving, room, True):
            return i
        if not reached(W, at, q[i - 1], q[i]):
            return i
        for k in range(count):
            out[i, k] = W[row + k, 0]
    return q.shape[0]
