"""Compiled loops that repeat steps from stored states.

They compute states between the steps of a run, or the sums of a recorder over steps.

This file is compiled together with the text of the driver and uses its names.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.driver.explicit import finite, take_explicit_steps
from symsimpson.text.driver.steps import *
from symsimpson.text.interface import *

#: Newton's method for a time within a step takes four to six iterations, and halving, where it
#: leads out of the step, as many as there are digits.
MOST_PARTS = 200
#: Stored states may be on disk, or belong to somebody else: they are only read.
TIMES, GIVEN = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 2))
#: The setting of a run whose states have these times, and their q and p.
BETWEEN = types.Tuple((types.float64, TIMES, WORKSPACE, DRIVER_LAYOUT_ROWS))
STATES_GIVEN = types.UniTuple(GIVEN, 2)
INTEGERS, REALS, TRUTHS = types.int64[::1], types.float64[::1], types.boolean[::1]
SIGNATURES |= {
    "states_at": types.void(
        SET,
        types.int64,
        BETWEEN,
        STATES_GIVEN,
        types.Tuple((INTEGERS, REALS, types.float64)),
        types.Tuple((WORKSPACE, WORKSPACE, REALS, TRUTHS)),
        types.int64,
        types.Tuple((INPUTS, GIVEN)),
    ),
    "between": types.void(
        SET,
        BETWEEN,
        STATES_GIVEN,
        types.Tuple((INTEGERS, INTEGERS, REALS)),
        types.Tuple((WORKSPACE, WORKSPACE, TRUTHS)),
        types.int64,
        INPUTS,
        INPUTS,
    ),
    "replay": types.int64(
        SET, BETWEEN, STATES_GIVEN, types.int64, types.boolean, WORKSPACE, INPUTS
    ),
}
#: Another solution of a step ends elsewhere by more than so much of the way, beside rounding.
SAME_WAY, ROUNDED = 1e-3, 1e-9


@njit(**DRIVER_OPTIONS)
def begin_at_state(kernels, setting, q, p):
    """Begin at a stored state."""
    h, t, W, at = setting
    n = at[DIMENSION]
    for k in range(at[POSITION], at[POSITION] + 4 * n):
        W[k, 0] = 0.0
    for a in range(n):
        W[at[POSITION] + a, 0] = q[a]
        W[at[MOMENTUM] + a, 0] = p[a]
    begin(kernels, 0, h, t, W, at)
    if at[TIME] < at[ROWS]:
        W[at[TIME], 0], W[at[TIME] + 1, 0] = t, 0.0


@njit(**DRIVER_OPTIONS)
def take(kernels, setting, count, state, driving, room, doubtful):
    """Take steps from a state, and replace it by the state after them; return True on success.

    ``driving`` has the inputs and the number of the first step among them. ``room`` has arrays for
    the progress and for states that are not stored. Steps in doubt fail unless ``doubtful`` is set.
    They are rare, and code to recover them would be slow to compile.
    """
    (_, _, W, at), (q, p), (inputs, first) = setting, state, driving
    begin_at_state(kernels, setting, q, p)
    progress, nothing, counted = room
    stores = nothing, nothing, nothing, counted
    progress[0], progress[1], progress[3] = 0, 0, first
    if kernels[MODE] == EXPLICIT:
        take_explicit_steps(kernels, setting, progress, count, 0, stores, inputs)
    else:
        take_steps(kernels, setting, progress, count, 0, stores, inputs)
        while doubtful and progress[1] == SUSPICIOUS:
            take_steps(kernels, setting, progress, count, 0, stores, inputs)
    n = at[DIMENSION]
    for a in range(n):
        q[a] = W[at[POSITION] + a, 0]
        p[a] = W[at[MOMENTUM] + a, 0]
    well = progress[0] == count and progress[1] == 0 and W[at[STATUS], 0] == 0.0
    return well and finite(W, at[POSITION], at[POSITION] + 4 * n, 0)


@njit(**DRIVER_OPTIONS)
def between(kernels, setting, states, sought, results, every, inputs, rests):
    """Compute states between stored ones: ``whole[i]`` steps and a part of a step after a start.

    ``setting`` has the times of stored states, and ``states`` their q and p. ``sought`` is (start,
    whole, rest): the index of the stored state, the number of whole steps, and the size of the
    part. No step is taken twice if start and whole increase. ``every`` whole steps lie between
    stored states. Whole steps use ``inputs``, and the i-th part uses row i of ``rests``.

    ``results`` takes q, p and whether all steps succeeded. The arrays of q and p have one more row,
    for the state after the whole steps.
    """
    (h, t, W, at), (q, p) = setting, states
    (start, whole, rest), (q_out, p_out, fine) = sought, results
    n, last = at[DIMENSION], len(start)
    room = np.zeros(4, dtype=np.int64), np.empty((1, 1, 1)), np.empty((1, 1), dtype=np.int64)
    stored, done, well = -1, 0, True
    for i in range(last):
        if start[i] != stored or whole[i] < done:
            stored, done, well = start[i], 0, True
            for a in range(n):
                q_out[last, a], p_out[last, a] = q[stored, a], p[stored, a]
        now = t[stored] + h * done
        if whole[i] > done and well:
            first, count = stored * every + done, whole[i] - done
            here, state = (h, now, W, at), (q_out[last], p_out[last])
            well = take(kernels, here, count, state, (inputs, first), room, False)
            done = whole[i]
            now = t[stored] + h * done
        for a in range(n):
            q_out[i, a], p_out[i, a] = q_out[last, a], p_out[last, a]
        fine[i] = well
        if well and rest[i] != 0.0:
            part = rest[i], now, W, at
            fine[i] = take(kernels, part, 1, (q_out[i], p_out[i]), (rests, i), room, False)


@njit(**RARE)
def take_part_of_step(kernels, energy, setting, ahead, asked, state, driving, near):
    """Move a state to the time ``asked``, which lies within a step that ends at time ``ahead``.

    Return the part of tau to that time, and whether all steps succeeded. Newton's method finds the
    part within a bracket, to the relative tolerance ``near``. The kernel of the energy gives the
    rate dt/dtau.
    """
    (h, now, W, at), (q, p), (inputs, room) = setting, state, driving
    n, time = at[DIMENSION], at[TIME]
    start_q, start_p = q.copy(), p.copy()
    part, low, high, left = 0.0, 0.0, h, asked - now
    change = h * left / (ahead - now) if ahead != now else h
    tries, there, well = 0, False, True
    while well and tries < MOST_PARTS and not there:
        if not (part + change - low) * (high - part - change) > 0.0:
            change = (low + high) / 2 - part
        part += change
        for a in range(n):
            q[a], p[a] = start_q[a], start_p[a]
        well = take(kernels, (part, now, W, at), 1, (q, p), (inputs, 0), room, False)
        later = W[time, 0]
        call(energy, part, later, W)
        before, left = left, asked - later
        if left * h > 0.0:
            low = part
        else:
            high = part
        change = left / W[time + RATE_BEHIND, 0]
        if abs(left) > abs(before) / 2:  # the rate is not that of the steps
            change = (low + high) / 2 - part
        there = abs(change) <= abs(h) * near or abs(left) <= abs(asked) * near
        tries += 1
    return part, well and there


@njit(**DRIVER_OPTIONS)
def states_at(kernels, energy, setting, states, sought, results, every, given):
    """Compute the states of a retimed run at given times, each from the stored state before it.

    ``setting`` has the times of stored states, and ``states`` their q and p. ``every`` steps lie
    between stored states. ``sought`` has the indices of stored states, the times, and the relative
    tolerance for these. ``results`` takes q and p, with one more row for trials, the part of tau of
    each state in its step, and whether all steps succeeded. ``given`` has inputs, and parameters: a
    row for each state, or one for all.
    """
    (h, t, W, at), (q, p) = setting, states
    (start, asked, near), (q_out, p_out, part, fine) = sought, results
    inputs, parameters = given
    n, last, time = at[DIMENSION], len(start), at[TIME]
    room = np.zeros(4, dtype=np.int64), np.empty((1, 1, 1)), np.empty((1, 1), dtype=np.int64)
    for i in range(last):
        k, now, ahead, well, more = start[i], t[start[i]], t[start[i]], True, True
        for row in range(parameters.shape[1]):
            W[at[PARAMETER] + row, 0] = parameters[min(i, parameters.shape[0] - 1), row]
        for a in range(n):
            q_out[i, a], p_out[i, a] = q[k, a], p[k, a]
        part[i] = 0.0
        for _ in range(every):
            if more and well and now != asked[i]:
                for a in range(n):
                    q_out[last, a], p_out[last, a] = q_out[i, a], p_out[i, a]
                step = h, now, W, at
                well = take(kernels, step, 1, (q_out[last], p_out[last]), (inputs, 0), room, False)
                ahead = W[time, 0]
                more = well and (asked[i] - ahead) * h >= 0.0
                if more:
                    now = ahead
                    for a in range(n):
                        q_out[i, a], p_out[i, a] = q_out[last, a], p_out[last, a]
        if now != asked[i] and well:
            here, state = (h, now, W, at), (q_out[i], p_out[i])
            part[i], well = take_part_of_step(
                kernels, energy, here, ahead, asked[i], state, (inputs, room), near
            )
        fine[i] = well


@njit(**RARE)
def reached(W, at, before, after):
    """Return whether steps that began at a stored state ended at the next one."""
    gap, change, size = 0.0, 0.0, 0.0
    for a in range(at[DIMENSION]):
        gap = max(gap, abs(W[at[POSITION] + a, 0] - after[a]))
        change = max(change, abs(after[a] - before[a]))
        size = max(size, abs(after[a]))
    return gap <= SAME_WAY * change + ROUNDED * size


@njit(**DRIVER_OPTIONS)
def replay(kernels, setting, states, every, anew, out, inputs):
    """Repeat the steps between stored states, and store a recorder's sums at each state.

    ``every`` steps lie between stored states. ``out[i]`` takes the sums over the steps from state
    0, or from state i - 1 with ``anew``. In the workspace the rounding errors follow the sums.
    ``inputs`` has the inputs of all steps. Return the number of states that were reached, the first
    one included. The replay stops if it does not end at the next stored state.
    """
    (h, t, W, at), (q, p) = setting, states
    n, row, count = at[DIMENSION], at[RECORDED], out.shape[1]
    here_q, here_p = np.empty(n), np.empty(n)
    room = np.zeros(4, dtype=np.int64), np.empty((1, 1, 1)), np.empty((1, 1), dtype=np.int64)
    for i in range(1, q.shape[0]):
        for a in range(n):
            here_q[a], here_p[a] = q[i - 1, a], p[i - 1, a]
        if anew:
            for k in range(2 * count):
                W[row + k, 0] = 0.0
        here, driving = (h, t[i - 1], W, at), (inputs, (i - 1) * every)
        if not take(kernels, here, every, (here_q, here_p), driving, room, True):
            return i
        if not reached(W, at, q[i - 1], q[i]):
            return i
        for k in range(count):
            out[i, k] = W[row + k, 0]
    return q.shape[0]
