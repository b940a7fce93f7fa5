"""Kicks and drifts of an explicit step; with constraints, drifts end where phi = 0.

A retimed system has dt = g(V) dtau. Its kicks use V and g(V), and its drifts T and g(E0 - T).
Both solve their part of K = f(E0 - V) - f(T), f' = g, exactly. With linear forces f - K q a step is
a product of shears. Their matrices are computed once a run, on and below the diagonal, and are
symmetric. Rounded coefficients therefore give another symplectic step, without energy drift.
"""


@compiled
def begin_composed(W, lane):
    """Begin with the low parts of q and p; shears by functions of exact values are symplectic."""
    copy(W, POSITION_LOW, INCREMENT, DIMENSION, lane)
    copy(W, MOMENTUM_LOW, RESIDUAL, DIMENSION, lane)
    if RETIMED:
        path_start(W, lane)
        W[PASSED, lane] = real(0)


@compiled
def drift(W, h, node, lane):
    """Move by M^-1 p, from the kick before."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
    solve_mass(W, lane)
    share = h * DRIFTS[node - 1]
    if RETIMED:
        kinetic = real(0)
        for a in range(DIMENSION):
            p = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
            kinetic += p * W[VELOCITY + a, lane]
        W[ENERGY, lane] = W[PARAMETER + START_ENERGY, lane] - kinetic / 2
        W[RATE, lane] = share
        own_time(W, lane)
        share = W[RATE, lane]
        W[PASSED, lane] += share
    move(W, share, node, lane)


@compiled
def move(W, share, node, lane):
    """Move by a share of the velocity."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[INCREMENT + a, lane] += share * W[VELOCITY + a, lane]
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + W[INCREMENT + a, lane]
        if TRACED and node == len(DRIFTS):  # the sum that closes the step
            q, _ = exact_sum(W[POSITION + a, lane], W[INCREMENT + a, lane])
            W[NODE_POSITION + s, lane] = q


@compiled
def kick(W, h, node, lane):
    """Change p by a force, and by friction of the rate G."""
    share = h * KICKS[node]
    if RETIMED:
        W[ENERGY, lane] = real(0)
        potential(W, lane)
        W[RATE, lane] = share
        own_time(W, lane)
        share = W[RATE, lane]
    for s in range(DIMENSION):
        a = COORDINATE[s]
        if FRICTION and DECAYS[a] != 0:  # exp(-G t) p + (1 - exp(-G t))/G F
            rate = W[DECAY + a, lane]
            half = exp(-rate * share / 2)
            lost = -2 * half * sinh(rate * share / 2)
            p = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
            W[RESIDUAL + a, lane] += lost * p - lost / rate * W[NODE_L_Q + s, lane]
        else:
            W[RESIDUAL + a, lane] += share * W[NODE_L_Q + s, lane]


@compiled
def close_composed(W, lane):
    """Close the step; the last force was that at its end."""
    for a in range(DIMENSION):
        add_exactly(W, POSITION + a, POSITION_LOW + a, W[INCREMENT + a, lane], lane)
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, W[RESIDUAL + a, lane], lane)


@compiled
def through_stiffness(W, a, lane):
    """Return row a of -h K times the vector in the rows of the velocity."""
    total = real(0)
    for c in range(DIMENSION):
        total += W[NODE_L_QQ + a * DIMENSION + c, lane] * W[VELOCITY + c, lane]
    return total


@compiled
def linear_kick(W, h, node, lane):
    """Change p by (c h + d h^3 K M^-1) (K q - f)."""
    near, far = -KICKS[node, 0], h * KICKS[node, 1]
    copy(W, STEP_F, NODE_VELOCITY, DIMENSION, lane)
    solve_mass(W, lane)
    for a in range(DIMENSION):
        W[NODE_L_Q + a, lane] = near * W[STEP_F + a, lane] + far * through_stiffness(W, a, lane)
    for b in range(DIMENSION):
        for a in range(DIMENSION):
            W[NODE_VELOCITY + a, lane] = W[NODE_L_QQ + a * DIMENSION + b, lane]
        solve_mass(W, lane)
        for a in range(b, DIMENSION):
            entry = near * W[NODE_L_QQ + a * DIMENSION + b, lane]
            entry += far * through_stiffness(W, a, lane)
            W[NODE_L_Q + a, lane] += entry * W[NODE_POSITION + b, lane]
            if a > b:
                W[NODE_L_Q + b, lane] += entry * W[NODE_POSITION + a, lane]
    for a in range(DIMENSION):
        W[RESIDUAL + a, lane] += W[NODE_L_Q + a, lane]


