"""Recovery of steps that failed, or whose solution is in doubt.

This file is compiled together with the text of the driver and uses its names.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.driver.steps import *
from symsimpson.text.interface import *

SIGNATURES |= {
    "recover": types.void(
        SET, types.float64, types.float64, WORKSPACE, DRIVER_LAYOUT_ROWS, types.int64
    )
}
#: A step is verified by MORE further steps, and by FINER steps for each of them. The squared
#: distance of their ends may be APART in units of the largest increments.
MORE, FINER, APART = 3, 16, 0.25
#: Two solutions of a step are one if their relative distance is below this, squared.
SAME_SOLUTION = 1e-12
#: The number of pieces in which a solution is continued from small steps.
PIECES = 16
#: A step is linear if the second correction is below the part LINEAR of the first, squared, and the
#: first correction not below the part LARGE of the increments.
LINEAR, LARGE = 1e-20, 1e-4
#: Steps resolve a passage with a small M if its pivot changes by no more than the factor CHANGE
#: within AHEAD more steps.
CHANGE, AHEAD = 2.25, 2


@njit(**RARE)
def keep_all(W, copy):
    """Copy all rows of all lanes."""
    for lane in range(LANES):
        keep(W, 0, W.shape[0], lane, copy)


@njit(**RARE)
def put_all_back(W, copy):
    """Restore all rows of all lanes."""
    for lane in range(LANES):
        put_back(W, 0, W.shape[0], lane, copy)


@njit(**RARE)
def activate_only(W, active, lane):
    """Activate one lane for kernels."""
    for other in range(LANES):
        W[active, other] = 1.0 if other == lane else 0.0


@njit(**RARE)
def distance(W, at, lane, a, b):
    """Squared distance of two sets of increments in the metric of M(q0)'s diagonal."""
    total = 0.0
    for row in range(at[MEASURED]):
        gap = a[row, lane] - b[row, lane]
        total += W[at[MASS_DIAGONAL] + row % at[DIMENSION], lane] * gap * gap
    return total


@njit(**RARE)
def continuation(kernels, h, t, W, at, lane):
    """Solve one lane's step by continuation from small steps to h; return a status.

    The lane must have the state at the start of the step. Only its increments change.
    """
    first, last = at[INCREMENT], at[STATE_END]
    rows, lanes = W.shape[0], LANES
    unknowns = last - first
    whole = np.empty((rows, lanes))
    keep_all(W, whole)
    zero = np.zeros((unknowns, lanes))
    straight = np.zeros((unknowns, lanes))
    bend = np.zeros((unknowns, lanes))
    bend_before = np.zeros((unknowns, lanes))
    guess = np.zeros((unknowns, lanes))
    solution = np.zeros((unknowns, lanes))
    largest = 0.0
    status = 0
    for piece in range(1, PIECES + 1):
        part = h * piece / PIECES
        activate_only(W, at[ACTIVE], lane)
        W[at[CONTRACTION], lane] = 1.0
        call(kernels[PREPARE], part, t, W)
        call(kernels[START], part, t, W)
        keep(W, first, last, lane, straight)
        for row in range(unknowns):
            extrapolated = 2.0 * bend[row, lane] - bend_before[row, lane]
            guess[row, lane] = straight[row, lane] + extrapolated * part * part
        put_back(W, first, last, lane, guess)
        status = solve(kernels[ITERATE], part, t, W, at)
        if status != 0:
            break
        keep(W, first, last, lane, solution)
        largest = max(largest, distance(W, at, lane, solution, zero))
        if piece > 2 and distance(W, at, lane, solution, guess) > 0.25 * largest:
            status = STEP_TOO_LARGE  # it jumped to another solution
            break
        for row in range(unknowns):
            bent = (solution[row, lane] - straight[row, lane]) / (part * part)
            bend_before[row, lane] = bent if piece == 1 else bend[row, lane]
            bend[row, lane] = bent
    whole[at[ITERATIONS], lane] = W[at[ITERATIONS], lane]
    put_all_back(W, whole)
    if status == 0:
        put_back(W, first, last, lane, solution)
    return status


