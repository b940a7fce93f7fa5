"""The compiled loop over blocks of trajectories, the members of an ensemble as lanes.

Compiled behind the text of the driver, whose names it uses. A thread works on blocks of its own
with a workspace of its own; what a lane computes does not depend on its neighbours.
"""

import numpy as np
from numba import njit, types

from symsimpson.module.interface import *
from symsimpson.runtime.driver.begin import begin, begin_growth
from symsimpson.runtime.driver.explicit import finite, take_explicit_steps
from symsimpson.runtime.driver.recovery import recover
from symsimpson.runtime.driver.solving import DRIVER_OPTIONS, LANES, RARE, call
from symsimpson.runtime.driver.steps import INPUTS, RENEWING, SET, SETTING, SIGNATURES, take_steps

#: Where in the cursor what stands.
BLOCK, STEP, BEGUN = 0, 1, 2
#: After so many steps in which it does not change at all, the time of a member stands still.
STANDSTILL = 1024
#: How observed values are reduced.
LEAST, LARGEST, MEAN, FIRST, LYAPUNOV, MEGNO, SALI = 0, 1, 2, 3, 4, 5, 6

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
    """Put the members of a block into the lanes; the last one fills a ragged end."""
    (h, t0, W, at), (q0, other0, parameters) = setting, starts
    members = q0.shape[0]
    n = at[DIMENSION]
    second = at[MOMENTUM] if more[0] == 0 else at[VELOCITY]
    for lane in range(LANES):
        member = min(block * LANES + lane, members - 1)
        for row in range(4 * n):
            W[at[POSITION] + row, lane] = 0.0
        for a in range(n):
            W[at[POSITION] + a, lane] = q0[member, a]
            W[second + a, lane] = other0[member, a]
        for k in range(parameters.shape[1]):
            W[at[PARAMETER] + k, lane] = parameters[member, k]
    begin(kernels, more[0], h, t0, W, at)
    retime = more[4]
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
            W[at[KEPT], lane], W[at[KEPT] + 1, lane] = t0, 0.0
            W[at[KEPT] + 2, lane], W[at[KEPT] + 3, lane] = t0, 0.0
        if not fine:
            W[at[STATUS], lane] = BAD_INPUT


@njit(**DRIVER_OPTIONS)
def look_at_time(W, at, still):
    """Undo the steps of members that have arrived with them, or whose time does not go on."""
    n, time = at[DIMENSION], at[KEPT]
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
    """Begin variations of the state; at given velocities, parameters change p, too."""
    size, count = columns.shape
    for lane in range(LANES):
        for j in range(count):
            for a in range(size):
                W[at[TANGENT] + j * size + a, lane] = columns[a, j]
    if momentum_slopes != 0:
        call(momentum_slopes, h, t, W)


@njit(**DRIVER_OPTIONS)
def observe(more, setting, reductions, block, members, step):
    """Reduce the observed values of the present state into those seen before."""
    (h, t, W, at), (kinds, seen) = setting, reductions
    if more[2] != 0:
        call(more[2], h, t, W)
    call(more[1], h, t, W)
    for k in range(kinds.shape[0]):
        kind = np.int64(kinds[k])
        if kind >= LYAPUNOV:
            continue
        for lane in range(LANES):
            member = block * LANES + lane
            if member >= members or W[at[STATUS], lane] != 0.0:
                continue
            value = W[at[ROWS] + k, lane]
            before = seen[member, 2 * k]
            if kind == MEAN:
                seen[member, 2 * k] = value if step == 0 else before + (value - before) / (step + 1)
            elif kind == FIRST:
                last = seen[member, 2 * k + 1]
                if np.isnan(before) and value > 0.0:
                    now, passed = t, h
                    if more[4] != 0:
                        now = W[at[KEPT], lane]
                        passed = now - W[at[KEPT] + 2, lane]
                    seen[member, 2 * k] = (
                        now if step == 0 else now - passed * value / (value - last)
                    )
                seen[member, 2 * k + 1] = value
            elif step == 0 or (value < before if kind == LEAST else value > before):
                seen[member, 2 * k] = value


@njit(**RARE)
def tell_of_variations(W, at, h, kinds, seen, block):
    """Keep what the variations of a block came to."""
    for k in range(kinds.shape[0]):
        kind = np.int64(kinds[k])
        for lane in range(LANES):
            member = block * LANES + lane
            if kind < LYAPUNOV or member >= seen.shape[0] or W[at[STATUS], lane] != 0.0:
                continue
            past = abs(h) * W[at[KEPT], lane] * at[RENEWAL]
            if kind == MEGNO:
                seen[member, 2 * k] = W[at[KEPT] + 1, lane]
            elif kind == SALI:
                seen[member, 2 * k] = W[at[KEPT] + 2, lane]
            else:
                seen[member, 2 * k] = W[at[KEPT] + 3, lane] / past


