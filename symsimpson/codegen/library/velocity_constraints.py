"""Velocity constraints A v = b, asked for at Gauss points of the path.

Their rows stand behind those of phi in each block; their multipliers act at the control points, as
those of phi do.
"""


@compiled
def assemble_rates(W, h, node, lane):
    """Let rows of the step say A v = b at a point, where what is alike says phi = 0."""
    point = node - NODES
    for c in range(HOLONOMIC, CONSTRAINTS):
        rate = c - HOLONOMIC
        W[RESIDUAL + DEGREE * DIMENSION + point * CONSTRAINTS + c, lane] = W[RATE + rate, lane]
        i = HELD_PLACE[DIMENSION + c]
        row = HELD_SHIFT + point * HELD_PULL_STEP + i * HELD_PLACE_STEP
        row = JACOBIAN + row * SOLVE_STRIDE
        for column in range(DEGREE):
            k = COLUMN_ORDER[column]
            for s in range(DIMENSION):
                a = rate * DIMENSION + COORDINATE[s]
                j = HELD_PLACE[s]
                entry = column * HELD_ROW_STEP + j * HELD_PLACE_STEP
                if abs(i - j) <= HELD_BAND:
                    W[row + SOLVE_OFFSET + entry, lane] = (
                        BASIS[node, k] * W[RATE_Q + a, lane]
                        + BASIS_SLOPE[node, k] / h * W[RATE_V + a, lane]
                    )


@compiled
def add_carried(W, h, lane):
    """Add the work -mu.b of velocity constraints at a control point, which CURVATURE has b of."""
    for c in range(HOLONOMIC, CONSTRAINTS):
        W[WORK_LOW + CARRIED, lane] -= W[MULTIPLIER + c, lane] / h * W[CURVATURE + c, lane]


@compiled
def keep_taken(W, lane):
    """Keep the multipliers of the projection, which end a step."""
    for c in range(CONSTRAINTS):
        W[TAKEN + c, lane] = W[MULTIPLIER + c, lane]


@compiled
def add_carried_end(W, lane):
    """Add the work of these at the end of the step."""
    for c in range(HOLONOMIC, CONSTRAINTS):
        W[WORK_LOW + CARRIED, lane] -= W[TAKEN + c, lane] * W[CURVATURE + c, lane]


@compiled
def keep_rates(W, h, node, lane):
    """Keep the derivatives of A v - b by q, h times, in the place of those of phi.

    The derivatives by parameters follow.
    """
    point = node - NODES + 1
    first = POINT_QQ + point * HELD_SIZE + HELD_OFFSET
    for c in range(HOLONOMIC, CONSTRAINTS):
        i = HELD_PLACE[DIMENSION + c]
        for s in range(DIMENSION):
            rate = RATE_Q + (c - HOLONOMIC) * DIMENSION + COORDINATE[s]
            if abs(i - HELD_PLACE[s]) <= HELD_BAND:
                W[first + i * HELD_STRIDE + HELD_PLACE[s], lane] = h * W[rate, lane]
    if VARIED_BY:
        for j in range(VARIED):
            for c in range(HOLONOMIC, CONSTRAINTS):
                rate = RATE_A + j * (CONSTRAINTS - HOLONOMIC) + c - HOLONOMIC
                slope = POINT_A + (point * VARIED + j) * CONSTRAINTS + c
                W[slope, lane] = h * W[rate, lane]


@compiled
def differentiate_carried(W, lane):
    """Evaluate the derivatives of b by q and by parameters."""
    carried_slopes(W, lane)
    if VARIED_BY:
        carried_parameter_slopes(W, lane)


@compiled
def vary_carried(W, variation, lane):
    """Add b_q dq to what A dv is, and what a parameter changes of b."""
    dq = TANGENT + variation * 2 * DIMENSION
    room = work_row_of(W, variation, lane)
    parameter = parameter_of(W, variation, lane)
    for c in range(HOLONOMIC, CONSTRAINTS):
        for a in range(DIMENSION):
            slope = W[RATE_Q + (c - HOLONOMIC) * DIMENSION + a, lane]
            W[room + DIMENSION + c, lane] += slope * W[dq + a, lane]
        if VARIED_BY and parameter >= 0:
            slope = RATE_A + parameter * (CONSTRAINTS - HOLONOMIC) + c - HOLONOMIC
            W[room + DIMENSION + c, lane] += W[slope, lane]


@compiled
def pull_carried(W, lane):
    """Add z.b_q to the derivative of a cost by q1, and z.b_a to those by parameters."""
    for c in range(HOLONOMIC, CONSTRAINTS):
        for a in range(DIMENSION):
            slope = W[RATE_Q + (c - HOLONOMIC) * DIMENSION + a, lane]
            W[ADJOINT + a, lane] += W[MULTIPLIER + c, lane] * slope
    if VARIED_BY:
        for j in range(VARIED):
            for c in range(HOLONOMIC, CONSTRAINTS):
                slope = RATE_A + j * (CONSTRAINTS - HOLONOMIC) + c - HOLONOMIC
                W[COST_END + j, lane] += W[MULTIPLIER + c, lane] * W[slope, lane]
