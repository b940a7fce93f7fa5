"""The derivatives of a step in one matrix, which its tangent and its adjoint share.

With X the increments and the multipliers of a step, its rows R = 0 and its end are differentiated
at the solution:

    [ S    R_q ]    S   by X, in JACOBIAN         R_q   by q0, in START_SLOPES
    [ E_X  E_q ]    E_X, E_q of p1 - p0, in END_SLOPES: first by q0, then by X

With q0 all points of the path move, at constant X. The derivative of the row of p0 by p0 is 1.
Derivatives by parameters are stored at the nodes, in STEP_F_A and STEP_P_A. Derivatives of
constraints are stored at the control points.
"""


@compiled
def differentiate_step(W, h, t, costed, lane):
    """Assemble the matrix, and add a running cost at the nodes if there is one."""
    for node in range(NODES):
        differentiate_node(W, h, t, node, lane)
        if COSTED and costed > 0:
            cost_at_node(W, h, t, node, lane)
            add_cost(W, h, node, lane)
    assemble_entries(W, h, DIMENSION, EQUATION_ROW_STEP, EQUATION_STRIDE, lane)
    assemble_slopes(W, h, lane)
    if HELD:
        assemble_constraints(W, h, t, 1, lane)


@compiled
def differentiate_node(W, h, t, node, lane):
    """Evaluate and store the derivatives of F and P at a node."""
    if TRACED and CYCLIC > 0:
        cyclic_point(W, h, t, node, 0, lane)
        copy(W, CYCLIC_V + node * CYCLIC, NODE_VELOCITY + OTHERS, CYCLIC, lane)
    else:
        at_node(W, h, t, node, lane)
    jet(W, lane)
    if DAMPED:
        grow_node(W, node, lane)
    if VARIED_BY:
        if SIZED:
            go_to_place(W, h, PLACES[node], real(1), lane)
        parameter_slopes(W, lane)
        if DAMPED:
            multiply(W, NODE_F_A, F_A_FROM[VARIED], W[GROWTH + node, lane], lane)
            multiply(W, NODE_P_A, P_A_FROM[VARIED], W[GROWTH + node, lane], lane)
        copy(W, NODE_F_A, STEP_F_A + node * F_A_FROM[VARIED], F_A_FROM[VARIED], lane)
        copy(W, NODE_P_A, STEP_P_A + node * P_A_FROM[VARIED], P_A_FROM[VARIED], lane)
    keep_node(W, node, lane)


@compiled
def find_grid(W, h, t, lane):
    """Count the steps before this one, if h moves their times, too."""
    if GRIDDED:
        W[TIME_GRID + 2, lane] = W[TIME_GRID, lane] * (t - W[TIME_GRID + 1, lane]) / h


@compiled
def differentiate_state(W, h, place, lane):
    """Evaluate the derivatives of F and P by parameters at the start (0) or end (1) of a step."""
    if SIZED:
        go_to_place(W, h, real(place), real(0), lane)
    parameter_slopes(W, lane)


@compiled
def assemble_slopes(W, h, lane):
    """Add up R_q and the derivatives of p1 - p0 = h sum_i b_i F_i over the nodes."""
    size = NODE_L_QV - NODE_L_QQ
    for a in range(DIMENSION):
        for b in range(max(0, a - BAND), min(DIMENSION, a + BAND + 1)):
            ab = a * NODE_STRIDE + b + NODE_OFFSET
            ba = b * NODE_STRIDE + a + NODE_OFFSET
            end = real(0)
            for node in range(NODES):
                end += h * WEIGHTS[node] * W[STEP_QQ + node * size + ab, lane]
            W[END_SLOPES + ab, lane] = end
            for column in range(DEGREE):
                m = COLUMN_ORDER[column]
                end = real(0)
                for node in range(NODES):
                    weight = h * WEIGHTS[node] * BASIS[node, m]
                    end += weight * W[STEP_QQ + node * size + ab, lane]
                    weight = WEIGHTS[node] * BASIS_SLOPE[node, m]
                    end += weight * W[STEP_QV + node * size + ab, lane]
                W[END_SLOPES + (column + 1) * size + ab, lane] = end
                if DRAGGED:
                    for node in range(NODES):
                        slope = WEIGHTS[node] * BASIS_SLOPE[node, m]
                        slope *= W[STEP_F_V + node * size + ab, lane]
                        W[END_SLOPES + (column + 1) * size + ab, lane] += slope
            for row in range(DEGREE):
                k = ROW_ORDER[row]
                start = real(0)
                for node in range(NODES):
                    weight = h * WEIGHTS[node] * BASIS[node, k]
                    start += weight * W[STEP_QQ + node * size + ab, lane]
                    weight = WEIGHTS[node] * BASIS_SLOPE[node, k]
                    start += weight * W[STEP_QV + node * size + ba, lane]
                W[START_SLOPES + row * size + ab, lane] = start


@compiled
def go_to_place(W, h, place, moving, lane):
    """Store h, a place in the step, and 1 if v there is divided by h, else 0."""
    W[NODE_STEP, lane] = h
    W[NODE_STEP + 1, lane] = place + W[TIME_GRID + 2, lane] if GRIDDED else place
    W[NODE_STEP + 2, lane] = moving


@compiled
def keep_point(W, h, point, lane):
    """Store derivatives of phi and Phi^T lambda by q and by parameters at a control point."""
    copy(W, CONSTRAINT_QQ, POINT_QQ + point * HELD_SIZE, HELD_SIZE, lane)
    if VARIED_BY:
        if SIZED and (ROLLING or MOVING):
            go_to_place(W, h, POINTS[point], real(1), lane)
        constraint_parameter_slopes(W, lane)
        size = VARIED * CONSTRAINTS
        copy(W, CONSTRAINT_A, POINT_A + point * size, size, lane)
        size = VARIED * DIMENSION
        copy(W, CONSTRAINT_QA, POINT_QA + point * size, size, lane)


@compiled
def exchange_steps(W, lane):
    """Exchange the rows of the last step with the rows of the next one."""
    exchange(W, POSITION, PREVIOUS, 4 * DIMENSION, lane)
    exchange(W, INCREMENT, SOLVED, UNKNOWNS, lane)


@compiled
def impulse_of_step(W, h, t, lane):
    """Find p1 - p0 of the step, before the projection."""
    begin_impulse(W, h, t, lane)
    for node in range(NODES):
        at_node(W, h, t, node, lane)
        jet(W, lane)
        accumulate(W, h, node, lane)
