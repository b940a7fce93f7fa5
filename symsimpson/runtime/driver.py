"""The compiled loop over steps: Newton, closing a step, catching what goes wrong.

One piece of code drives every generated module. It calls kernels by address, with the step, the
time and the workspace; everything that a run must remember stands in the workspace, so that a run
can stop after any step and go on with the same bits. This file is compiled by itself and imports
nothing of the package.
"""

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

#: Lanes of a block; known here, their loops cost nothing for a single trajectory (a third of the
#: time of a small step). This text is compiled with other numbers too.
LANES = 1
# addresses of kernels
PREPARE, START, NEWTON, ADVANCE = 0, 1, 2, 3
#: Kernels that iterate over stages are one more: what they cannot solve is left to Newton's method.
BY_STAGES = 5
# what the driver must know of the layout, in the order in which it comes
ACTIVE, MISMATCH, STATUS, CONTRACTION, SCALE, ITERATIONS = range(6)
POSITION, MOMENTUM, INCREMENT, STATE_END, METRIC, DIMENSION = range(6, 12)
PREVIOUS, SOLVED, COUNT, RELATIVE, IN_DOUBT = range(12, 17)
# why run stopped before the end
FAILED, SUSPICIOUS = 1, 2
# values of Status
NOT_CONVERGED, NOT_FINITE, STEP_TOO_LARGE, COORDINATE_SINGULARITY = 2, 3, 4, 6
#: Values of IN_DOUBT: the step says nothing about the motion, or perhaps.
UNRESOLVED, LOOKED_AT = 2.0, 3.0
#: A step is looked at by taking so many more, and the same way in so many finer ones each; their
#: ends may be so far apart, squared, in units of the largest increments.
MORE, FINER, APART = 3, 16, 0.25

MOST_ITERATIONS = 40
#: By what the ratio of a correction to the square of the one before is raised in each step (it is
#: kept squared), until it is 1 or seen again: trust fades, so that it is measured anew.
FADING = 1.05**2
#: Two solutions of a step are one if their relative distance is below this, squared.
SAME_SOLUTION = 1e-12
#: From a suspicious step the solution is followed from small steps in so many pieces.
PIECES = 16


OPTIONS = {"nogil": True, "error_model": "numpy"}
#: For what is called in each step: a call costs reference counts of its arrays.
INLINE = {"inline": "always", **OPTIONS}
KERNELS, PLACES, WORKSPACE = types.int64[::1], types.int64[::1], types.float64[:, ::1]
STATES, COUNTS = types.float64[:, :, ::1], types.int64[:, ::1]
#: What is called from Python, each compiled by itself when it is first needed.
SIGNATURES = {
    "begin": types.void(KERNELS, types.int64, types.float64, types.float64, WORKSPACE, PLACES),
    "switch": types.void(KERNELS, types.float64, types.float64, WORKSPACE, PLACES),
    "run": types.void(
        KERNELS, types.float64, types.float64, WORKSPACE, PLACES, types.int64[::1],
        types.int64, types.int64, STATES, STATES, COUNTS,
    ),
    "mend": types.void(
        KERNELS, types.float64, types.float64, WORKSPACE, PLACES, types.int64,
    ),
}  # fmt: skip


@intrinsic
def call(typing_context, address, h, t, workspace):
    """Call a kernel ``void(double, double, double*)`` at an address."""
    signature = types.void(types.int64, types.float64, types.float64, workspace)

    def code(context, builder, signature, arguments):
        double = ir.DoubleType()
        function = ir.FunctionType(ir.VoidType(), [double, double, double.as_pointer()])
        pointer = builder.inttoptr(arguments[0], function.as_pointer())
        array = context.make_array(signature.args[3])(context, builder, arguments[3])
        builder.call(pointer, [arguments[1], arguments[2], array.data])
        return context.get_dummy_value()

    return signature, code


