"""Residual and Jacobian as sums over the nodes."""


@compiled
def grow_node(W, node, lane):
    """Multiply the values of a node by the growth factor of its weight."""
    growth = W[GROWTH + node, lane]
    size = NODE_L_QV - NODE_L_QQ
    multiply(W, NODE_L_Q, DIMENSION, growth, lane)
    multiply(W, NODE_L_V, DIMENSION, growth, lane)
    multiply(W, NODE_L_QQ, size, growth, lane)
    multiply(W, NODE_L_QV, size, growth, lane)
    multiply(W, NODE_L_VV, size, growth, lane)


@compiled
def weigh_node(W, h, node, lane):
    """Store h b_i F and h b_i P of a node: rows of a step are rounded here and nowhere else."""
    weight = h * WEIGHTS[node]
    for a in range(DIMENSION):
        W[STEP_F + node * DIMENSION + a, lane] = weight * W[NODE_L_Q + a, lane]
        W[STEP_P + node * DIMENSION + a, lane] = weight * W[NODE_L_V + a, lane]


@compiled
def assemble_residual(W, h, lane):
    """Add up D_k L_d over the nodes.

    A step is symplectic if its equations are the derivatives of one function L_d, whatever that
    function is. Therefore rounded numbers must be the same in the path and here. With the bends
    Y_k = X_k - c_k X_d of the path, 0 < k < d,

        q_i = q0 + c_i X_d + sum_k A_ik Y_k,    v_i = (X_d + sum_k B_ik Y_k)/h,

    the row of q0 has no differences of tables, and no large numbers that cancel:

        p0 + sum_i h b_i F_i - sum_i c_i h b_i F_i - (1/h) sum_i h b_i P_i = 0.

    Its forces are added up first: 1 - c_i need not be what rounding makes of it. Elimination is
    stable if it is this row less sum_k (1 - c_k) D_k L_d, which vanishes at the solution.
    """
    rate = 1 / h
    for a in range(DIMENSION):
        whole = W[MOMENTUM + COORDINATE[a], lane]
        share = real(0)
        inertia = real(0)
        for node in range(NODES):
            force = W[STEP_F + node * DIMENSION + a, lane]
            inertia += W[STEP_P + node * DIMENSION + a, lane]
            if TRACED and EXACT_PLACE[node] > 0:  # 1 - c_i is not rounded
                whole += (1 - PLACES[node]) * force
            else:
                whole += force
                share += PLACES[node] * force
        rest = real(0)
        for row in range(DEGREE):
            k = ROW_ORDER[row]  # 0 comes last
            here = RESIDUAL + row * EQUATION_ROW_STEP + a * EQUATION_PLACE_STEP
            if k > 0:
                part = real(0)
                moved = real(0)
                for node in range(NODES):
                    part += BASIS[node, k] * W[STEP_F + node * DIMENSION + a, lane]
                    moved += BASIS_SLOPE[node, k] * W[STEP_P + node * DIMENSION + a, lane]
                W[here, lane] = part + rate * moved
                rest += (1 - POINTS[k]) * W[here, lane]
            else:
                W[here, lane] = whole - share - rate * inertia - rest


@compiled
def keep_node(W, node, lane):
    """Store the derivatives of F and P by q and v at a node."""
    size = NODE_L_QV - NODE_L_QQ
    for entry in range(size):
        W[STEP_QQ + node * size + entry, lane] = W[NODE_L_QQ + entry, lane]
        W[STEP_QV + node * size + entry, lane] = W[NODE_L_QV + entry, lane]
        W[STEP_VV + node * size + entry, lane] = W[NODE_L_VV + entry, lane]
    if DRAGGED:
        copy(W, NODE_F_V, STEP_F_V + node * size, size, lane)


