"""The compiled loops of the adjoint: derivatives of a cost, from the end of a run to its start.

This file is compiled together with the text of the driver and uses its names.
"""

from numba import njit, types

from symsimpson.text.driver.between import BETWEEN, GIVEN, STATES_GIVEN
from symsimpson.text.driver.steps import *
from symsimpson.text.interface import *

SIGNATURES |= {
    "carry_back": types.void(
        types.UniTuple(types.int64, 2),
        SETTING,
        types.UniTuple(types.int64, 2),
        types.int64,
        types.Tuple((STATES, GIVEN, INPUTS)),
        WORKSPACE,
        types.int64[::1],
        WORKSPACE,
    ),
    "pull_velocities": types.void(
        types.UniTuple(types.int64, 3),
        BETWEEN,
        STATES_GIVEN,
        types.UniTuple(types.int64, 2),
        WORKSPACE,
        WORKSPACE,
    ),
}


@njit(**DRIVER_OPTIONS)
def carry_back(addresses, setting, rows, first, given, totals, chosen, slopes):
    """Carry derivatives of a cost by the state back over as many steps as ``slopes`` has rows.

    ``addresses`` are the addresses of the kernels prepare and adjoint. ``rows`` has the first row
    of the derivatives by the state, and the first row of the derivatives by parameters. The kernel
    replaces the latter in each step. ``first`` is the number of the first step.

    ``given`` is (records, jumps, inputs): records[i + 1] is step i, and jumps[i] the derivative of
    the cost by the state after it, if any. The inputs belong to the whole run. The first row of
    ``totals`` takes the sums of derivatives by parameters, the second row their rounding errors.
    ``slopes`` takes the ``chosen`` derivatives of each step.
    """
    (prepare, adjoint), (h, t0, W, at) = addresses, setting
    (row, slope_row), (records, jumps, inputs) = rows, given
    n, steps = at[DIMENSION], slopes.shape[0]
    call(prepare, h, t0, W)
    for back in range(steps):
        i = steps - 1 - back
        if jumps.shape[0] > 0:
            for k in range(2 * n):
                W[row + k, 0] += jumps[i, k]
        for k in range(4 * n):
            W[at[PREVIOUS] + k, 0] = records[i + 1, k, 0]
        for k in range(4 * n, records.shape[1]):
            W[at[SOLVED] + k - 4 * n, 0] = records[i + 1, k, 0]
        give(W, at, inputs, first + i)
        W[at[ACTIVE], 0] = 1.0
        call(adjoint, h, t0 + h * (first + i), W)
        for k in range(totals.shape[1]):
            before = totals[0, k]
            change = W[slope_row + k, 0] + totals[1, k]
            totals[0, k] = before + change
            totals[1, k] = change - (totals[0, k] - before)
        for k in range(slopes.shape[1]):
            slopes[i, k] = W[slope_row + chosen[k], 0]


@njit(**DRIVER_OPTIONS)
def pull_velocities(addresses, setting, states, rows, out, slopes):
    """Turn derivatives by q and p at states, given in ``out``, into those by q and v.

    ``addresses`` are the addresses of prepare, start and start_adjoint. ``rows`` has the first row
    of the derivatives by the state, and the first row of the derivatives by parameters. ``slopes``
    takes the latter at constant v.
    """
    (prepare, start, adjoint), (h, t, W, at) = addresses, setting
    (q, p), (row, slope_row), n = states, rows, at[DIMENSION]
    call(prepare, h, t[0], W)
    for i in range(out.shape[0]):
        for a in range(n):
            W[at[POSITION] + a, 0] = q[i, a]
            W[at[MOMENTUM] + a, 0] = p[i, a]
        call(start, h, t[i], W)
        for k in range(2 * n):
            W[row + k, 0] = out[i, k]
        call(adjoint, h, t[i], W)
        for k in range(2 * n):
            out[i, k] = W[row + k, 0]
        for k in range(slopes.shape[1]):
            slopes[i, k] = W[slope_row + k, 0]