@njit(**OPTIONS)
def give_up(W, at):
    """Mark the lanes that have not converged."""
    for lane in range(LANES):
        if W[at[ACTIVE], lane] > 0.0:
            W[at[ACTIVE], lane] = -NOT_CONVERGED
    return NOT_CONVERGED


@njit(**INLINE)
def solve(newton, h, t, W, at):
    """Iterate until every active lane is done; give 0, or the status of a lane that failed.

    The kernel judges: lanes that are done have ACTIVE = 0, failed ones ACTIVE = -status.
    """
    lanes = LANES
    active, relative, contraction = at[ACTIVE], at[RELATIVE], at[CONTRACTION]
    for lane in range(lanes):
        W[relative, lane] = np.inf
        W[contraction, lane] = min(1.0, W[contraction, lane] * FADING)
    for _ in range(MOST_ITERATIONS):
        call(newton, h, t, W)
        busy = 0
        for lane in range(lanes):
            busy += W[active, lane] > 0.0
        if busy == 0:
            worst = 0
            for lane in range(lanes):
                if W[active, lane] < 0.0:
                    worst = NOT_FINITE
            return worst
    return give_up(W, at)


@njit(**INLINE)
def keep(W, first, last, lane, copy):
    """Copy rows of a lane."""
    for row in range(first, last):
        copy[row - first, lane] = W[row, lane]


@njit(**OPTIONS)
def put_back(W, first, last, lane, copy):
    """Restore rows of a lane."""
    for row in range(first, last):
        W[row, lane] = copy[row - first, lane]


@njit(**OPTIONS)
def keep_all(W, copy):
    """Copy all rows of all lanes."""
    for lane in range(LANES):
        keep(W, 0, W.shape[0], lane, copy)


@njit(**OPTIONS)
def put_all_back(W, copy):
    """Restore all rows of all lanes."""
    for lane in range(LANES):
        put_back(W, 0, W.shape[0], lane, copy)


@njit(**OPTIONS)
def step_back(W, at, lane):
    """Restore the state and the predicted increments from before the last call of advance."""
    first, last, previous = at[POSITION], at[STATE_END], at[PREVIOUS]
    for row in range(last - first):
        W[first + row, lane] = W[previous + row, lane]


@njit(**OPTIONS)
def activate_only(W, active, lane):
    """Let kernels work on one lane."""
    for other in range(LANES):
        W[active, other] = 1.0 if other == lane else 0.0


@njit(**OPTIONS)
def distance(W, at, lane, a, b):
    """Squared distance of two sets of increments in the metric of M(q0)'s diagonal."""
    total = 0.0
    for row in range(a.shape[0]):
        gap = a[row, lane] - b[row, lane]
        total += W[at[METRIC] + row % at[DIMENSION], lane] * gap * gap
    return total


