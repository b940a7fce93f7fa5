"""A whole short run in one call, where nothing needs to be looked at on the way.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.driver.begin import START_OF_RUN, begin_anew
from symsimpson.driver.explicit import finite, steady, take_explicit_steps
from symsimpson.driver.recovery import recover
from symsimpson.driver.solving import DRIVER_OPTIONS
from symsimpson.driver.steps import (
    COUNTS,
    INPUTS,
    SET,
    SETTING,
    SIGNATURES,
    SUSPICIOUS,
    WORKSPACE,
    store_lane,
    take_steps,
)
from symsimpson.module.interface import *

SIGNATURES |= {
    "run_briefly": types.int64(
        SET,
        types.UniTuple(types.int64, 2),
        SETTING,
        START_OF_RUN,
        types.Tuple((types.int64, types.int64, types.int64, types.float64)),
        types.Tuple((types.float64[:, :, :, ::1], COUNTS, WORKSPACE)),
        INPUTS,
    )
}

#: Whether steps are solved by iteration; this text is compiled for those that are not, too.
ITERATED = True
take_all = take_steps if ITERATED else take_explicit_steps


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
    """Begin anew, take all steps, and return how many iterations they took, or -1.

    It is -1 where anything is not as it should be: a step failed, the end is not finite, or the
    energy at a few of the stored states is not ``steady``. ``addresses`` are those of legendre (0
    if momenta are given) and of the energy. ``asked`` are the number of steps, how many lie between
    stored states, how many of these are looked at, and a limit; ``results`` takes states,
    iterations, and at the end the last q and p, then the least and the largest of stored positions.
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
    if few > 0 and not steady(energy, setting, stored, (last, few, limit), 0):
        return -1
    return count
