"""Ways to begin: at a state, with other kernels, with variations of the state.

Compiled behind the text of the driver, whose names it uses.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.driver.solving import DRIVER_OPTIONS, LANES, RARE, call
from symsimpson.text.driver.steps import (
    DRIVER_LAYOUT_ROWS,
    SET,
    SETTING,
    SIGNATURES,
    WORKSPACE,
    keep,
)
from symsimpson.text.interface import *

#: Parameters, positions, and momenta or velocities.
START_OF_RUN = types.UniTuple(types.float64[::1], 3)
SIGNATURES |= {
    "begin_growth": types.void(WORKSPACE, DRIVER_LAYOUT_ROWS, types.int64, types.float64[:, ::1]),
    "begin": types.void(
        SET, types.int64, types.float64, types.float64, WORKSPACE, DRIVER_LAYOUT_ROWS
    ),
    "begin_anew": types.void(SET, types.int64, SETTING, START_OF_RUN),
    "change_to": types.void(
        SET, types.boolean, types.float64, types.float64, WORKSPACE, DRIVER_LAYOUT_ROWS
    ),
}


@njit(**DRIVER_OPTIONS)
def begin(kernels, legendre, h, t, W, at):
    """Begin at the q and p (or, with the address of legendre, the q and v) in the workspace."""
    for lane in range(LANES):
        W[at[ACTIVE], lane] = 1.0
        W[at[STATUS], lane] = 0.0
        W[at[CONTRACTION], lane] = 1.0
        W[at[LARGEST_SQUARED], lane] = 0.0
        W[at[PIVOT_LIMIT], lane] = SMALL_PIVOT
        W[at[PIVOT_TIME], lane] = np.inf
        W[at[ITERATIONS], lane] = 0.0
    call(kernels[PREPARE], h, t, W)
    if legendre != 0:
        call(legendre, h, t, W)
    call(kernels[START], h, t, W)


@njit(**DRIVER_OPTIONS)
def begin_anew(kernels, legendre, setting, start):
    """Begin in a workspace in which another run may have been, with parameters, q and p, or v."""
    (h, t, W, at), (parameters, q, other) = setting, start
    second = at[MOMENTUM] if legendre == 0 else at[VELOCITY]
    for row in range(W.shape[0]):
        W[row, 0] = 0.0
    for k in range(parameters.size):
        W[at[PARAMETER] + k, 0] = parameters[k]
    for a in range(at[DIMENSION]):
        W[at[POSITION] + a, 0] = q[a]
        W[second + a, 0] = other[a]
    begin(kernels, legendre, h, t, W, at)


@njit(**RARE)
def change_to(kernels, anew, h, t, W, at):
    """Go on with other kernels of the same layout, from the state and the predicted increments.

    Kernels that begin ``anew`` predict the increments themselves. Pivots of M are compared with
    those at the start of the run in both cases.
    """
    first, last, before = at[INCREMENT], at[STATE_END], np.empty((W.shape[0], LANES))
    for lane in range(LANES):
        keep(W, 0, W.shape[0], lane, before)
        W[at[STATUS], lane] = 0.0
    if anew:
        begin(kernels, 0, h, t, W, at)
    else:
        call(kernels[PREPARE], h, t, W)
        call(kernels[START], h, t, W)
    for lane in range(LANES):
        if not anew:  # the increments are the predicted ones, too
            for row in range(first, last):
                W[row, lane] = before[row, lane]
                W[row + last - first, lane] = before[row, lane]
        for row in range(at[PIVOT_SCALE], at[PIVOT_TIME] + 1):
            if before[row, lane] != 0.0:
                W[row, lane] = before[row, lane]
        W[at[ITERATIONS], lane] = before[at[ITERATIONS], lane]
        W[at[LARGEST_SQUARED], lane] = before[at[LARGEST_SQUARED], lane]


@njit(**RARE)
def begin_growth(W, at, first, columns):
    """Begin variations of members from a ``first`` one on, and what tells how they grow.

    Each member has 2 n rows of ``columns``: orthonormal variations, then the weights of dq and dp.
    """
    size, count = 2 * at[DIMENSION], at[RENEWED]
    product = at[GROWN] + 2 * count + 4
    weight = product + 2 * count * count
    for lane in range(LANES):
        member = min(first + lane, columns.shape[0] // size - 1)
        for row in range(at[GROWN], weight):
            W[row, lane] = 0.0
        for j in range(count):
            W[product + j * (count + 1), lane] = 1.0
        for a in range(size):
            W[weight + a, lane] = columns[member * size + a, count]
            for j in range(count):
                W[at[TANGENT] + j * size + a, lane] = columns[member * size + a, j]
