"""Second derivatives of the rows of a step, contracted with weights.

With weights lambda_k of D_k L_d, k = 0..d, and gamma of a running cost g, the function is

    sum_i h alpha_i.F_i + beta_i.P_i + h gamma_i g_i,
    alpha_i = b_i sum_k A_ik lambda_k,    beta_i = b_i sum_k B_ik lambda_k,    gamma_i = b_i gamma,

plus, with weights nu_k of phi(X_k), sum_k nu_k.phi(X_k) - lambda_k.Phi(X_k)^T mu_k. The variables
of the matrix HESSIAN are the control points X_0..X_d, mu_0..mu_(d-1), and the varied parameters and
inputs at each node.
"""


@kernel
def curvature(W, h, t, lane):
    """Second derivatives of weighted rows of a step."""
    clear(W, HESSIAN, HESSIAN_SIZE * HESSIAN_SIZE, lane)
    for node in range(NODES):
        at_node(W, h, t, node, lane)
        if TIMED_COST:
            W[NODE_TIME, lane] = t + PLACES[node] * h
        weigh_node_rows(W, node, lane)
        go_to_place(W, h, PLACES[node], real(1), lane)
        node_curvature(W, lane)
        add_curvature(W, node, lane)
    if HELD:
        for point in range(DEGREE + 1):
            at_point(W, h, t, point, lane)
            clear(W, CONSTRAINT_QQ, HELD_SIZE, lane)
            for s in range(DIMENSION):
                a = COORDINATE[s]
                W[NODE_WEIGHT + a, lane] = W[ROW_WEIGHT + point * DIMENSION + a, lane]
            first = ROW_WEIGHT + (DEGREE + 1) * DIMENSION + point * CONSTRAINTS
            copy(W, first, NODE_WEIGHT + DIMENSION, CONSTRAINTS, lane)
            for c in range(CONSTRAINTS):  # these are mu
                W[MULTIPLIER + c, lane] /= h
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
        multiply(W, NODE_WEIGHT, 2 * DIMENSION, W[GROWTH + node, lane], lane)


@compiled
def reach(node, variable, k):
    """Return the derivative of a variable at a node by X_k: of q, h v, or a parameter."""
    slope = BASIS[node, k] if variable < DIMENSION else BASIS_SLOPE[node, k]
    return slope if variable < 2 * DIMENSION else real(1)


@compiled
def row_of(node, variable, k):
    """Return the row of the Hessian of the point X_k, or of a parameter at a node."""
    varied = VARIED_FROM + (variable - 2 * DIMENSION) * NODES + node
    return k * DIMENSION + variable % DIMENSION if variable < 2 * DIMENSION else varied


@compiled
def add_entry(W, row, column, value, both, lane):
    """Add a second derivative, and the one with the variables exchanged if these are ``both``."""
    W[HESSIAN + row * HESSIAN_SIZE + column, lane] += value
    if both:
        W[HESSIAN + column * HESSIAN_SIZE + row, lane] += value


@compiled
def add_curvature(W, node, lane):
    """Carry the second derivatives at a node to the control points."""
    for entry in range(len(CURVATURE_ROW)):
        i = CURVATURE_ROW[entry]
        j = CURVATURE_COLUMN[entry]
        for k in range(DEGREE + 1 if i < 2 * DIMENSION else 1):
            for m in range(DEGREE + 1 if j < 2 * DIMENSION else 1):
                value = reach(node, j, m) * W[NODE_CURVATURE + entry, lane]
                value = reach(node, i, k) * value
                add_entry(W, row_of(node, i, k), row_of(node, j, m), value, i != j, lane)


@compiled
def place_of(point, variable):
    """Return the row of a variable at a control point: q, a multiplier, or a parameter."""
    if variable < DIMENSION:
        return point * DIMENSION + variable
    if variable < DIMENSION + CONSTRAINTS:
        return (DEGREE + 1) * DIMENSION + point * CONSTRAINTS + variable - DIMENSION
    return VARIED_FROM + (variable - DIMENSION - CONSTRAINTS) * NODES


@compiled
def add_point_curvature(W, point, lane):
    """Add the second derivatives at a control point; parameters count for the first node."""
    for entry in range(len(POINT_ROW)):
        i = POINT_ROW[entry]
        j = POINT_COLUMN[entry]
        held = i >= DIMENSION and i < DIMENSION + CONSTRAINTS
        if point < DEGREE or not held:
            value = W[POINT_CURVATURE + entry, lane]
            add_entry(W, place_of(point, i), place_of(point, j), value, i != j, lane)