@njit(**RARE)
def take_more_steps(kernels, h, t, W, at, lane, steps):
    """Take steps with one lane; return whether all of them succeeded."""
    for step in range(steps):
        activate_only(W, at[ACTIVE], lane)
        if solve(kernels[ITERATE], h, t + h * step, W, at) != 0:
            return False
        activate_only(W, at[ACTIVE], lane)
        call(kernels[ADVANCE], h, t + h * step, W)
        if not W[at[VELOCITY_JUMP_SQUARED], lane] < np.inf:
            return False
    return True


@njit(**RARE)
def resolved(kernels, h, t, W, at, lane):
    """Return whether a step, and the steps after it, agree with finer steps."""
    first, n, rows, lanes = at[POSITION], at[DIMENSION], W.shape[0], LANES
    after, coarse = np.empty((rows, lanes)), np.empty((n, lanes))
    keep_all(W, after)
    good = take_more_steps(kernels, h, t + h, W, at, lane, MORE)
    keep(W, first, first + n, lane, coarse)
    put_all_back(W, after)
    if good:
        part = h / FINER
        step_back(W, at, lane)
        activate_only(W, at[ACTIVE], lane)
        call(kernels[PREPARE], part, t, W)
        call(kernels[START], part, t, W)
        good = take_more_steps(kernels, part, t, W, at, lane, (MORE + 1) * FINER)
    apart = 0.0
    for a in range(n):
        gap = W[first + a, lane] - coarse[a, lane]
        apart += W[at[MASS_DIAGONAL] + a, lane] * gap * gap
    put_all_back(W, after)
    return good and apart <= APART * W[at[LARGEST_SQUARED], lane]


@njit(**RARE)
def is_linear(kernels, h, t, W, at, lane):
    """Return whether the equations of a lane's step are linear, so that they have one solution.

    The lane must have the state at the start of the step. The test takes two iterations.
    """
    before = np.empty((W.shape[0], LANES))
    keep_all(W, before)
    activate_only(W, at[ACTIVE], lane)
    call(kernels[START], h, t, W)
    call(kernels[ITERATE], h, t, W)
    first = W[at[RELATIVE], lane] * W[at[INCREMENT_SQUARED], lane]
    size = W[at[INCREMENT_SQUARED], lane]
    activate_only(W, at[ACTIVE], lane)
    call(kernels[ITERATE], h, t, W)
    second = W[at[RELATIVE], lane] * W[at[INCREMENT_SQUARED], lane]
    put_all_back(W, before)
    return second <= LINEAR * first and first >= LARGE * size


@njit(**RARE)
def is_singular(kernels, h, t, W, at, lane, first, last):
    """Return whether M of a lane is not definite after steps at constant velocity."""
    before = np.empty((W.shape[0], LANES))
    lost = 0
    for other in range(LANES):
        keep(W, 0, W.shape[0], other, before)
    call(kernels[START], h, t, W)
    for ahead in range(first, last + 1):
        for a in range(at[DIMENSION]):
            moved = ahead * h * W[at[VELOCITY] + a, lane]
            W[at[POSITION] + a, lane] = before[at[POSITION] + a, lane] + moved
        call(kernels[START], h, t + ahead * h, W)
        lost += W[at[MASS_PIVOT], lane] < 0.0
    for other in range(LANES):
        put_back(W, 0, W.shape[0], other, before)
    return lost > 0


@njit(**RARE)
def set_failure_status(kernels, h, t, W, at, lane):
    """Set the status of a failed lane if M loses its definiteness ahead."""
    status = W[at[STATUS], lane]
    failed = (
        abs(status - NOT_FINITE) <= 1.0
    )  # and the statuses next to it: not converged, too large
    if failed and is_singular(kernels, h, t, W, at, lane, 1, 2):
        W[at[STATUS], lane] = SINGULAR_LEGENDRE


