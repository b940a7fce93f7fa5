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
        row = JACOBIAN + (point * HELD_ROW_STEP + i * HELD_PLACE_STEP) * SOLVE_STRIDE
        for column in range(DEGREE):
            k = COLUMN_ORDER[column]
            for s in range(DIMENSION):
                a = rate * DIMENSION + COORDINATE[s]
                entry = column * HELD_ROW_STEP + HELD_PLACE[s] * HELD_PLACE_STEP
                if abs(i - HELD_PLACE[s]) <= HELD_BAND:
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
def go_to_point(W, h, point, lane):
    """Say where in the step a control point is."""
    W[NODE_STEP, lane] = h
    W[NODE_STEP + 1, lane] = POINTS[point]
    W[NODE_STEP + 2, lane] = real(1)


@compiled
def keep_rates(W, h, node, lane):
    """Keep the derivatives of A v - b by q, h times, in the place of those of phi."""
    first = POINT_QQ + (node - NODES + 1) * HELD_SIZE + HELD_OFFSET
    for c in range(HOLONOMIC, CONSTRAINTS):
        i = HELD_PLACE[DIMENSION + c]
        for s in range(DIMENSION):
            rate = RATE_Q + (c - HOLONOMIC) * DIMENSION + COORDINATE[s]
            if abs(i - HELD_PLACE[s]) <= HELD_BAND:
                W[first + i * HELD_STRIDE + HELD_PLACE[s], lane] = h * W[rate, lane]


@compiled
def keep_rate_slopes(W, h, node, lane):
    """Keep its derivatives by parameters, h times."""
    for j in range(VARIED):
        first = POINT_A + ((node - NODES + 1) * VARIED + j) * CONSTRAINTS
        for c in range(HOLONOMIC, CONSTRAINTS):
            rate = RATE_A + j * (CONSTRAINTS - HOLONOMIC) + c - HOLONOMIC
            W[first + c, lane] = h * W[rate, lane]


@compiled
def vary_carried(W, dq, room, lane):
    """Add b_q dq to what A dv is."""
    for c in range(HOLONOMIC, CONSTRAINTS):
        for a in range(DIMENSION):
            slope = W[RATE_Q + (c - HOLONOMIC) * DIMENSION + a, lane]
            W[room + DIMENSION + c, lane] += slope * W[dq + a, lane]


@compiled
def add_carried_slopes(W, room, parameter, lane):
    """Add what a parameter changes of b."""
    for c in range(HOLONOMIC, CONSTRAINTS):
        if parameter >= 0:
            slope = RATE_A + parameter * (CONSTRAINTS - HOLONOMIC) + c - HOLONOMIC
            W[room + DIMENSION + c, lane] += W[slope, lane]


@compiled
def pull_carried(W, lane):
    """Add z.b_q to the derivative of a cost by q1."""
    for c in range(HOLONOMIC, CONSTRAINTS):
        for a in range(DIMENSION):
            slope = W[RATE_Q + (c - HOLONOMIC) * DIMENSION + a, lane]
            W[ADJOINT + a, lane] += W[MULTIPLIER + c, lane] * slope


@compiled
def pull_carried_slopes(W, lane):
    """Add z.b_a to the derivatives by parameters."""
    for j in range(VARIED):
        for c in range(HOLONOMIC, CONSTRAINTS):
            slope = RATE_A + j * (CONSTRAINTS - HOLONOMIC) + c - HOLONOMIC
            W[COST_END + j, lane] += W[MULTIPLIER + c, lane] * W[slope, lane]
