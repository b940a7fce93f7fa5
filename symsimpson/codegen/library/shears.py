"""Linear forces f - K q: a step is a product of shears, with matrices made once a run.

Only entries on and below the diagonal of a matrix are computed; those above are the same numbers.
Rounded coefficients then give another symplectic step, not a step that drifts.
"""


@compiled
def find_stiffness(W, h, lane):
    """Find M and its factors, the derivatives -h K of h F, and h f."""
    for s in range(DIMENSION):
        W[NODE_POSITION + s, lane] = real(REST)
    forces(W, lane)
    mass(W, lane)
    keep_mass(W, lane)
    factor_mass(W, lane)
    for a in range(DIMENSION):
        W[STEP_F + a, lane] = h * W[NODE_L_Q + a, lane]
        for b in range(DIMENSION):
            W[NODE_L_QQ + a * DIMENSION + b, lane] *= h
            W[STEP_F + a, lane] -= W[NODE_L_QQ + a * DIMENSION + b, lane] * REST


@compiled
def through_stiffness(W, a, lane):
    """Return row a of -h K times a vector that stands in the rows of the velocity."""
    total = real(0)
    for c in range(DIMENSION):
        total += W[NODE_L_QQ + a * DIMENSION + c, lane] * W[VELOCITY + c, lane]
    return total


@compiled
def linear_kick(W, h, node, lane):
    """Change p by (c h + d h^3 K M^-1) (K q - f)."""
    near, far = -KICKS[node, 0], h * KICKS[node, 1]
    for a in range(DIMENSION):
        W[NODE_VELOCITY + a, lane] = W[STEP_F + a, lane]
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
    find_stiffness(W, h, lane)
    path_start(W, lane)
    begin_composed(W, lane)
    linear_kick(W, h, 0, lane)
    for node in range(1, len(KICKS)):
        linear_drift(W, h, node, lane)
        linear_kick(W, h, node, lane)
    close_composed(W, lane)