@njit(**OPTIONS)
def follow(kernels, h, t, W, at, lane):
    """Solve one lane's step by following the solution from small steps to h; give a status.

    The state of the lane must be that at the start of the step. Only its increments change.
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
    found = np.zeros((unknowns, lanes))
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
        status = solve(kernels[NEWTON], part, t, W, at)
        if status != 0:
            break
        keep(W, first, last, lane, found)
        largest = max(largest, distance(W, at, lane, found, zero))
        if piece > 2 and distance(W, at, lane, found, guess) > 0.25 * largest:
            status = STEP_TOO_LARGE  # it jumped to another solution
            break
        for row in range(unknowns):
            bent = (found[row, lane] - straight[row, lane]) / (part * part)
            bend_before[row, lane] = bent if piece == 1 else bend[row, lane]
            bend[row, lane] = bent
    whole[at[ITERATIONS], lane] = W[at[ITERATIONS], lane]
    put_all_back(W, whole)
    if status == 0:
        put_back(W, first, last, lane, found)
    return status


@njit(**OPTIONS)
def go_on(kernels, h, t, W, at, lane, steps):
    """Take steps with one lane; tells whether all of them could be taken."""
    for step in range(steps):
        activate_only(W, at[ACTIVE], lane)
        if solve(kernels[NEWTON], h, t + h * step, W, at) != 0:
            return False
        activate_only(W, at[ACTIVE], lane)
        call(kernels[ADVANCE], h, t + h * step, W)
        if not W[at[MISMATCH], lane] < np.inf:
            return False
    return True


@njit(**OPTIONS)
def resolved(kernels, h, t, W, at, lane):
    """Tell whether a step, and what follows from it, is about what finer steps come to."""
    first, n, rows, lanes = at[POSITION], at[DIMENSION], W.shape[0], LANES
    after, coarse = np.empty((rows, lanes)), np.empty((n, lanes))
    keep_all(W, after)
    good = go_on(kernels, h, t + h, W, at, lane, MORE)
    keep(W, first, first + n, lane, coarse)
    put_all_back(W, after)
    if good:
        part = h / FINER
        step_back(W, at, lane)
        activate_only(W, at[ACTIVE], lane)
        call(kernels[PREPARE], part, t, W)
        call(kernels[START], part, t, W)
        good = go_on(kernels, part, t, W, at, lane, (MORE + 1) * FINER)
    apart = 0.0
    for a in range(n):
        gap = W[first + a, lane] - coarse[a, lane]
        apart += W[at[METRIC] + a, lane] * gap * gap
    put_all_back(W, after)
    return good and apart <= APART * W[at[SCALE], lane]


@njit(**OPTIONS)
def verify(kernels, h, t, W, at, lane):
    """Close a lane's step anew if its solution is not the one that smaller steps lead to."""
    first, last = at[INCREMENT], at[STATE_END]
    rows, lanes = W.shape[0], LANES
    increments = np.empty((last - first, lanes))
    keep(W, at[SOLVED], at[SOLVED] + last - first, lane, increments)
    after = np.empty((rows, lanes))
    keep_all(W, after)
    finite = W[at[MISMATCH], lane] < np.inf
    unresolved = W[at[IN_DOUBT], lane] == UNRESOLVED
    if finite and W[at[IN_DOUBT], lane] == LOOKED_AT:
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
    if follow(kernels, h, t, W, at, lane) != 0:
        W[at[STATUS], lane] = STEP_TOO_LARGE
        return
    followed = np.zeros((last - first, lanes))
    zero = np.zeros((last - first, lanes))
    keep(W, first, last, lane, followed)
    size = distance(W, at, lane, followed, zero)
    after[at[SCALE], lane] = max(after[at[SCALE], lane], size)
    after[at[ITERATIONS], lane] = W[at[ITERATIONS], lane]
    if not distance(W, at, lane, followed, increments) <= SAME_SOLUTION * size:
        activate_only(W, at[ACTIVE], lane)
        call(kernels[START], h, t, W)
        put_back(W, first, last, lane, followed)
        call(kernels[ADVANCE], h, t, W)
        keep(W, 0, rows, lane, after)
        if not W[at[MISMATCH], lane] < np.inf:
            step_back(W, at, lane)
            keep(W, 0, rows, lane, after)
            after[at[STATUS], lane] = NOT_FINITE
    put_all_back(W, after)


@njit(**OPTIONS)
def mend(kernels, h, t, W, at, event):
    """Finish a step at which ``run`` stopped: lanes that failed, or are in doubt."""
    first, last = at[INCREMENT], at[STATE_END]
    lanes = LANES
    if len(kernels) == BY_STAGES:
        if event == SUSPICIOUS:
            step_back(W, at, 0)
        W[at[STATUS], 0] = NOT_CONVERGED
        return
    if event == FAILED:
        for lane in range(lanes):
            failure = -W[at[ACTIVE], lane]
            if failure > 0.0:
                for row in range(first, last):  # the predicted increments, which stand behind
                    W[row, lane] = W[row + last - first, lane]
                lost = follow(kernels, h, t, W, at, lane)
                if lost != 0:
                    W[at[STATUS], lane] = lost if lost == STEP_TOO_LARGE else failure
        for lane in range(lanes):
            W[at[ACTIVE], lane] = 1.0 if W[at[STATUS], lane] == 0.0 else 0.0
        call(kernels[ADVANCE], h, t, W)
    for lane in range(lanes):
        if W[at[STATUS], lane] == 0.0 and W[at[IN_DOUBT], lane] != 0.0:
            verify(kernels, h, t, W, at, lane)


