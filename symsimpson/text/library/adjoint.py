"""Derivatives of a cost, carried from the end of a step back to its start.

The cost is J(q1, p1). ADJOINT has its derivatives (a, b) by q1 and p1. The matrix of a step's
derivatives gives S^T w = a at X_d + E_X^T b. The derivatives by q0 are a + E_q^T b - R_q^T w, and
the derivatives by p0 are b - w_0. At node i

    sigma = h b_i (b - sum_k A_ik w_k),    tau = -b_i sum_k B_ik w_k

are the derivatives of J by F and P, and those by a parameter sum_i (F_a.sigma + P_a.tau). A
running cost g adds h b_i g(t_i, q_i, v_i) at each node.

With constraints, K = [[M, Phi^T], [Phi, 0]] at the end, and K (x, z) = (M b, 0). The derivative
by the momentum before the projection is x. The derivative by q1 is then

    a + P_q^T (b - x) - Hess(nu.phi) x - Hess(z.phi) v.

At control points the rows phi = 0 have multipliers u, next to w of the other rows.
"""


@kernel
def adjoint(W, h, t, lane):
    """Carry derivatives of a cost back over the step that was taken."""
    if W[ACTIVE, lane] != 0:
        if HELD:
            undo_projection(W, h, t, lane)
        exchange_steps(W, lane)
        if FOLLOWING:
            solve_following(W, h, t, lane)
        if DAMPED:
            for a in range(DIMENSION):
                W[ADJOINT + DIMENSION + a, lane] /= W[GROWTH + NODES, lane]
        clear(W, ADJOINT_RIGHT, UNKNOWNS, lane)
        for column in range(DEGREE):
            if COLUMN_ORDER[column] == DEGREE:
                for s in range(DIMENSION):
                    here = column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
                    W[ADJOINT_RIGHT + here, lane] = W[ADJOINT + COORDINATE[s], lane]
        clear(W, ADJOINT_START, DIMENSION, lane)
        clear(W, COST_SLOPE, VARIED * NODES, lane)
        differentiate_step(W, h, t, 1, lane)
        pull_end(W, lane)
        if HELD:
            for point in range(DEGREE):
                pull_point(W, h, point, lane)
        factor_equations(W, lane)
        solve_transposed(W, ADJOINT_RIGHT, lane)
        if VARIED_BY:
            for node in range(NODES):
                pull_parameters(W, h, node, lane)
        pull_start(W, lane)
        if HELD:
            for point in range(DEGREE + 1):
                pull_start_of_point(W, h, point, lane)
        close_adjoint(W, lane)
        exchange_steps(W, lane)


@kernel
def start_adjoint(W, h, t, lane):
    """Derivatives by q0 and v0 from those by q0 and p0.

    The momentum is p = L_v(q, v). The derivatives of b.p by q are added, and its derivatives by v
    replace b. Its derivatives by parameters replace derivatives through the first node.
    """
    go_to_start(W, t, lane)
    jet(W, lane)
    if VARIED_BY:
        differentiate_state(W, h, 0, lane)
        for j in range(VARIED):
            slope = real(0)
            for row in range(P_A_FROM[j], P_A_FROM[j + 1]):
                by_momentum = W[ADJOINT + DIMENSION + COORDINATE[P_A_PLACE[row]], lane]
                slope += W[NODE_P_A + row, lane] * by_momentum
            W[COST_SLOPE + j * NODES, lane] = slope
    b = ADJOINT + DIMENSION
    for s in range(DIMENSION):
        W[NODE_VELOCITY + s, lane] = add_product(W, real(0), NODE_L_VV, s, 1, b, lane)
        W[ADJOINT + COORDINATE[s], lane] += add_product(W, real(0), NODE_L_QV, s, 0, b, lane)
    for s in range(DIMENSION):
        W[b + COORDINATE[s], lane] = W[NODE_VELOCITY + s, lane]


