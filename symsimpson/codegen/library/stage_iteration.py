"""Iteration over the velocities and forces at the nodes, alike for all systems."""


@compiled
def stage_constants(W, h, lane):
    """The tables of the nodes; the parts h b_i of the step, which add up to h, their inverses.

    Read from rows, tables are vectors; as constants they tempt compilers to unroll the nodes.
    """
    for row in range(4 * NODES):
        for node in range(STRIDE):
            W[STAGE_MU + row * STRIDE + node, lane] = STAGE_TABLE[row, node]
    inner = real(0)
    for node in range(1, NODES - 1):
        W[STAGE_STEP + node, lane] = h * WEIGHTS[node]
        inner += h * WEIGHTS[node]
    W[STAGE_STEP, lane] = (h - inner) / 2
    W[STAGE_STEP + NODES - 1, lane] = (h - inner) / 2
    for node in range(NODES):
        W[STAGE_RATE + node, lane] = 1 / W[STAGE_STEP + node, lane]
        if not AUTONOMOUS:
            W[STAGE_PLACE + node, lane] = PLACES[node]


@compiled
def over_nodes(W, first, lane):
    """The sum of a row of nodes, in four parts that do not wait for each other."""
    a, b, c, d = real(0), real(0), real(0), real(0)
    for node in range(first, first + STRIDE, 4):
        a += W[node, lane]
        b += W[node + 1, lane]
        c += W[node + 2, lane]
        d += W[node + 3, lane]
    return (a + b) + (c + d)


@compiled
def check_stage_convergence(W, lane):
    """Go on or not: ACTIVE becomes 0 where the nodes are solved, -3 where they are not finite.

    Corrections shrink by a factor each time; the next one is predicted by the largest factor seen
    of late, and where it would be lost in rounding, the step is done. All sizes are squared.
    A correction that is no smaller than the one before is rounding only where both are small: those
    of slow iterations may grow for once, long before the step is solved.
    Convergence is not checked before the iteration in which the step is expected to be nearly done.
    """
    W[ITERATIONS, lane] += 1.0
    W[STAGE_COUNT, lane] += 1.0
    if W[STAGE_COUNT, lane] >= W[STAGE_EXPECTED, lane]:
        correction = over_nodes(W, STAGE_CORRECTION, lane)
        increment = max(over_nodes(W, STAGE_SIZE, lane), correction)
        before, factor = W[RELATIVE, lane], W[CONTRACTION, lane]
        now = correction / (increment if increment != 0 else 1.0)
        factor = max(now / before, 0.25 * factor) if before < INFINITE else factor
        negligible = (factor < 1) & (now * factor <= LOST * (1 - factor) * (1 - factor))
        stalled = (now < STALLED) & (now >= (0.25 if now < NOISE else 1.0) * before)
        done = negligible | (now <= ROUNDING) | stalled
        finite = (correction < INFINITE) & (increment < INFINITE)
        W[CORRECTION_SQUARED, lane] = correction
        W[INCREMENT_SQUARED, lane] = increment
        W[CONTRACTION, lane] = factor
        W[RELATIVE, lane] = now
        W[ACTIVE, lane] = (0.0 if done else 1.0) if finite else -3.0


@compiled
def turned(sine, cosine, change):
    """Sine and cosine of an angle that changed by so little, to rounding for up to 2^-7."""
    z = change * change
    along = change * (1 - z * (0.16666666666666666 - z * 0.008333333333333333))
    back = z * (0.5 - z * (0.041666666666666664 - z * 0.001388888888888889))
    return sine + (cosine * along - sine * back), cosine - (sine * along + cosine * back)


@compiled
def check_turns(W, lane):
    """Go on with sines and cosines that are computed, where they were turned too far."""
    late = W[ACTIVE, lane] == 0 or W[STAGE_COUNT, lane] > MANY
    if late and W[STAGE_COUNT, lane] > W[STAGE_TURNED, lane]:
        farthest = over_nodes(W, STAGE_TURN, lane)
        if not farthest <= TURN:
            W[STAGE_TURNED, lane] = INFINITE
            if W[ACTIVE, lane] == 0:
                W[ACTIVE, lane] = 1.0


@compiled
def check_stage_acceptance(W, lane):
    """Leave it to Newton's method where velocities of cyclic coordinates are no polynomial.

    LARGEST_SQUARED is what it compares its increments with: about n^2/4 times those of n nodes,
    squared. In the next step convergence is checked first when one more iteration is likely to be
    enough, and earlier behind a step that was done when it was first checked: it may have been so
    for long.
    """
    increment = W[INCREMENT_SQUARED, lane]
    resolved = W[CYCLIC_JUMP_SQUARED, lane] <= UNRESOLVED * increment
    W[IN_DOUBT, lane] = 0.0 if resolved else 1.0
    W[LARGEST_SQUARED, lane] = max(W[LARGEST_SQUARED, lane], 0.25 * NODES**2 * increment)
    count = W[STAGE_COUNT, lane]
    W[STAGE_EXPECTED, lane] = count - (1.0 if count > W[STAGE_EXPECTED, lane] else 3.0)
    W[STAGE_COUNT, lane] = 0.0


@compiled
def least_over_nodes(W, lane):
    """Find the smallest pivot of M at the nodes, or 0 where it may vanish behind the last."""
    least = W[STAGE_PIVOT, lane]
    for node in range(1, NODES):
        least = min(least, W[STAGE_PIVOT + node, lane])
    last = W[STAGE_PIVOT + NODES - 1, lane]
    ahead = last + FALL * (last - W[STAGE_PIVOT + NODES - 2, lane])
    W[MASS_PIVOT, lane] = 0.0 if (ahead <= 0) & (least > 0) else least


@compiled
def leave_path(W, lane):
    """Leave the path of the step to whoever differentiates it: increments of control points."""
    for k in range(DEGREE):
        for a in range(DIMENSION):
            moved = real(0)
            for node in range(NODES):
                moved += REACHED_BY_MOVES[k, node] * W[STAGE_V + a * STRIDE + node, lane]
            W[SOLVED + k * DIMENSION + a, lane] = moved
