"""The derivatives of a step in one matrix, which its tangent and its adjoint share.

With X the increments and the multipliers of a step, its rows R = 0 and its end are differentiated
at the solution:

    [ S    R_q ]    S   by X, in JACOBIAN         R_q   by q0, in START_SLOPES
    [ E_X  E_q ]    E_X, E_q of p1 - p0, in END_SLOPES: first by q0, then by X

By q0 all points of the path move, X being held. By p0 a row of its own is 1. Derivatives by
parameters stay at the nodes, STEP_F_A and STEP_P_A, and those of constraints at the control points.
"""


@compiled
def differentiate_node(W, h, t, node, lane):
    """Evaluate and keep the derivatives of F and P at a node."""
    if TRACED and CYCLIC > 0:
        cyclic_state(W, h, t, node, 0, lane)
    else:
        at_node(W, h, t, node, lane)
    jet(W, lane)
    if DAMPED:
        grow_node(W, node, lane)
    if VARIED_BY:
        if SIZED:
            go_to_place(W, h, PLACES[node], real(1), lane)
        parameter_slopes(W, lane)
        keep_parameter_slopes(W, node, lane)
    keep_node(W, node, lane)


@compiled
def assemble_derivatives(W, h, t, lane):
    """Assemble the matrix, from what is kept of the nodes and from the constraints."""
    assemble_nodes(W, h, lane)
    assemble_slopes(W, h, lane)
    if HELD:
        for point in range(DEGREE + 1 if HOLONOMIC > 0 else DEGREE):
            at_point(W, h, t, point, lane)
            constrain(W, lane)
            assemble_constraint(W, h, point, lane)
            if VARIED_BY:
                if SIZED and ROLLING:
                    go_to_place(W, h, POINTS[point], real(1), lane)
                constraint_parameter_slopes(W, lane)
            keep_point(W, point, lane)
    if ROLLING:
        for node in range(NODES, NODES + DEGREE):
            at_node(W, h, t, node, lane)
            rates(W, lane)
            assemble_rates(W, h, node, lane)
            if VARIED_BY:
                if SIZED:
                    go_to_place(W, h, PLACES[node], real(1), lane)
                rate_parameter_slopes(W, lane)
            keep_rates(W, h, node, lane)


@compiled
def differentiate_state(W, h, place, lane):
    """Evaluate the derivatives of F and P by parameters at the start of a step or at its end."""
    if SIZED:
        go_to_place(W, h, real(place), real(0), lane)
    parameter_slopes(W, lane)


@compiled
def assemble_slopes(W, h, lane):
    """Add up what the nodes contribute to R_q, and to derivatives of p1 - p0 = h sum_i b_i F_i."""
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
    """Keep the size of the step, a place in it, and whether v there is divided by h: 1 or 0."""
    W[NODE_STEP, lane] = h
    W[NODE_STEP + 1, lane] = place
    W[NODE_STEP + 2, lane] = moving


@compiled
def keep_parameter_slopes(W, node, lane):
    """Keep the derivatives of F and P by parameters at a node, times what its weight grows to."""
    if DAMPED:
        for row in range(F_A_FROM[VARIED]):
            W[NODE_F_A + row, lane] *= W[GROWTH + node, lane]
        for row in range(P_A_FROM[VARIED]):
            W[NODE_P_A + row, lane] *= W[GROWTH + node, lane]
    for row in range(F_A_FROM[VARIED]):
        W[STEP_F_A + node * F_A_FROM[VARIED] + row, lane] = W[NODE_F_A + row, lane]
    for row in range(P_A_FROM[VARIED]):
        W[STEP_P_A + node * P_A_FROM[VARIED] + row, lane] = W[NODE_P_A + row, lane]


@compiled
def keep_point(W, point, lane):
    """Keep Phi and the second derivatives of lambda.phi at a control point.

    The derivatives of phi and of Phi^T lambda by parameters follow.
    """
    for entry in range(HELD_SIZE):
        W[POINT_QQ + point * HELD_SIZE + entry, lane] = W[CONSTRAINT_QQ + entry, lane]
    if VARIED_BY:
        for entry in range(VARIED * CONSTRAINTS):
            W[POINT_A + point * VARIED * CONSTRAINTS + entry, lane] = W[CONSTRAINT_A + entry, lane]
        for entry in range(VARIED * DIMENSION):
            W[POINT_QA + point * VARIED * DIMENSION + entry, lane] = W[CONSTRAINT_QA + entry, lane]


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
def impulse_of_step(W, h, t, lane):
    """Find p1 - p0 of the step, before the projection."""
    clear_momentum(W, lane)
    for point in range(DEGREE):
        at_point(W, h, t, point, lane)
        constraint_slopes(W, lane)
        add_pull(W, lane)
    divide_pulls(W, h, lane)
    for node in range(NODES):
        at_node(W, h, t, node, lane)
        jet(W, lane)
        accumulate(W, h, node, lane)