@njit(**OPTIONS)
def begin(kernels, legendre, h, t, W, at):
    """Begin at the q and p (or, with the address of legendre, the q and v) in the workspace."""
    for lane in range(LANES):
        W[at[ACTIVE], lane] = 1.0
        W[at[STATUS], lane] = 0.0
        W[at[CONTRACTION], lane] = 1.0
        W[at[SCALE], lane] = 0.0
        W[at[ITERATIONS], lane] = 0.0
    call(kernels[PREPARE], h, t, W)
    if legendre != 0:
        call(legendre, h, t, W)
    call(kernels[START], h, t, W)


@njit(**OPTIONS)
def switch(kernels, h, t, W, at):
    """Go on with other kernels of the same layout, from the state and the predicted increments."""
    first, last = at[INCREMENT], at[STATE_END]
    increments = np.empty((last - first, LANES))
    for lane in range(LANES):
        keep(W, first, last, lane, increments)
        W[at[STATUS], lane] = 0.0
    call(kernels[PREPARE], h, t, W)
    call(kernels[START], h, t, W)
    for lane in range(LANES):
        put_back(W, first, last, lane, increments)
        put_back(W, last, 2 * last - first, lane, increments)  # they are the predicted ones too


@njit(**INLINE)
def store(W, at, place, q_out, p_out, iterations_out):
    """Store the states of lanes that go on, and their iterations since the states before."""
    for lane in range(LANES):
        if W[at[STATUS], lane] == 0.0:
            for a in range(at[DIMENSION]):
                q_out[place, a, lane] = W[at[POSITION] + a, lane]
                p_out[place, a, lane] = W[at[MOMENTUM] + a, lane]
            iterations_out[place, lane] = np.int64(W[at[ITERATIONS], lane])
            W[at[ITERATIONS], lane] = 0.0


@njit(**OPTIONS)
def run(
    kernels, h, t0, W, at, progress, stop, every, q_out, p_out, iterations_out,
):  # fmt: skip
    """Take steps until ``stop``, an event, or no lane is left; ``progress`` is (step, event).

    States are stored after each ``every`` steps, none for ``every = 0``. A lane with a status
    other than 0 is not touched. At an event the step is not finished: ``mend`` does that, and
    ``run`` goes on.
    """
    lanes = LANES
    active, status, in_doubt = at[ACTIVE], at[STATUS], at[IN_DOUBT]
    step, mended = progress[0], progress[1] != 0
    progress[1] = 0
    while step < stop:
        if not mended:
            t = t0 + h * step
            alive = 0
            for lane in range(lanes):
                W[active, lane] = 1.0 if W[status, lane] == 0.0 else 0.0
                alive += W[status, lane] == 0.0
            if alive == 0:
                break
            if solve(kernels[NEWTON], h, t, W, at) != 0:
                progress[1] = FAILED
                break
            doubts = 0
            for lane in range(lanes):
                W[active, lane] = 1.0 if W[status, lane] == 0.0 else 0.0
            call(kernels[ADVANCE], h, t, W)
            for lane in range(lanes):
                doubts += (W[status, lane] == 0.0) & (W[in_doubt, lane] != 0.0)
            if doubts > 0:
                progress[1] = SUSPICIOUS
                break
        mended = False
        step += 1
        if every != 0 and step % every == 0:
            store(W, at, step // every, q_out, p_out, iterations_out)
    progress[0] = step
