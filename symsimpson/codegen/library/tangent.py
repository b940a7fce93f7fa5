"""Derivatives of a step: variations of q0, p0 and parameters, carried to its end.

A variation is a column of the derivative: dq and dp stand in TANGENT, those of all variations one
behind the other; behind them each has room for the right side of its equations, which becomes dX,
and for dp1 - dp0. The last VARIED of them belong to the parameters and inputs that are varied.
"""


@compiled
def grow_slopes(W, node, lane):
    """Multiply derivatives by parameters at a node by what its weight has grown to."""
    for row in range(F_A_FROM[VARIED]):
        W[NODE_F_A + row, lane] *= W[GROWTH + node, lane]
    for row in range(P_A_FROM[VARIED]):
        W[NODE_P_A + row, lane] *= W[GROWTH + node, lane]


@compiled
def exchange_steps(W, lane):
    """Put the step that was taken in the place of the next one, or back."""
    for row in range(4 * DIMENSION):
        kept = W[POSITION + row, lane]
        W[POSITION + row, lane] = W[PREVIOUS + row, lane]
        W[PREVIOUS + row, lane] = kept
    for row in range(UNKNOWNS):
        kept = W[INCREMENT + row, lane]
        W[INCREMENT + row, lane] = W[SOLVED + row, lane]
        W[SOLVED + row, lane] = kept


@compiled
def room_of(W, variation, lane):
    """Return the first row of the room that a variation has behind all of them."""
    count = int(W[TANGENTS, lane])
    return TANGENT + count * 2 * DIMENSION + variation * (UNKNOWNS + DIMENSION)


@compiled
def parameter_of(W, variation, lane):
    """Return the number of the parameter that is varied; negative if it is none."""
    return variation - int(W[TANGENTS, lane]) + VARIED


@compiled
def vary_momentum_at_start(W, lane):
    """Begin variations of parameters with what they change of p = L_v(q, v)."""
    for parameter in range(VARIED):
        variation = int(W[TANGENTS, lane]) - VARIED + parameter
        dp = TANGENT + variation * 2 * DIMENSION + DIMENSION
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[dp + COORDINATE[P_A_PLACE[row]], lane] = W[NODE_P_A + row, lane]


@compiled
def begin_variation(W, variation, lane):
    """Begin the right side -R_p dp0, in the row of q0, and dp1 - dp0."""
    dp = TANGENT + variation * 2 * DIMENSION + DIMENSION
    room = room_of(W, variation, lane)
    for row in range(UNKNOWNS + DIMENSION):
        W[room + row, lane] = real(0)
    for row in range(DEGREE):
        if ROW_ORDER[row] == 0:
            for s in range(DIMENSION):
                here = room + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
                W[here, lane] = -W[dp + COORDINATE[s], lane]


@compiled
def add_slopes(W, variation, lane):
    """Add to dF and dP at a node what the parameter itself changes."""
    parameter = parameter_of(W, variation, lane)
    if parameter >= 0:
        for row in range(F_A_FROM[parameter], F_A_FROM[parameter + 1]):
            W[NODE_POSITION + F_A_PLACE[row], lane] += W[NODE_F_A + row, lane]
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[NODE_VELOCITY + P_A_PLACE[row], lane] += W[NODE_P_A + row, lane]


@compiled
def vary_start(W, variation, lane):
    """Find dF and dP at a node of a path that is moved by dq0; they stand where q and v stood."""
    dq = TANGENT + variation * 2 * DIMENSION
    for s in range(DIMENSION):
        force = real(0)
        momentum = real(0)
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            moved = W[dq + COORDINATE[b], lane]
            force += W[NODE_L_QQ + s * NODE_STRIDE + b + NODE_OFFSET, lane] * moved
            momentum += W[NODE_L_QV + b * NODE_STRIDE + s + NODE_OFFSET, lane] * moved
        W[NODE_POSITION + s, lane] = force
        W[NODE_VELOCITY + s, lane] = momentum


@compiled
def assemble_variation(W, h, node, variation, lane):
    """Add what a node contributes to the right side: -R_q dq0 - R_a da."""
    room = room_of(W, variation, lane)
    for row in range(DEGREE):
        k = ROW_ORDER[row]
        of_force = h * WEIGHTS[node] * BASIS[node, k]
        of_momentum = WEIGHTS[node] * BASIS_SLOPE[node, k]
        for s in range(DIMENSION):
            change = of_force * W[NODE_POSITION + s, lane]
            change += of_momentum * W[NODE_VELOCITY + s, lane]
            W[room + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane] -= change


