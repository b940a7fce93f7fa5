"""Kernels: what each of them does on one lane. What a module does not need is left out of it."""


@compiled
def go_to_start(W, t, lane):
    """Go to the start of the path."""
    path_start(W, lane)
    if not AUTONOMOUS:
        node_time(W, t, lane)
    if DRIVEN:
        node_inputs(W, 0, lane)


@compiled
def at_node(W, h, t, node, lane):
    """Go to a node of the path, or to a point where A v = b: these points follow the nodes."""
    path(W, h, node, lane)
    if TIMED:
        time_at_node(W, h, t, node, lane)


@compiled
def time_at_node(W, h, t, node, lane):
    """Keep the time and the inputs at a node."""
    if not AUTONOMOUS:
        node_time(W, t + PLACES[node] * h, lane)
    if DRIVEN and node < NODES:
        node_inputs(W, node, lane)


@compiled
def at_point(W, h, t, point, lane):
    """Go to a control point of the path."""
    control_point(W, point, lane)
    if ROLLING and not AUTONOMOUS:
        node_time(W, t + POINTS[point] * h, lane)


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
    """Go to the start of the path and factorise M there."""
    go_to_start(W, t, lane)
    mass(W, lane)
    factor(W, lane)


@compiled
def solve_velocity(W, lane):
    """Solve for the velocity, with these factors."""
    momentum_to_solve(W, lane)
    if HELD:
        solve_allowed(W, lane)
    else:
        solve_mass(W, lane)


@compiled
def solve_allowed(W, lane):
    """Solve for the velocity that constraints allow, and for what they take from p."""
    if ROLLING:
        hold_velocities(W, lane)
    else:
        allow_no_change(W, lane)
    solve_held(W, lane)


@compiled
def find_velocity(W, t, lane):
    """Find the velocity at a state."""
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
    assemble_nodes(W, h, lane)
    if HELD:
        for point in range(DEGREE + 1 if HOLONOMIC > 0 else DEGREE):
            at_point(W, h, t, point, lane)
            constrain(W, lane)
            assemble_constraint(W, h, point, lane)
    if ROLLING:
        for node in range(NODES, NODES + DEGREE):
            at_node(W, h, t, node, lane)
            rates(W, lane)
            assemble_rates(W, h, node, lane)


@compiled
def keep_node(W, node, lane):
    """Keep the derivatives of F and P at a node."""
    keep_jet(W, node, lane)
    if DRAGGED:
        keep_drag(W, node, lane)


@compiled
def assemble_nodes(W, h, lane):
    """Assemble what the nodes contribute to the Jacobian."""
    if CLEARED > 0:
        clear_matrix(W, lane, CLEARED)
    assemble_entries(W, h, DIMENSION, EQUATION_ROW_STEP, EQUATION_STRIDE, lane)


@compiled
def constant_mass_equations(W, h, t, lane):
    """Residual and Jacobian of a system whose M is constant; X_d may be none of the unknowns."""
    clear_matrix(W, lane, SOLVE_ENTRIES)
    inertia(W, h, lane)
    for node in FORCE_NODES:
        at_node(W, h, t, node, lane)
        forces(W, lane)
        assemble_forces(W, h, node, lane)
        if FOLLOWS:
            keep_slopes(W, node, lane)
    combine_rows(W, lane)


@compiled
def find_straight_path(W, h, t, lane):
    """Find X_d of a path without other control points: a velocity at which q0 starts."""
    clear_momentum(W, lane)
    for node in FORCE_NODES:
        at_node(W, h, t, node, lane)
        gradient(W, lane)
        accumulate_start(W, h, node, lane)
    end_path(W, h, lane)


@compiled
def correct(W, h, t, lane):
    """Solve for a correction, without its sign: it takes the place of the residual."""
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
    if HELD and NEWTON_IN_ORDER:
        factor_in_order(W, JACOBIAN + SOLVE_OFFSET, SOLVE_UNKNOWNS, SOLVE_STRIDE, lane)
        solve_in_order(W, JACOBIAN + SOLVE_OFFSET, RESIDUAL, SOLVE_UNKNOWNS, SOLVE_STRIDE, lane)
    if not IN_PAIRS and not NEWTON_IN_ORDER:
        solve_pivoted(W, lane)
    if HELD:
        part_rows(W, RESIDUAL, lane)
    if FOLLOWS:
        correct_end(W, h, lane)


@compiled
def solve_linear_step(W, h, t, lane):
    """Solve equations that are linear in the increments: one Newton step from a path at rest.

    A second one finds their last digits. It takes away what rounding does to the factors, which
    would be the same in all steps and add up.
    """
    for row in range(UNKNOWNS):
        W[INCREMENT + row, lane] = real(0)
    for _ in range(2):
        correct(W, h, t, lane)
        for row in range(BLOCKS):
            for s in range(DIMENSION):
                unknown = INCREMENT + (SOLVE_COLUMNS[row] - 1) * DIMENSION + COORDINATE[s]
                correction = W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane]
                W[unknown, lane] -= correction


