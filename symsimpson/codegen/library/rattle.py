"""Explicit steps that constraints hold: kicks, and drifts that end where phi = 0."""


@compiled
def free_velocity(W, lane):
    """Solve for the velocity that constraints allow, and for what they take from p."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
    allow_no_change(W, lane)
    solve_held(W, lane)


@compiled
def momentum_left(W, lane):
    """Return p - Phi^T mu - M v of a drift to the solve, which rounding has left there."""
    for c in range(CONSTRAINTS):
        W[MULTIPLIER + c, lane] = W[INCREMENT + DIMENSION + c, lane]
    constraint_forces(W, lane)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        left = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane] - W[CONSTRAINT_FORCE + a, lane]
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            mass = W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            left -= mass * W[DRIFT_VELOCITY + COORDINATE[b], lane]
        W[NODE_VELOCITY + s, lane] = left


@compiled
def add_drift(W, share, lane):
    """Add a velocity to that of the drift, and what it moves; measure that relative to q."""
    correction = real(0)
    size = real(0)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        change = share * W[VELOCITY + a, lane]
        W[DRIFT_VELOCITY + a, lane] += W[VELOCITY + a, lane]
        W[INCREMENT + a, lane] += change
        q = W[POSITION + a, lane] + W[INCREMENT + a, lane]
        W[NODE_POSITION + s, lane] = q
        correction += W[MASS_DIAGONAL + a, lane] * change**2
        size += W[MASS_DIAGONAL + a, lane] * q**2
    for c in range(CONSTRAINTS):
        W[INCREMENT + DIMENSION + c, lane] += W[MULTIPLIER + c, lane]
    W[CORRECTION_SQUARED, lane] = correction
    W[INCREMENT_SQUARED, lane] = size


@compiled
def drift_held(W, h, node, lane):
    """Move by M^-1 (p - Phi^T mu), with Phi at the start and mu for which phi = 0 at the end.

    Corrections take Phi at the start for both, so that one factorisation serves all: each leaves a
    part of the error that is small with h. What does not converge becomes NaN.
    """
    share = h * DRIFTS[node - 1]
    for a in range(DIMENSION):
        W[DRIFT_VELOCITY + a, lane] = real(0)
    for c in range(CONSTRAINTS):
        W[INCREMENT + DIMENSION + c, lane] = real(0)
    free_velocity(W, lane)
    add_drift(W, share, lane)
    W[RELATIVE, lane] = INFINITE
    for _ in range(MOST_CORRECTIONS):
        constraint_values(W, lane)
        momentum_left(W, lane)
        for c in range(CONSTRAINTS):
            W[CURVATURE + c, lane] = -W[CONSTRAINT + c, lane] / share
        solve_held(W, lane)
        add_drift(W, share, lane)
        check_drift(W, lane)
        if W[RELATIVE, lane] == 0:
            break
    for c in range(CONSTRAINTS):
        W[MULTIPLIER + c, lane] = W[INCREMENT + DIMENSION + c, lane]
    take_momentum(W, lane)
    if W[RELATIVE, lane] != 0:
        W[RESIDUAL, lane] = INFINITE - INFINITE