@compiled
def factor_equations(W, lane):
    """Factorise the matrix of all unknowns, P S = L U, in its place."""
    factor_pivoted(
        W,
        JACOBIAN + TANGENT_OFFSET,
        TANGENT_UNKNOWNS,
        TANGENT_LOWER,
        TANGENT_UPPER,
        TANGENT_STRIDE,
        lane,
    )


@compiled
def solve_variation(W, variation, lane):
    """Solve for dX of a variation."""
    solve_factored(
        W,
        JACOBIAN + TANGENT_OFFSET,
        room_of(W, variation, lane),
        TANGENT_UNKNOWNS,
        TANGENT_LOWER,
        TANGENT_UPPER,
        TANGENT_STRIDE,
        lane,
    )


@compiled
def vary_path(W, h, node, variation, lane):
    """Find dq and dv of the path at a node."""
    dq = TANGENT + variation * 2 * DIMENSION
    room = room_of(W, variation, lane)
    for s in range(DIMENSION):
        moved = W[dq + COORDINATE[s], lane]
        slope = real(0)
        for column in range(DEGREE):
            k = COLUMN_ORDER[column]
            change = W[room + column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane]
            moved += BASIS[node, k] * change
            slope += BASIS_SLOPE[node, k] * change
        W[NODE_POSITION + s, lane] = moved
        W[NODE_VELOCITY + s, lane] = slope / h


@compiled
def vary_momentum(W, h, node, variation, lane):
    """Add what a node contributes to dp1 - dp0 = h sum_i b_i dF_i."""
    impulse = room_of(W, variation, lane) + UNKNOWNS
    for s in range(DIMENSION):
        force = real(0)
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            entry = s * NODE_STRIDE + b + NODE_OFFSET
            force += W[NODE_L_QQ + entry, lane] * W[NODE_POSITION + b, lane]
            force += W[NODE_L_QV + entry, lane] * W[NODE_VELOCITY + b, lane]
        W[impulse + COORDINATE[s], lane] += h * WEIGHTS[node] * force


@compiled
def add_impulse(W, h, node, variation, lane):
    """Add to dp1 - dp0 what the parameter itself changes of the force at a node."""
    parameter = parameter_of(W, variation, lane)
    impulse = room_of(W, variation, lane) + UNKNOWNS
    if parameter >= 0:
        for row in range(F_A_FROM[parameter], F_A_FROM[parameter + 1]):
            a = COORDINATE[F_A_PLACE[row]]
            W[impulse + a, lane] += h * WEIGHTS[node] * W[NODE_F_A + row, lane]


@compiled
def add_drag(W, lane):
    """Add to F_v at a node what forces depend on velocities."""
    for entry in range(NODE_L_VV - NODE_L_QV):
        W[NODE_L_QV + entry, lane] += W[NODE_F_V + entry, lane]


@compiled
def close_variation(W, variation, lane):
    """Carry a variation to the end of the step: dq1 = dq0 + dX_d, and dp1."""
    dq = TANGENT + variation * 2 * DIMENSION
    room = room_of(W, variation, lane)
    for row in range(DEGREE):
        if COLUMN_ORDER[row] == DEGREE:
            for s in range(DIMENSION):
                here = room + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
                W[dq + COORDINATE[s], lane] += W[here, lane]
    for a in range(DIMENSION):
        W[dq + DIMENSION + a, lane] += W[room + UNKNOWNS + a, lane]


@compiled
def decay_variation(W, variation, lane):
    """Let a momentum decay as that of the step does."""
    dp = TANGENT + variation * 2 * DIMENSION + DIMENSION
    for a in range(DIMENSION):
        W[dp + a, lane] /= W[GROWTH + NODES, lane]


@compiled
def move_variation(W, variation, lane):
    """Multiply a variation by the derivative of the step, and add what a parameter changes."""
    size = 2 * DIMENSION
    here = TANGENT + variation * size
    parameter = parameter_of(W, variation, lane)
    room = room_of(W, variation, lane)
    for row in range(size):
        moved = real(0)
        for column in range(size):
            moved += W[DERIVATIVE + column * size + row, lane] * W[here + column, lane]
        if parameter >= 0:
            moved += W[DERIVATIVE + (size + parameter) * size + row, lane]
        W[room + row, lane] = moved
    for row in range(size):
        W[here + row, lane] = W[room + row, lane]
