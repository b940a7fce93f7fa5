"""Variations of q0, p0 and parameters, carried to the end of a step.

A variation is a column of the derivative: dq and dp stand in TANGENT, those of all variations one
behind the other; behind them each has room for the right side of its equations, which becomes dX,
and for dp1 - dp0. The last VARIED of them belong to the parameters and inputs that are varied. At
the solution S dX = -(R_q dq0 + R_p dp0 + R_a da), and then dq1 = dq0 + dX_d,
dp1 = dp0 + E_q dq0 + E_X dX + E_a da.
"""


@kernel
def tangent(W, h, t, lane):
    """Carry variations of the state to the end of the step that was taken."""
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        if FOLLOWING:
            step_equations(W, h, t, lane)
            solve_following(W, lane)
        if BY_COLUMNS:
            find_derivative(W, h, t, lane)
            for variation in range(int(W[TANGENTS, lane])):
                move_variation(W, variation, lane)
        else:
            for node in range(NODES):
                differentiate_node(W, h, t, node, lane)
            assemble_derivatives(W, h, t, lane)
            factor_equations(W, lane)
            for variation in range(int(W[TANGENTS, lane])):
                dq = TANGENT + variation * 2 * DIMENSION
                room = work_row_of(W, variation, lane)
                begin_variation(W, h, dq, room, parameter_of(W, variation, lane), lane)
                solve_factored(W, room, lane)
                close_variation(W, h, dq, room, lane)
        if HELD:
            impulse_of_step(W, h, t, lane)
        exchange_steps(W, lane)
        if HELD:
            project_variations(W, h, t, lane)
        if CONSTANT_MASS:
            factor_at_start(W, t + h, lane)


@compiled
def find_derivative(W, h, t, lane):
    """Find the derivative of a step as a whole, column by column."""
    for node in range(NODES):
        differentiate_node(W, h, t, node, lane)
    assemble_derivatives(W, h, t, lane)
    factor_in_order(W, JACOBIAN, UNKNOWNS, EQUATION_STRIDE, lane)
    for column in range(2 * DIMENSION + VARIED):
        dq = DERIVATIVE + column * 2 * DIMENSION
        room = COLUMN_ROOM + column * (UNKNOWNS + DIMENSION)
        begin_column(W, column, lane)
        begin_variation(W, h, dq, room, column - 2 * DIMENSION, lane)
        solve_in_order(W, JACOBIAN, room, UNKNOWNS, EQUATION_STRIDE, lane)
        close_variation(W, h, dq, room, lane)


@kernel
def momentum_slopes(W, h, t, lane):
    """Set dp0 = dP/da for each varied parameter, where v0 is given and p0 = L_v(q0, v0)."""
    go_to_start(W, t, lane)
    differentiate_state(W, h, 0, lane)
    for parameter in range(VARIED):
        variation = int(W[TANGENTS, lane]) - VARIED + parameter
        dp = TANGENT + variation * 2 * DIMENSION + DIMENSION
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[dp + COORDINATE[P_A_PLACE[row]], lane] = W[NODE_P_A + row, lane]


@compiled
def work_row_of(W, variation, lane):
    """Return the first row of a variation's workspace, which holds its right side."""
    count = int(W[TANGENTS, lane])
    return TANGENT + count * 2 * DIMENSION + variation * (UNKNOWNS + DIMENSION)


@compiled
def parameter_of(W, variation, lane):
    """Return the index among the varied parameters; negative for any other variation."""
    return variation - int(W[TANGENTS, lane]) + VARIED


