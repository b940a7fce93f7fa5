"""Kicks and drifts of an explicit step."""


@compiled
def first_kick(W, h, lane):
    """Begin with what rounding has left before, and the force at the end of the last step."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[INCREMENT + a, lane] = W[POSITION_LOW + a, lane]
        W[RESIDUAL + a, lane] = W[MOMENTUM_LOW + a, lane] + h * KICKS[0] * W[NODE_L_Q + s, lane]


@compiled
def drift(W, h, part, lane):
    """Move by M^-1 p."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
    solve_mass(W, lane)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[INCREMENT + a, lane] += h * DRIFTS[part] * W[VELOCITY + a, lane]
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + W[INCREMENT + a, lane]


@compiled
def kick(W, h, number, lane):
    """Change p by a force."""
    for s in range(DIMENSION):
        W[RESIDUAL + COORDINATE[s], lane] += h * KICKS[number] * W[NODE_L_Q + s, lane]


@compiled
def close_composed(W, lane):
    """Close the step; the last force was that at its end."""
    for a in range(DIMENSION):
        add_exactly(W, POSITION + a, POSITION_LOW + a, W[INCREMENT + a, lane], lane)
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, W[RESIDUAL + a, lane], lane)
