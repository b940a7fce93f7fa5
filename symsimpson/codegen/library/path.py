"""The polynomial path of a step, and where its nodes are."""


@compiled
def path(W, h, node, lane):
    """Position and velocity of the path at a node: those of a straight line, and of its bends."""
    rate = 1 / h
    for s in range(DIMENSION):
        a = COORDINATE[s]
        last = W[INCREMENT + (DEGREE - 1) * DIMENSION + a, lane]
        q = real(0)
        v = last
        for k in range(1, DEGREE):
            bend = W[INCREMENT + (k - 1) * DIMENSION + a, lane] - POINTS[k] * last
            q += BASIS[node, k] * bend
            v += BASIS_SLOPE[node, k] * bend
        q += PLACES[node] * last
        if TRACED and AT_POINT[node] > 0:  # the same number, without a sum
            q = W[INCREMENT + (AT_POINT[node] - 1) * DIMENSION + a, lane]
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + q
        W[NODE_VELOCITY + s, lane] = rate * v


@compiled
def path_end(W, lane):
    """Position at the end of the path, as the sum that closes the step gives it."""
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
        W[NODE_VELOCITY + s, lane] = W[VELOCITY + COORDINATE[s], lane]


@compiled
def node_time(W, t, lane):
    """Keep the time at a node."""
    W[NODE_TIME, lane] = t


@compiled
def node_inputs(W, node, lane):
    """Keep the inputs at a node."""
    for k in range(INPUTS):
        W[NODE_INPUT + k, lane] = W[INPUT + k * INPUT_STRIDE + node, lane]


@compiled
def straight_path(W, h, lane):
    """Increments of a path with the constant velocity v."""
    for k in range(DEGREE):
        for a in range(DIMENSION):
            increment = POINTS[k + 1] * h * W[VELOCITY + a, lane]
            W[INCREMENT + k * DIMENSION + a, lane] = increment
            W[PREDICTED + k * DIMENSION + a, lane] = increment


@compiled
def predict(W, h, lane):
    """Extrapolate the last path, bent to leave the new point with its velocity v."""
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
    for row in range(UNKNOWNS):
        W[INCREMENT + row, lane] = W[RESIDUAL + row, lane]
        W[PREDICTED + row, lane] = W[RESIDUAL + row, lane]
    W[VELOCITY_JUMP_SQUARED, lane] = velocity_jump_squared
