"""Variations of q0, p0 and parameters, carried to the end of a step.

A variation is a column of the derivative. TANGENT has dq and dp of all variations. Then follow, for
each variation, the right side of its equations, which becomes dX, and dp1 - dp0. The last VARIED
variations belong to varied parameters and inputs. The equations of a variation are

    S dX = -(R_q dq0 + R_p dp0 + R_a da),
    dq1 = dq0 + dX_d,    dp1 = dp0 + E_q dq0 + E_X dX + E_a da.

With constraints, rows of multipliers h mu follow the rows of increments. The step ends with a
projection: M v + Phi^T nu = p - a, Phi v = 0, and p = M v + a. With P = L_v this gives

    M dv + Phi^T dnu = dp - Hess(nu.phi) dq - P_q dq,    Phi dv = -(v.phi_qq) dq,

and the projected momentum changes by M dv + P_q dq.
"""


@kernel
def tangent(W, h, t, lane):
    """Carry variations of the state to the end of the last step."""
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        find_grid(W, h, t, lane)
        if BY_COLUMNS:
            differentiate_end(W, h, t, lane)
        else:
            if FOLLOWING:
                solve_following(W, h, t, lane)
            differentiate_step(W, h, t, 0, lane)
            factor_equations(W, lane)
        count = int(W[TANGENTS, lane])
        for variation in range(count):
            if BY_COLUMNS:
                dq = variation * 2 * DIMENSION
                move_variation(W, h, t, dq, lane)
                parameter = variation - count + VARIED
                if VARIED_BY and parameter >= 0:
                    for row in range(2 * DIMENSION):
                        changed = W[DERIVATIVE + parameter * 2 * DIMENSION + row, lane]
                        W[TANGENT + dq + row, lane] += changed
            else:
                dq = TANGENT + variation * 2 * DIMENSION
                room = work_row_of(W, variation, lane)
                begin_variation(W, h, dq, room, variation - count + VARIED, lane)
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
def condense(W, h, lane):
    """Eliminate inner control points from the derivatives of D_k L_d by X_m, q0 and parameters.

    The displacement q0 of all points follows X_d, like one more control point. The result
    [[S, R], [E_X, E_q]] gives two equations:

        S dX_d + R dq0 + dp0 = 0,    dp1 - dp0 = E_X dX_d + E_q dq0.
    """
    assemble_entries(W, h, DIMENSION, EQUATION_ROW_STEP, EQUATION_STRIDE, lane)
    if VARIED_BY:  # derivatives by parameters stand beside the others
        right = JACOBIAN + UNKNOWNS * EQUATION_STRIDE
        for parameter in range(VARIED):
            clear(W, right, UNKNOWNS + DIMENSION, lane)
            add_parameter(W, h, right, parameter, lane)
            for row in range(UNKNOWNS):
                here = JACOBIAN + row * EQUATION_STRIDE + UNKNOWNS + parameter
                W[here, lane] = -W[right + row, lane]
    last = UNKNOWNS - 2 * DIMENSION
    for i in range(last):
        row_i = JACOBIAN + i * EQUATION_STRIDE
        inverse = 1 / W[row_i + i, lane]
        for j in range(i + 1, UNKNOWNS):
            row_j = JACOBIAN + j * EQUATION_STRIDE
            factor = W[row_j + i, lane] * inverse
            for k in range(j if SYMMETRIC else i + 1, EQUATION_STRIDE):
                change = factor * W[row_i + k, lane]
                W[row_j + k, lane] -= change
                if SYMMETRIC and j < k < UNKNOWNS:
                    W[JACOBIAN + k * EQUATION_STRIDE + j, lane] -= change
    for a in range(DIMENSION if last > 0 else 0):  # the row of p0 is that of p1 less the impulse
        for k in range(last, EQUATION_STRIDE):
            here = JACOBIAN + (last + a) * EQUATION_STRIDE + k
            impulse = W[here + DIMENSION * EQUATION_STRIDE, lane]
            W[here, lane] = impulse - W[here, lane]
    factor_in_order(W, CONDENSED_END, DIMENSION, EQUATION_STRIDE, lane)