@njit(**RARE)
def look_at_pivot(kernels, h, t, W, at, lane):
    """Return whether M is singular or indefinite after a step; else store its smallest pivot.

    The time is stored, too, if trial steps do not resolve the passage.
    """
    W[at[IN_DOUBT], lane] -= SMALL_MASS
    pivot = W[at[MASS_PIVOT], lane]
    change = 0.0
    if pivot > LOST_PIVOT:
        W[at[PIVOT_LIMIT], lane] = SMALLER * pivot
        after = np.empty((W.shape[0], LANES))
        keep_all(W, after)
        if take_more_steps(kernels, h, t, W, at, lane, AHEAD):
            change = W[at[MASS_PIVOT], lane] / pivot
        put_all_back(W, after)
    if not (change > 1.0 / CHANGE and change < CHANGE):
        W[at[PIVOT_TIME], lane] = t
    return pivot <= LOST_PIVOT


@njit(**RARE)
def verify(kernels, h, t, W, at, lane):
    """Replace the solution of a lane's step if smaller steps lead to another one."""
    if W[at[IN_DOUBT], lane] >= SMALL_MASS:
        if look_at_pivot(kernels, h, t + h, W, at, lane):
            step_back(W, at, lane)
            W[at[STATUS], lane] = SINGULAR_LEGENDRE
            return
        if W[at[IN_DOUBT], lane] == ACCEPTED:
            return
    first, last = at[INCREMENT], at[STATE_END]
    rows, lanes = W.shape[0], LANES
    increments = np.empty((last - first, lanes))
    keep(W, at[SOLVED], at[SOLVED] + last - first, lane, increments)
    after = np.empty((rows, lanes))
    keep_all(W, after)
    finite = W[at[VELOCITY_JUMP_SQUARED], lane] < np.inf
    if finite and W[at[IN_DOUBT], lane] == TO_BE_VERIFIED:
        least = rounding_bound(W, at, h, lane)
        if W[at[INCREMENT_SQUARED], lane] <= least:  # at rest, and so will be what follows
            W[at[LARGEST_SQUARED], lane] = max(W[at[LARGEST_SQUARED], lane], least)
            return
    unresolved = W[at[IN_DOUBT], lane] == UNRESOLVED
    if finite and W[at[IN_DOUBT], lane] == POSSIBLY_UNRESOLVED:
        if resolved(kernels, h, t, W, at, lane):
            return
        unresolved = True
    step_back(W, at, lane)
    if not finite:
        W[at[STATUS], lane] = NOT_FINITE
        return
    if unresolved:
        W[at[STATUS], lane] = COORDINATE_SINGULARITY
        return
    if is_linear(kernels, h, t, W, at, lane):
        put_all_back(W, after)
        size = W[at[INCREMENT_SQUARED], lane]
        W[at[LARGEST_SQUARED], lane] = max(W[at[LARGEST_SQUARED], lane], size)
        return
    if continuation(kernels, h, t, W, at, lane) != 0:
        W[at[STATUS], lane] = STEP_TOO_LARGE
        return
    continued = np.zeros((last - first, lanes))
    zero = np.zeros((last - first, lanes))
    keep(W, first, last, lane, continued)
    size = distance(W, at, lane, continued, zero)
    after[at[LARGEST_SQUARED], lane] = max(after[at[LARGEST_SQUARED], lane], size)
    after[at[ITERATIONS], lane] = W[at[ITERATIONS], lane]
    if not distance(W, at, lane, continued, increments) <= SAME_SOLUTION * size:
        activate_only(W, at[ACTIVE], lane)
        call(kernels[START], h, t, W)
        put_back(W, first, last, lane, continued)
        call(kernels[ADVANCE], h, t, W)
        keep(W, 0, rows, lane, after)
        small = W[at[IN_DOUBT], lane] >= SMALL_MASS
        lost = small and look_at_pivot(kernels, h, t + h, W, at, lane)
        if lost or not W[at[VELOCITY_JUMP_SQUARED], lane] < np.inf:
            step_back(W, at, lane)
            keep(W, 0, rows, lane, after)
            after[at[STATUS], lane] = SINGULAR_LEGENDRE if lost else NOT_FINITE
    put_all_back(W, after)


