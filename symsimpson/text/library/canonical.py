"""Steps of a Hamiltonian H(q, p): the nodes have momenta of their own.

With as many nodes as degrees, a step is a symplectic partitioned Runge-Kutta method. The unknowns
are y_j = h b_j V_j with V = H_p, and g_j = h b_j F_j with F = f - H_q:

    q_i = q0 + sum_j (a_ij/b_j) y_j,    p_i = p0 + sum_j (1 - a_ji/b_i) g_j,
    q1 = q0 + sum_j y_j,                p1 = p0 + sum_j g_j.

The rows of a node's velocity hold its momentum, and the rows of its momentum hold V. INCREMENT has
all y_j, then all g_j.
"""


@compiled
def phase_node(W, h, t, node, lane):
    """Go to a node of the step."""
    for a in range(DIMENSION):
        q, p = real(0), real(0)
        for j in range(NODES):
            q += STAGE_TABLE[j, node] * W[INCREMENT + j * DIMENSION + a, lane]
            p += STAGE_TABLE[NODES + j, node] * W[INCREMENT + (NODES + j) * DIMENSION + a, lane]
        W[NODE_POSITION + a, lane] = W[POSITION + a, lane] + q
        W[NODE_VELOCITY + a, lane] = W[MOMENTUM + a, lane] + p
    if TIMED:
        time_at_node(W, h, t, node, lane)


@compiled
def phase_equations(W, h, t, lane):
    """Residual and Jacobian: y_i - h b_i V_i of all nodes, then g_i - h b_i F_i."""
    for node in range(NODES):
        phase_node(W, h, t, node, lane)
        phase_jet(W, lane)
        share = h * WEIGHTS[node]
        for a in range(DIMENSION):
            y, g = node * DIMENSION + a, (NODES + node) * DIMENSION + a
            W[RESIDUAL + y, lane] = W[INCREMENT + y, lane] - share * W[NODE_L_V + a, lane]
            W[RESIDUAL + g, lane] = W[INCREMENT + g, lane] - share * W[NODE_L_Q + a, lane]
        phase_rows(W, share, node, lane)


@compiled
def store_slopes(W, node, lane):
    """Store the derivatives of V and F by q and p at a node: a matrix with 2 n rows."""
    first = STEP_SLOPES + 4 * node * DIMENSION * DIMENSION
    for a in range(DIMENSION):
        for b in range(DIMENSION):
            ab, upper = a * DIMENSION + b, first + 2 * a * DIMENSION + b
            lower = upper + 2 * DIMENSION * DIMENSION
            W[upper, lane] = W[NODE_P_Q + ab, lane]
            W[upper + DIMENSION, lane] = W[NODE_L_VV + ab, lane]
            W[lower, lane] = W[NODE_L_QQ + ab, lane]
            W[lower + DIMENSION, lane] = W[NODE_L_QV + ab, lane]