@compiled
def assemble_entries(W, h, count, row_step, stride, lane):
    """Add up D_k D_m L_d over the nodes, for the first ``count`` coordinates."""
    rate = 1 / h
    size = NODE_L_QV - NODE_L_QQ
    if CLEARED > 0:
        clear(W, JACOBIAN, CLEARED, lane)
    for row in range(DEGREE):
        k = ROW_ORDER[row]
        for a in range(count):
            i = row * row_step + a * EQUATION_PLACE_STEP
            for column in range(DEGREE):
                m = COLUMN_ORDER[column]
                first = JACOBIAN + i * stride + EQUATION_OFFSET
                first += column * row_step
                for b in range(max(0, a - BAND), min(count, a + BAND + 1)):
                    ab = a * NODE_STRIDE + b + NODE_OFFSET
                    ba = b * NODE_STRIDE + a + NODE_OFFSET
                    entry = real(0)
                    for node in range(NODES):
                        here = node * size
                        weight = h * (WEIGHTS[node] * BASIS[node, k] * BASIS[node, m])
                        entry += weight * W[STEP_QQ + here + ab, lane]
                        weight = WEIGHTS[node] * BASIS[node, k] * BASIS_SLOPE[node, m]
                        entry += weight * W[STEP_QV + here + ab, lane]
                        weight = WEIGHTS[node] * BASIS_SLOPE[node, k] * BASIS[node, m]
                        entry += weight * W[STEP_QV + here + ba, lane]
                        weight = WEIGHTS[node] * BASIS_SLOPE[node, k] * BASIS_SLOPE[node, m]
                        entry += rate * weight * W[STEP_VV + here + ab, lane]
                        if DRAGGED:  # unlike L_qv, by columns alone
                            weight = WEIGHTS[node] * BASIS[node, k] * BASIS_SLOPE[node, m]
                            entry += weight * W[STEP_F_V + here + ab, lane]
                    W[first + b * EQUATION_PLACE_STEP, lane] = entry


@compiled
def inertia(W, h, lane):
    """Begin the rows of a constant M, times h: S M Y of the bends, and -M X_d.

    The factors of the matrix are combined already. The rows D_k are combined later.
    """
    end = INCREMENT + (DEGREE - 1) * DIMENSION
    for s in range(DIMENSION):
        straight = real(0)
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            mass = W[MASS + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            straight += mass * W[end + COORDINATE[b], lane]
        W[ROW + s, lane] = -straight
        for k in range(1, DEGREE):
            value = real(0)
            for m in range(1, DEGREE):
                moved = real(0)
                for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                    a = COORDINATE[b]
                    bend = W[INCREMENT + (m - 1) * DIMENSION + a, lane]
                    bend -= POINTS[m] * W[end + a, lane]
                    moved += W[MASS + s * NODE_STRIDE + b + NODE_OFFSET, lane] * bend
                value += STIFFNESS[k - 1, m - 1] * moved
            W[ROW + k * DIMENSION + s, lane] = value
        for row in range(BLOCKS):
            i = row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP
            for column in range(BLOCKS):
                stiffness = TEST_STIFFNESS[row, column]
                entry = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET + column * SOLVE_ROW_STEP
                for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                    mass = stiffness * W[MASS + s * NODE_STRIDE + b + NODE_OFFSET, lane]
                    W[entry + b * SOLVE_PLACE_STEP, lane] = mass


@compiled
def correct_end(W, h, lane):
    """Find the correction of X_d from its linearised row, after the other corrections.

    Then the end of the path is known without the force at the solution.
    """
    square = h * h
    size = NODE_L_QV - NODE_L_QQ
    for s in range(DIMENSION):
        row = W[ROW + LAST * DIMENSION + s, lane]
        for node in FORCE_NODES:
            for column in range(BLOCKS):
                slope = square * (LAST_FORCE[node] * BASIS[node, SOLVE_COLUMNS[column]])
                right = RESIDUAL + column * SOLVE_ROW_STEP
                for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                    change = slope * W[right + b * SOLVE_PLACE_STEP, lane]
                    row -= (
                        change * W[STEP_QQ + node * size + s * NODE_STRIDE + b + NODE_OFFSET, lane]
                    )
        W[NODE_VELOCITY + s, lane] = row
    solve_mass(W, lane)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        change = LAST_SCALE * W[VELOCITY + a, lane]
        for column in range(BLOCKS):
            correction = W[RESIDUAL + column * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane]
            change -= LAST_MOVED[column] * correction
        W[RESIDUAL + BLOCKS * DIMENSION + s, lane] = change
