"""Derivatives of a cost, carried from the end of a step back to its start.

The cost is J(q1, p1), or what follows of it; its derivatives (a, b) by q1 and p1 stand in ADJOINT.
With the matrix of a step's derivatives, S^T w = a at X_d + E_X^T b; derivatives by q0 are
a + E_q^T b - R_q^T w, by p0 they are b - w_0. At node i

    sigma = h b_i (b - sum_k A_ik w_k),    tau = -b_i sum_k B_ik w_k

are the derivatives of J by F and P, and those by a parameter sum_i (F_a.sigma + P_a.tau). A
running cost g adds h b_i g(t_i, q_i, v_i) at each node.
"""


@kernel
def adjoint(W, h, t, lane):
    """Carry derivatives of a cost back over the step that was taken."""
    if W[ACTIVE, lane] != 0:
        if HELD:
            undo_projection(W, h, t, lane)
        exchange_steps(W, lane)
        if FOLLOWING:
            step_equations(W, h, t, lane)
            solve_following(W, lane)
        begin_adjoint(W, lane)
        for node in range(NODES):
            differentiate_node(W, h, t, node, lane)
            if COSTED:
                cost_at_node(W, h, t, node, lane)
                add_cost(W, h, node, lane)
        assemble_derivatives(W, h, t, lane)
        pull_end(W, lane)
        if HELD:
            for point in range(DEGREE):
                pull_point(W, h, point, lane)
        factor_equations(W, lane)
        solve_transposed(W, ADJOINT_RIGHT, lane)
        if VARIED_BY:
            for node in range(NODES):
                pull_node(W, h, node, lane)
                pull_parameters(W, node, lane)
        pull_start(W, lane)
        if HELD:
            for point in range(DEGREE + 1):
                pull_start_of_point(W, h, point, lane)
        close_adjoint(W, lane)
        exchange_steps(W, lane)


@kernel
def start_adjoint(W, h, t, lane):
    """Derivatives by q0 and v0 from those by q0 and p0."""
    go_to_start(W, t, lane)
    jet(W, lane)
    if VARIED_BY:
        differentiate_state(W, h, 0, lane)
    pull_momentum(W, lane)


@kernel
def record(W, h, t, lane):
    """Keep the step that was taken: where it began, and its increments."""
    if W[ACTIVE, lane] != 0:
        for row in range(4 * DIMENSION):
            W[TANGENT + row, lane] = W[PREVIOUS + row, lane]
        for row in range(UNKNOWNS):
            W[TANGENT + 4 * DIMENSION + row, lane] = W[SOLVED + row, lane]


@kernel
def step_cost(W, h, t, lane):
    """Add the running cost of the step that was taken."""
    if W[ACTIVE, lane] != 0:
        exchange_steps(W, lane)
        if FOLLOWING:
            step_equations(W, h, t, lane)
            solve_following(W, lane)
        for node in range(NODES):
            at_node(W, h, t, node, lane)
            cost_at_node(W, h, t, node, lane)
            integrate_cost(W, h, node, lane)
        exchange_steps(W, lane)


@kernel
def running_cost(W, h, t, lane):
    """The running cost at q and v, which stands in the place of p."""
    for a in range(DIMENSION):
        W[VELOCITY + a, lane] = W[MOMENTUM + a, lane]
    go_to_start(W, t, lane)
    if TIMED_COST:
        node_time(W, t, lane)
    if SIZED:
        go_to_place(W, h, real(0), real(0), lane)
    cost_slopes(W, lane)


@compiled
def cost_at_node(W, h, t, node, lane):
    """Evaluate the running cost and its derivatives at a node."""
    if TIMED_COST:
        node_time(W, t + PLACES[node] * h, lane)
    if SIZED:
        go_to_place(W, h, PLACES[node], real(1), lane)
    cost_slopes(W, lane)


