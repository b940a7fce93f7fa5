"""Kernels: the operations on one lane. A module has only the parts that it needs."""


@compiled
def go_to_start(W, t, lane):
    """Go to the start of the path."""
    path_start(W, lane)
    if not AUTONOMOUS:
        W[NODE_TIME, lane] = t
    if DRIVEN:
        for k in range(INPUTS):
            W[NODE_INPUT + k, lane] = W[INPUT + k * INPUT_STRIDE, lane]


@compiled
def at_node(W, h, t, node, lane):
    """Go to a node of the path, or to a point where A v = b: these points follow the nodes."""
    rate = 1 / h
    for s in range(DIMENSION):
        a = COORDINATE[s]
        last = W[INCREMENT + (DEGREE - 1) * DIMENSION + a, lane]
        q = real(0)
        v = last
        for k in range(1, DEGREE):
            bend = W[INCREMENT + (k - 1) * DIMENSION + a, lane] - POINTS[k] * last
            q += BASIS[node, k] * bend
            v += BASIS_SLOPE[node, k] * bend
        q += PLACES[node] * last
        if TRACED and AT_POINT[node] > 0:  # the same number, without a sum
            q = W[INCREMENT + (AT_POINT[node] - 1) * DIMENSION + a, lane]
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + q
        W[NODE_VELOCITY + s, lane] = rate * v
    if TIMED:
        time_at_node(W, h, t, node, lane)


@compiled
def time_at_node(W, h, t, node, lane):
    """Set the time and the inputs at a node."""
    if not AUTONOMOUS:
        W[NODE_TIME, lane] = t + PLACES[node] * h
    if DRIVEN and node < NODES:
        for k in range(INPUTS):
            W[NODE_INPUT + k, lane] = W[INPUT + k * INPUT_STRIDE + node, lane]


@compiled
def factor(W, lane):
    """Factorise M, bordered by constraints if there are any."""
    if HELD:
        constraint_slopes(W, lane)
        border_mass(W, lane)
        if WEIGHTED:
            weigh_constraints(W, lane)
        factor_held(W, lane)
    else:
        factor_mass(W, lane)


@compiled
def factor_at_start(W, t, lane):
    """Go to the start of the path and factorise M there; store a constant M."""
    go_to_start(W, t, lane)
    mass(W, lane)
    if SEPARABLE:
        copy(W, NODE_L_VV, MASS, MASS - NODE_L_VV, lane)
    factor(W, lane)


@compiled
def solve_velocity(W, lane):
    """Solve for the velocity with the factors of M."""
    for s in range(DIMENSION):
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + COORDINATE[s], lane] - W[NODE_L_V + s, lane]
    if HELD:
        solve_allowed(W, lane)
    else:
        solve_mass(W, lane)


@compiled
def solve_allowed(W, lane):
    """Solve for the velocity that satisfies the constraints, and for the multipliers."""
    if ROLLING or MOVING:
        hold_velocities(W, lane)
    else:
        clear(W, CURVATURE, CONSTRAINTS, lane)
    solve_held(W, lane)


@compiled
def find_velocity(W, t, lane):
    """Find the velocity at a state."""
    if CANONICAL:
        find_rates(W, t, lane)
    else:
        if not QUADRATIC_L and not TRACED:
            invert_momentum(W, t, lane)
        factor_at_start(W, t, lane)
        solve_velocity(W, lane)


@compiled
def step_equations(W, h, t, lane):
    """Residual and Jacobian of the step, rows in the order of elimination."""
    for node in range(NODES):
        at_node(W, h, t, node, lane)
        jet(W, lane)
        if DAMPED:
            grow_node(W, node, lane)
        weigh_node(W, h, node, lane)
        keep_node(W, node, lane)
    assemble_residual(W, h, lane)
    assemble_entries(W, h, DIMENSION, EQUATION_ROW_STEP, EQUATION_STRIDE, lane)
    if HELD:
        assemble_constraints(W, h, t, 0, lane)