@njit(**RARE)
def mark_for_newton(kernels, h, t, W, at, event):
    """Mark lanes whose stages failed or are in doubt, so that Newton's method can try."""
    if event == FAILED:
        left = 0
        for lane in range(LANES):
            if W[at[ACTIVE], lane] < 0.0:
                W[at[STATUS], lane] = NOT_CONVERGED
            W[at[ACTIVE], lane] = 1.0 if W[at[STATUS], lane] == 0.0 else 0.0
            left += W[at[STATUS], lane] == 0.0
        if left == 0:
            return
        call(kernels[ADVANCE], h, t, W)
    for lane in range(LANES):
        if W[at[STATUS], lane] == 0.0 and W[at[IN_DOUBT], lane] != 0.0:
            lost = True
            if W[at[IN_DOUBT], lane] >= SMALL_MASS and W[at[MASS_PIVOT], lane] >= 0.0:
                lost = is_singular(kernels, h, t + h, W, at, lane, 0, 0)
                look_at_pivot(kernels, h, t + h, W, at, lane)
            if lost or W[at[IN_DOUBT], lane] != ACCEPTED:
                step_back(W, at, lane)
                W[at[STATUS], lane] = NOT_CONVERGED


@njit(**RARE)
def recover(kernels, h, t, W, at, event):
    """Finish a step at which ``take_steps`` stopped, for lanes that failed or are in doubt."""
    if event == TAKEN_BACK:
        set_failure_status(kernels, h, t, W, at, 0)
        return
    first, last = at[INCREMENT], at[STATE_END]
    lanes = LANES
    if kernels[MODE] == STAGES:
        mark_for_newton(kernels, h, t, W, at, event)
        return
    alive = np.empty(LANES)
    for lane in range(lanes):
        alive[lane] = W[at[STATUS], lane]
    if event == FAILED:
        for lane in range(lanes):
            failure = -W[at[ACTIVE], lane]
            if failure > 0.0:
                for row in range(first, last):  # the predicted increments, which follow
                    W[row, lane] = W[row + last - first, lane]
                lost = continuation(kernels, h, t, W, at, lane)
                if lost != 0:
                    W[at[STATUS], lane] = lost if lost == STEP_TOO_LARGE else failure
        for lane in range(lanes):
            W[at[ACTIVE], lane] = 1.0 if W[at[STATUS], lane] == 0.0 else 0.0
        call(kernels[ADVANCE], h, t, W)
    for lane in range(lanes):
        if W[at[STATUS], lane] == 0.0 and W[at[IN_DOUBT], lane] != 0.0:
            verify(kernels, h, t, W, at, lane)
        if alive[lane] == 0.0:
            set_failure_status(kernels, h, t, W, at, lane)


@njit(**RARE)
def take_one(kernels, h, t, W, at):
    """Take one step of a single trajectory like ``take_steps``; recover it if necessary."""
    watched = kernels[MODE] == NEWTON_AFTER_STAGES
    if watched:
        call(kernels[MEASURE], h, t, W)
        W[at[COUNT], 0] = W[at[LARGEST_SQUARED], 0]
    W[at[ACTIVE], 0] = 1.0
    event = FAILED
    if solve(kernels[ITERATE], h, t, W, at) == 0:
        W[at[ACTIVE], 0] = 1.0
        call(kernels[ADVANCE], h, t, W)
        event = SUSPICIOUS if W[at[IN_DOUBT], 0] != 0.0 else 0
    if event != 0:
        recover(kernels, h, t, W, at, event)
    if watched and W[at[STATUS], 0] == 0.0:
        watch(kernels, h, t, W, at)
        if W[at[STATUS], 0] != 0.0:
            recover(kernels, h, t, W, at, TAKEN_BACK)