@compiled
def begin_adjoint(W, lane):
    """Begin the right side dJ/dX with what the end of the path contributes, other sums with 0."""
    if DAMPED:
        for a in range(DIMENSION):
            W[ADJOINT + DIMENSION + a, lane] /= W[GROWTH + NODES, lane]
    for row in range(UNKNOWNS):
        W[ADJOINT_RIGHT + row, lane] = real(0)
    for column in range(DEGREE):
        if COLUMN_ORDER[column] == DEGREE:
            for s in range(DIMENSION):
                here = column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
                W[ADJOINT_RIGHT + here, lane] = W[ADJOINT + COORDINATE[s], lane]
    for s in range(DIMENSION):
        W[ADJOINT_START + s, lane] = real(0)
    for entry in range(VARIED * NODES):
        W[COST_SLOPE + entry, lane] = real(0)


@compiled
def add_cost(W, h, node, lane):
    """Add the running cost at a node, and its derivatives to those of J."""
    integrate_cost(W, h, node, lane)
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
    """Add what p1 contributes: E_X^T b to the right side, E_q^T b to the derivative by q0."""
    for s in range(DIMENSION):
        start = W[ADJOINT_START + s, lane]
        for c in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            slope = W[END_SLOPES + c * NODE_STRIDE + s + NODE_OFFSET, lane]
            start += slope * W[ADJOINT + DIMENSION + COORDINATE[c], lane]
        W[ADJOINT_START + s, lane] = start
        for column in range(DEGREE):
            first = END_SLOPES + (column + 1) * (NODE_L_QV - NODE_L_QQ) + s + NODE_OFFSET
            here = ADJOINT_RIGHT + column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            right = W[here, lane]
            for c in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                b = W[ADJOINT + DIMENSION + COORDINATE[c], lane]
                right += W[first + c * NODE_STRIDE, lane] * b
            W[here, lane] = right


@compiled
def pull_node(W, h, node, lane):
    """Find sigma and tau at a node; they stand where q and v stood."""
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


@compiled
def pull_parameters(W, node, lane):
    """Add the derivatives by parameters that go through a node."""
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
    """Add to the derivative by q0 what the rows of the step contribute, -R_q^T w."""
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
def integrate_cost(W, h, node, lane):
    """Add the running cost at a node."""
    before = W[COST, lane]
    change = h * WEIGHTS[node] * W[NODE_COST, lane] + W[COST + 1, lane]
    W[COST, lane] = before + change
    W[COST + 1, lane] = change - (W[COST, lane] - before)


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
            for s in range(DIMENSION):
                w = W[ADJOINT_RIGHT + row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP, lane]
                W[ADJOINT + DIMENSION + COORDINATE[s], lane] -= w


@compiled
def pull_momentum(W, lane):
    """Find the derivatives of b.p, p = L_v(q, v): by q they are added, by v they replace b.

    Those by parameters replace derivatives that go through the first node.
    """
    if VARIED_BY:
        for j in range(VARIED):
            slope = real(0)
            for row in range(P_A_FROM[j], P_A_FROM[j + 1]):
                b = W[ADJOINT + DIMENSION + COORDINATE[P_A_PLACE[row]], lane]
                slope += W[NODE_P_A + row, lane] * b
            W[COST_SLOPE + j * NODES, lane] = slope
    for s in range(DIMENSION):
        by_position = real(0)
        by_velocity = real(0)
        for c in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            b = W[ADJOINT + DIMENSION + COORDINATE[c], lane]
            by_position += W[NODE_L_QV + s * NODE_STRIDE + c + NODE_OFFSET, lane] * b
            by_velocity += W[NODE_L_VV + c * NODE_STRIDE + s + NODE_OFFSET, lane] * b
        W[ADJOINT + COORDINATE[s], lane] += by_position
        W[NODE_VELOCITY + s, lane] = by_velocity
    for s in range(DIMENSION):
        W[ADJOINT + DIMENSION + COORDINATE[s], lane] = W[NODE_VELOCITY + s, lane]
