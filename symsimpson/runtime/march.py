"""The compiled loop over steps that need no iteration, and over states to evaluate.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.runtime.driver import (
    ACTIVE,
    ADVANCE,
    COUNT,
    COUNTS,
    DIMENSION,
    INLINE,
    KERNELS,
    LANES,
    MOMENTUM,
    NOT_FINITE,
    OPTIONS,
    PLACES,
    POSITION,
    SIGNATURES,
    START,
    STATES,
    STATUS,
    WORKSPACE,
    call,
    keep,
    put_back,
    store,
)

SIGNATURES |= {
    "march": types.void(
        KERNELS, types.float64, types.float64, WORKSPACE, PLACES, types.int64[::1], types.int64,
        types.int64, STATES, STATES, COUNTS,
    ),
    "evaluate": types.void(
        types.int64, types.int64, types.int64, types.float64, WORKSPACE, PLACES,
        types.float64[::1], types.float64[:, :], types.float64[:, :], types.int64, WORKSPACE,
    ),
}  # fmt: skip
#: Steps that a kernel takes in one call.
AT_ONCE = 1 << 62


@njit(**INLINE)
def finite(W, first, last, lane):
    """Tell whether rows of a lane are finite."""
    total = 0.0
    for row in range(first, last):
        total += 0.0 * W[row, lane]  # 0 for finite numbers alone
    return total == 0.0


@njit(**OPTIONS)
def march(kernels, h, t0, W, at, progress, stop, every, q_out, p_out, iterations_out):
    """Take steps that need no iteration, all up to the next state to store in one call.

    Arguments are as for ``run``. A lane whose state would not be finite stops before that step.
    """
    n, lanes = at[DIMENSION], LANES
    position, status = at[POSITION], at[STATUS]
    state_end = position + 4 * n
    before = np.empty((4 * n, lanes))
    step = progress[0]
    single = 0
    while step < stop:
        count = stop - step if every == 0 else min(stop - step, every - step % every)
        count = 1 if single > 0 else min(count, AT_ONCE)
        alive = 0
        for lane in range(lanes):
            keep(W, position, state_end, lane, before)
            W[at[ACTIVE], lane] = 1.0 if W[status, lane] == 0.0 else 0.0
            W[at[COUNT], lane] = count
            alive += W[status, lane] == 0.0
        if alive == 0:
            break
        call(kernels[ADVANCE], h, t0 + h * step, W)
        lost = 0
        for lane in range(lanes):
            if W[status, lane] == 0.0 and not finite(W, position, state_end, lane):
                lost += 1
        if lost > 0:
            alive -= lost
            for lane in range(lanes):
                if count == 1 and finite(W, position, state_end, lane):
                    continue
                put_back(W, position, state_end, lane, before)
                if count == 1 and W[status, lane] == 0.0:
                    W[status, lane] = NOT_FINITE
            if count > 1:  # take these steps again, one by one
                single = count
                call(kernels[START], h, t0 + h * step, W)
                continue
            if alive == 0:
                break
        step += count
        single -= 1
        if every != 0 and step % every == 0:
            store(W, at, step // every, q_out, p_out, iterations_out)
    progress[0] = step


@njit(**OPTIONS)
def evaluate(prepare, before, kernel, h, W, at, t, q, p, block, out):
    """Evaluate a kernel that maps (t, q, p) to the rows of a block, for each of many states.

    Another kernel comes before it, if its address is not 0.
    """
    n = at[DIMENSION]
    call(prepare, h, 0.0, W)
    for i in range(q.shape[0]):
        for a in range(n):
            W[at[POSITION] + a, 0] = q[i, a]
            W[at[MOMENTUM] + a, 0] = p[i, a]
        if before != 0:
            call(before, h, t[i], W)
        call(kernel, h, t[i], W)
        for k in range(out.shape[1]):
            out[i, k] = W[block + k, 0]