@compiled
def constant_mass_equations(W, h, t, lane):
    """Residual and Jacobian for a constant M; X_d need not be an unknown."""
    clear(W, JACOBIAN, SOLVE_ENTRIES, lane)
    inertia(W, h, lane)
    size, square = NODE_L_QV - NODE_L_QQ, h * h
    for node in FORCE_NODES:
        at_node(W, h, t, node, lane)
        forces(W, lane)
        for s in range(DIMENSION):
            force = h * WEIGHTS[node] * W[NODE_L_Q + s, lane]
            W[STEP_F + node * DIMENSION + s, lane] = force  # rounded as in p1 - p0
        for row in range(BLOCKS):
            for s in range(DIMENSION):
                i = row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP
                for column in range(BLOCKS):
                    slope = square * (TEST_FORCE[node, row] * BASIS[node, SOLVE_COLUMNS[column]])
                    entry = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET + column * SOLVE_ROW_STEP
                    for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                        W[entry + b * SOLVE_PLACE_STEP, lane] += (
                            slope * W[NODE_L_QQ + s * NODE_STRIDE + b + NODE_OFFSET, lane]
                        )
        if FOLLOWS:
            copy(W, NODE_L_QQ, STEP_QQ + node * size, size, lane)
    for s in range(DIMENSION):
        whole, share = W[MOMENTUM + COORDINATE[s], lane], real(0)
        for node in FORCE_NODES:
            force = W[STEP_F + node * DIMENSION + s, lane]
            whole += force
            share += PLACES[node] * force
            for k in range(1, DEGREE):
                W[ROW + k * DIMENSION + s, lane] += h * (BASIS[node, k] * force)
        W[ROW + s, lane] += h * (whole - share)
    for row in range(BLOCKS):
        for s in range(DIMENSION):
            value = TEST_START[row] * W[ROW + s, lane]
            for k in range(1, DEGREE):
                value += TEST_ROWS[row, k] * W[ROW + k * DIMENSION + s, lane]
            W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane] = value


@compiled
def find_straight_path(W, h, t, lane):
    """Find X_d of a straight path: h M^-1 times p0 plus the impulse of the forces."""
    clear(W, RESIDUAL, DIMENSION, lane)
    for node in FORCE_NODES:
        at_node(W, h, t, node, lane)
        gradient(W, lane)
        weight = h * WEIGHTS[node]
        for s in range(DIMENSION):
            force = weight * W[NODE_L_Q + s, lane]
            W[RESIDUAL + COORDINATE[s], lane] += force - PLACES[node] * force
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_VELOCITY + s, lane] = W[RESIDUAL + a, lane] + W[MOMENTUM + a, lane]
    solve_mass(W, lane)
    for a in range(DIMENSION):
        W[INCREMENT + (DEGREE - 1) * DIMENSION + a, lane] = h * W[VELOCITY + a, lane]


@compiled
def correct(W, h, t, lane):
    """Assemble the equations and solve for the negative correction, in place of the residual."""
    if SEPARABLE:
        constant_mass_equations(W, h, t, lane)
    elif CYCLIC:
        cyclic_equations(W, h, t, lane)
    else:
        step_equations(W, h, t, lane)
    if HELD:
        join_equations(W, lane)
    if TRACED and HELD and WEIGHTED:  # M is singular without constraints
        go_to_start(W, t, lane)
        mass(W, lane)
        constraint_slopes(W, lane)
        border_mass(W, lane)
        stiffen(W, h, lane)
    if IN_PAIRS:
        solve_in_pairs(W, lane)
    if NEWTON_IN_ORDER:
        factor_in_order(W, JACOBIAN + SOLVE_OFFSET, SOLVE_UNKNOWNS, SOLVE_STRIDE, lane)
        solve_in_order(W, JACOBIAN + SOLVE_OFFSET, RESIDUAL, SOLVE_UNKNOWNS, SOLVE_STRIDE, lane)
    if not IN_PAIRS and not NEWTON_IN_ORDER:
        solve_pivoted(W, lane)
    if HELD:
        reorder_rows(W, RESIDUAL, 1, lane)
    if FOLLOWS:
        correct_end(W, h, lane)


@compiled
def solve_linear_step(W, h, t, lane):
    """Solve equations that are linear in the increments: one Newton step from a path at rest.

    A second Newton step finds their last digits. It removes the rounding errors of the factors,
    which are equal in all steps and would add up.
    """
    clear(W, INCREMENT, UNKNOWNS, lane)
    for _ in range(2):
        correct(W, h, t, lane)
        for row in range(BLOCKS):
            for s in range(DIMENSION):
                unknown = INCREMENT + (SOLVE_COLUMNS[row] - 1) * DIMENSION + COORDINATE[s]
                correction = W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane]
                W[unknown, lane] -= correction


@compiled
def find_impulse(W, h, t, lane):
    """Find p1 - p0 = h sum_i b_i F_i, which replaces the residual."""
    begin_impulse(W, h, t, lane)
    for node in range(NODES):
        at_node(W, h, t, node, lane)
        if TRACED and AT_POINT[node] == DEGREE:  # where M is needed, too
            path_end(W, lane)
        gradient(W, lane)
        if DAMPED:
            multiply(W, NODE_L_Q, DIMENSION, W[GROWTH + node, lane], lane)
        accumulate(W, h, node, lane)