@compiled
def linear_drift(W, h, node, lane):
    """Move by b (M/h + e h K)^-1 p."""
    start = DRIFTS[node - 1, 0]
    for k in range(DIMENSION**2):
        stiff = DRIFTS[node - 1, 1] / start * W[NODE_L_QQ + k, lane]
        W[JACOBIAN + k, lane] = W[MASS + k, lane] / (start * h) - stiff
    factor_symmetric(W, JACOBIAN, DIMENSION, DIMENSION, DIMENSION, lane)
    for a in range(DIMENSION):
        W[NODE_L_V + a, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
        W[VELOCITY + a, lane] = real(0)
    for b in range(DIMENSION):
        for a in range(DIMENSION):
            W[NODE_VELOCITY + a, lane] = real(1) if a == b else real(0)
        solve_symmetric(W, JACOBIAN, NODE_VELOCITY, DIMENSION, DIMENSION, DIMENSION, lane)
        for a in range(b, DIMENSION):
            entry = W[NODE_VELOCITY + a, lane]
            W[VELOCITY + a, lane] += entry * W[NODE_L_V + b, lane]
            if a > b:
                W[VELOCITY + b, lane] += entry * W[NODE_L_V + a, lane]
    move(W, 1, node, lane)


@compiled
def shear(W, h, t, lane):
    """Take a step of shears: kicks, and drifts between them."""
    go_to_start(W, t, lane)
    for s in range(DIMENSION):
        W[NODE_POSITION + s, lane] = real(REST)
    forces(W, lane)
    mass(W, lane)
    copy(W, NODE_L_VV, MASS, MASS - NODE_L_VV, lane)
    factor_mass(W, lane)
    for a in range(DIMENSION):  # h f and -h K
        W[STEP_F + a, lane] = h * W[NODE_L_Q + a, lane]
        for b in range(DIMENSION):
            W[NODE_L_QQ + a * DIMENSION + b, lane] *= h
            W[STEP_F + a, lane] -= W[NODE_L_QQ + a * DIMENSION + b, lane] * REST
    path_start(W, lane)
    begin_composed(W, lane)
    linear_kick(W, h, 0, lane)
    for node in range(1, len(KICKS)):
        linear_drift(W, h, node, lane)
        linear_kick(W, h, node, lane)
    close_composed(W, lane)


@compiled
def free_velocity(W, lane):
    """Solve for the velocity with Phi v = 0, and for the multipliers of p."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
    clear(W, CURVATURE, CONSTRAINTS, lane)
    solve_held(W, lane)


@compiled
def momentum_left(W, lane):
    """Set the right side to p - Phi^T mu - M v of a drift, which is its rounding error."""
    copy(W, INCREMENT + DIMENSION, MULTIPLIER, CONSTRAINTS, lane)
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
    """Add a velocity to the drift and its displacement; measure this relative to q."""
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

    Corrections use Phi at the start, so that one factorisation serves all of them. Each reduces the
    error by a factor that is small with h. A drift that does not converge becomes NaN.
    """
    share = h * DRIFTS[node - 1]
    clear(W, DRIFT_VELOCITY, DIMENSION, lane)
    clear(W, INCREMENT + DIMENSION, CONSTRAINTS, lane)
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
    copy(W, INCREMENT + DIMENSION, MULTIPLIER, CONSTRAINTS, lane)
    take_momentum(W, lane)
    if W[RELATIVE, lane] != 0:
        W[RESIDUAL, lane] = INFINITE - INFINITE
