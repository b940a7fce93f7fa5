"""A short run in one call, over a number of steps or to an end time.

This file is compiled together with the text of the driver and uses its names.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.driver.between import states_at
from symsimpson.text.driver.explicit import finite, has_steady_energy, take_explicit_steps
from symsimpson.text.driver.recovery import recover
from symsimpson.text.driver.steps import *
from symsimpson.text.interface import *

SIGNATURES |= {
    "run_briefly": types.int64(
        SET,
        types.UniTuple(types.int64, 2),
        SETTING,
        START_OF_RUN,
        types.Tuple((types.int64, types.int64, types.int64, types.float64)),
        types.Tuple((types.float64[:, :, :, ::1], COUNTS, WORKSPACE)),
        INPUTS,
    ),
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
    ),
}

#: True if steps are solved by iteration; this text is also compiled for explicit steps.
ITERATED = True
take_all = take_steps if ITERATED else take_explicit_steps
#: The fewest stored states whose energy is checked.
FEWEST_LOOKED_AT = 16


@njit(**DRIVER_OPTIONS)
def take_briefly(kernels, setting, progress, stop, every, stores, inputs):
    """Take steps, and verify those in doubt, until ``stop`` or a failure."""
    h, t0, W, at = setting
    take_all(kernels, setting, progress, stop, every, stores, inputs)
    while ITERATED and progress[1] == SUSPICIOUS and W[at[STATUS], 0] == 0.0:
        recover(kernels, h, t0 + h * progress[0], W, at, SUSPICIOUS)
        take_all(kernels, setting, progress, stop, every, stores, inputs)


@njit(**DRIVER_OPTIONS)
def run_briefly(kernels, addresses, setting, start, asked, results, inputs):
    """Take all steps of a new run; return the number of iterations, or -1 for a failure.

    A run fails if a step fails, if the end is not finite, or if sampled states have no steady
    energy. ``addresses`` has the addresses of legendre (0 if momenta are given) and of the energy.
    ``asked`` has the number of steps, the steps between stored states, the number of samples, and
    the limit of the energy change. ``results`` takes states, iterations, and four rows at the end:
    the last q and p, then the least and largest stored positions.
    """
    (legendre, energy), (_, _, W, at) = addresses, setting
    (steps, every, few, limit), (states, iterations, end) = asked, results
    n, last = at[DIMENSION], steps // every if every != 0 else 0
    begin_anew(kernels, legendre, setting, start)
    progress, nothing = np.zeros(4, dtype=np.int64), np.empty((1, 0, 1))
    stores = states[0], states[1], nothing, iterations
    store_lane(W, at, 0, 0, stores)
    take_briefly(kernels, setting, progress, steps, every, stores, inputs)
    over = progress[0] == steps and W[at[STATUS], 0] == 0.0 and W[at[MASS_PIVOT], 0] >= 0.0
    over = over and W[at[PIVOT_TIME], 0] == np.inf
    if not over or not finite(W, at[POSITION], at[POSITION] + 4 * n, 0):
        return -1
    count = np.int64(W[at[ITERATIONS], 0])
    for i in range(1, last + 1):
        count += iterations[i, 0]
    for a in range(n):
        end[0, a] = W[at[POSITION] + a, 0]
        end[1, a] = W[at[MOMENTUM] + a, 0]
        least, largest = states[0, 0, a, 0], states[0, 0, a, 0]
        for i in range(1, last + 1):
            least, largest = min(least, states[0, i, a, 0]), max(largest, states[0, i, a, 0])
        end[2, a], end[3, a] = least, largest
    stored = states[0], states[1]
    if few > 0 and not has_steady_energy(energy, setting, stored, (last, few, limit), 0):
        return -1
    return count


@njit(**DRIVER_OPTIONS)
def run_to_end(kernels, addresses, setting, start, asked, results, inputs):
    """Take the steps of a new retimed run up to a step that passes the end time, and its part.

    Return the number of whole steps, -1 for a failure, or -2 if the largest number of steps did not
    reach the end. ``addresses`` has the addresses of legendre (0 if momenta are given), energy and
    retime. The kernel retime sets the energy and the rate among the parameters. ``setting`` begins
    with the step, the initial time, the end time, and its relative tolerance.

    ``results`` takes states, their times and iterations. Then it takes the states before and after
    the last part of a step. Its last array takes the size of that part, and all iterations.
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
        if not has_steady_energy(energy, (h, t0, W, at), stored, judged, rate):
            return -1
    return steps
