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