@kernel
def record(W, h, t, lane):
    """Store the initial state and the increments of the last step."""
    if W[ACTIVE, lane] != 0:
        copy(W, PREVIOUS, TANGENT, 4 * DIMENSION, lane)
        copy(W, SOLVED, TANGENT + 4 * DIMENSION, UNKNOWNS, lane)


@kernel
def step_cost(W, h, t, lane):
    """Add the running cost of the last step."""
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        if FOLLOWING:
            solve_following(W, h, t, lane)
        for node in range(NODES):
            if CANONICAL:
                phase_node(W, h, t, node, lane)
            else:
                at_node(W, h, t, node, lane)
            cost_at_node(W, h, t, node, lane)
        exchange_steps(W, lane)


@kernel
def running_cost(W, h, t, lane):
    """The running cost at q and v; the rows of p contain v."""
    copy(W, MOMENTUM, VELOCITY, DIMENSION, lane)
    go_to_start(W, t, lane)
    if TIMED_COST:
        W[NODE_TIME, lane] = t
    if SIZED:
        go_to_place(W, h, real(0), real(0), lane)
    cost_slopes(W, lane)


@compiled
def cost_at_node(W, h, t, node, lane):
    """Add the running cost at a node, and evaluate its derivatives."""
    if TIMED_COST:
        W[NODE_TIME, lane] = t + PLACES[node] * h
    if SIZED:
        go_to_place(W, h, PLACES[node], real(1), lane)
    cost_slopes(W, lane)
    before = W[COST, lane]
    change = h * WEIGHTS[node] * W[NODE_COST, lane] + W[COST + 1, lane]
    W[COST, lane] = before + change
    W[COST + 1, lane] = change - (W[COST, lane] - before)


@compiled
def add_cost(W, h, node, lane):
    """Add the derivatives of the running cost at a node to the derivatives of J."""
    weight = h * WEIGHTS[node]
    for s in range(DIMENSION):
        by_position = weight * W[NODE_COST + 1 + s, lane]
        by_velocity = WEIGHTS[node] * W[NODE_COST + 1 + DIMENSION + s, lane]
        W[ADJOINT_START + s, lane] += by_position
        for column in range(DEGREE):
            k = COLUMN_ORDER[column]
            change = BASIS[node, k] * by_position + BASIS_SLOPE[node, k] * by_velocity
            W[ADJOINT_RIGHT + column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane] += change
    for j in range(VARIED):
        slope = weight * W[NODE_COST + 1 + 2 * DIMENSION + j, lane]
        W[COST_SLOPE + j * NODES + node, lane] += slope


@compiled
def pull_end(W, lane):
    """Add the terms of p1: E_X^T b to the right side, E_q^T b to the derivative by q0."""
    b = ADJOINT + DIMENSION
    for s in range(DIMENSION):
        start = W[ADJOINT_START + s, lane]
        W[ADJOINT_START + s, lane] = add_product(W, start, END_SLOPES, s, 1, b, lane)
        for column in range(DEGREE):
            first = END_SLOPES + (column + 1) * (NODE_L_QV - NODE_L_QQ)
            here = ADJOINT_RIGHT + column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            W[here, lane] = add_product(W, W[here, lane], first, s, 1, b, lane)


@compiled
def pull_parameters(W, h, node, lane):
    """Add derivatives by parameters through a node; sigma and tau replace q and v there."""
    for s in range(DIMENSION):
        sigma = W[ADJOINT + DIMENSION + COORDINATE[s], lane]
        tau = real(0)
        for row in range(DEGREE):
            k = ROW_ORDER[row]
            w = W[ADJOINT_RIGHT + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane]
            sigma -= BASIS[node, k] * w
            tau -= BASIS_SLOPE[node, k] * w
        W[NODE_POSITION + s, lane] = h * WEIGHTS[node] * sigma
        W[NODE_VELOCITY + s, lane] = WEIGHTS[node] * tau
    for j in range(VARIED):
        slope = real(0)
        for row in range(F_A_FROM[j], F_A_FROM[j + 1]):
            by_force = W[STEP_F_A + node * F_A_FROM[VARIED] + row, lane]
            slope += by_force * W[NODE_POSITION + F_A_PLACE[row], lane]
        for row in range(P_A_FROM[j], P_A_FROM[j + 1]):
            by_momentum = W[STEP_P_A + node * P_A_FROM[VARIED] + row, lane]
            slope += by_momentum * W[NODE_VELOCITY + P_A_PLACE[row], lane]
        W[COST_SLOPE + j * NODES + node, lane] += slope