@njit(**RARE)
def finish_block(W, at, block, step, every, buffers, outs, lost):
    """Store what the lanes of a block have come to."""
    (buffer_q, buffer_p, kept, counted), (q_out, p_out, codes_out, kept_out) = buffers, outs
    n = at[DIMENSION]
    for lane in range(LANES):
        member = block * LANES + lane
        if member >= q_out.shape[0]:
            continue
        codes_out[member, 0] = np.int64(W[at[STATUS], lane])
        codes_out[member, 1] = step if lost[lane] < 0 else lost[lane]
        iterations = np.int64(W[at[ITERATIONS], lane])
        if every == 0:
            for a in range(n):
                q_out[member, 0, a] = W[at[POSITION] + a, lane]
                p_out[member, 0, a] = W[at[MOMENTUM] + a, lane]
            for k in range(kept_out.shape[2]):
                kept_out[member, 0, k] = W[at[KEPT] + k, lane]
        else:
            for place in range(codes_out[member, 1] // every + 1):
                iterations += counted[place, lane] if place > 0 else 0
                for a in range(n):
                    q_out[member, place, a] = buffer_q[place, a, lane]
                    p_out[member, place, a] = buffer_p[place, a, lane]
                for k in range(kept_out.shape[2]):
                    kept_out[member, place, k] = kept[place, k, lane]
        codes_out[member, 2] = iterations


@njit(**DRIVER_OPTIONS)
def advance_blocks(kernels, more, setting, cursor, asked, starts, buffers, outs):
    """Advance blocks, as far as it is asked for; the next call goes on from there.

    ``more`` holds addresses: legendre (0 if momenta are given), observe (0 if nothing is), energy
    (0 if not wanted), what parameters change of momenta (0 if nothing), and what sets the energy
    and the rate of a member that keeps a time of its own (0 if none does). Observed values stand
    behind the rows of the module.

    Parameters
    ----------
    asked
        The last block, and a budget of steps for all; steps of a member, and how many from one
        stored state to the next.
    starts
        Positions, and momenta or velocities, of all members; parameters; inputs; columns that
        variations begin as, where a kernel is called behind each step.
    buffers
        Stored states of the block under way, what is kept beside them, iterations; and two numbers
        for each lane: the steps of one that has ended, else -1, and those in which its time stood
        still.
    outs
        Take states; status, steps and iterations of each member; what is kept beside states; then
        the kinds of reductions, and two numbers for each.
    """
    (h, t0, W, at), (last, budget, steps, every) = setting, asked
    q0, other0, parameters, inputs, columns = starts
    buffer_q, buffer_p, kept, counted, lost = buffers
    q_out, p_out, codes_out, kept_out, kinds, seen = outs
    progress = np.zeros(3, dtype=np.int64)
    members, n = q0.shape[0], at[DIMENSION]
    timed = more[4] != 0
    followed = kernels[BEHIND] != 0 and not timed
    watched = more[1] != 0
    while cursor[BLOCK] < last and budget > 0:
        block = cursor[BLOCK]
        own = inputs if inputs.shape[0] == 1 else inputs[block * LANES :]
        if cursor[BEGUN] == 0:
            load_block(kernels, more, setting, block, (q0, other0, parameters))
            if RENEWING and followed:
                begin_growth(W, at, columns)
            elif followed:
                begin_variations(more[3], h, t0, W, at, columns)
            for lane in range(LANES):
                lost[lane] = 0 if W[at[STATUS], lane] != 0.0 else -1
                lost[LANES + lane] = 0
                if every != 0:
                    for a in range(n):
                        buffer_q[0, a, lane] = W[at[POSITION] + a, lane]
                        buffer_p[0, a, lane] = W[at[MOMENTUM] + a, lane]
                    for k in range(kept_out.shape[2]):
                        kept[0, k, lane] = W[at[KEPT] + k, lane]
            if watched:
                observe(more, setting, (kinds, seen), block, members, 0)
            cursor[BEGUN], cursor[STEP] = 1, 0
            budget -= 1
        progress[0], progress[1] = cursor[STEP], 0
        alive = True
        while progress[0] < steps and budget > 0 and alive:
            step = progress[0]
            until = min(steps, step + 1 if watched or timed else step + budget)
            stores = buffer_q, buffer_p, kept, counted
            if kernels[MODE] == EXPLICIT:
                take_explicit_steps(kernels, setting, progress, until, every, stores, own)
            else:
                take_steps(kernels, setting, progress, until, every, stores, own)
                if progress[1] != 0:
                    recover(kernels, h, t0 + h * progress[0], W, at, progress[1])
                    # the step is taken and not yet counted: take_steps does that first
                    until = progress[0] + 1
                    take_steps(kernels, setting, progress, until, every, stores, own)
            if timed:
                look_at_time(W, at, lost[LANES:])
            alive = False
            for lane in range(LANES):
                if W[at[STATUS], lane] == 0.0:
                    alive = True
                elif lost[lane] < 0:
                    lost[lane] = max(progress[0] - 1, 0)
            budget -= progress[0] - step
            if watched and alive:
                here = h, t0 + h * progress[0], W, at
                observe(more, here, (kinds, seen), block, members, progress[0])
        cursor[STEP] = progress[0]
        if progress[0] >= steps or not alive:
            tell_of_variations(W, at, h, kinds, seen, block)
            whole = buffer_q, buffer_p, kept, counted
            found = q_out, p_out, codes_out, kept_out
            finish_block(W, at, block, progress[0], every, whole, found, lost)
            cursor[BLOCK], cursor[BEGUN] = block + 1, 0
