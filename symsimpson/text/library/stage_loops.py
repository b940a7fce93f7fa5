"""The iteration over velocities and forces at the nodes; nodes are SIMD lanes.

With as many nodes as degrees the path is given by the velocities v_j at its nodes,

    q_i = q0 + sum_j (a_ij/b_j) (h b_j v_j),    p_i = p0 + sum_j (1 - a_ji/b_i) (h b_j f_j),

f_j = L_q(q_j, v_j) and M(q_j) v_j = p_j - a(q_j): a symplectic partitioned Runge-Kutta method. An
iteration computes positions from velocities, forces from positions, momenta from forces, and
velocities from momenta, with one small solve for each node. It contracts by h^2 K rather than h.
All nodes have the same operations. One trajectory fills a vector register with its nodes.
"""


@compiled
def stage_constants(W, h, lane):
    """Set the tables of the nodes, the parts h b_i of the step, which add up to h, and 1/(h b_i).

    In rows, tables are vectors. Constants would make compilers unroll the nodes.
    """
    for row in range(4 * NODES):
        for node in range(STRIDE):
            W[STAGE_MU + row * STRIDE + node, lane] = STAGE_TABLE[row, node]
    inner = real(0)
    for node in range(1, NODES - 1):
        W[STAGE_STEP + node, lane] = h * WEIGHTS[node]
        inner += h * WEIGHTS[node]
    if ONE_NODE:
        W[STAGE_STEP, lane] = h
    else:
        W[STAGE_STEP, lane] = (h - inner) / 2
        W[STAGE_STEP + NODES - 1, lane] = (h - inner) / 2
    for node in range(NODES):
        W[STAGE_RATE + node, lane] = 1 / W[STAGE_STEP + node, lane]
        if not AUTONOMOUS:
            W[STAGE_PLACE + node, lane] = PLACES[node]


@compiled
def over_nodes(W, first, lane):
    """Sum a value over the nodes, in four independent parts."""
    a, b, c, d = real(0), real(0), real(0), real(0)
    for node in range(first, first + STRIDE, 4):
        a += W[node, lane]
        b += W[node + 1, lane]
        c += W[node + 2, lane]
        d += W[node + 3, lane]
    return (a + b) + (c + d)


@compiled
def check_stage_convergence(W, lane):
    """Set ACTIVE to 0 if the nodes are solved, and to -3 if they are not finite.

    The largest recent ratio of two corrections predicts the next one. The step is done if that is
    below rounding. All sizes are squared. A correction that is not smaller than the one before is
    rounding only if both are small. Corrections of slow iterations may grow once, long before the
    step is solved. The check begins at the iteration in which the step is expected to be done.
    """
    W[ITERATIONS, lane] += 1.0
    W[STAGE_COUNT, lane] += 1.0
    if W[STAGE_COUNT, lane] >= W[STAGE_EXPECTED, lane]:
        correction = over_nodes(W, STAGE_CORRECTION, lane)
        increment = max(over_nodes(W, STAGE_SIZE, lane), correction)
        before, factor = W[RELATIVE, lane], W[CONTRACTION, lane]
        now = correction / (increment if increment != 0 else 1.0)
        factor = max(now / before, 0.25 * factor) if before < INFINITE else factor
        negligible = (factor < 1) & (now * factor <= LOST * (1 - factor) * (1 - factor))
        stalled = (now < STALLED) & (now >= (0.25 if now < NOISE else 1.0) * before)
        done = negligible | (now <= ROUNDING) | stalled
        finite = (correction < INFINITE) & (increment < INFINITE)
        W[CORRECTION_SQUARED, lane] = correction
        W[INCREMENT_SQUARED, lane] = increment
        W[CONTRACTION, lane] = factor
        W[RELATIVE, lane] = now
        W[ACTIVE, lane] = (0.0 if done else 1.0) if finite else -3.0


@compiled
def turned(sine, cosine, change):
    """Turn a sine and a cosine by a change of the angle; accurate to rounding up to 2^-7."""
    z = change * change
    along = change * (1 - z * (0.16666666666666666 - z * 0.008333333333333333))
    back = z * (0.5 - z * (0.041666666666666664 - z * 0.001388888888888889))
    return sine + (cosine * along - sine * back), cosine - (sine * along + cosine * back)


@compiled
def check_turns(W, lane):
    """Switch to computed sines and cosines if they were turned too far."""
    late = W[ACTIVE, lane] == 0 or W[STAGE_COUNT, lane] > MANY
    if late and W[STAGE_COUNT, lane] > W[STAGE_TURNED, lane]:
        farthest = over_nodes(W, STAGE_TURN, lane)
        if not farthest <= TURN:
            W[STAGE_TURNED, lane] = INFINITE
            if W[ACTIVE, lane] == 0:
                W[ACTIVE, lane] = 1.0


