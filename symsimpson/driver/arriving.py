"""A whole run in a time of its own in one call, to an end that comes behind steps not counted.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.driver.begin import START_OF_RUN, begin, begin_anew
from symsimpson.driver.between import states_at
from symsimpson.driver.explicit import steady
from symsimpson.driver.short_run import take_briefly
from symsimpson.driver.solving import DRIVER_OPTIONS, call
from symsimpson.driver.steps import COUNTS, DRIVER_LAYOUT_ROWS, INPUTS, SET, SIGNATURES, WORKSPACE
from symsimpson.module.interface import *

SIGNATURES |= {
    "run_to_end": types.int64(
        SET,
        types.UniTuple(types.int64, 3),
        types.Tuple((types.float64[::1], WORKSPACE, DRIVER_LAYOUT_ROWS)),
        START_OF_RUN,
        types.Tuple((types.int64, types.int64, types.int64, types.float64)),
        types.Tuple(
            (
                types.float64[:, :, :, ::1],
                types.float64[:, :, ::1],
                COUNTS,
                WORKSPACE,
                types.float64[::1],
            )
        ),
        INPUTS,
    )
}
#: Fewer stored states are not looked at.
FEWEST_LOOKED_AT = 16


@njit(**DRIVER_OPTIONS)
def run_to_end(kernels, addresses, setting, start, asked, results, inputs):
    """Begin anew, take steps until the end lies behind one, and then a part of a step to there.

    Returns the number of whole steps; -1 where anything is not as it should be, -2 where the most
    steps that are ``asked`` for did not lead there. ``addresses`` are those of legendre (0 if
    momenta are given), of the energy, and of what sets the energy and the rate of the run, which go
    to its parameters; ``setting`` has the step, the start, the end, and how near that must be met.
    The ``results`` are states, their times, iterations, at the end the state before the last
    part, and then that behind it; and of the last part how long it is, and all iterations.
    """
    (legendre, energy, retime), (times, W, at) = addresses, setting
    (most, every, few, limit), (states, times_out, iterations, end, tail) = asked, results
    h, t0, t_end, near = times[0], times[1], times[2], times[3]
    parameters, n, time = start[0], at[DIMENSION], at[TIME]
    begin_anew(kernels, legendre, (h, t0, W, at), start)
    call(retime, h, t0, W)
    begin(kernels, 0, h, t0, W, at)
    W[time, 0], W[time + 4, 0], W[time + 5, 0] = t0, 1.0, t_end
    for k in range(parameters.size):
        parameters[k] = W[at[PARAMETER] + k, 0]
    stores = states[0], states[1], times_out, iterations
    store_lane(W, at, 0, 0, stores)
    if not (parameters[-1] > 0.0 and W[at[MASS_PIVOT], 0] >= 0.0):  # the first rate
        return -1
    progress = np.zeros(4, dtype=np.int64)
    take_briefly(kernels, (h, t0, W, at), progress, most, every, stores, inputs)
    if W[at[STATUS], 0] != ARRIVED:
        return -2 if progress[0] == most else -1
    if W[at[PIVOT_TIME], 0] < np.inf:  # steps there may not resolve the motion
        return -1
    steps = progress[0] - 1
    last, tail[1] = steps // every, W[at[ITERATIONS], 0]
    for i in range(1, last + 1):
        tail[1] += iterations[i, 0]
    ends, before = np.empty((2, 2, n)), W[time + 2 : time + 3, 0].copy()
    for a in range(n):
        end[0, a] = W[at[PREVIOUS] + a, 0]
        end[1, a] = W[at[PREVIOUS] + 2 * n + a, 0]
    for row in range(W.shape[0]):  # the last part does not depend on the way that led there
        W[row, 0] = 0.0
    fine, when = np.zeros(1, dtype=np.bool_), np.full(1, t_end)
    sought = np.zeros(1, dtype=np.int64), when, near
    last_part = ends[0], ends[1], tail[:1], fine
    given = inputs, parameters.reshape(1, -1)
    here = h, before, W, at
    states_at(kernels, energy, here, (end[:1], end[1:]), sought, last_part, 1, given)
    for a in range(n):
        end[0, a], end[1, a] = ends[0, 0, a], ends[1, 0, a]
    if not fine[0]:
        return -1
    if few > 0 and last + 1 >= FEWEST_LOOKED_AT:
        seen, rate = min(last, few), time + RATE_BEHIND
        judged, stored = (last, seen, limit), (states[0], states[1])
        if not steady(energy, (h, t0, W, at), stored, judged, rate):
            return -1
    return steps
