"""The derivatives of a step in one matrix, which its tangent and its adjoint share.

With X the increments and the multipliers of a step, its rows R = 0 and its end are differentiated
at the solution:

    [ S    R_q ]    S   by X, in JACOBIAN         R_q   by q0, in START_SLOPES
    [ E_X  E_q ]    E_X, E_q of p1 - p0, in END_SLOPES: first by q0, then by X

By q0 all points of the path move, X being held. By p0 a row of its own is 1. Derivatives by
parameters stay at the nodes, STEP_F_A and STEP_P_A, and those of constraints at the control points.
"""


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
def assemble_slopes_of_drag(W, lane):
    """Add to the derivatives of p1 - p0 what forces contribute that depend on v."""
    size = NODE_L_QV - NODE_L_QQ
    for a in range(DIMENSION):
        for b in range(max(0, a - BAND), min(DIMENSION, a + BAND + 1)):
            ab = a * NODE_STRIDE + b + NODE_OFFSET
            for column in range(DEGREE):
                for node in range(NODES):
                    slope = WEIGHTS[node] * BASIS_SLOPE[node, COLUMN_ORDER[column]]
                    W[END_SLOPES + (column + 1) * size + ab, lane] += (
                        slope * W[STEP_F_V + node * size + ab, lane]
                    )


@compiled
def go_to_node(W, h, node, lane):
    """Say how long the step is, where in it a node is, and that v there goes with 1/h."""
    W[NODE_STEP, lane] = h
    W[NODE_STEP + 1, lane] = PLACES[node]
    W[NODE_STEP + 2, lane] = real(1)


@compiled
def go_to_state(W, h, place, lane):
    """Say the same of a state, of which v is what it is."""
    W[NODE_STEP, lane] = h
    W[NODE_STEP + 1, lane] = real(place)
    W[NODE_STEP + 2, lane] = real(0)


@compiled
def grow_slopes(W, node, lane):
    """Multiply derivatives by parameters at a node by what its weight has grown to."""
    for row in range(F_A_FROM[VARIED]):
        W[NODE_F_A + row, lane] *= W[GROWTH + node, lane]
    for row in range(P_A_FROM[VARIED]):
        W[NODE_P_A + row, lane] *= W[GROWTH + node, lane]


@compiled
def keep_parameter_slopes(W, node, lane):
    """Keep the derivatives of F and P by parameters at a node."""
    for row in range(F_A_FROM[VARIED]):
        W[STEP_F_A + node * F_A_FROM[VARIED] + row, lane] = W[NODE_F_A + row, lane]
    for row in range(P_A_FROM[VARIED]):
        W[STEP_P_A + node * P_A_FROM[VARIED] + row, lane] = W[NODE_P_A + row, lane]


@compiled
def keep_point(W, point, lane):
    """Keep Phi and the second derivatives of lambda.phi at a control point."""
    for entry in range(HELD_SIZE):
        W[POINT_QQ + point * HELD_SIZE + entry, lane] = W[CONSTRAINT_QQ + entry, lane]


@compiled
def keep_point_slopes(W, point, lane):
    """Keep the derivatives of phi and of Phi^T lambda by parameters at a control point."""
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
