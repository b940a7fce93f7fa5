"""The iteration over velocities and forces at the nodes, by loops over coordinates."""


@compiled
def begin_stages(W, lane):
    """Begin with the same velocity at all nodes."""
    for a in range(DIMENSION):
        for node in range(NODES):
            W[STAGE_V + a * STRIDE + node, lane] = (
                W[STAGE_STEP + node, lane] * W[VELOCITY + a, lane]
            )
    W[STAGE_EXPECTED, lane] = 0.0
    W[STAGE_COUNT, lane] = 0.0
    W[CYCLIC_JUMP_SQUARED, lane] = 0.0


@compiled
def sum_stages(W, out, factors, values, lane):
    """Sum what all nodes have of each coordinate, by the factors of each node."""
    for a in range(DIMENSION):
        for node in range(STRIDE if LANES == 1 else NODES):
            W[out + a * STRIDE + node, lane] = real(0)
        for j in range(NODES):
            value = W[values + a * STRIDE + j, lane]
            for node in range(STRIDE if LANES == 1 else NODES):
                W[out + a * STRIDE + node, lane] += W[factors + j * STRIDE + node, lane] * value


@compiled
def enter_node(W, node, lane):
    """Let position and velocity at a node stand where its energies are found from them.

    The velocity gives the node's share of q1 - q0 to the last digit: with a rounded 1/(h b) alone,
    forces would belong to another velocity than momenta.
    """
    share, rate = W[STAGE_STEP + node, lane], W[STAGE_RATE + node, lane]
    for s in range(DIMENSION):
        a = COORDINATE[s]
        moved = W[STAGE_V + a * STRIDE + node, lane]
        first = rate * moved
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + W[STAGE_Q + a * STRIDE + node, lane]
        W[NODE_VELOCITY + s, lane] = first + rate * (moved - share * first)


@compiled
def leave_force(W, node, lane):
    """Keep the force at a node, by its share of the step."""
    share = W[STAGE_STEP + node, lane]
    for s in range(DIMENSION):
        W[STAGE_F + COORDINATE[s] * STRIDE + node, lane] = share * W[NODE_L_Q + s, lane]


@compiled
def leave_velocity(W, node, lane):
    """Find the velocity at a node from the momentum there, and how far the one before was off."""
    share = W[STAGE_STEP + node, lane]
    for s in range(DIMENSION):
        a = COORDINATE[s]
        p = W[MOMENTUM + a, lane] + W[STAGE_P + a * STRIDE + node, lane]
        W[NODE_VELOCITY + s, lane] = p - W[NODE_L_V + s, lane]
    first = NODE_L_VV + NODE_OFFSET
    solve_symmetric(W, first, NODE_VELOCITY, DIMENSION, MASS_BAND, NODE_STRIDE, lane)
    correction, size = real(0), real(0)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        new = share * W[NODE_VELOCITY + s, lane]
        change = new - W[STAGE_V + a * STRIDE + node, lane]
        correction += W[MASS_DIAGONAL + a, lane] * change**2
        size += W[MASS_DIAGONAL + a, lane] * new**2
        W[STAGE_V + a * STRIDE + node, lane] = new
    W[STAGE_CORRECTION + node, lane] = correction
    W[STAGE_SIZE + node, lane] = size


@compiled
def close_stages(W, lane):
    """Add what the nodes contribute to q and p, with what rounding lost carried along."""
    for row in range(4 * DIMENSION):
        W[PREVIOUS + row, lane] = W[POSITION + row, lane]
    for a in range(DIMENSION):
        increment = over_nodes(W, STAGE_V + a * STRIDE, lane) + W[POSITION_LOW + a, lane]
        add_exactly(W, POSITION + a, POSITION_LOW + a, increment, lane)
        increment = over_nodes(W, STAGE_F + a * STRIDE, lane) + W[MOMENTUM_LOW + a, lane]
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, increment, lane)


@compiled
def extrapolate_stages(W, lane):
    """Extrapolate velocities to the nodes of the next step, with care after many iterations."""
    smooth = NODES * STRIDE if W[STAGE_COUNT, lane] > MANY else 0
    sum_stages(W, STAGE_Q, STAGE_AHEAD + smooth, STAGE_V, lane)
    for row in range(DIMENSION * STRIDE):
        W[STAGE_V + row, lane] = W[STAGE_Q + row, lane]