@compiled
def move_end(W, lane):
    """Carry dq, parameters and dp to the end of the step."""
    moved = DIMENSION + VARIED
    for a in range(DIMENSION):
        right = W[TANGENT + moved + a, lane]
        for b in range(moved):
            slope = W[CONDENSED_END + a * EQUATION_STRIDE + DIMENSION + b, lane]
            right += slope * W[TANGENT + b, lane]
        W[RESIDUAL + a, lane] = -right
    solve_in_order(W, CONDENSED_END, RESIDUAL, DIMENSION, EQUATION_STRIDE, lane)
    for a in range(DIMENSION):
        row = CONDENSED_END + (DIMENSION + a) * EQUATION_STRIDE
        momentum = W[TANGENT + moved + a, lane]
        for b in range(DIMENSION):
            momentum += W[row + b, lane] * W[RESIDUAL + b, lane]
        for b in range(moved):
            momentum += W[row + DIMENSION + b, lane] * W[TANGENT + b, lane]
        W[TANGENT + moved + a, lane] = momentum / W[GROWTH + NODES, lane] if DAMPED else momentum
    for a in range(DIMENSION):
        W[TANGENT + a, lane] += W[RESIDUAL + a, lane]


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
def begin_variation(W, h, dq, room, parameter, lane):
    """Find the right side -(R_q dq0 + R_p dp0 + R_a da), and E_q dq0 + E_a da of dp1 - dp0."""
    clear(W, room + DEGREE * DIMENSION, UNKNOWNS - DEGREE * DIMENSION, lane)
    for s in range(DIMENSION):
        impulse = add_product(W, real(0), END_SLOPES, s, 0, dq, lane)
        W[room + UNKNOWNS + COORDINATE[s], lane] = impulse
        for row in range(DEGREE):
            first = START_SLOPES + row * (NODE_L_QV - NODE_L_QQ)
            start = W[dq + DIMENSION + COORDINATE[s], lane] if ROW_ORDER[row] == 0 else real(0)
            start = add_product(W, start, first, s, 0, dq, lane)
            W[room + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane] = -start
    if VARIED_BY:
        add_parameter(W, h, room, parameter, lane)
    if HELD:
        for point in range(DEGREE + 1):
            vary_constraint(W, h, point, dq, room, parameter, lane)


@compiled
def add_product(W, total, first, s, turned, x, lane):
    """Add to a number the row of a matrix at a node times a vector, or its column if ``turned``."""
    for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
        place = b * NODE_STRIDE + s if turned > 0 else s * NODE_STRIDE + b
        total += W[first + place + NODE_OFFSET, lane] * W[x + COORDINATE[b], lane]
    return total


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
                s = P_A_PLACE[entry]
                for row in range(DEGREE):
                    here = room + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
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
def project_variations(W, h, t, lane):
    """Project the variations of p at the end of the step; restore the velocities."""
    find_velocity(W, t + h, lane)
    jet(W, lane)
    if VARIED_BY:
        differentiate_state(W, h, 1, lane)
    for constraint in range(CONSTRAINTS):
        for c in range(CONSTRAINTS):
            W[MULTIPLIER + c, lane] = real(1) if c == constraint else real(0)
        differentiate_constraints(W, lane)
        for variation in range(int(W[TANGENTS, lane])):
            vary_curvature(W, constraint, variation, lane)
    if CARRIED:
        carried_slopes(W, lane)
        if VARIED_BY:
            carried_parameter_slopes(W, lane)
        for variation in range(int(W[TANGENTS, lane])):
            vary_carried(W, variation, lane)
    for s in range(DIMENSION):  # what the projection has taken from p
        a = COORDINATE[s]
        before = W[PREVIOUS + 2 * DIMENSION + a, lane] + W[RESIDUAL + a, lane]
        W[NODE_VELOCITY + s, lane] = before - W[MOMENTUM + a, lane]
    clear(W, CURVATURE, CONSTRAINTS, lane)
    solve_held(W, lane)
    differentiate_constraints(W, lane)
    for variation in range(int(W[TANGENTS, lane])):
        project_variation(W, variation, lane)
    solve_velocity(W, lane)


@compiled
def differentiate_constraints(W, lane):
    """Evaluate phi and Phi^T lambda with their derivatives, by parameters too."""
    constrain(W, lane)
    if VARIED_BY:
        constraint_parameter_slopes(W, lane)


@compiled
def times(W, first, i, turned, x, lane):
    """Multiply row i of the bordered derivatives, or its column, with a vector."""
    total = real(0)
    for b in range(DIMENSION):
        j = HELD_PLACE[b]
        if abs(i - j) <= HELD_BAND:
            place = j * HELD_STRIDE + i if turned > 0 else i * HELD_STRIDE + j
            total += W[first + place + HELD_OFFSET, lane] * W[x + COORDINATE[b], lane]
    return total


