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
def assemble(W, h, node, lane):
    """Add a node's part to D_k L_d and to D_k D_m L_d.

    In the residual rounded numbers are those of the path, and what belongs to q0 is made of the
    same products: then the rows are derivatives of one L_d. In the Jacobian they need not be.
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
    for row in range(DEGREE):
        k = ROW_ORDER[row]
        weight_q = h * WEIGHTS[node] * BASIS[node, k]
        weight_v = WEIGHTS[node] * BASIS_SLOPE[node, k]
        for a in range(DIMENSION):
            i = row * EQUATION_ROW_STEP + a * EQUATION_PLACE_STEP
            for column in range(DEGREE):
                m = COLUMN_ORDER[column]
                weight_qq = weight_q * BASIS[node, m]
                weight_qv = WEIGHTS[node] * BASIS[node, k] * BASIS_SLOPE[node, m]
                weight_vq = weight_v * BASIS[node, m]
                weight_vv = weight_v * BASIS_SLOPE[node, m] / h
                entry = JACOBIAN + i * EQUATION_STRIDE + EQUATION_OFFSET
                entry += column * EQUATION_ROW_STEP
                for b in range(max(0, a - BAND), min(DIMENSION, a + BAND + 1)):
                    ab = a * NODE_STRIDE + b + NODE_OFFSET
                    ba = b * NODE_STRIDE + a + NODE_OFFSET
                    W[entry + b * EQUATION_PLACE_STEP, lane] += (
                        weight_qq * W[NODE_L_QQ + ab, lane]
                        + weight_qv * W[NODE_L_QV + ab, lane]
                        + weight_vq * W[NODE_L_QV + ba, lane]
                        + weight_vv * W[NODE_L_VV + ab, lane]
                    )


@compiled
def assemble_drag(W, node, lane):
    """Add to D_k D_m L_d what forces that depend on v contribute: unlike L_qv, by columns alone."""
    for row in range(DEGREE):
        weight = WEIGHTS[node] * BASIS[node, ROW_ORDER[row]]
        for a in range(DIMENSION):
            i = row * EQUATION_ROW_STEP + a * EQUATION_PLACE_STEP
            for column in range(DEGREE):
                slope = weight * BASIS_SLOPE[node, COLUMN_ORDER[column]]
                entry = JACOBIAN + i * EQUATION_STRIDE + EQUATION_OFFSET
                entry += column * EQUATION_ROW_STEP
                for b in range(max(0, a - BAND), min(DIMENSION, a + BAND + 1)):
                    W[entry + b * EQUATION_PLACE_STEP, lane] += (
                        slope * W[NODE_F_V + a * NODE_STRIDE + b + NODE_OFFSET, lane]
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