@compiled
def begin_impulse(W, h, t, lane):
    """Begin p1 - p0 with the constraint forces -Phi^T mu at the control points."""
    clear(W, RESIDUAL, DIMENSION, lane)
    if HELD:
        for point in range(DEGREE):
            at_point(W, h, t, point, lane)
            constraint_slopes(W, lane)
            for s in range(DIMENSION):
                i = HELD_PLACE[s]
                row = CONSTRAINT_QQ + i * HELD_STRIDE + HELD_OFFSET
                for j in range(max(0, i - HELD_BAND), min(HELD_PLACES, i + HELD_BAND + 1)):
                    if CONSTRAINT_AT[j] >= 0:
                        pull = W[row + j, lane] * W[MULTIPLIER + CONSTRAINT_AT[j], lane]
                        W[RESIDUAL + COORDINATE[s], lane] -= pull
        multiply(W, RESIDUAL, DIMENSION, 1 / h, lane)


@compiled
def find_allowed_impulse(W, h, t, lane):
    """Find p1 - p0 with the momentum projected on the constraints, and the velocity at q1."""
    find_impulse(W, h, t, lane)
    path_end(W, lane)
    if not AUTONOMOUS:
        W[NODE_TIME, lane] = t + h
    mass(W, lane)
    factor(W, lane)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        p = W[MOMENTUM + a, lane] + (W[RESIDUAL + a, lane] + W[MOMENTUM_LOW + a, lane])
        W[NODE_VELOCITY + s, lane] = p - W[NODE_L_V + s, lane]
    solve_allowed(W, lane)
    take_momentum(W, lane)
    if CARRIED:
        copy(W, MULTIPLIER, TAKEN, CONSTRAINTS, lane)


@compiled
def find_pivots(W, lane):
    """Find pivots of M + 10 w Phi^T Phi: positive if M is definite where Phi v = 0."""
    border_mass(W, lane)
    multiply(W, CONSTRAINT_WEIGHT, CONSTRAINTS, 10, lane)
    weigh_constraints(W, lane)
    factor_symmetric(W, HELD + HELD_OFFSET, DIMENSION, DIMENSION - 1, HELD_STRIDE, lane)


@compiled
def find_allowed_velocity(W, t, lane):
    """Find phi, the smallest change of q (in M) that makes it zero, and the velocity at a state.

    The multipliers use the same slopes and factors.
    """
    factor_at_start(W, t, lane)
    constrain(W, lane)
    clear(W, NODE_VELOCITY, DIMENSION, lane)
    for c in range(CONSTRAINTS):
        W[CURVATURE + c, lane] = -W[CONSTRAINT + c, lane]
    solve_held(W, lane)
    copy(W, VELOCITY, HELD_CHANGE, DIMENSION, lane)
    solve_velocity(W, lane)


@compiled
def find_multipliers(W, lane):
    """Find multipliers for this velocity; HELD_RIGHT has the accelerations."""
    pushes(W, lane)
    copy(W, RESIDUAL, NODE_VELOCITY, DIMENSION, lane)
    copy(W, VELOCITY, CONSTRAINT_FORCE, DIMENSION, lane)
    solve_held(W, lane)
    copy(W, CONSTRAINT_FORCE, VELOCITY, DIMENSION, lane)
    constraint_forces(W, lane)


@kernel
def start(W, h, t, lane):
    """Begin at (q, p) with increments of constant velocity, or with the force there."""
    if not QUADRATIC_L and not TRACED:
        invert_momentum(W, t, lane)
    factor_at_start(W, t, lane)
    if PIVOTS:
        scale_pivots(W, lane)
    solve_velocity(W, lane)
    if COMPOSED:
        go_to_start(W, t, lane)
        gradient(W, lane)
    elif ITERATED:
        straight_path(W, h, lane)


@kernel
def legendre(W, h, t, lane):
    """P = dL/dv from q and v."""
    go_to_start(W, t, lane)
    mass(W, lane)
    momentum(W, lane)


@kernel
def equations(W, h, t, lane):
    """Residual and Jacobian of the step, rows in the order of elimination."""
    step_equations(W, h, t, lane)


@kernel
def newton(W, h, t, lane):
    """One Newton iteration for the increments X_k of the control points."""
    if W[ACTIVE, lane] != 0:
        correct(W, h, t, lane)
        apply_correction(W, lane)


