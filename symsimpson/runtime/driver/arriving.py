"""A whole run in a time of its own in one call, to an end that comes behind steps not counted.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.module.interface import *
from symsimpson.runtime.driver.begin import begin, begin_anew
from symsimpson.runtime.driver.between import states_at
from symsimpson.runtime.driver.brief import take_all
from symsimpson.runtime.driver.explicit import steady
from symsimpson.runtime.driver.solving import DRIVER_OPTIONS, call
from symsimpson.runtime.driver.steps import COUNTS, INPUTS, SET, SIGNATURES, TOLD_ROWS, WORKSPACE

SIGNATURES |= {
    "run_to_end": types.int64(
        SET,
        types.int64[::1],
        types.float64[::1],
        WORKSPACE,
        TOLD_ROWS,
        types.float64[::1],
        types.float64[::1],
        types.float64[::1],
        types.int64,
        types.int64,
        types.int64,
        types.float64,
        types.float64[:, :, :, ::1],
        types.float64[:, :, ::1],
        COUNTS,
        WORKSPACE,
        types.float64[::1],
        INPUTS,
    )
}
#: Fewer stored states are not looked at.
FEWEST_LOOKED_AT = 16


@njit(**DRIVER_OPTIONS)
def run_to_end(
    kernels,
    more,
    times,
    W,
    at,
    parameters,
    q,
    other,
    most,
    every,
    few,
    limit,
    states,
    kept,
    iterations,
    end,
    told,
    inputs,
):
    """Begin anew, take steps until the end lies behind one, and then a part of a step to there.

    Returns the number of whole steps; -1 where anything is not as it should be, -2 where ``most``
    steps did not lead there. ``more`` has the addresses of legendre (0 if momenta are given), of
    the energy, and of what sets the energy and the rate of the run, which go to ``parameters``;
    ``times`` the step, the start, the end, and how near that must be met. ``end`` has the state
    before the last part, and takes that behind it; ``told`` the part, and the iterations.
    """
    legendre, energy, retime = more[0], more[1], more[2]
    h, t0, t_end, near = times[0], times[1], times[2], times[3]
    n, time = q.size, at[KEPT]
    begin_anew(kernels, legendre, h, t0, W, at, parameters, q, other)
    call(retime, h, t0, W)
    begin(kernels, 0, h, t0, W, at)
    W[time, 0], kept[0, 0, 0] = t0, t0
    W[time + 4, 0], W[time + 5, 0] = 1.0, t_end
    for k in range(parameters.size):
        parameters[k] = W[at[PARAMETER] + k, 0]
    for a in range(n):
        states[0, 0, a, 0] = W[at[POSITION] + a, 0]
        states[1, 0, a, 0] = W[at[MOMENTUM] + a, 0]
    if not (parameters[-1] > 0.0 and W[at[MASS_PIVOT], 0] >= 0.0):  # the first rate
        return -1
    progress = np.zeros(3, dtype=np.int64)
    take_all(
        kernels, h, t0, W, at, progress, most, every, states[0], states[1], kept, iterations, inputs
    )
    if W[at[STATUS], 0] != ARRIVED:
        return -2 if progress[0] == most else -1
    steps = progress[0] - 1
    last, told[1] = steps // every, W[at[ITERATIONS], 0]
    for i in range(1, last + 1):
        told[1] += iterations[i, 0]
    ends, before = np.empty((2, 2, n)), W[time + 2 : time + 3, 0].copy()
    for a in range(n):
        end[0, a] = W[at[PREVIOUS] + a, 0]
        end[1, a] = W[at[PREVIOUS] + 2 * n + a, 0]
    for row in range(W.shape[0]):  # the last part does not depend on the way that led there
        W[row, 0] = 0.0
    fine, asked = np.zeros(1, dtype=np.bool_), np.full(1, t_end)
    states_at(
        kernels,
        energy,
        h,
        before,
        W,
        at,
        end[:1],
        end[1:],
        np.zeros(1, dtype=np.int64),
        asked,
        ends[0],
        ends[1],
        told[:1],
        fine,
        1,
        inputs,
        near,
        parameters.reshape(1, -1),
    )
    for a in range(n):
        end[0, a], end[1, a] = ends[0, 0, a], ends[1, 0, a]
    if not fine[0]:
        return -1
    if few > 0 and last + 1 >= FEWEST_LOOKED_AT:
        seen, rate = min(last, few), time + RATE_BEHIND
        if not steady(energy, h, W, at, states[0], states[1], last, seen, limit, rate):
            return -1
    return steps
