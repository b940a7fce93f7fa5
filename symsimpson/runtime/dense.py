"""The compiled loop over states between the steps of a run.

Compiled behind the text of the driver, whose names it uses.
"""

from numba import njit, types

from symsimpson.runtime.driver import (
    COUNTS,
    DIMENSION,
    KERNELS,
    MOMENTUM,
    OPTIONS,
    PLACES,
    POSITION,
    SIGNATURES,
    STATES,
    STATUS,
    WORKSPACE,
    begin,
    run,
)
from symsimpson.runtime.march import march
from symsimpson.runtime.mend import mend

SIGNATURES |= {
    "between": types.void(
        KERNELS, types.boolean, types.float64, types.float64[::1], WORKSPACE, PLACES,
        types.int64[::1], WORKSPACE, WORKSPACE, types.int64[::1], types.int64[::1],
        types.float64[::1], STATES, COUNTS, WORKSPACE, WORKSPACE, types.int64[::1],
    ),
}  # fmt: skip


@njit(**OPTIONS)
def take(kernels, direct, h, t, W, at, progress, count, q, p, states, counts):
    """Take steps from (q, p), and leave there the state after them; gives the status."""
    n = at[DIMENSION]
    for row in range(at[POSITION], at[POSITION] + 4 * n):
        W[row, 0] = 0.0
    for a in range(n):
        W[at[POSITION] + a, 0] = q[a]
        W[at[MOMENTUM] + a, 0] = p[a]
    begin(kernels, 0, h, t, W, at)
    progress[0], progress[1] = 0, 0
    if direct:
        march(kernels, h, t, W, at, progress, count, 0, states, states, counts)
    while progress[0] < count and W[at[STATUS], 0] == 0.0:
        run(kernels, h, t, W, at, progress, count, 0, states, states, counts)
        if progress[1] != 0:
            mend(kernels, h, t + h * progress[0], W, at, progress[1])
    for a in range(n):
        q[a] = W[at[POSITION] + a, 0]
        p[a] = W[at[MOMENTUM] + a, 0]
    return W[at[STATUS], 0]


@njit(**OPTIONS)
def between(
    kernels, direct, h, t, W, at, progress, q, p, start, whole, rest, states, counts, q_out, p_out,
    codes,
):  # fmt: skip
    """Give the states ``whole[i]`` steps and then one of size ``rest[i]`` after the i-th start.

    ``t``, ``q``, ``p`` are stored states, ``start`` tells which of them; where that and the whole
    steps go up, no step is taken twice. ``q_out`` and ``p_out`` have one row more than there are
    states to give: the state after the whole steps stands there.
    """
    n, last = at[DIMENSION], len(start)
    stored, done, lost = -1, 0, 0.0
    for i in range(last):
        if start[i] != stored or whole[i] < done:
            stored, done, lost = start[i], 0, 0.0
            for a in range(n):
                q_out[last, a], p_out[last, a] = q[stored, a], p[stored, a]
        now = t[stored] + h * done
        if whole[i] > done and lost == 0.0:
            lost = take(kernels, direct, h, now, W, at, progress, whole[i] - done, q_out[last],
                        p_out[last], states, counts)  # fmt: skip
            done = whole[i]
            now = t[stored] + h * done
        for a in range(n):
            q_out[i, a], p_out[i, a] = q_out[last, a], p_out[last, a]
        codes[i] = lost
        if lost == 0.0 and rest[i] != 0.0:
            codes[i] = take(kernels, direct, rest[i], now, W, at, progress, 1, q_out[i], p_out[i],
                            states, counts)  # fmt: skip