@compiled
def pull_start(W, lane):
    """Add the terms of the rows of the step, -R_q^T w, to the derivative by q0."""
    for row in range(DEGREE):
        first = START_SLOPES + row * (NODE_L_QV - NODE_L_QQ) + NODE_OFFSET
        right = ADJOINT_RIGHT + row * EQUATION_ROW_STEP
        for s in range(DIMENSION):
            slope = real(0)
            for c in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                w = W[right + c * EQUATION_PLACE_STEP, lane]
                slope += W[first + c * NODE_STRIDE + s, lane] * w
            W[ADJOINT_START + s, lane] -= slope


@compiled
def close_adjoint(W, lane):
    """Carry the derivatives to the start of the step: by q0, and by p0, b - w_0."""
    if HELD and VARIED_BY:
        for j in range(VARIED):
            W[COST_SLOPE + j * NODES, lane] += W[COST_END + j, lane]
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[ADJOINT + a, lane] += W[ADJOINT_START + s, lane]
        for row in range(DEGREE):
            if ROW_ORDER[row] == 0:
                w = W[ADJOINT_RIGHT + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane]
                W[ADJOINT + DIMENSION + a, lane] -= w


@compiled
def undo_projection(W, h, t, lane):
    """Carry derivatives of a cost from the end of the step to before its projection."""
    exchange_steps(W, lane)
    impulse_of_step(W, h, t, lane)
    exchange_steps(W, lane)
    for a in range(DIMENSION):  # the end, with the momentum before its projection
        end = SOLVED + (DEGREE - 1) * DIMENSION + a
        W[POSITION + a, lane] = W[PREVIOUS + a, lane] + W[end, lane]
        W[MOMENTUM + a, lane] = W[PREVIOUS + 2 * DIMENSION + a, lane] + W[RESIDUAL + a, lane]
    find_velocity(W, t + h, lane)
    jet(W, lane)
    if VARIED_BY:
        differentiate_state(W, h, 1, lane)
    copy(W, VELOCITY, ADJOINT_START, DIMENSION, lane)
    copy(W, MULTIPLIER, HELD_CHANGE, CONSTRAINTS, lane)
    b = ADJOINT + DIMENSION
    for s in range(DIMENSION):
        W[NODE_VELOCITY + s, lane] = add_product(W, real(0), NODE_L_VV, s, 0, b, lane)
    clear(W, CURVATURE, CONSTRAINTS, lane)
    solve_held(W, lane)
    differentiate_constraints(W, lane)
    pull_curvature(W, lane)
    if CARRIED:
        carried_slopes(W, lane)
        if VARIED_BY:
            carried_parameter_slopes(W, lane)
        pull_carried(W, lane)
    copy(W, VELOCITY, b, DIMENSION, lane)
    copy(W, HELD_CHANGE, MULTIPLIER, CONSTRAINTS, lane)
    differentiate_constraints(W, lane)
    pull_hessian(W, b, lane)


@compiled
def pull_hessian(W, x, lane):
    """Add -Hess(lambda.phi) x to the derivative by q1, and its part by parameters."""
    for s in range(DIMENSION):
        pull = times(W, CONSTRAINT_QQ, HELD_PLACE[s], 1, x, lane)
        W[ADJOINT + COORDINATE[s], lane] -= pull
    if VARIED_BY:
        for j in range(VARIED):
            for s in range(DIMENSION):
                change = W[x + COORDINATE[s], lane]
                W[COST_END + j, lane] -= W[CONSTRAINT_QA + j * DIMENSION + s, lane] * change


