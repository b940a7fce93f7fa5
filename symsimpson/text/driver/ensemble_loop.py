"""The compiled loop over blocks of trajectories, the members of an ensemble as lanes.

This file is compiled together with the text of the driver and uses its names. Each thread has its
own blocks and its own workspace. The results of a lane do not depend on its neighbours.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.driver.explicit import finite, take_explicit_steps
from symsimpson.text.driver.recovery import recover
from symsimpson.text.driver.steps import *
from symsimpson.text.interface import *

#: The entries of the cursor.
BLOCK, STEP, BEGUN = 0, 1, 2
#: The number of steps without any change of the time after which a member is stopped.
STANDSTILL = 1024
#: Expressions below this part of their size at the end count as events, which run alone.
NEARLY_ZERO = 2.0**-30
#: Kinds of reductions: indicators of chaos, and the number of events that acted.
LYAPUNOV, MEGNO, SALI, ACTED = 4, 5, 6, 7

MEMBERS, STORED = types.float64[:, ::1], types.float64[:, :, ::1]
SIGNATURES |= {
    "advance_blocks": types.void(
        SET,
        types.int64[::1],
        SETTING,
        types.int64[::1],
        types.UniTuple(types.int64, 4),
        types.Tuple((MEMBERS, MEMBERS, MEMBERS, INPUTS, MEMBERS)),
        types.Tuple((STORED, STORED, STORED, types.int64[:, ::1], types.int64[::1])),
        types.Tuple((STORED, STORED, types.int64[:, ::1], STORED, types.float64[::1], MEMBERS)),
    )
}


@njit(**RARE)
def load_block(kernels, more, setting, block, starts):
    """Load the members of a block into lanes; the last member fills spare lanes."""
    (h, t0, W, at), (q0, other0, parameters) = setting, starts
    members = q0.shape[0]
    n = at[DIMENSION]
    second = at[MOMENTUM] if more[0] == 0 else at[VELOCITY]
    for lane in range(LANES):
        member = min(block * LANES + lane, members - 1)
        for row in range(4 * n):
            W[at[POSITION] + row, lane] = 0.0
        for pair in range(RECORDED, len(at), 2):  # sums, and what rounding takes from them
            for row in range(2 * at[pair + 1]):
                W[at[pair] + row, lane] = 0.0
        for a in range(n):
            W[at[POSITION] + a, lane] = q0[member, a]
            W[second + a, lane] = other0[member, a]
        for k in range(parameters.shape[1]):
            W[at[PARAMETER] + k, lane] = parameters[member, k]
    begin(kernels, more[0], h, t0, W, at)
    retime = more[2]
    if retime != 0:
        call(retime, h, t0, W)
        begin(kernels, 0, h, t0, W, at)
    last = at[PARAMETER] + parameters.shape[1] - 1
    for lane in range(LANES):
        member = min(block * LANES + lane, members - 1)
        fine = W[at[MASS_PIVOT], lane] >= 0.0 and finite(W, at[VELOCITY], at[VELOCITY] + n, lane)
        if retime != 0:
            fine = fine and W[last, lane] > 0.0  # the rate where it begins
            for k in range(parameters.shape[1]):
                parameters[member, k] = W[at[PARAMETER] + k, lane]
            W[at[TIME], lane], W[at[TIME] + 1, lane] = t0, 0.0
            W[at[TIME] + 2, lane], W[at[TIME] + 3, lane] = t0, 0.0
        if not fine:
            W[at[STATUS], lane] = BAD_INPUT


@njit(**DRIVER_OPTIONS)
def undo_arrived_steps(W, at, still):
    """Undo the last step of members that have arrived, or whose time stands still."""
    n, time = at[DIMENSION], at[TIME]
    for lane in range(LANES):
        if W[at[STATUS], lane] == 0.0:
            still[lane] = still[lane] + 1 if W[time, lane] == W[time + 2, lane] else 0
            if still[lane] == STANDSTILL:
                W[at[STATUS], lane] = RATE_NOT_POSITIVE
        status = W[at[STATUS], lane]
        if status in (ARRIVED, RATE_NOT_POSITIVE) and still[lane] >= 0:
            for row in range(4 * n):
                W[at[POSITION] + row, lane] = W[at[PREVIOUS] + row, lane]
            W[time, lane], W[time + 1, lane] = W[time + 2, lane], W[time + 3, lane]
            still[lane] = -1


@njit(**RARE)
def begin_variations(momentum_slopes, h, t, W, at, columns):
    """Begin variations of the state; at constant velocities parameters also change p."""
    size, count = columns.shape
    for lane in range(LANES):
        for j in range(count):
            for a in range(size):
                W[at[TANGENT] + j * size + a, lane] = columns[a, j]
    if momentum_slopes != 0:
        call(momentum_slopes, h, t, W)


@njit(**RARE)
def begin_event_search(kernels, h, t, W, at, first, rows):
    """Begin the search for events: call their recorders at the initial states."""
    for lane in range(LANES):
        for row in range(rows):  # sizes are none yet; of the others nothing is known
            W[first + row, lane] = 0.0 if row % WATCHED == SIZE_WATCHED else np.nan
        W[at[ACTIVE], lane] = 1.0 if W[at[STATUS], lane] == 0.0 else 0.0
    for k in range(RECORDERS, RECORDERS + at[OF_EVENTS]):
        call(kernels[k], h, t, W)


@njit(**RARE)
def mark_events_at_end(W, at, first, rows):
    """Mark members with an event that may act at their end: they run alone again."""
    for k in range(rows // WATCHED):
        row = first + WATCHED * k
        for lane in range(LANES):
            near = NEARLY_ZERO * W[row + SIZE_WATCHED, lane]
            if W[at[STATUS], lane] == 0.0 and abs(W[row + VALUE_WATCHED, lane]) <= near:
                W[at[STATUS], lane] = MET


@njit(**RARE)
def store_observed(W, at, h, row, kinds, seen, block):
    """Store the observed values and growth rates of a block in ``seen``.

    ``row`` is the first row of observed values. The last entry of a member is the smallest pivot of
    M if its steps may not have resolved this passage.
    """
    last = seen.shape[1]
    for lane in range(LANES):
        member = block * LANES + lane
        if member < seen.shape[0]:
            passed = W[at[PIVOT_TIME], lane] < np.inf
            seen[member, last - 1] = W[at[PIVOT_LIMIT], lane] if passed else SMALL_PIVOT
    for k in range(kinds.shape[0]):
        kind = np.int64(kinds[k])
        for lane in range(LANES):
            member = block * LANES + lane
            if member >= seen.shape[0]:
                continue
            if kind == ACTED:  # members with some are run by themselves
                seen[member, 2 * k] = 0.0
                continue
            if kind < LYAPUNOV:
                seen[member, 2 * k] = W[row + 2 * k, lane]
                continue
            if W[at[STATUS], lane] != 0.0:
                continue
            past = abs(h) * W[at[GROWN], lane] * at[RENEWAL]
            if kind == MEGNO:
                seen[member, 2 * k] = W[at[GROWN] + 1, lane]
            elif kind == SALI:
                seen[member, 2 * k] = W[at[GROWN] + 2, lane]
            else:
                seen[member, 2 * k] = W[at[GROWN] + 3, lane] / past


@njit(**RARE)
def finish_block(W, at, block, step, every, buffers, outs, lost):
    """Store the results of the lanes of a block."""
    (buffer_q, buffer_p, recorded, counted), (q_out, p_out, codes_out, recorded_out) = buffers, outs
    for lane in range(LANES):
        member = block * LANES + lane
        if member >= q_out.shape[0]:
            continue
        codes_out[member, 0] = np.int64(W[at[STATUS], lane])
        codes_out[member, 1] = step if lost[lane] < 0 else lost[lane]
        iterations = np.int64(W[at[ITERATIONS], lane])
        if every == 0:
            store_lane(W, at, 0, lane, buffers)
        last = codes_out[member, 1] // every if every != 0 else 0
        for place in range(last + 1):
            iterations += counted[place, lane] if place > 0 else 0
            for a in range(at[DIMENSION]):
                q_out[member, place, a] = buffer_q[place, a, lane]
                p_out[member, place, a] = buffer_p[place, a, lane]
            for k in range(recorded_out.shape[2]):
                recorded_out[member, place, k] = recorded[place, k, lane]
        codes_out[member, 2] = iterations


@njit(**DRIVER_OPTIONS)
def advance_blocks(kernels, more, setting, cursor, asked, starts, buffers, outs):
    """Advance blocks of members within a budget of steps; the next call continues there.

    ``more`` begins with the addresses of the kernels legendre, momentum_slopes and retime. An
    address is 0 if the run does not need the kernel. Then follow the first row and the number of
    rows of observed values, and the first row and the number of rows of watched expressions.

    Parameters
    ----------
    asked
        The last block, and a budget of steps for all blocks. Then the steps of a member, and the
        steps between its stored states.
    starts
        Positions, and momenta or velocities, of all members. Then parameters, inputs, and the
        initial columns of variations. ``begin_growth`` takes columns for each member.
    buffers
        Stored states of the current block, the rows of recorders, and iterations. Then two numbers
        for each lane. The first is the number of steps of a lane that has ended, else -1. The
        second counts steps in which its time stood still.
    outs
        Arrays for the results: states, then status, steps and iterations of each member, then the
        rows of recorders. The last two have the kinds of reductions, and two numbers for each.
    """
    (h, t0, W, at), (last, budget, steps, every) = setting, asked
    q0, other0, parameters, inputs, columns = starts
    buffer_q, buffer_p, recorded, counted, lost = buffers
    q_out, p_out, codes_out, recorded_out, kinds, seen = outs
    stores = buffer_q, buffer_p, recorded, counted
    progress = np.zeros(4, dtype=np.int64)
    timed = more[2] != 0
    while cursor[BLOCK] < last and budget > 0:
        block = cursor[BLOCK]
        given = inputs if inputs.shape[0] == 1 else inputs[block * LANES :]
        if cursor[BEGUN] == 0:
            load_block(kernels, more, setting, block, (q0, other0, parameters))
            if RENEWING:
                begin_growth(W, at, block * LANES, columns)
            elif columns.shape[1] > 0:
                begin_variations(more[1], h, t0, W, at, columns)
            if at[OF_EVENTS] > 0:
                begin_event_search(kernels, h, t0, W, at, more[5], more[6])
            for lane in range(LANES):
                lost[lane] = 0 if W[at[STATUS], lane] != 0.0 else -1
                lost[LANES + lane] = 0
                for row in range(more[4]):
                    W[more[3] + row, lane] = np.nan if row < more[4] - 1 else 0.0
                if every != 0:
                    store_lane(W, at, 0, lane, stores)
            record(kernels, len(kernels) - at[OF_STATES], h, t0, t0, W, at)
            cursor[BEGUN], cursor[STEP] = 1, 0
            budget -= 1
        progress[0], progress[1] = cursor[STEP], 0
        alive = True
        while progress[0] < steps and budget > 0 and alive:
            step = progress[0]
            until = min(steps, step + 1 if timed else step + budget)
            if kernels[MODE] == EXPLICIT:
                take_explicit_steps(kernels, setting, progress, until, every, stores, given)
            else:
                take_steps(kernels, setting, progress, until, every, stores, given)
                if progress[1] != 0:
                    recover(kernels, h, t0 + h * progress[0], W, at, progress[1])
                    # take_steps first counts the recovered step
                    until = progress[0] + 1
                    take_steps(kernels, setting, progress, until, every, stores, given)
            if timed:
                undo_arrived_steps(W, at, lost[LANES:])
            alive = False
            for lane in range(LANES):
                if W[at[STATUS], lane] == 0.0:
                    alive = True
                elif lost[lane] < 0:
                    lost[lane] = max(progress[0] - 1, 0)
            budget -= progress[0] - step
        cursor[STEP] = progress[0]
        if progress[0] >= steps or not alive:
            mark_events_at_end(W, at, more[5], more[6])
            store_observed(W, at, h, more[3], kinds, seen, block)
            outcome = q_out, p_out, codes_out, recorded_out
            finish_block(W, at, block, progress[0], every, stores, outcome, lost)
            cursor[BLOCK], cursor[BEGUN] = block + 1, 0