@compiled
def check_stage_acceptance(W, lane):
    """Mark a step for Newton's method if velocities of cyclic coordinates are no polynomial.

    Newton's method compares its increments with LARGEST_SQUARED: about n^2/4 times the squared
    increments of n nodes. The next step first checks convergence when one more iteration should be
    enough. It checks earlier if this step was done at its first check.
    """
    increment = W[INCREMENT_SQUARED, lane]
    resolved = W[CYCLIC_JUMP_SQUARED, lane] <= UNRESOLVED * increment
    W[IN_DOUBT, lane] = 0.0 if resolved else 1.0
    W[LARGEST_SQUARED, lane] = max(W[LARGEST_SQUARED, lane], 0.25 * NODES**2 * increment)
    count = W[STAGE_COUNT, lane]
    W[STAGE_EXPECTED, lane] = count - (1.0 if count > W[STAGE_EXPECTED, lane] else 3.0)
    W[STAGE_COUNT, lane] = 0.0


@compiled
def stage_sum(W, factors, values, node, lane):
    """Sum values of all nodes times the factors of one node, in two independent halves."""
    first, second = real(0), real(0)
    for j in range(NODES // 2):
        first += W[factors + j * STRIDE + node, lane] * W[values + j, lane]
    for j in range(NODES // 2, NODES):
        second += W[factors + j * STRIDE + node, lane] * W[values + j, lane]
    return first + second


@compiled
def enter_stage(W, h, t, node, lane):
    """Set the rows of position, velocity, time and inputs to a node.

    The velocity gives the node's share of q1 - q0 to the last digit. With a rounded 1/(h b) alone,
    forces and momenta would belong to different velocities.
    """
    share, rate = W[STAGE_STEP + node, lane], W[STAGE_RATE + node, lane]
    for s in range(DIMENSION):
        a = COORDINATE[s]
        moved = W[STAGE_V + a * STRIDE + node, lane]
        first = rate * moved
        lost = moved - share * first
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + W[STAGE_Q + a * STRIDE + node, lane]
        if CANONICAL:
            kicked = W[STAGE_KICK + a * STRIDE + node, lane]
            W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + kicked
        else:
            W[NODE_VELOCITY + s, lane] = first + rate * lost
    if not AUTONOMOUS:
        W[NODE_TIME, lane] = t + W[STAGE_PLACE + node, lane] * h
    if DRIVEN:
        for k in range(INPUTS):
            W[NODE_INPUT + k, lane] = W[INPUT + k * INPUT_STRIDE + node, lane]


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
    """Find the velocity at a node from its momentum, and the change of that velocity."""
    if GYROSCOPIC or not CONSTANT_MASS:
        enter_stage(W, h, t, node, lane)
    if not CONSTANT_MASS:
        mass(W, lane)
        factor_mass(W, lane)
    if PIVOTS:
        W[STAGE_PIVOT + node, lane] = least_pivot(W, lane)
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
def stage_rate(W, h, t, node, lane):
    """Find momentum and velocity H_p at a node of a Hamiltonian, and the changes of both."""
    enter_stage(W, h, t, node, lane)
    share = W[STAGE_STEP + node, lane]
    correction, size = real(0), real(0)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        kicked = stage_sum(W, STAGE_NU, STAGE_F + a * STRIDE, node, lane)
        change = kicked - W[STAGE_KICK + a * STRIDE + node, lane]
        correction += W[MOMENTUM_WEIGHT + a, lane] * change**2
        size += W[MOMENTUM_WEIGHT + a, lane] * kicked**2
        W[STAGE_KICK + a * STRIDE + node, lane] = kicked
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + kicked
    velocity(W, lane)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        new = share * W[NODE_L_V + s, lane]
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
        if CANONICAL:
            stage_rate(W, h, t, node, lane)
        else:
            stage_velocity(W, h, t, node, lane)


@compiled
def close_stages(W, lane):
    """Add the sums over the nodes to q and p by compensated sums."""
    copy(W, POSITION, PREVIOUS, 4 * DIMENSION, lane)
    for a in range(DIMENSION):
        increment = over_nodes(W, STAGE_V + a * STRIDE, lane) + W[POSITION_LOW + a, lane]
        add_exactly(W, POSITION + a, POSITION_LOW + a, increment, lane)
    for k in range(len(FORCED)):
        a = FORCED[k]
        increment = over_nodes(W, STAGE_F + a * STRIDE, lane) + W[MOMENTUM_LOW + a, lane]
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, increment, lane)


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
    copy(W, STAGE_Q, STAGE_V, DIMENSION * STRIDE, lane)


@compiled
def extrapolate_phase(W, smooth, lane):
    """Extrapolate velocities, forces and momenta to all nodes of the next step."""
    for node in range(STRIDE if LANES == 1 else NODES):
        for a in range(DIMENSION):
            table, force = STAGE_AHEAD + smooth, STAGE_F + a * STRIDE
            moved = stage_sum(W, table, STAGE_V + a * STRIDE, node, lane)
            W[STAGE_Q + a * STRIDE + node, lane] = moved
            W[STAGE_KICK + a * STRIDE + node, lane] = stage_sum(W, table, force, node, lane)
    copy(W, STAGE_Q, STAGE_V, DIMENSION * STRIDE, lane)
    copy(W, STAGE_KICK, STAGE_F, DIMENSION * STRIDE, lane)
    for node in range(STRIDE if LANES == 1 else NODES):
        for a in range(DIMENSION):
            kicked = stage_sum(W, STAGE_NU, STAGE_F + a * STRIDE, node, lane)
            W[STAGE_KICK + a * STRIDE + node, lane] = kicked


@compiled
def start_velocity(W, t, lane):
    """Find the velocity at (q, p), and store the pivots of M there."""
    find_velocity(W, t, lane)
    if PIVOTS:
        scale_pivots(W, lane)


@compiled
def end_velocity(W, h, t, lane):
    """Find the velocity at the end of a step."""
    find_velocity(W, t + h, lane)


@kernel
def start_stages(W, h, t, lane):
    """Begin at (q, p): the same velocity at all nodes."""
    if CANONICAL:
        start_rates(W, h, t, lane)
        clear(W, STAGE_KICK, DIMENSION * STRIDE, lane)
        for a in range(DIMENSION):
            for node in range(STRIDE if LANES == 1 else NODES):
                push = W[STAGE_STEP + node, lane] * W[NODE_L_Q + a, lane]
                W[STAGE_F + a * STRIDE + node, lane] = push
    else:
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
        if CANONICAL:
            for node in range(NODES):
                for a in range(DIMENSION):
                    y, g = SOLVED + node * DIMENSION + a, SOLVED + (NODES + node) * DIMENSION + a
                    W[y, lane] = W[STAGE_V + a * STRIDE + node, lane]
                    W[g, lane] = W[STAGE_F + a * STRIDE + node, lane]
            measure_phase(W, h, SOLVED, lane)
        if LOOKED_AT and not CANONICAL:
            for k in range(DEGREE):  # increments of control points, for derivatives
                for a in range(DIMENSION):
                    moved = real(0)
                    for node in range(NODES):
                        moved += REACHED_BY_MOVES[k, node] * W[STAGE_V + a * STRIDE + node, lane]
                    W[SOLVED + k * DIMENSION + a, lane] = moved
        if UNFORCED:
            end_velocity(W, h, t, lane)
            jump_squared = real(0)
            for a in UNFORCED:  # velocities of cyclic coordinates at q1, less those of the path
                gap = h * W[VELOCITY + a, lane]
                for node in range(NODES):
                    gap -= STAGE_END[node] * W[STAGE_V + a * STRIDE + node, lane]
                jump_squared += W[MASS_DIAGONAL + a, lane] * gap**2
            W[CYCLIC_JUMP_SQUARED, lane] = jump_squared
        # steps that take many iterations are long: there a smoother extrapolation is closer
        smooth = NODES * STRIDE if W[STAGE_COUNT, lane] > MANY else 0
        if CANONICAL:
            extrapolate_phase(W, smooth, lane)
        elif W[STAGE_COUNT, lane] > MANY:
            extrapolate_stages(W, NODES * STRIDE, lane)
        else:
            extrapolate_stages(W, 0, lane)
        check_stage_acceptance(W, lane)
        if PIVOTS:
            least = W[STAGE_PIVOT, lane]
            for node in range(1, NODES):
                least = min(least, W[STAGE_PIVOT + node, lane])
            last = W[STAGE_PIVOT + NODES - 1, lane]  # M may be singular after it
            ahead = last + FALL * (last - W[STAGE_PIVOT + NODES - 2, lane])
            W[MASS_PIVOT, lane] = 0.0 if (ahead <= 0) & (least > 0) else least
            check_pivots(W, lane)
        if TURNED:
            W[STAGE_TURNED, lane] = FRESH