@compiled
def begin_variation(W, h, dq, room, parameter, lane):
    """Find the right side -(R_q dq0 + R_p dp0 + R_a da), and E_q dq0 + E_a da of dp1 - dp0."""
    for row in range(DEGREE * DIMENSION, UNKNOWNS):
        W[room + row, lane] = real(0)
    for s in range(DIMENSION):
        impulse = real(0)
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            slope = W[END_SLOPES + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            impulse += slope * W[dq + COORDINATE[b], lane]
        W[room + UNKNOWNS + COORDINATE[s], lane] = impulse
        for row in range(DEGREE):
            first = START_SLOPES + row * (NODE_L_QV - NODE_L_QQ) + s * NODE_STRIDE + NODE_OFFSET
            start = W[dq + DIMENSION + COORDINATE[s], lane] if ROW_ORDER[row] == 0 else real(0)
            for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                start += W[first + b, lane] * W[dq + COORDINATE[b], lane]
            W[room + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane] = -start
    if VARIED_BY:
        add_parameter(W, h, room, parameter, lane)
    if HELD:
        for point in range(DEGREE + 1):
            vary_constraint(W, h, point, dq, room, parameter, lane)


@compiled
def add_parameter(W, h, room, parameter, lane):
    """Add dF/da and dP/da of all nodes to the right side, and dF/da to dp1 - dp0."""
    if parameter >= 0:
        for node in range(NODES):
            for entry in range(F_A_FROM[parameter], F_A_FROM[parameter + 1]):
                slope = W[STEP_F_A + node * F_A_FROM[VARIED] + entry, lane]
                force = h * WEIGHTS[node] * slope
                s = F_A_PLACE[entry]
                W[room + UNKNOWNS + COORDINATE[s], lane] += force
                for row in range(DEGREE):
                    here = room + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
                    W[here, lane] -= BASIS[node, ROW_ORDER[row]] * force
            for entry in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
                slope = W[STEP_P_A + node * P_A_FROM[VARIED] + entry, lane]
                momentum = WEIGHTS[node] * slope
                for row in range(DEGREE):
                    here = room + row * EQUATION_ROW_STEP
                    here += P_A_PLACE[entry] * EQUATION_PLACE_STEP
                    W[here, lane] -= BASIS_SLOPE[node, ROW_ORDER[row]] * momentum


@compiled
def close_variation(W, h, dq, room, lane):
    """Carry a variation to the end of the step: dq1 = dq0 + dX_d, and dp1."""
    if HELD:
        for point in range(DEGREE):
            vary_pull(W, h, point, dq, room, lane)
    for s in range(DIMENSION):
        impulse = W[room + UNKNOWNS + COORDINATE[s], lane]
        for column in range(DEGREE):
            first = END_SLOPES + (column + 1) * (NODE_L_QV - NODE_L_QQ)
            first += s * NODE_STRIDE + NODE_OFFSET
            moved = room + column * EQUATION_ROW_STEP
            for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                impulse += W[first + b, lane] * W[moved + b * EQUATION_PLACE_STEP, lane]
            if COLUMN_ORDER[column] == DEGREE:
                W[dq + COORDINATE[s], lane] += W[moved + s * EQUATION_PLACE_STEP, lane]
        W[dq + DIMENSION + COORDINATE[s], lane] += impulse
        if DAMPED:
            W[dq + DIMENSION + COORDINATE[s], lane] /= W[GROWTH + NODES, lane]


@compiled
def begin_column(W, column, lane):
    """Set a column to a unit vector, or to zero for a parameter."""
    for row in range(2 * DIMENSION):
        W[DERIVATIVE + column * 2 * DIMENSION + row, lane] = real(1) if row == column else real(0)


@compiled
def move_variation(W, variation, lane):
    """Multiply a variation by the derivative of the step, and add what a parameter changes."""
    dq = TANGENT + variation * 2 * DIMENSION
    room = work_row_of(W, variation, lane)
    parameter = parameter_of(W, variation, lane)
    size = 2 * DIMENSION
    for row in range(size):
        moved = real(0)
        for column in range(size):
            moved += W[DERIVATIVE + column * size + row, lane] * W[dq + column, lane]
        if parameter >= 0:
            moved += W[DERIVATIVE + (size + parameter) * size + row, lane]
        W[room + row, lane] = moved
    for row in range(size):
        W[dq + row, lane] = W[room + row, lane]