@kernel
def newton_pivoted(W, h, t, lane):
    """One Newton iteration with row pivoting, where the fixed order of elimination fails."""
    if W[ACTIVE, lane] != 0:
        if FOLLOWING:  # what is left then is the iteration of the reduced equations
            solve_following(W, h, t, lane)
        step_equations(W, h, t, lane)
        if HELD:
            join_equations(W, lane)
        solve_pivoted(W, lane)
        if HELD:
            reorder_rows(W, RESIDUAL, 1, lane)
        if FOLLOWING:
            for row in range(BLOCKS):
                for s in range(DIMENSION):
                    if FOLLOWING[s] != 0:
                        W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane] = real(0)
                        W[INCREMENT + row * DIMENSION + s, lane] = real(0)
        apply_correction(W, lane)


@compiled
def apply_correction(W, lane):
    """Apply the correction in the rows of the residual, and check convergence."""
    update_increments(W, lane)
    if HELD:
        check_rounding(W, lane)
    check_convergence(W, lane)


@kernel
def advance(W, h, t, lane):
    """Close a step by compensated sums, then predict the next increments."""
    if COMPOSED and W[ACTIVE, lane] != 0:
        compose(W, h, t, lane)
    if not COMPOSED and W[ACTIVE, lane] != 0:
        if STRAIGHT_PATH:
            find_straight_path(W, h, t, lane)
        if ITERATED:
            measure_prediction(W, lane)
        if CYCLIC:
            find_cyclic_impulse(W, h, t, lane)
        elif HELD:
            find_allowed_impulse(W, h, t, lane)
        else:
            find_impulse(W, h, t, lane)
        keep_step(W, lane)
        close_step(W, lane)
        if not QUADRATIC_L:
            end_slope(W, h, lane)
        if not SEPARABLE and not HELD:
            factor_at_start(W, t + h, lane)
        if PIVOTS:
            W[MASS_PIVOT, lane] = least_pivot(W, lane)
        if ITERATED:
            if not HELD:
                solve_velocity(W, lane)
            predict(W, h, lane)
            if HELD:
                expect_rounding(W, lane)
            check_acceptance(W, lane)
            if PIVOTS:
                check_pivots(W, lane)


@compiled
def compose(W, h, t, lane):
    """Take a step of kicks, and drifts between them."""
    if TRACED:
        factor_at_start(W, t, lane)
    if not ALIKE:  # a force at the start of a step is not that at the end of the one before
        go_to_start(W, t, lane)
        gradient(W, lane)
    begin_composed(W, lane)
    kick(W, h, 0, lane)
    for node in range(1, len(KICKS)):
        if HELD:
            drift_held(W, h, node, lane)
        else:
            drift(W, h, node, lane)
        if TIMED:
            time_at_node(W, h, t, node, lane)
        if HELD:
            factor(W, lane)
        gradient(W, lane)
        kick(W, h, node, lane)
    if HELD:
        free_velocity(W, lane)
        take_momentum(W, lane)
    close_composed(W, lane)


@kernel
def energy(W, h, t, lane):
    """The Hamiltonian at (q, p), its kinetic part, and the velocities."""
    if QUADRATIC_L:
        find_velocity(W, t, lane)
        kinetic_energy(W, lane)
    else:
        if not TRACED:
            invert_momentum(W, t, lane)
        general_energy(W, t, lane)
    go_to_start(W, t, lane)
    potential(W, lane)


@kernel
def multipliers(W, h, t, lane):
    """Phi and the multipliers of L - lambda.phi at (q, p)."""
    find_allowed_velocity(W, t, lane)
    find_multipliers(W, lane)


@kernel
def work(W, h, t, lane):
    """Add the work of forces in the last step, and the integral of dL/dt.

    Constraints that move do the work of their multipliers times b, in CURVATURE.
    """
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        if FOLLOWING:
            solve_following(W, h, t, lane)
        for node in range(NODES):
            at_node(W, h, t, node, lane)
            node_power(W, lane)
            for k in range(NODE_POWERS):
                W[WORK_LOW + k, lane] += h * WEIGHTS[node] * W[POWER + k, lane]
        if CARRIED:
            for point in range(DEGREE):
                at_point(W, h, t, point, lane)
                hold_velocities(W, lane)
                for c in range(FIRST_SIDE, CONSTRAINTS):
                    pull = W[MULTIPLIER + c, lane] / h
                    W[WORK_LOW + CARRIED, lane] -= pull * W[CURVATURE + c, lane]
        exchange_steps(W, lane)
        if CARRIED:
            go_to_start(W, t + h, lane)
            hold_velocities(W, lane)
            for c in range(FIRST_SIDE, CONSTRAINTS):
                W[WORK_LOW + CARRIED, lane] -= W[TAKEN + c, lane] * W[CURVATURE + c, lane]
        for k in range(NODE_POWERS):
            change = W[WORK_LOW + k, lane]
            W[WORK_LOW + k, lane] = real(0)
            add_exactly(W, WORK + k, WORK_LOW + k, change, lane)