@compiled
def pull_curvature(W, lane):
    """Add P_q^T (b - x) - Hess(z.phi) v to the derivative by q1; x is in VELOCITY."""
    for s in range(DIMENSION):
        slope = -times(W, CONSTRAINT_QQ, HELD_PLACE[s], 1, ADJOINT_START, lane)
        for c in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            a = COORDINATE[c]
            taken = W[ADJOINT + DIMENSION + a, lane] - W[VELOCITY + a, lane]
            slope += W[NODE_L_QV + s * NODE_STRIDE + c + NODE_OFFSET, lane] * taken
        W[ADJOINT + COORDINATE[s], lane] += slope
    if VARIED_BY:
        for j in range(VARIED):
            slope = real(0)
            for s in range(DIMENSION):
                velocity = W[ADJOINT_START + COORDINATE[s], lane]
                slope -= W[CONSTRAINT_QA + j * DIMENSION + s, lane] * velocity
            for row in range(P_A_FROM[j], P_A_FROM[j + 1]):
                a = COORDINATE[P_A_PLACE[row]]
                taken = W[ADJOINT + DIMENSION + a, lane] - W[VELOCITY + a, lane]
                slope += W[NODE_P_A + row, lane] * taken
            W[COST_END + j, lane] = slope


@compiled
def pull_point(W, h, point, lane):
    """Add the constraint forces at a control point to the right side."""
    first, b = POINT_QQ + point * HELD_SIZE, ADJOINT + DIMENSION
    column = COLUMN_OF_POINT[point]
    for s in range(DIMENSION):
        if column >= 0:
            row = column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            W[ADJOINT_RIGHT + row, lane] -= times(W, first, HELD_PLACE[s], 1, b, lane) / h
    for c in range(CONSTRAINTS):
        row = DEGREE * DIMENSION + point * CONSTRAINTS + c
        slope = times(W, first, HELD_PLACE[DIMENSION + c], 1, b, lane)
        W[ADJOINT_RIGHT + row, lane] -= slope / h


@compiled
def pull_start_of_point(W, h, point, lane):
    """Add the derivatives by q0 and by parameters that go through a control point."""
    first = POINT_QQ + point * HELD_SIZE + HELD_OFFSET
    multiplier = ADJOINT_RIGHT + DEGREE * DIMENSION + (point - 1) * CONSTRAINTS
    for s in range(DIMENSION):
        if point < DEGREE:  # w - b
            row = ROW_OF_POINT[point] * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            b = W[ADJOINT + DIMENSION + COORDINATE[s], lane]
            W[NODE_VELOCITY + s, lane] = W[ADJOINT_RIGHT + row, lane] - b
    for s in range(DIMENSION):
        i = HELD_PLACE[s]
        slope = real(0)
        for a in range(DIMENSION):
            if point < DEGREE and abs(i - HELD_PLACE[a]) <= HELD_BAND:
                entry = first + HELD_PLACE[a] * HELD_STRIDE + i
                slope += W[entry, lane] * W[NODE_VELOCITY + a, lane]
        for c in range(CONSTRAINTS):
            j = HELD_PLACE[DIMENSION + c]
            if point > 0 and abs(i - j) <= HELD_BAND:
                slope -= W[first + j * HELD_STRIDE + i, lane] * W[multiplier + c, lane]
        W[ADJOINT_START + s, lane] += slope / h
    if VARIED_BY:
        for j in range(VARIED):
            slope = real(0)
            for s in range(DIMENSION):
                if point < DEGREE:
                    pull = W[POINT_QA + (point * VARIED + j) * DIMENSION + s, lane]
                    slope += pull * W[NODE_VELOCITY + s, lane]
            for c in range(CONSTRAINTS):
                if point > 0:
                    phi = W[POINT_A + (point * VARIED + j) * CONSTRAINTS + c, lane]
                    slope -= phi * W[multiplier + c, lane]
            W[COST_SLOPE + j * NODES, lane] += slope / h
