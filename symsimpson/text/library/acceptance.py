"""Tests of convergence and of doubt for the step of a lane, without branches."""


@compiled
def check_convergence(W, lane):
    """Set ACTIVE to 0 where a lane is solved, and to -3 where it is not finite.

    CONTRACTION is the ratio of a correction to the square of the one before. It predicts the next
    correction. The lane is done if rounding would hide that in each coordinate. Sizes are squared.
    """
    active = W[ACTIVE, lane]
    correction, increment = W[CORRECTION_SQUARED, lane], W[INCREMENT_SQUARED, lane]
    before, ratio = W[RELATIVE, lane], W[CONTRACTION, lane]
    finite = (correction < INFINITE) & (increment < INFINITE)
    now = correction / (increment if increment != 0 else 1.0)
    # where rounding enters, what is seen is too large: it is safe
    seen = max(now * (1.0 / (before * before if before > 0 else 1.0)), 0.25 * ratio)
    ratio = seen if before < QUADRATIC else ratio
    negligible = ratio * (now * now) <= NEGLIGIBLE
    if DIMENSION > 1:
        rounded = OWN_ROUNDED * (increment * increment)
        for a in range(DIMENSION):
            changed, moved = W[OWN_CORRECTION + a, lane], W[OWN_INCREMENT + a, lane]
            enough = OWN_NEGLIGIBLE * (moved * moved) + rounded
            negligible = negligible & (ratio * (changed * changed) <= enough)
    done = negligible | ((now < STAGNATION) & (now >= 0.25 * before))
    state = (0.0 if done else 1.0) if finite else -3.0
    on = active > 0
    W[ITERATIONS, lane] += 1.0 if on else 0.0
    W[CONTRACTION, lane] = ratio if on & finite else W[CONTRACTION, lane]
    W[RELATIVE, lane] = now if on & finite else before
    W[ACTIVE, lane] = state if on else active


@compiled
def rounding_of_q(W, lane):
    """Return the squared increments, weighted by the diagonal of M, of rounded positions."""
    size = 0.0
    for a in range(DIMENSION):
        size += W[MASS_DIAGONAL + a, lane] * W[POSITION + a, lane] ** 2
    return ROUNDED * size


@compiled
def expect_rounding(W, lane):
    """Raise the largest increments so far to the size of rounding, for a system at rest."""
    known, least = W[LARGEST_SQUARED, lane], rounding_of_q(W, lane)
    W[LARGEST_SQUARED, lane] = least if (known > 0) & (known < least) else known


@compiled
def check_rounding(W, lane):
    """End the iteration if corrections no longer shrink and are below the rounding of q.

    The increments do not matter: near rest they may be as small as rounding.
    """
    correction, increment = W[CORRECTION_SQUARED, lane], W[INCREMENT_SQUARED, lane]
    stalled = correction >= 0.25 * (W[RELATIVE, lane] * increment)
    done = (W[ACTIVE, lane] > 0) & stalled & (correction <= rounding_of_q(W, lane))
    W[ITERATIONS, lane] += 1.0 if done else 0.0
    W[ACTIVE, lane] = 0.0 if done else W[ACTIVE, lane]


@compiled
def check_drift(W, lane):
    """Set RELATIVE to the size of the last correction, or to 0 if it is rounding."""
    before, size = W[RELATIVE, lane], W[INCREMENT_SQUARED, lane]
    now = W[CORRECTION_SQUARED, lane] / (size if size != 0 else 1.0)
    done = (now == 0) | ((now <= ROUNDED) & (now >= 0.25 * before))
    W[RELATIVE, lane] = 0.0 if done else now


@compiled
def check_pivots(W, lane):
    """Mark a step (by 4 more) at whose end a pivot of M is far smaller than any before."""
    W[IN_DOUBT, lane] += 4.0 if W[MASS_PIVOT, lane] <= W[PIVOT_LIMIT, lane] else 0.0


@compiled
def check_acceptance(W, lane):
    """Mark a solution (1) that may not be the one that smaller steps lead to.

    Its increments, or the velocity at the end of its path, are far from what is expected. Or
    velocities of cyclic coordinates are lost within the step (2), or their masses change much (3).
    """
    known = W[LARGEST_SQUARED, lane]
    largest = max(known, W[INCREMENT_SQUARED, lane])
    expected = (known <= 0) | (W[PREDICTION_ERROR_SQUARED, lane] <= known)
    sure = expected & (W[VELOCITY_JUMP_SQUARED, lane] <= FAR * largest)
    lost = W[CYCLIC_JUMP_SQUARED, lane] > UNRESOLVED * largest
    doubt = 3.0 if W[CYCLIC_MASS_CHANGE, lane] > LARGE_CHANGE else (0.0 if sure else 1.0)
    W[IN_DOUBT, lane] = 2.0 if lost else doubt
    W[LARGEST_SQUARED, lane] = largest if sure & (W[ACTIVE, lane] > 0) else known