@compiled
def vary_constraint(W, h, point, dq, room, parameter, lane):
    """Add the changes of constraints and their forces at a control point to the right side."""
    first = POINT_QQ + point * HELD_SIZE
    if point < DEGREE:
        for s in range(DIMENSION):
            row = ROW_OF_POINT[point] * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            W[room + row, lane] += times(W, first, HELD_PLACE[s], 0, dq, lane) / h
            if VARIED_BY and parameter >= 0:
                pull = W[POINT_QA + (point * VARIED + parameter) * DIMENSION + s, lane] / h
                W[room + row, lane] += pull
                W[room + UNKNOWNS + COORDINATE[s], lane] -= pull
    if point > 0:
        for c in range(CONSTRAINTS):
            row = room + DEGREE * DIMENSION + (point - 1) * CONSTRAINTS + c
            W[row, lane] -= times(W, first, HELD_PLACE[DIMENSION + c], 0, dq, lane) / h
            if VARIED_BY and parameter >= 0:
                W[row, lane] -= (
                    W[POINT_A + (point * VARIED + parameter) * CONSTRAINTS + c, lane] / h
                )


@compiled
def vary_pull(W, h, point, dq, room, lane):
    """Add the change of constraint forces at a control point to dp1 - dp0."""
    column = COLUMN_OF_POINT[point]
    first = POINT_QQ + point * HELD_SIZE
    for s in range(DIMENSION):
        i = HELD_PLACE[s]
        row = first + i * HELD_STRIDE + HELD_OFFSET
        pull = times(W, first, i, 0, dq, lane)
        for b in range(DIMENSION):
            if column >= 0 and abs(i - HELD_PLACE[b]) <= HELD_BAND:
                moved = W[room + column * EQUATION_ROW_STEP + b * EQUATION_PLACE_STEP, lane]
                pull += W[row + HELD_PLACE[b], lane] * moved
        for c in range(CONSTRAINTS):
            j = HELD_PLACE[DIMENSION + c]
            if abs(i - j) <= HELD_BAND:
                change = W[room + DEGREE * DIMENSION + point * CONSTRAINTS + c, lane]
                pull += W[row + j, lane] * change
        W[room + UNKNOWNS + COORDINATE[s], lane] -= pull / h


@compiled
def vary_curvature(W, constraint, variation, lane):
    """Find -(v.phi_qq) dq of a constraint, and the derivative of -Phi v by a parameter."""
    dq = TANGENT + variation * 2 * DIMENSION
    parameter = variation - int(W[TANGENTS, lane]) + VARIED
    total = real(0)
    for s in range(DIMENSION):
        change = times(W, CONSTRAINT_QQ, HELD_PLACE[s], 0, dq, lane)
        total -= W[VELOCITY + COORDINATE[s], lane] * change
    if VARIED_BY and parameter >= 0:
        for s in range(DIMENSION):
            slope = W[CONSTRAINT_QA + parameter * DIMENSION + s, lane]
            total -= W[VELOCITY + COORDINATE[s], lane] * slope
    W[work_row_of(W, variation, lane) + DIMENSION + constraint, lane] = total


@compiled
def project_variation(W, variation, lane):
    """Solve for dv with dp - Hess(nu.phi) dq - P_q dq, and let dp be M dv + P_q dq."""
    dq = TANGENT + variation * 2 * DIMENSION
    dp = dq + DIMENSION
    parameter = variation - int(W[TANGENTS, lane]) + VARIED
    for s in range(DIMENSION):
        right = W[dp + COORDINATE[s], lane]
        right -= times(W, CONSTRAINT_QQ, HELD_PLACE[s], 0, dq, lane)
        right -= add_product(W, real(0), NODE_L_QV, s, 1, dq, lane)
        W[NODE_VELOCITY + s, lane] = right
    if VARIED_BY and parameter >= 0:
        for s in range(DIMENSION):
            W[NODE_VELOCITY + s, lane] -= W[CONSTRAINT_QA + parameter * DIMENSION + s, lane]
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[NODE_VELOCITY + P_A_PLACE[row], lane] -= W[NODE_P_A + row, lane]
    copy(W, work_row_of(W, variation, lane) + DIMENSION, CURVATURE, CONSTRAINTS, lane)
    solve_held(W, lane)
    for s in range(DIMENSION):
        change = add_product(W, real(0), NODE_L_QV, s, 1, dq, lane)
        W[dp + COORDINATE[s], lane] = add_product(W, change, NODE_L_VV, s, 0, VELOCITY, lane)
    if VARIED_BY and parameter >= 0:
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[dp + COORDINATE[P_A_PLACE[row]], lane] += W[NODE_P_A + row, lane]