@compiled
def phase_place(node, row):
    """Return the place of a velocity, or of a force, at a node among the unknowns."""
    return (row // DIMENSION * NODES + node) * DIMENSION + row % DIMENSION


@compiled
def phase_rows(W, share, node, lane):
    """Write the rows of a node in the Jacobian."""
    store_slopes(W, node, lane)
    for a in range(2 * DIMENSION):
        row = phase_place(node, a)
        slopes = STEP_SLOPES + (2 * node * DIMENSION + a) * 2 * DIMENSION
        for j in range(NODES):
            for b in range(2 * DIMENSION):
                column = phase_place(j, b)
                reached = share * STAGE_TABLE[b // DIMENSION * NODES + j, node]
                entry = (1.0 if row == column else 0.0) - reached * W[slopes + b, lane]
                W[JACOBIAN + row * UNKNOWNS + column, lane] = entry


@compiled
def weigh_phase(W, h, lane):
    """Set the weights of increments: q and p count relative to their last moves.

    PHASE_SIZE has these moves. Squared increments are energies times h^2, as with a mass matrix.
    """
    power = real(0)
    for a in range(DIMENSION):
        power += W[PHASE_SIZE + a, lane] * W[PHASE_SIZE + DIMENSION + a, lane]
    power = abs(h) * power / DIMENSION
    power = power if power > 0 else 1.0
    for a in range(DIMENSION):
        move, pushed = W[PHASE_SIZE + a, lane], W[PHASE_SIZE + DIMENSION + a, lane]
        W[MASS_DIAGONAL + a, lane] = power / (move * move) if move > 0 else 0.0
        W[MOMENTUM_WEIGHT + a, lane] = power / (pushed * pushed) if pushed > 0 else 0.0


@compiled
def size_of_move(W, row, moved, state, lane):
    """Renew the size of moves; it falls at most by half, and not below the rounding of q or p."""
    size = max(moved, 0.5 * W[row, lane])
    W[row, lane] = max(size, SMALL_MOVE * abs(W[state, lane]))


@compiled
def measure_phase(W, h, increments, lane):
    """Set the weights of increments from those in the rows ``increments``."""
    for a in range(DIMENSION):
        moved, pushed = real(0), real(0)
        for j in range(NODES):
            moved += abs(W[increments + j * DIMENSION + a, lane])
            pushed += abs(W[increments + (NODES + j) * DIMENSION + a, lane])
        size_of_move(W, PHASE_SIZE + a, moved, POSITION + a, lane)
        size_of_move(W, PHASE_SIZE + DIMENSION + a, pushed, MOMENTUM + a, lane)
    weigh_phase(W, h, lane)


@kernel
def start_phase(W, h, t, lane):
    """Begin at (q, p) with the same V and F at all nodes."""
    start_rates(W, h, t, lane)


@compiled
def start_rates(W, h, t, lane):
    """Set increments of constant V and F, and the sizes of moves."""
    find_rates(W, t, lane)
    clear(W, PHASE_SIZE, 2 * DIMENSION, lane)
    for node in range(NODES):
        share = h * WEIGHTS[node]
        for a in range(DIMENSION):
            W[INCREMENT + node * DIMENSION + a, lane] = share * W[NODE_L_V + a, lane]
            W[INCREMENT + (NODES + node) * DIMENSION + a, lane] = share * W[NODE_L_Q + a, lane]
    copy(W, INCREMENT, PREDICTED, UNKNOWNS, lane)
    measure_phase(W, h, INCREMENT, lane)
    W[MASS_PIVOT, lane] = 0.0


@compiled
def find_rates(W, t, lane):
    """Evaluate V = H_p and F at (q, p); the velocity is V."""
    go_to_start(W, t, lane)
    gradient(W, lane)
    velocity(W, lane)
    copy(W, NODE_L_V, VELOCITY, DIMENSION, lane)


@kernel
def newton_phase(W, h, t, lane):
    """One Newton iteration for the increments of q and p at the nodes."""
    if W[ACTIVE, lane] != 0:
        phase_equations(W, h, t, lane)
        solve_pivoted(W, lane)
        correction_squared, increment_squared = real(0), real(0)
        for a in range(DIMENSION):
            correction, increment = real(0), real(0)
            for j in range(2 * NODES):
                weight = W[(MASS_DIAGONAL if j < NODES else MOMENTUM_WEIGHT) + a, lane]
                change = -W[RESIDUAL + j * DIMENSION + a, lane]
                new = W[INCREMENT + j * DIMENSION + a, lane] + change
                W[INCREMENT + j * DIMENSION + a, lane] = new
                correction += weight * change**2
                increment += weight * new**2
            W[OWN_CORRECTION + a, lane] = correction
            W[OWN_INCREMENT + a, lane] = increment
            correction_squared += correction
            increment_squared += increment
        W[CORRECTION_SQUARED, lane] = correction_squared
        W[INCREMENT_SQUARED, lane] = increment_squared
        check_convergence(W, lane)


@kernel
def advance_phase(W, h, t, lane):
    """Close a step by compensated sums, then extrapolate the increments of the next one."""
    if W[ACTIVE, lane] != 0:
        error = real(0)
        for a in range(DIMENSION):
            for j in range(2 * NODES):
                weight = W[(MASS_DIAGONAL if j < NODES else MOMENTUM_WEIGHT) + a, lane]
                row = j * DIMENSION + a
                error += weight * (W[INCREMENT + row, lane] - W[PREDICTED + row, lane]) ** 2
        W[PREDICTION_ERROR_SQUARED, lane] = error
        W[VELOCITY_JUMP_SQUARED, lane] = 0.0
        W[CYCLIC_JUMP_SQUARED, lane] = 0.0
        W[CYCLIC_MASS_CHANGE, lane] = 0.0
        keep_step(W, lane)
        for a in range(DIMENSION):
            moved, pushed = W[POSITION_LOW + a, lane], W[MOMENTUM_LOW + a, lane]
            for j in range(NODES):
                moved += W[INCREMENT + j * DIMENSION + a, lane]
                pushed += W[INCREMENT + (NODES + j) * DIMENSION + a, lane]
            add_exactly(W, POSITION + a, POSITION_LOW + a, moved, lane)
            add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, pushed, lane)
        measure_phase(W, h, INCREMENT, lane)
        for part in range(2):  # y_j, then g_j
            first = part * NODES * DIMENSION
            for node in range(NODES):
                for a in range(DIMENSION):
                    moved = real(0)
                    for j in range(NODES):
                        ahead = STAGE_TABLE[2 * NODES + j, node]
                        moved += ahead * W[INCREMENT + first + j * DIMENSION + a, lane]
                    W[PREDICTED + first + node * DIMENSION + a, lane] = moved
        copy(W, PREDICTED, INCREMENT, UNKNOWNS, lane)
        check_acceptance(W, lane)


@kernel
def phase_energy(W, h, t, lane):
    """H at (q, p), the velocities H_p, and half the sum of abs(p_a v_a) as a size of energies."""
    find_rates(W, t, lane)
    size = real(0)
    for a in range(DIMENSION):
        size += abs(W[MOMENTUM + a, lane] * W[VELOCITY + a, lane])
    W[KINETIC, lane] = size / 2
    W[ENERGY, lane] = real(0)
    potential(W, lane)


@kernel
def phase_momentum(W, h, t, lane):
    """The momentum with H_p = v, from q and v; NaN if H_pp is singular everywhere."""
    if REGULAR:
        invert_momentum(W, t, lane)
    else:
        for a in range(DIMENSION):
            W[MOMENTUM + a, lane] = INFINITE - INFINITE


@kernel
def phase_work(W, h, t, lane):
    """Add the work of forces in the last step, and the integral of dH/dt."""
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        for node in range(NODES):
            phase_node(W, h, t, node, lane)
            node_power(W, lane)
            for k in range(NODE_POWERS):
                W[WORK_LOW + k, lane] += h * WEIGHTS[node] * W[POWER + k, lane]
        exchange_steps(W, lane)
        for k in range(NODE_POWERS):
            change = W[WORK_LOW + k, lane]
            W[WORK_LOW + k, lane] = real(0)
            add_exactly(W, WORK + k, WORK_LOW + k, change, lane)


@compiled
def differentiate_phase(W, h, t, costed, lane):
    """Factorise the Jacobian of the last step, and store derivatives of V and F at the nodes."""
    for node in range(NODES):
        phase_node(W, h, t, node, lane)
        phase_jet(W, lane)
        share = h * WEIGHTS[node]
        phase_rows(W, share, node, lane)
        if VARIED_BY:
            if SIZED:
                go_to_place(W, h, PLACES[node], real(1), lane)
            parameter_slopes(W, lane)
            copy(W, NODE_F_A, STEP_F_A + node * F_A_FROM[VARIED], F_A_FROM[VARIED], lane)
            copy(W, NODE_P_A, STEP_P_A + node * P_A_FROM[VARIED], P_A_FROM[VARIED], lane)
        if COSTED and costed > 0:
            cost_at_node(W, h, t, node, lane)
            add_phase_cost(W, share, node, lane)
    factor_equations(W, lane)


@kernel
def phase_tangent(W, h, t, lane):
    """Carry variations of the state to the end of the last step.

    At a node dV = V_q dq + V_p dp + V_a da, and the same holds for F.
    """
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        find_grid(W, h, t, lane)
        differentiate_phase(W, h, t, 0, lane)
        count = int(W[TANGENTS, lane])
        for variation in range(count):
            dq = TANGENT + variation * 2 * DIMENSION
            room = work_row_of(W, variation, lane)
            parameter = variation - count + VARIED
            for node in range(NODES):
                share = h * WEIGHTS[node]
                for a in range(2 * DIMENSION):
                    slopes = STEP_SLOPES + (2 * node * DIMENSION + a) * 2 * DIMENSION
                    changed = real(0)
                    for b in range(2 * DIMENSION):
                        changed += W[slopes + b, lane] * W[dq + b, lane]
                    W[room + phase_place(node, a), lane] = share * changed
                if VARIED_BY and parameter >= 0:
                    for entry in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
                        slope = W[STEP_P_A + node * P_A_FROM[VARIED] + entry, lane]
                        W[room + node * DIMENSION + P_A_PLACE[entry], lane] += share * slope
                    for entry in range(F_A_FROM[parameter], F_A_FROM[parameter + 1]):
                        slope = W[STEP_F_A + node * F_A_FROM[VARIED] + entry, lane]
                        row = (NODES + node) * DIMENSION + F_A_PLACE[entry]
                        W[room + row, lane] += share * slope
            solve_factored(W, room, lane)
            for a in range(2 * DIMENSION):
                for j in range(NODES):
                    W[dq + a, lane] += W[room + phase_place(j, a), lane]
        exchange_steps(W, lane)


@compiled
def add_phase_cost(W, share, node, lane):
    """Add the running cost at a node, differentiated by q and p there, to the derivatives of J."""
    for a in range(2 * DIMENSION):
        slope = share * W[NODE_COST + 1 + a, lane]
        W[ADJOINT_START + a, lane] += slope
        for j in range(NODES):
            reached = STAGE_TABLE[a // DIMENSION * NODES + j, node]
            W[ADJOINT_RIGHT + phase_place(j, a), lane] += reached * slope
    for j in range(VARIED):
        slope = share * W[NODE_COST + 1 + 2 * DIMENSION + j, lane]
        W[COST_SLOPE + j * NODES + node, lane] += slope


@kernel
def phase_adjoint(W, h, t, lane):
    """Carry derivatives of a cost back over the step that was taken.

    ADJOINT has the derivatives by q1 and p1. With S^T w = (a, b) at all nodes, the derivatives by
    V and F at a node are h b_i w.
    """
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        for a in range(2 * DIMENSION):
            for j in range(NODES):
                W[ADJOINT_RIGHT + phase_place(j, a), lane] = W[ADJOINT + a, lane]
        clear(W, ADJOINT_START, 2 * DIMENSION, lane)
        clear(W, COST_SLOPE, VARIED * NODES, lane)
        differentiate_phase(W, h, t, 1, lane)
        solve_transposed(W, ADJOINT_RIGHT, lane)
        for node in range(NODES):
            share = h * WEIGHTS[node]
            for a in range(2 * DIMENSION):
                slopes = STEP_SLOPES + (2 * node * DIMENSION + a) * 2 * DIMENSION
                w = share * W[ADJOINT_RIGHT + phase_place(node, a), lane]
                for b in range(2 * DIMENSION):
                    W[ADJOINT_START + b, lane] += W[slopes + b, lane] * w
            for j in range(VARIED):
                slope = real(0)
                for row in range(P_A_FROM[j], P_A_FROM[j + 1]):
                    w = W[ADJOINT_RIGHT + node * DIMENSION + P_A_PLACE[row], lane]
                    slope += W[STEP_P_A + node * P_A_FROM[VARIED] + row, lane] * w
                for row in range(F_A_FROM[j], F_A_FROM[j + 1]):
                    w = W[ADJOINT_RIGHT + (NODES + node) * DIMENSION + F_A_PLACE[row], lane]
                    slope += W[STEP_F_A + node * F_A_FROM[VARIED] + row, lane] * w
                W[COST_SLOPE + j * NODES + node, lane] += share * slope
        for row in range(2 * DIMENSION):
            W[ADJOINT + row, lane] += W[ADJOINT_START + row, lane]
        exchange_steps(W, lane)


@kernel
def compose_phase(W, h, t, lane):
    """Take a step of kicks p += h b F, and drifts q += h a H_p between them: H = T(p) + V(q)."""
    go_to_start(W, t, lane)
    gradient(W, lane)
    begin_composed(W, lane)
    for node in range(len(KICKS)):
        if node > 0:
            for a in range(DIMENSION):
                W[NODE_VELOCITY + a, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
            velocity(W, lane)
            for a in range(DIMENSION):
                W[INCREMENT + a, lane] += h * DRIFTS[node - 1] * W[NODE_L_V + a, lane]
                W[NODE_POSITION + a, lane] = W[POSITION + a, lane] + W[INCREMENT + a, lane]
            if TIMED:
                time_at_node(W, h, t, node, lane)
            gradient(W, lane)
        for a in range(DIMENSION):
            W[RESIDUAL + a, lane] += h * KICKS[node] * W[NODE_L_Q + a, lane]
    close_composed(W, lane)


@kernel
def begin_phase(W, h, t, lane):
    """Begin explicit steps at (q, p)."""
    find_rates(W, t, lane)
    W[MASS_PIVOT, lane] = 0.0


@compiled
def solve_for_momentum(W, t, lane):
    """Factorise H_pp at (q, p), with the derivatives of velocities and by parameters there."""
    go_to_start(W, t, lane)
    phase_jet(W, lane)
    factor_mass(W, lane)
    if VARIED_BY:
        if SIZED:
            go_to_place(W, real(1), real(0), real(0), lane)
        parameter_slopes(W, lane)


@kernel
def phase_momentum_slopes(W, h, t, lane):
    """Set dp0 for each varied parameter, where v0 is given: H_pp dp0 = -dH_p/da."""
    solve_for_momentum(W, t, lane)
    for parameter in range(VARIED):
        variation = int(W[TANGENTS, lane]) - VARIED + parameter
        clear(W, NODE_VELOCITY, DIMENSION, lane)
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[NODE_VELOCITY + P_A_PLACE[row], lane] -= W[NODE_P_A + row, lane]
        solve_with_mass(W, lane)
        dp = TANGENT + variation * 2 * DIMENSION + DIMENSION
        copy(W, NODE_VELOCITY, dp, DIMENSION, lane)


@kernel
def phase_start_adjoint(W, h, t, lane):
    """Derivatives by q0 and v0 from those by q0 and p0, where H_p(q0, p0) = v0."""
    solve_for_momentum(W, t, lane)
    copy(W, ADJOINT + DIMENSION, NODE_VELOCITY, DIMENSION, lane)
    solve_with_mass(W, lane)
    for a in range(DIMENSION):
        w = W[NODE_VELOCITY + a, lane]
        W[ADJOINT + DIMENSION + a, lane] = w
        for b in range(DIMENSION):
            W[ADJOINT + b, lane] -= W[NODE_P_Q + a * DIMENSION + b, lane] * w
    if VARIED_BY:
        for j in range(VARIED):
            slope = real(0)
            for row in range(P_A_FROM[j], P_A_FROM[j + 1]):
                slope -= W[NODE_P_A + row, lane] * W[NODE_VELOCITY + P_A_PLACE[row], lane]
            W[COST_SLOPE + j * NODES, lane] = slope
