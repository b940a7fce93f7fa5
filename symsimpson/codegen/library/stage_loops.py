"""The iteration over velocities and forces at the nodes, which are the lanes of vector code.

With as many nodes as degrees the path is given by the velocities v_j at its nodes,

    q_i = q0 + sum_j (a_ij/b_j) (h b_j v_j),    p_i = p0 + sum_j (1 - a_ji/b_i) (h b_j f_j),

f_j = L_q(q_j, v_j) and M(q_j) v_j = p_j - a(q_j): a symplectic partitioned Runge-Kutta method. An
iteration takes positions from velocities, forces from positions, momenta from forces and velocities
from momenta, with one small solve a node; what contracts is h^2 K rather than h. All nodes are
treated alike, so they are lanes, and one trajectory fills a vector register.
"""


@compiled
def stage_sum(W, factors, values, node, lane):
    """Sum what all nodes have by factors of a node, in halves that do not wait for each other."""
    first, second = real(0), real(0)
    for j in range(NODES // 2):
        first += W[factors + j * STRIDE + node, lane] * W[values + j, lane]
    for j in range(NODES // 2, NODES):
        second += W[factors + j * STRIDE + node, lane] * W[values + j, lane]
    return first + second


@compiled
def enter_stage(W, h, t, node, lane):
    """Let position and velocity at a node stand where its energies are found from them.

    The velocity gives the node's share of q1 - q0 to the last digit: with a rounded 1/(h b) alone,
    forces would belong to another velocity than momenta.
    """
    share, rate = W[STAGE_STEP + node, lane], W[STAGE_RATE + node, lane]
    for s in range(DIMENSION):
        a = COORDINATE[s]
        moved = W[STAGE_V + a * STRIDE + node, lane]
        first = rate * moved
        lost = moved - share * first
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + W[STAGE_Q + a * STRIDE + node, lane]
        W[NODE_VELOCITY + s, lane] = first + rate * lost
    if not AUTONOMOUS:
        node_time(W, t + W[STAGE_PLACE + node, lane] * h, lane)
    if DRIVEN:
        node_inputs(W, node, lane)


@compiled
def stage_force(W, h, t, node, lane):
    """Find position and force at a node."""
    for a in range(DIMENSION):
        moved = stage_sum(W, STAGE_MU, STAGE_V + a * STRIDE, node, lane)
        W[STAGE_Q + a * STRIDE + node, lane] = moved
    enter_stage(W, h, t, node, lane)
    gradient(W, lane)
    share = W[STAGE_STEP + node, lane]
    for s in range(DIMENSION):
        W[STAGE_F + COORDINATE[s] * STRIDE + node, lane] = share * W[NODE_L_Q + s, lane]


@compiled
def stage_forces(W, h, t, lane):
    """Find positions and forces at all nodes."""
    for node in range(STRIDE if LANES == 1 else NODES):
        stage_force(W, h, t, node, lane)


@compiled
def stage_velocity(W, h, t, node, lane):
    """Find the velocity at a node from its momentum, and how far the one before was off."""
    if GYROSCOPIC or not CONSTANT_MASS:
        enter_stage(W, h, t, node, lane)
    if not CONSTANT_MASS:
        mass(W, lane)
        factor_mass(W, lane)
    if PIVOTS:
        W[STAGE_PIVOT + node, lane] = least_pivot(W, NODE_L_VV, lane)
    if GYROSCOPIC and CONSTANT_MASS:
        gyroscopic(W, lane)
    share = W[STAGE_STEP + node, lane]
    for s in range(DIMENSION):
        a = COORDINATE[s]
        kicked = stage_sum(W, STAGE_NU, STAGE_F + a * STRIDE, node, lane)
        p = W[MOMENTUM + a, lane] + kicked
        W[NODE_VELOCITY + s, lane] = p - W[NODE_L_V + s, lane]
    solve_with_mass(W, lane)
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
def stage_velocities(W, h, t, lane):
    """Find momenta and velocities at all nodes."""
    for node in range(STRIDE if LANES == 1 else NODES):
        stage_velocity(W, h, t, node, lane)


@compiled
def close_stages(W, lane):
    """Add what the nodes contribute to q and p, with what rounding lost carried along."""
    for row in range(4 * DIMENSION):
        W[PREVIOUS + row, lane] = W[POSITION + row, lane]
    for a in range(DIMENSION):
        increment = over_nodes(W, STAGE_V + a * STRIDE, lane) + W[POSITION_LOW + a, lane]
        add_exactly(W, POSITION + a, POSITION_LOW + a, increment, lane)
    for k in range(len(FORCED)):
        a = FORCED[k]
        increment = over_nodes(W, STAGE_F + a * STRIDE, lane) + W[MOMENTUM_LOW + a, lane]
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, increment, lane)


@compiled
def cyclic_jump(W, h, lane):
    """Measure how far velocities of cyclic coordinates at q1 are from those of the path."""
    jump_squared = real(0)
    for a in UNFORCED:
        gap = h * W[VELOCITY + a, lane]
        for node in range(NODES):
            gap -= STAGE_END[node] * W[STAGE_V + a * STRIDE + node, lane]
        jump_squared += W[MASS_DIAGONAL + a, lane] * gap**2
    W[CYCLIC_JUMP_SQUARED, lane] = jump_squared


@compiled
def stage_ahead(W, smooth, node, lane):
    """Extrapolate the velocity to a node of the next step, by a table that begins there."""
    for a in range(DIMENSION):
        moved = stage_sum(W, STAGE_AHEAD + smooth, STAGE_V + a * STRIDE, node, lane)
        W[STAGE_Q + a * STRIDE + node, lane] = moved


@compiled
def extrapolate_stages(W, smooth, lane):
    """Extrapolate velocities to all nodes of the next step."""
    for node in range(STRIDE if LANES == 1 else NODES):
        stage_ahead(W, smooth, node, lane)
    for row in range(DIMENSION * STRIDE):
        W[STAGE_V + row, lane] = W[STAGE_Q + row, lane]


@compiled
def start_velocity(W, t, lane):
    """Find the velocity at (q, p), and keep the pivots of M there."""
    find_velocity(W, t, lane)
    if PIVOTS:
        scale_pivots(W, NODE_L_VV, lane)


@compiled
def end_velocity(W, h, t, lane):
    """Find the velocity at the end of a step."""
    find_velocity(W, t + h, lane)


@kernel
def start_stages(W, h, t, lane):
    """Begin at (q, p): the same velocity at all nodes."""
    start_velocity(W, t, lane)
    for a in range(DIMENSION):
        for node in range(STRIDE if LANES == 1 else NODES):
            W[STAGE_V + a * STRIDE + node, lane] = (
                W[STAGE_STEP + node, lane] * W[VELOCITY + a, lane]
            )
    W[STAGE_EXPECTED, lane] = 0.0
    W[STAGE_COUNT, lane] = 0.0
    W[CYCLIC_JUMP_SQUARED, lane] = 0.0
    if TURNED:
        W[STAGE_TURNED, lane] = FRESH


@kernel
def iterate(W, h, t, lane):
    """One iteration for the velocities and forces at all nodes."""
    if W[ACTIVE, lane] != 0:
        if TURNED and W[STAGE_COUNT, lane] >= W[STAGE_TURNED, lane]:
            turned_forces(W, h, t, lane)
        else:
            stage_forces(W, h, t, lane)
        stage_velocities(W, h, t, lane)
        check_stage_convergence(W, lane)
        if TURNED:
            check_turns(W, lane)


@kernel
def advance_stages(W, h, t, lane):
    """Close a step by compensated sums, then extrapolate to the nodes of the next."""
    if W[ACTIVE, lane] != 0:
        close_stages(W, lane)
        if LOOKED_AT:
            leave_path(W, lane)
        if UNFORCED:
            end_velocity(W, h, t, lane)
            cyclic_jump(W, h, lane)
        # steps that take many iterations are long: there a smoother extrapolation is closer
        if W[STAGE_COUNT, lane] > MANY:
            extrapolate_stages(W, NODES * STRIDE, lane)
        else:
            extrapolate_stages(W, 0, lane)
        check_stage_acceptance(W, lane)
        if PIVOTS:
            least_over_nodes(W, lane)
            check_pivots(W, lane)
        if TURNED:
            W[STAGE_TURNED, lane] = FRESH
