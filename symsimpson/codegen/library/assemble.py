"""Residual and Jacobian from what the nodes contribute."""


@compiled
def grow_node(W, node, lane):
    """Multiply what a node contributes by what its weight has grown to."""
    growth = W[GROWTH + node, lane]
    for a in range(DIMENSION):
        W[NODE_L_Q + a, lane] *= growth
        W[NODE_L_V + a, lane] *= growth
    for entry in range(NODE_L_QV - NODE_L_QQ):
        W[NODE_L_QQ + entry, lane] *= growth
        W[NODE_L_QV + entry, lane] *= growth
        W[NODE_L_VV + entry, lane] *= growth


@compiled
def assemble_rows(W, h, node, lane):
    """Add a node's part to D_k L_d.

    Rounded numbers are those of the path, and what belongs to q0 is made of the same products: then
    the rows are derivatives of one L_d. In the Jacobian they need not be.
    """
    weight = h * WEIGHTS[node]
    rate = 1 / h
    for a in range(DIMENSION):
        force = weight * W[NODE_L_Q + a, lane]
        momentum = rate * (weight * W[NODE_L_V + a, lane])
        start = (force - PLACES[node] * force) - momentum
        for row in range(DEGREE):
            k = ROW_ORDER[row]  # 0 comes last
            part = start
            if k > 0:
                part = BASIS[node, k] * force + BASIS_SLOPE[node, k] * momentum
                start -= (1 - POINTS[k]) * part
            W[RESIDUAL + row * EQUATION_ROW_STEP + a * EQUATION_PLACE_STEP, lane] += part


@compiled
def keep_jet(W, node, lane):
    """Keep the derivatives of F and P by q and v at a node."""
    size = NODE_L_QV - NODE_L_QQ
    for entry in range(size):
        W[STEP_QQ + node * size + entry, lane] = W[NODE_L_QQ + entry, lane]
        W[STEP_QV + node * size + entry, lane] = W[NODE_L_QV + entry, lane]
        W[STEP_VV + node * size + entry, lane] = W[NODE_L_VV + entry, lane]


@compiled
def keep_drag(W, node, lane):
    """Keep what forces at a node depend on v."""
    size = NODE_L_QV - NODE_L_QQ
    for entry in range(size):
        W[STEP_F_V + node * size + entry, lane] = W[NODE_F_V + entry, lane]


@compiled
def assemble_matrix(W, h, lane):
    """Add up what the nodes contribute to D_k D_m L_d: entry by entry, the nodes last."""
    rate = 1 / h
    size = NODE_L_QV - NODE_L_QQ
    for row in range(DEGREE):
        k = ROW_ORDER[row]
        for a in range(DIMENSION):
            i = row * EQUATION_ROW_STEP + a * EQUATION_PLACE_STEP
            for column in range(DEGREE):
                m = COLUMN_ORDER[column]
                first = JACOBIAN + i * EQUATION_STRIDE + EQUATION_OFFSET
                first += column * EQUATION_ROW_STEP
                for b in range(max(0, a - BAND), min(DIMENSION, a + BAND + 1)):
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
                    W[first + b * EQUATION_PLACE_STEP, lane] = entry


@compiled
def assemble_matrix_of_drag(W, lane):
    """Add to it what forces contribute that depend on v: unlike L_qv, by columns alone."""
    size = NODE_L_QV - NODE_L_QQ
    for row in range(DEGREE):
        for a in range(DIMENSION):
            i = row * EQUATION_ROW_STEP + a * EQUATION_PLACE_STEP
            for column in range(DEGREE):
                first = JACOBIAN + i * EQUATION_STRIDE + EQUATION_OFFSET
                first += column * EQUATION_ROW_STEP
                for b in range(max(0, a - BAND), min(DIMENSION, a + BAND + 1)):
                    ab = a * NODE_STRIDE + b + NODE_OFFSET
                    for node in range(NODES):
                        weight = WEIGHTS[node] * BASIS[node, ROW_ORDER[row]]
                        weight *= BASIS_SLOPE[node, COLUMN_ORDER[column]]
                        W[first + b * EQUATION_PLACE_STEP, lane] += (
                            weight * W[STEP_F_V + node * size + ab, lane]
                        )


@compiled
def inertia(W, h, lane):
    """Begin the rows of a constant M: S M Y of the bends, and h p0 - M X_d where p0 belongs to it.

    Each D_k is evaluated by itself and enters rows as a whole; their matrix has combined factors.
    """
    end = INCREMENT + (DEGREE - 1) * DIMENSION
    for s in range(DIMENSION):
        start = h * W[MOMENTUM + COORDINATE[s], lane]
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            mass = W[MASS + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            start -= mass * W[end + COORDINATE[b], lane]
        for row in range(BLOCKS):
            i = row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP
            W[RESIDUAL + i, lane] = TEST_START[row] * start
            for column in range(BLOCKS):
                stiffness = TEST_STIFFNESS[row, column]
                entry = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET + column * SOLVE_ROW_STEP
                for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                    mass = stiffness * W[MASS + s * NODE_STRIDE + b + NODE_OFFSET, lane]
                    W[entry + b * SOLVE_PLACE_STEP, lane] = mass
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
            for row in range(BLOCKS):
                i = row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP
                W[RESIDUAL + i, lane] += TEST_ROWS[row, k] * value


@compiled
def assemble_forces(W, h, node, lane):
    """Add the forces at a node and their derivatives to these rows."""
    for s in range(DIMENSION):
        force = h * (h * WEIGHTS[node] * W[NODE_L_Q + s, lane])
        for row in range(BLOCKS):
            value = TEST_START[row] * (force - PLACES[node] * force)
            for k in range(1, DEGREE):
                value += TEST_ROWS[row, k] * (BASIS[node, k] * force)
            W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane] += value
    for row in range(BLOCKS):
        weight = h * h * TEST_FORCE[node, row]
        for s in range(DIMENSION):
            i = row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP
            for column in range(BLOCKS):
                slope = weight * BASIS[node, SOLVE_COLUMNS[column]]
                entry = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET + column * SOLVE_ROW_STEP
                for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                    W[entry + b * SOLVE_PLACE_STEP, lane] += (
                        slope * W[NODE_L_QQ + s * NODE_STRIDE + b + NODE_OFFSET, lane]
                    )
