"""The compiled loop over steps that are solved by iteration, from its beginning.

One piece of code drives every generated module. It calls kernels by address, with the step, the
time and the workspace. The workspace has the whole state of a run. A run can therefore stop after
any step, and continue with bitwise identical results. All files of this folder are compiled as one
text, after the constants of ``symsimpson.text.interface``, and import nothing else.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.interface import *

#: Lanes of a block; known here, their loops cost nothing for a single trajectory (a third of the
#: time of a small step). This text is compiled with other numbers too.
LANES = 1
MOST_ITERATIONS = 40
#: No status: the step is not solved yet.
UNSOLVED = -1
#: The number of iterations after which corrections may be rounding errors.
FEW_ITERATIONS = 16
#: Rounding errors are below this part of positions, of moves in a step and of what forces add to
#: them, squared: 2^-52 with room.
ROUND_OFF = 2.0**-92
#: The growth per step of the squared ratio of a correction to the square of the one before. It
#: grows up to 1 until it is measured again.
FADING = 1.05**2
#: Functions that only compiled code calls have no wrapper for Python, which compiles slowly.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
DRIVER_OPTIONS = {"nogil": True, "error_model": "numpy", **INNER}
#: For functions that are called once a run, or if a step fails: they may be slow, and compile fast.
#: They are not inlined: the loop would count references of their arrays in every step.
RARE = {**DRIVER_OPTIONS}
#: For functions that are called in each step: a call would count references of its arrays.
INLINE = {"inline": "always", **DRIVER_OPTIONS}


def call(address, h, t, workspace):
    """Call a kernel ``void(double, double, double*)`` at an address; the walker does."""
    raise NotImplementedError


@njit(**RARE)
def mark_unconverged(active):
    """Mark the lanes that have not converged."""
    for lane in range(LANES):
        if active[lane] > 0.0:
            active[lane] = -NOT_CONVERGED
    return NOT_CONVERGED


@njit(**RARE)
def rounding_bound(W, at, h, lane):
    """Bound the squared size of corrections that rounding causes, in the metric of M(q0).

    Positions, momenta and the terms of forces are rounded. If these cancel, as at an equilibrium,
    increments may be as small as their rounding errors.
    """
    size = W[at[LARGEST_SQUARED], lane] + h * h * h * h * W[W.shape[0] - 1, lane]
    for a in range(at[DIMENSION]):
        mass, q = W[at[MASS_DIAGONAL] + a, lane], W[at[POSITION] + a, lane]
        if mass > 0.0:
            moved = h * W[at[MOMENTUM] + a, lane]
            size += mass * q * q + moved * moved / mass
    return ROUND_OFF * size


@njit(**RARE)
def solve_to_rounding(iterate, h, t, W, at):
    """Continue the iteration; a lane is also done if its corrections are rounding errors.

    These corrections are small and do not shrink. The row IN_DOUBT stores the corrections: it is
    free until the step is closed.
    """
    active, before = W[at[ACTIVE]], W[at[IN_DOUBT]]
    for lane in range(LANES):
        before[lane] = np.inf
    for _ in range(FEW_ITERATIONS, MOST_ITERATIONS):
        busy = 0
        for lane in range(LANES):
            if active[lane] > 0.0:
                correction = W[at[RELATIVE], lane] * W[at[INCREMENT_SQUARED], lane]
                if correction >= before[lane] and correction <= rounding_bound(W, at, h, lane):
                    active[lane] = 0.0
                before[lane] = correction
            busy += active[lane] > 0.0
        if busy == 0:
            return worst_status(active)
        call(iterate, h, t, W)
    return mark_unconverged(active)


@njit(**RARE)
def worst_status(active):
    """Return 0 if all lanes are solved, else the status of one that is not."""
    worst = 0
    for lane in range(LANES):
        if active[lane] < 0.0:
            worst = NOT_FINITE
    return worst


@njit(**INLINE)
def solve_for(iterate, h, t, W, active, relative, contraction):
    """Iterate until every active lane is done; return 0, UNSOLVED, or the status of a failure.

    The kernel checks convergence: it sets ``active`` to 0 in a lane that is done, and to -status in
    a lane that failed. It predicts the last correction from the one before and may skip it.
    """
    for lane in range(LANES):
        relative[lane] = np.inf
        contraction[lane] = min(1.0, contraction[lane] * FADING)
    # of a length that the compiler does not know: unrolled, the loop would count references
    for _ in range(FEW_ITERATIONS + (h == 0.0)):
        call(iterate, h, t, W)
        busy = 0
        for lane in range(LANES):
            busy += active[lane] > 0.0
        if busy == 0:
            worst = 0
            for lane in range(LANES):
                if active[lane] < 0.0:
                    worst = NOT_FINITE
            return worst
    return UNSOLVED


@njit(**DRIVER_OPTIONS)
def solve(iterate, h, t, W, at):
    """Iterate until every active lane is done, on the rows of a workspace."""
    status = solve_for(iterate, h, t, W, W[at[ACTIVE]], W[at[RELATIVE]], W[at[CONTRACTION]])
    return solve_to_rounding(iterate, h, t, W, at) if status == UNSOLVED else status


#: A step by Newton's method after stages may change the energy by about half the largest kinetic
#: energy before: this part of the largest squared increments, divided by h^2 and the degree.
ENERGY_CHANGE = 0.75
#: Its squared increments may be this multiple of the largest ones before.
GROWTH = 25.0
#: The relative rounding error of an energy, with room.
ENERGY_ROUNDING = 2.0**-40
# why steps stop before the end
FAILED, SUSPICIOUS, TAKEN_BACK = 1, 2, 3

#: Whether variations are made orthonormal on the way; a driver that does takes longer to compile.
RENEWING = False
SET, DRIVER_LAYOUT_ROWS, WORKSPACE = types.int64[::1], types.int64[::1], types.float64[:, ::1]
STATES, COUNTS = types.float64[:, :, ::1], types.int64[:, ::1]
#: Inputs by member, step, node and number; the last entry of a direction also serves later ones.
INPUTS = types.Array(types.float64, 4, "A", readonly=True)
#: A run as an argument: the step, the initial time, the workspace, and the layout for the driver.
#: STORES are the arrays for stored q and p, rows of recorders, and iterations.
SETTING = types.Tuple((types.float64, types.float64, WORKSPACE, DRIVER_LAYOUT_ROWS))
STORES = types.Tuple((STATES, STATES, STATES, COUNTS))
#: Functions for Python, compiled when they are first needed.
SIGNATURES = {
    "apply": types.void(types.int64, types.float64, types.float64, WORKSPACE),
    "take_steps": types.void(
        SET, SETTING, types.int64[::1], types.int64, types.int64, STORES, INPUTS
    ),
}


@njit(**DRIVER_OPTIONS)
def apply(kernel, h, t, W):
    """Call a kernel once."""
    call(kernel, h, t, W)


@njit(**INLINE)
def keep(W, first, last, lane, copy):
    """Copy rows of a lane."""
    for row in range(first, last):
        copy[row - first, lane] = W[row, lane]


@njit(**INLINE)
def give(W, at, inputs, step):
    """Copy the inputs of a step to the workspace: for each input its values at all nodes."""
    members, steps, nodes, count = inputs.shape
    for k in range(count):
        for i in range(at[INPUT_STRIDE]):
            row = at[INPUT] + k * at[INPUT_STRIDE] + i
            for lane in range(LANES):
                W[row, lane] = inputs[
                    min(lane, members - 1), min(step, steps - 1), min(i, nodes - 1), k
                ]


@njit(**RARE)
def put_back(W, first, last, lane, copy):
    """Restore rows of a lane."""
    for row in range(first, last):
        W[row, lane] = copy[row - first, lane]


@njit(**RARE)
def step_back(W, at, lane):
    """Restore the state and the predicted increments from before the last call of advance."""
    first, last, previous = at[POSITION], at[STATE_END], at[PREVIOUS]
    for row in range(last - first):
        W[first + row, lane] = W[previous + row, lane]


@njit(**INLINE)
def store_lane(W, at, place, lane, stores):
    """Store the state of a lane, its rows of recorders, and iterations since the last store."""
    q_out, p_out, recorded_out, iterations_out = stores
    for a in range(at[DIMENSION]):
        q_out[place, a, lane] = W[at[POSITION] + a, lane]
        p_out[place, a, lane] = W[at[MOMENTUM] + a, lane]
    column = 0
    for pair in range(RECORDED, len(at), 2):
        for row in range(at[pair + 1]):
            recorded_out[place, column + row, lane] = W[at[pair] + row, lane]
        column += at[pair + 1]
    iterations_out[place, lane] = np.int64(W[at[ITERATIONS], lane])
    W[at[ITERATIONS], lane] = 0.0


@njit(**INLINE)
def store(W, at, place, stores):
    """Store the states of lanes that have not stopped."""
    for lane in range(LANES):
        if W[at[STATUS], lane] == 0.0:
            store_lane(W, at, place, lane, stores)


@njit(**INLINE)
def record(kernels, first, h, t, reached, W, at):
    """Call the recorders from number ``first`` on.

    Recorders of events and of states get the time of the state. The others get the time of the
    step. Recorders of events come first. After an event the other recorders are inactive.
    """
    last, looked = len(kernels), RECORDERS + at[OF_EVENTS]
    for k in range(first, last):
        for lane in range(LANES):
            W[at[ACTIVE], lane] = 1.0 if W[at[STATUS], lane] == 0.0 else 0.0
        call(kernels[k], h, reached if k < looked or k >= last - at[OF_STATES] else t, W)


@njit(**RARE)
def orthonormalise(W, first, size, count, factor, lane):
    """Make columns orthonormal, V = Q R, by Gram and Schmidt.

    ``factor`` is the first row of R. The weights of the scalar product follow R.
    """
    weight = factor + count * count
    for j in range(count):
        v = first + j * size
        for i in range(j):
            u, part = first + i * size, 0.0
            for a in range(size):
                part += W[weight + a, lane] * W[u + a, lane] * W[v + a, lane]
            for a in range(size):
                W[v + a, lane] -= part * W[u + a, lane]
            W[factor + i * count + j, lane] = part
        norm = 0.0
        for a in range(size):
            norm += W[weight + a, lane] * W[v + a, lane] ** 2
        norm = np.sqrt(norm)
        for a in range(size):
            W[v + a, lane] /= norm
        W[factor + j * count + j, lane] = norm


@njit(**RARE)
def renew(W, at):
    """Make variations orthonormal, and update the indicators of chaos.

    The rows from GROWN on are: the number of calls, the mean MEGNO, SALI, the sums of ln R_jj, and
    GALI of two, three, ... variations. Then follow the sums of k ln R_11 and of MEGNO, the product
    of all R with normalised columns, R, and the weights of dq and dp.
    """
    size, count, first = 2 * at[DIMENSION], at[RENEWED], at[GROWN]
    sums, aligned = first + 3, first + 3 + count
    megno, product = first + 2 * count + 2, first + 2 * count + 4
    factor = product + count * count
    for lane in range(LANES):
        orthonormalise(W, at[TANGENT], size, count, factor, lane)
        for j in range(count):
            W[sums + j, lane] += np.log(W[factor + j * (count + 1), lane])
        W[first, lane] += 1.0
        number = W[first, lane]
        W[megno, lane] += number * np.log(W[factor, lane])
        W[megno + 1, lane] += 2.0 * W[megno, lane] / number
        W[first + 1, lane] = W[megno + 1, lane] / number
        volume = 1.0
        for j in range(count):
            norm = 0.0
            for i in range(j + 1):
                value = 0.0
                for k in range(i, j + 1):
                    value += W[factor + i * count + k, lane] * W[product + k * count + j, lane]
                W[product + i * count + j, lane] = value
                norm += value**2
            norm = np.sqrt(norm)
            for i in range(j + 1):
                W[product + i * count + j, lane] /= norm
            volume *= W[product + j * (count + 1), lane]
            if j > 0:
                W[aligned + j - 1, lane] = volume
        if count > 1:  # the shorter diagonal of two sides of length 1
            along, across = abs(W[product + 1, lane]), W[product + count + 1, lane]
            W[first + 2, lane] = across / np.sqrt((1.0 + along) / 2.0)


@njit(**DRIVER_OPTIONS)
def watch(kernels, h, t, W, at):
    """Undo a step whose energy change or increments are too large: it has another solution."""
    before = W[at[ENERGY], 0]
    call(kernels[MEASURE], h, t, W)
    degree = (at[STATE_END] - at[INCREMENT]) // at[DIMENSION]
    increment = max(W[at[INCREMENT_SQUARED], 0], W[at[LARGEST_SQUARED], 0])
    largest = W[at[COUNT], 0] if W[at[COUNT], 0] > 0.0 else increment
    change = abs(W[at[ENERGY], 0] - before) * h * h
    # an energy at rest changes by rounding
    lost = ENERGY_ROUNDING * (abs(before) + W[at[ENERGY] + 1, 0]) * h * h
    small = change * degree <= ENERGY_CHANGE * largest + lost and increment <= GROWTH * largest
    if W[at[STATUS], 0] == 0.0 and not small:
        step_back(W, at, 0)
        W[at[LARGEST_SQUARED], 0] = W[at[COUNT], 0]
        W[at[STATUS], 0] = STEP_TOO_LARGE if change < np.inf else NOT_FINITE


@njit(**DRIVER_OPTIONS)
def take_steps(kernels, setting, progress, stop, every, stores, inputs):
    """Take steps until ``stop``, an event, or the end of all lanes.

    ``progress`` is (step, event, before, given): ``before`` counts the steps before step 0, and
    ``given`` is the index of its ``inputs``. Recorders are called after each step. States are
    stored after each ``every`` steps, and never for ``every = 0``. Lanes with a status other than 0
    do not change. An event stops a step before its end: ``recover`` finishes the step, and the next
    call of ``take_steps`` continues.
    """
    h, t0, W, at = setting
    # as rows of their own their lanes are vectors
    active, status, in_doubt = W[at[ACTIVE]], W[at[STATUS]], W[at[IN_DOUBT]]
    relative, contraction = W[at[RELATIVE]], W[at[CONTRACTION]]
    step, recovered, before, given = progress[0], progress[1] != 0, progress[2], progress[3]
    progress[1] = 0
    watched = kernels[MODE] == NEWTON_AFTER_STAGES
    followed = len(kernels) > RECORDERS
    if watched and not recovered:
        call(kernels[MEASURE], h, t0 + h * (before + step), W)
    while step < stop:
        if not recovered:
            t = t0 + h * (before + step)
            if watched:
                W[at[COUNT], 0] = W[at[LARGEST_SQUARED], 0]
            alive = 0
            for lane in range(LANES):
                active[lane] = 1.0 if status[lane] == 0.0 else 0.0
                alive += status[lane] == 0.0
            if alive == 0:
                break
            give(W, at, inputs, given + step)
            outcome = solve_for(kernels[ITERATE], h, t, W, active, relative, contraction)
            if outcome == UNSOLVED:
                outcome = solve_to_rounding(kernels[ITERATE], h, t, W, at)
            if outcome != 0:
                progress[1] = FAILED
                break
            doubts = 0
            for lane in range(LANES):
                active[lane] = 1.0 if status[lane] == 0.0 else 0.0
            call(kernels[ADVANCE], h, t, W)
            for lane in range(LANES):
                doubts += (status[lane] == 0.0) & (in_doubt[lane] != 0.0)
            if doubts > 0:
                progress[1] = SUSPICIOUS
                break
        if watched:
            watch(kernels, h, t0 + h * (before + step), W, at)
            if status[0] != 0.0:
                progress[1] = TAKEN_BACK
                break
        recovered = False
        step += 1
        if followed:
            passed, reached = t0 + h * (before + step - 1), t0 + h * (before + step)
            record(kernels, RECORDERS, h, passed, reached, W, at)
        if RENEWING and followed and (before + step) % at[RENEWAL] == 0:
            renew(W, at)
        if every != 0 and step % every == 0:
            store(W, at, step // every, stores)
    progress[0] = step


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
    """Begin a run in a used workspace, with parameters, q and p (or v)."""
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
    """Continue with other kernels of the same layout, from the state and predicted increments.

    With ``anew`` the kernels predict the increments themselves. The references of the pivots of M
    do not change.
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
    """Begin variations of members from number ``first`` on, and their indicators of chaos.

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
