"""The end of a step."""


@compiled
def accumulate(W, h, node, lane):
    """Add a node's part to p1 - p0 = h sum_i b_i L_q(q_i, v_i)."""
    weight = h * WEIGHTS[node]
    for s in range(DIMENSION):
        force = weight * W[NODE_L_Q + s, lane]
        W[RESIDUAL + COORDINATE[s], lane] += force


@compiled
def exact_sum(a, b):
    """Add two numbers; the second result is the rounding error of the first (Knuth)."""
    total = a + b
    taken = total - a
    return total, (a - (total - taken)) + (b - taken)


@compiled
def add_exactly(W, row, low, increment, lane):
    """Add to a number; its low part takes the rounding error."""
    total, lost = exact_sum(W[row, lane], increment)
    W[row, lane] = total
    W[low, lane] = lost


@compiled
def keep_step(W, lane):
    """Store the state before a step, its increments, and their prediction."""
    for row in range(4 * DIMENSION):
        W[PREVIOUS + row, lane] = W[POSITION + row, lane]
    for row in range(UNKNOWNS):
        W[PREVIOUS + 4 * DIMENSION + row, lane] = W[PREDICTED + row, lane]
        W[SOLVED + row, lane] = W[INCREMENT + row, lane]


@compiled
def measure_prediction(W, lane):
    """Measure the error of predicted increments by the diagonal of M(q0)."""
    prediction_error_squared = real(0)
    for s in range(SOLVE_COORDINATES):
        a = COORDINATE[s]
        for row in range(a, DEGREE * DIMENSION, DIMENSION):
            error = W[INCREMENT + row, lane] - W[PREDICTED + row, lane]
            prediction_error_squared += W[MASS_DIAGONAL + a, lane] * error**2
    W[PREDICTION_ERROR_SQUARED, lane] = prediction_error_squared


@compiled
def close_step(W, lane):
    """Add the increments to q and p by compensated sums."""
    for a in range(DIMENSION):
        increment = W[INCREMENT + (DEGREE - 1) * DIMENSION + a, lane] + W[POSITION_LOW + a, lane]
        add_exactly(W, POSITION + a, POSITION_LOW + a, increment, lane)
        increment = W[RESIDUAL + a, lane] + W[MOMENTUM_LOW + a, lane]
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, increment, lane)
