"""The compiled loop over explicit steps, and loops that evaluate kernels at states.

This file is compiled together with the text of the driver and uses its names.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.driver.steps import *
from symsimpson.text.interface import *

SIGNATURES |= {
    "take_explicit_steps": SIGNATURES["take_steps"],
    "evaluate": types.void(
        types.UniTuple(types.int64, 3),
        types.float64,
        WORKSPACE,
        DRIVER_LAYOUT_ROWS,
        types.Tuple((types.float64[::1], types.float64[:, :], types.float64[:, :])),
        types.int64,
        WORKSPACE,
        types.Tuple((INPUTS, types.float64[:, :])),
    ),
}
#: Steps that a kernel takes in one call.
AT_ONCE = 1 << 62


@njit(**INLINE)
def finite(W, first, last, lane):
    """Return whether rows of a lane are finite."""
    total = 0.0
    for row in range(first, last):
        total += 0.0 * W[row, lane]  # 0 for finite numbers alone
    return total == 0.0


@njit(**DRIVER_OPTIONS)
def take_explicit_steps(kernels, setting, progress, stop, every, stores, inputs):
    """Take explicit steps; one kernel call takes all steps up to the next stored state.

    Arguments are as for ``take_steps``. A lane stops before a step that would not be finite.
    """
    h, t0, W, at = setting
    n, lanes = at[DIMENSION], LANES
    position, status = at[POSITION], at[STATUS]
    state_end = position + 4 * n
    kept = np.empty((4 * n, lanes))
    step, before, given = progress[0], progress[2], progress[3]
    single = 0
    followed = len(kernels) > RECORDERS
    while step < stop:
        count = stop - step if every == 0 else min(stop - step, every - step % every)
        count = 1 if single > 0 or followed else min(count, AT_ONCE, at[STEPS_A_CALL])
        alive = 0
        for lane in range(lanes):
            keep(W, position, state_end, lane, kept)
            W[at[ACTIVE], lane] = 1.0 if W[status, lane] == 0.0 else 0.0
            W[at[COUNT], lane] = count
            alive += W[status, lane] == 0.0
        if alive == 0:
            break
        give(W, at, inputs, given + step)
        call(kernels[ADVANCE], h, t0 + h * (before + step), W)
        lost = 0
        for lane in range(lanes):
            if W[status, lane] == 0.0 and not finite(W, position, state_end, lane):
                lost += 1
        if lost > 0:
            alive -= lost
            for lane in range(lanes):
                if count == 1 and finite(W, position, state_end, lane):
                    continue
                put_back(W, position, state_end, lane, kept)
                if count == 1 and W[status, lane] == 0.0:
                    W[status, lane] = NOT_FINITE
            if count > 1:  # take these steps again, one by one
                single = count
                call(kernels[START], h, t0 + h * (before + step), W)
                continue
            if alive == 0:
                break
        if followed:
            for lane in range(lanes):
                for row in range(4 * n):
                    W[at[PREVIOUS] + row, lane] = kept[row, lane]
            passed, reached = t0 + h * (before + step), t0 + h * (before + step + 1)
            record(kernels, RECORDERS, h, passed, reached, W, at)
        step += count
        single -= 1
        if RENEWING and followed and (before + step) % at[RENEWAL] == 0:
            renew(W, at)
        if every != 0 and step % every == 0:
            store(W, at, step // every, stores)
    progress[0] = step


@njit(**DRIVER_OPTIONS)
def evaluate(addresses, h, W, at, states, block, out, given):
    """Evaluate a kernel that maps (t, q, p) or (t, q, v) to the rows of a block, at many states.

    ``addresses`` has the addresses of prepare (or 0 if W is prepared), of a kernel to call first
    (or 0), and of the kernel.
    ``given`` has the inputs of each state, and a row of parameters for each member. All members
    have the same number of consecutive states.
    """
    (prepare, before, kernel), (t, q, p), (inputs, values) = addresses, states, given
    n, together = at[DIMENSION], q.shape[0] // max(values.shape[0], 1)
    for i in range(q.shape[0]):
        if i % together == 0:
            for k in range(values.shape[1]):
                W[at[PARAMETER] + k, 0] = values[i // together, k]
            if prepare != 0:
                call(prepare, h, 0.0, W)
        for a in range(n):
            W[at[POSITION] + a, 0] = q[i, a]
            W[at[MOMENTUM] + a, 0] = p[i, a]
            W[at[VELOCITY] + a, 0] = p[i, a]
        give(W, at, inputs, i)
        if before != 0:
            call(before, h, t[i], W)
        call(kernel, h, t[i], W)
        for k in range(out.shape[1]):
            out[i, k] = W[block + k, 0]


@njit(**DRIVER_OPTIONS)
def has_steady_energy(energy, setting, states, judged, rate):
    """Return whether the energy of sampled states stays near its first value.

    ``states`` are q and p. ``judged`` is (last, few, limit): samples are the states number
    i * last // few, for i from 0 to few. The largest change of the energy is compared with
    ``limit`` times the kinetic energy. It must not exceed this bound at more than half of the
    samples, and at one or more of the first eighth. If ``rate`` is not 0, it is the row of dt/dtau,
    which multiplies both energies. If dt/dtau has nearly vanished, the energy itself must be near
    its first value.
    """
    (h, _, W, at), (q, p), (last, few, limit) = setting, states, judged
    n, row = at[DIMENSION], at[ENERGY]
    kinetic = np.empty(few + 1)
    start, change, first_pace = 0.0, 0.0, 1.0
    for i in range(few + 1):
        place = i * last // few
        for a in range(n):
            W[at[POSITION] + a, 0] = q[place, a, 0]
            W[at[MOMENTUM] + a, 0] = p[place, a, 0]
        call(energy, h, 0.0, W)
        pace = W[rate, 0] if rate != 0 else 1.0
        if i == 0:
            start, first_pace = W[row, 0], pace
        if pace < STANDING * first_pace and abs(W[row, 0] - start) > limit * W[row + 1, 0]:
            return False
        here = pace * abs(W[row, 0] - start)
        if not here < np.inf:
            return False
        change = max(change, here)
        kinetic[i] = pace * W[row + 1, 0]
    enough, early = 0, False
    for i in range(few + 1):
        enough += change <= limit * kinetic[i]
        early = early or (8 * i < few and change <= limit * kinetic[i])
    return early and 2 * enough > few + 1