@compiled
def find_impulse(W, h, t, lane):
    """Find p1 - p0 = h sum_i b_i F_i, which takes the place of the residual."""
    clear_momentum(W, lane)
    if HELD:
        for point in range(DEGREE):
            at_point(W, h, t, point, lane)
            constraint_slopes(W, lane)
            add_pull(W, lane)
        divide_pulls(W, h, lane)
    for node in range(NODES):
        at_node(W, h, t, node, lane)
        if TRACED and AT_POINT[node] == DEGREE:  # where M is needed, too
            path_end(W, lane)
        gradient(W, lane)
        if DAMPED:
            grow_force(W, node, lane)
        accumulate(W, h, node, lane)


@compiled
def find_allowed_impulse(W, h, t, lane):
    """Find what constraints allow of p1 - p0, and the velocity at q1."""
    find_impulse(W, h, t, lane)
    path_end(W, lane)
    if not AUTONOMOUS:
        node_time(W, t + h, lane)
    mass(W, lane)
    factor(W, lane)
    momentum_at_end(W, lane)
    solve_allowed(W, lane)
    take_momentum(W, lane)


@compiled
def find_pivots(W, lane):
    """Find pivots of M + 10 w Phi^T Phi, positive if M is definite for what constraints allow."""
    border_mass(W, lane)
    for c in range(CONSTRAINTS):
        W[CONSTRAINT_WEIGHT + c, lane] *= 10
    weigh_constraints(W, lane)
    factor_symmetric(W, HELD + HELD_OFFSET, DIMENSION, DIMENSION - 1, HELD_STRIDE, lane)


@compiled
def find_allowed_velocity(W, t, lane):
    """Find phi and the velocity at a state; its slopes and factors serve multipliers, too."""
    factor_at_start(W, t, lane)
    constrain(W, lane)
    change_to_constraints(W, lane)
    solve_velocity(W, lane)


@compiled
def find_multipliers(W, lane):
    """Find multipliers for this velocity; accelerations take the place of velocities."""
    pushes(W, lane)
    push_to_solve(W, lane)
    solve_held(W, lane)
    constraint_forces(W, lane)


@kernel
def start(W, h, t, lane):
    """Begin at (q, p) with increments of constant velocity, or with the force there."""
    go_to_start(W, t, lane)
    mass(W, lane)
    if SEPARABLE:
        keep_mass(W, lane)
    factor(W, lane)
    if PIVOTS and HELD:
        scale_pivots(W, HELD, lane)
    if PIVOTS and not HELD:
        scale_pivots(W, NODE_L_VV, lane)
    solve_velocity(W, lane)
    if COMPOSED:
        go_to_start(W, t, lane)
        gradient(W, lane)
    elif ITERATED:
        straight_path(W, h, lane)
        if HELD:
            clear_multipliers(W, lane)


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
        step_equations(W, h, t, lane)
        if FOLLOWING:  # what is left then is the iteration of the reduced equations
            solve_following(W, lane)
            step_equations(W, h, t, lane)
        if HELD:
            join_equations(W, lane)
        solve_pivoted(W, lane)
        if HELD:
            part_rows(W, RESIDUAL, lane)
        if FOLLOWING:
            clear_following(W, lane)
        apply_correction(W, lane)


@compiled
def apply_correction(W, lane):
    """Apply the correction that stands in the place of the residual, and judge it."""
    update_increments(W, lane)
    if HELD:
        update_multipliers(W, lane)
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
        if not SEPARABLE and not HELD:
            factor_at_start(W, t + h, lane)
        if PIVOTS and HELD:
            compare_pivots(W, HELD, lane)
        if PIVOTS and not HELD:
            compare_pivots(W, NODE_L_VV, lane)
        if ITERATED:
            if not HELD:
                solve_velocity(W, lane)
            if CARRIED:
                keep_taken(W, lane)
            if HELD:
                carry_multipliers(W, lane)
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
        go_to_start(W, t, lane)
        mass(W, lane)
        factor_mass(W, lane)
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
    find_velocity(W, t, lane)
    kinetic_energy(W, lane)
    go_to_start(W, t, lane)
    potential(W, lane)


@kernel
def multipliers(W, h, t, lane):
    """Phi and the multipliers of L - lambda.phi at (q, p)."""
    find_allowed_velocity(W, t, lane)
    find_multipliers(W, lane)


@kernel
def work(W, h, t, lane):
    """Add the work of forces in the step that was taken, and the integral of dL/dt."""
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        if FOLLOWING:
            step_equations(W, h, t, lane)
            solve_following(W, lane)
        for node in range(NODES):
            at_node(W, h, t, node, lane)
            node_power(W, lane)
            add_work(W, h, node, lane)
        if CARRIED:
            for point in range(DEGREE):
                at_point(W, h, t, point, lane)
                hold_velocities(W, lane)
                add_carried(W, h, lane)
        exchange_steps(W, lane)
        if CARRIED:
            go_to_start(W, t + h, lane)
            hold_velocities(W, lane)
            add_carried_end(W, lane)
        sum_work(W, lane)
