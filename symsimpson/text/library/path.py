"""The polynomial path of a step: its start, its end and its prediction."""


@compiled
def path_end(W, lane):
    """Position at the end of the path, rounded like the sum that closes the step."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        increment = W[INCREMENT + (DEGREE - 1) * DIMENSION + a, lane] + W[POSITION_LOW + a, lane]
        q, _ = exact_sum(W[POSITION + a, lane], increment)
        W[NODE_POSITION + s, lane] = q


@compiled
def path_start(W, lane):
    """Position and velocity at the start of the path."""
    for s in range(DIMENSION):
        W[NODE_POSITION + s, lane] = W[POSITION + COORDINATE[s], lane]
        if CANONICAL:
            W[NODE_VELOCITY + s, lane] = W[MOMENTUM + COORDINATE[s], lane]
        else:
            W[NODE_VELOCITY + s, lane] = W[VELOCITY + COORDINATE[s], lane]


@compiled
def straight_path(W, h, lane):
    """Begin with a path of constant velocity v; multipliers of 0 suffice as they are linear."""
    for k in range(DEGREE):
        for a in range(DIMENSION):
            W[INCREMENT + k * DIMENSION + a, lane] = POINTS[k + 1] * h * W[VELOCITY + a, lane]
    if HELD:
        clear(W, INCREMENT + DEGREE * DIMENSION, DEGREE * CONSTRAINTS, lane)
    copy(W, INCREMENT, PREDICTED, UNKNOWNS, lane)


@compiled
def end_slope(W, h, lane):
    """Set the velocity to the slope of the path at its end, where M is evaluated next."""
    for a in range(DIMENSION):
        moved = real(0)
        for j in range(DEGREE):
            moved += END_SLOPE[j] * W[INCREMENT + j * DIMENSION + a, lane]
        W[VELOCITY + a, lane] = moved / h


@compiled
def predict(W, h, lane):
    """Extrapolate the last path, and correct it to start with the velocity v."""
    velocity_jump_squared = real(0)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        jump = h * W[VELOCITY + a, lane]
        for j in range(DEGREE):
            jump -= END_SLOPE[j] * W[INCREMENT + j * DIMENSION + a, lane]
        if s < SOLVE_COORDINATES:
            velocity_jump_squared += W[MASS_DIAGONAL + a, lane] * jump**2
        for k in range(DEGREE):
            increment = START_SLOPE[k] * jump
            for j in range(DEGREE):
                increment += EXTRAPOLATION[k, j] * W[INCREMENT + j * DIMENSION + a, lane]
            W[RESIDUAL + k * DIMENSION + a, lane] = increment
    copy(W, RESIDUAL, INCREMENT, DEGREE * DIMENSION, lane)
    copy(W, INCREMENT, PREDICTED, UNKNOWNS, lane)
    W[VELOCITY_JUMP_SQUARED, lane] = velocity_jump_squared
