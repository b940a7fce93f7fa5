"""Second derivatives of the rows of a step, contracted with weights.

With weights lambda_k of D_k L_d, k = 0..d, and gamma of a running cost g, that is of

    sum_i h alpha_i.F_i + beta_i.P_i + h gamma_i g_i,
    alpha_i = b_i sum_k A_ik lambda_k,    beta_i = b_i sum_k B_ik lambda_k,    gamma_i = b_i gamma,

and with weights nu_k of phi(X_k), of sum_k nu_k.phi(X_k) - lambda_k.Phi(X_k)^T mu_k besides. The
matrix HESSIAN is by the control points X_0..X_d, by mu_0..mu_(d-1), and by the values that what is
varied has at each node.
"""


@kernel
def curvature(W, h, t, lane):
    """Second derivatives of weighted rows of a step."""
    for entry in range(HESSIAN_SIZE * HESSIAN_SIZE):
        W[HESSIAN + entry, lane] = real(0)
    for node in range(NODES):
        at_node(W, h, t, node, lane)
        if TIMED_COST:
            node_time(W, t + PLACES[node] * h, lane)
        weigh_node_rows(W, node, lane)
        go_to_place(W, h, PLACES[node], real(1), lane)
        node_curvature(W, lane)
        add_curvature(W, node, lane)
    if HELD:
        for point in range(DEGREE + 1):
            at_point(W, h, t, point, lane)
            clear_constraints(W, lane)
            weigh_point_rows(W, h, point, lane)
            point_curvature(W, lane)
            add_point_curvature(W, point, lane)


@compiled
def weigh_node_rows(W, node, lane):
    """Find alpha, beta and the weight of the running cost at a node."""
    for s in range(DIMENSION):
        force = real(0)
        momentum = real(0)
        for k in range(DEGREE + 1):
            weight = WEIGHTS[node] * W[ROW_WEIGHT + k * DIMENSION + COORDINATE[s], lane]
            force += BASIS[node, k] * weight
            momentum += BASIS_SLOPE[node, k] * weight
        W[NODE_WEIGHT + COORDINATE[s], lane] = force
        W[NODE_WEIGHT + DIMENSION + COORDINATE[s], lane] = momentum
    W[NODE_WEIGHT + 2 * DIMENSION, lane] = WEIGHTS[node] * W[COST_WEIGHT, lane]
    if DAMPED:  # a cost does not grow
        for row in range(2 * DIMENSION):
            W[NODE_WEIGHT + row, lane] *= W[GROWTH + node, lane]


@compiled
def reach(node, variable, k):
    """Return the derivative of a variable at a node, q or h v, by the control point X_k."""
    return BASIS[node, k] if variable < DIMENSION else BASIS_SLOPE[node, k]


@compiled
def add_curvature(W, node, lane):
    """Carry the second derivatives at a node to the control points."""
    for entry in range(len(CURVATURE_ROW)):
        i = CURVATURE_ROW[entry]
        j = CURVATURE_COLUMN[entry]
        value = W[NODE_CURVATURE + entry, lane]
        if i < 2 * DIMENSION:
            for k in range(DEGREE + 1):
                for m in range(DEGREE + 1):
                    row = k * DIMENSION + i % DIMENSION
                    column = m * DIMENSION + j % DIMENSION
                    term = reach(node, i, k) * (reach(node, j, m) * value)
                    W[HESSIAN + row * HESSIAN_SIZE + column, lane] += term
                    if i != j:
                        W[HESSIAN + column * HESSIAN_SIZE + row, lane] += term
        else:
            row = VARIED_FROM + (i - 2 * DIMENSION) * NODES + node
            for m in range(DEGREE + 1):
                if j < 2 * DIMENSION:
                    column = m * DIMENSION + j % DIMENSION
                    term = reach(node, j, m) * value
                    W[HESSIAN + row * HESSIAN_SIZE + column, lane] += term
                    W[HESSIAN + column * HESSIAN_SIZE + row, lane] += term
            if j >= 2 * DIMENSION:
                column = VARIED_FROM + (j - 2 * DIMENSION) * NODES + node
                W[HESSIAN + row * HESSIAN_SIZE + column, lane] += value
                if i != j:
                    W[HESSIAN + column * HESSIAN_SIZE + row, lane] += value


@compiled
def weigh_point_rows(W, h, point, lane):
    """Find the weights of a control point; the multipliers there are mu, and none at the last."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_WEIGHT + a, lane] = W[ROW_WEIGHT + point * DIMENSION + a, lane]
    for c in range(CONSTRAINTS):
        row = ROW_WEIGHT + (DEGREE + 1) * DIMENSION + point * CONSTRAINTS + c
        W[NODE_WEIGHT + DIMENSION + c, lane] = W[row, lane]
        W[MULTIPLIER + c, lane] /= h


@compiled
def place_of(point, variable):
    """Return where a variable at a control point stands: q, a multiplier, or what is varied."""
    if variable < DIMENSION:
        return point * DIMENSION + variable
    if variable < DIMENSION + CONSTRAINTS:
        return (DEGREE + 1) * DIMENSION + point * CONSTRAINTS + variable - DIMENSION
    return VARIED_FROM + (variable - DIMENSION - CONSTRAINTS) * NODES


@compiled
def add_point_curvature(W, point, lane):
    """Add the second derivatives at a control point; by a parameter, as if at the first node."""
    for entry in range(len(POINT_ROW)):
        i = POINT_ROW[entry]
        j = POINT_COLUMN[entry]
        held = i >= DIMENSION and i < DIMENSION + CONSTRAINTS
        if point < DEGREE or not held:
            row = place_of(point, i)
            column = place_of(point, j)
            W[HESSIAN + row * HESSIAN_SIZE + column, lane] += W[POINT_CURVATURE + entry, lane]
            if i != j:
                W[HESSIAN + column * HESSIAN_SIZE + row, lane] += W[POINT_CURVATURE + entry, lane]
