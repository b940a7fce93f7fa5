"""Cyclic coordinates: their velocities follow from constant momenta, without unknowns.

D_k L_d = 0 for all control points of cyclic coordinates y means that L_vy - p is orthogonal to
polynomials of degree d - 1. Hence L_vy = p + sum_r C_ri / b_i lambda_r at node i, where the rows of
C annihilate these polynomials. With M_yy = L D L^T and beta = L_vy at v_y = 0 the velocities are
v_y = L^-T D^-1 L^-1 (L_vy - beta). They are a polynomial of degree d - 1 if sum_i C_ri v_y = 0,
which gives the multipliers lambda. The text stores them as L_o^-1 lambda for the node o =
REFERENCE, with factors T = L^-1 L_o at each node. L is the sum of 1, a constant part, and a part
that depends on q. The last part is stored separately: then differences of L lose no digits where
M_yy is nearly singular.

The cyclic coordinates are the last ones. The start of the path has the number NODES and its end
NODES + 1, unless nodes are there.
"""


@compiled
def cyclic_forward(W, vector, node, lane):
    """Solve L x = b at a node; x replaces b."""
    for r in range(CYCLIC):
        row = (node * CYCLIC + r) * CYCLIC
        for k in range(r):
            W[vector + r, lane] -= W[CYCLIC_FIXED + row + k, lane] * W[vector + k, lane]
            W[vector + r, lane] -= W[CYCLIC_L + row + k, lane] * W[vector + k, lane]


@compiled
def cyclic_point(W, h, t, node, closing, lane):
    """Go to a node; if the step is closed, a node at q1 is its exact end."""
    at_node(W, h, t, node, lane)
    if TRACED and closing > 0 and AT_POINT[node] == DEGREE:
        path_end(W, lane)


@compiled
def cyclic_node(W, node, lane):
    """Find 1 / D and L^-1 (p - beta) at a node."""
    cyclic_mass(W, node, lane)
    first = node * CYCLIC
    for r in range(CYCLIC):
        W[CYCLIC_INVERSE + first + r, lane] = 1 / W[CYCLIC_D + first + r, lane]
        free = W[MOMENTUM + COORDINATE[OTHERS + r], lane] - W[CYCLIC_P + first + r, lane]
        W[CYCLIC_P + first + r, lane] = free
    cyclic_forward(W, CYCLIC_P + first, node, lane)


@compiled
def cyclic_bases(W, node, lane):
    """Find T = 1 + L^-1 (L_o - L) at a node, on and below its diagonal."""
    for k in range(CYCLIC):
        W[CYCLIC_T + (node * CYCLIC + k) * CYCLIC + k, lane] = real(1)
        for r in range(k + 1, CYCLIC):
            row = (node * CYCLIC + r) * CYCLIC
            value = W[CYCLIC_L + (REFERENCE * CYCLIC + r) * CYCLIC + k, lane]
            value -= W[CYCLIC_L + row + k, lane]
            for m in range(k + 1, r):
                turned = W[CYCLIC_T + (node * CYCLIC + m) * CYCLIC + k, lane]
                value -= W[CYCLIC_L + row + m, lane] * turned
            W[CYCLIC_T + row + k, lane] = value


@compiled
def cyclic_multipliers(W, lane):
    """Solve sum_i C_ri T^T D^-1 (L^-1 (p - beta) + C_mi / b_i T lambda_m) = 0."""
    size = EXTRA * CYCLIC
    for row in range(size):
        r, i = row // CYCLIC, row % CYCLIC
        right = real(0)
        for node in range(NODES):
            for here in range(node * CYCLIC + i, node * CYCLIC + CYCLIC):
                turned = W[CYCLIC_T + here * CYCLIC + i, lane] * W[CYCLIC_INVERSE + here, lane]
                right -= ANNIHILATOR[r, node] * (turned * W[CYCLIC_P + here, lane])
        W[CYCLIC_LAMBDA + row, lane] = right
        for column in range(size):
            m, j = column // CYCLIC, column % CYCLIC
            entry = real(0)
            for node in range(NODES):
                weight = ANNIHILATOR[r, node] * ANNIHILATOR[m, node] / WEIGHTS[node]
                for here in range(node * CYCLIC + max(i, j), node * CYCLIC + CYCLIC):
                    both = W[CYCLIC_T + here * CYCLIC + i, lane]
                    both *= W[CYCLIC_T + here * CYCLIC + j, lane]
                    entry += weight * (W[CYCLIC_INVERSE + here, lane] * both)
            W[CYCLIC_MATRIX + row * size + column, lane] = entry
    if size == 2:  # one division, instead of two that wait for each other
        x, y, z = W[CYCLIC_MATRIX, lane], W[CYCLIC_MATRIX + 1, lane], W[CYCLIC_MATRIX + 3, lane]
        scale = 1 / (x * z - y**2)
        W[CYCLIC_MATRIX, lane], W[CYCLIC_MATRIX + 3, lane] = z * scale, x * scale
        W[CYCLIC_MATRIX + 1, lane] = -y * scale
    else:
        factor_symmetric(W, CYCLIC_MATRIX, size, size, size, lane)
    solve_multipliers(W, lane)


@compiled
def solve_multipliers(W, lane):
    """Solve for multipliers with the factors of their matrix, or with its inverse."""
    if EXTRA * CYCLIC == 2:
        x, y, mixed = W[CYCLIC_LAMBDA, lane], W[CYCLIC_LAMBDA + 1, lane], W[CYCLIC_MATRIX + 1, lane]
        W[CYCLIC_LAMBDA, lane] = W[CYCLIC_MATRIX, lane] * x + mixed * y
        W[CYCLIC_LAMBDA + 1, lane] = mixed * x + W[CYCLIC_MATRIX + 3, lane] * y
    else:
        size = EXTRA * CYCLIC
        solve_symmetric(W, CYCLIC_MATRIX, CYCLIC_LAMBDA, size, size, size, lane)


@compiled
def cyclic_velocities(W, h, t, closing, lane):
    """Find v_y at all nodes; CYCLIC_GAP is L^-1 (L_vy - p) at the last node."""
    for node in range(NODES):
        cyclic_point(W, h, t, node, closing, lane)
        cyclic_node(W, node, lane)
    if EXTRA > 0:
        for node in range(NODES):
            cyclic_bases(W, node, lane)
        cyclic_multipliers(W, lane)
    for node in range(NODES):
        for k in range(CYCLIC):
            here = node * CYCLIC + k
            W[CYCLIC_GAP + k, lane] = real(0)
            if EXTRA > 0:
                for i in range(EXTRA * CYCLIC):
                    if i % CYCLIC <= k:
                        turned = W[CYCLIC_T + here * CYCLIC + i % CYCLIC, lane]
                        turned *= W[CYCLIC_LAMBDA + i, lane]
                        weight = ANNIHILATOR[i // CYCLIC, node] / WEIGHTS[node]
                        W[CYCLIC_GAP + k, lane] += weight * turned
                W[CYCLIC_P + here, lane] += W[CYCLIC_GAP + k, lane]
        for back in range(CYCLIC):
            k = CYCLIC - 1 - back
            v = W[CYCLIC_INVERSE + node * CYCLIC + k, lane] * W[CYCLIC_P + node * CYCLIC + k, lane]
            for m in range(k + 1, CYCLIC):
                row = (node * CYCLIC + m) * CYCLIC
                above = W[CYCLIC_FIXED + row + k, lane] + W[CYCLIC_L + row + k, lane]
                v -= above * W[CYCLIC_V + node * CYCLIC + m, lane]
            W[CYCLIC_V + node * CYCLIC + k, lane] = v


@compiled
def reduce_jet(W, node, lane):
    """Turn F_q, F_v and P_v into derivatives of the Routhian L - p v_y, where v_y follows from p.

    With E = L^-1 P_yq and F = L^-1 M_yx this subtracts E^T D^-1 E, E^T D^-1 F and F^T D^-1 F.
    """
    for b in range(OTHERS):
        e, f = CYCLIC_E + b * CYCLIC, CYCLIC_F + b * CYCLIC
        for r in range(CYCLIC):
            W[e + r, lane] = W[NODE_L_QV + b * NODE_STRIDE + OTHERS + r, lane]
            W[f + r, lane] = W[NODE_L_VV + (OTHERS + r) * NODE_STRIDE + b, lane]
        cyclic_forward(W, e, node, lane)
        cyclic_forward(W, f, node, lane)
        for r in range(CYCLIC):
            inverse = W[CYCLIC_INVERSE + node * CYCLIC + r, lane]
            here = (node * CYCLIC + r) * OTHERS + b
            W[CYCLIC_DE + here, lane] = inverse * W[e + r, lane]
            W[CYCLIC_DF + here, lane] = inverse * W[f + r, lane]
    for a in range(OTHERS):
        row = a * NODE_STRIDE
        for r in range(CYCLIC):
            here = (node * CYCLIC + r) * OTHERS
            e, f = W[CYCLIC_E + a * CYCLIC + r, lane], W[CYCLIC_F + a * CYCLIC + r, lane]
            for b in range(OTHERS):
                W[NODE_L_QV + row + b, lane] -= e * W[CYCLIC_DF + here + b, lane]
                if not TRACED or b <= a:
                    W[NODE_L_QQ + row + b, lane] -= e * W[CYCLIC_DE + here + b, lane]
                    W[NODE_L_VV + row + b, lane] -= f * W[CYCLIC_DF + here + b, lane]
                if TRACED and b < a:  # the same products
                    column = b * NODE_STRIDE + a
                    W[NODE_L_QQ + column, lane] -= e * W[CYCLIC_DE + here + b, lane]
                    W[NODE_L_VV + column, lane] -= f * W[CYCLIC_DF + here + b, lane]


@compiled
def cyclic_matrix(W, h, lane):
    """Add the terms of the multipliers to the Jacobian: h Q_k^T S^-1 Q_m.

    Q = sum_i C_i T^T D^-1 H, and H = A E + B F / h is the derivative of L_vy at a node by a control
    point, at constant v_y.
    """
    rate = 1 / h
    size = EXTRA * CYCLIC
    for node in range(NODES):
        for i in range(CYCLIC):
            here = (node * CYCLIC + i) * OTHERS
            for k in range(i + 1, CYCLIC):
                turned = W[CYCLIC_T + (node * CYCLIC + k) * CYCLIC + i, lane]
                other = (node * CYCLIC + k) * OTHERS
                for b in range(OTHERS):
                    W[CYCLIC_DE + here + b, lane] += turned * W[CYCLIC_DE + other + b, lane]
                    W[CYCLIC_DF + here + b, lane] += turned * W[CYCLIC_DF + other + b, lane]
            for b in range(OTHERS):
                W[CYCLIC_DF + here + b, lane] *= rate
    for m in range(DEGREE + 1):
        for b in range(OTHERS):
            for i in range(size):
                value = real(0)
                for node in range(NODES):
                    weight = ANNIHILATOR[i // CYCLIC, node]
                    here = (node * CYCLIC + i % CYCLIC) * OTHERS + b
                    value += weight * BASIS[node, m] * W[CYCLIC_DE + here, lane]
                    value += weight * BASIS_SLOPE[node, m] * W[CYCLIC_DF + here, lane]
                W[CYCLIC_PULL + (m * OTHERS + b) * size + i, lane] = value
    for column in range(DEGREE):
        for b in range(OTHERS):
            pull = CYCLIC_PULL + (COLUMN_ORDER[column] * OTHERS + b) * size
            for i in range(size):
                W[CYCLIC_LAMBDA + i, lane] = h * W[pull + i, lane]
            solve_multipliers(W, lane)
            for row in range(DEGREE):
                for a in range(OTHERS):
                    entry = (row * OTHERS + a) * OTHERS * DEGREE + column * OTHERS + b
                    pull = CYCLIC_PULL + (ROW_ORDER[row] * OTHERS + a) * size
                    for i in range(size):
                        pulled = W[pull + i, lane] * W[CYCLIC_LAMBDA + i, lane]
                        W[JACOBIAN + entry, lane] += pulled


@compiled
def cyclic_equations(W, h, t, lane):
    """Residual and Jacobian of the other coordinates, at constant momenta of cyclic ones."""
    cyclic_velocities(W, h, t, 0, lane)
    for node in range(NODES):
        cyclic_point(W, h, t, node, 0, lane)
        copy(W, CYCLIC_V + node * CYCLIC, NODE_VELOCITY + OTHERS, CYCLIC, lane)
        jet(W, lane)
        weigh_node(W, h, node, lane)
        reduce_jet(W, node, lane)
        keep_node(W, node, lane)
    assemble_residual(W, h, lane)
    for row in range(1, DEGREE):  # those of the others stand together
        for a in range(OTHERS):
            W[RESIDUAL + row * OTHERS + a, lane] = W[RESIDUAL + row * DIMENSION + a, lane]
    assemble_entries(W, h, OTHERS, OTHERS, OTHERS * DEGREE, lane)
    if EXTRA > 0:
        cyclic_matrix(W, h, lane)


@compiled
def find_cyclic_impulse(W, h, t, lane):
    """Find p1 - p0, which replaces the residual, and the increments of the cyclic coordinates.

    The last increment is h sum_i b_i v_y.
    """
    cyclic_velocities(W, h, t, 1, lane)
    clear(W, RESIDUAL, DIMENSION, lane)
    for node in range(NODES):
        cyclic_point(W, h, t, node, 1, lane)
        copy(W, CYCLIC_V + node * CYCLIC, NODE_VELOCITY + OTHERS, CYCLIC, lane)
        gradient(W, lane)
        accumulate(W, h, node, lane)
    for r in range(CYCLIC):
        increment = INCREMENT + COORDINATE[OTHERS + r]
        moved = real(0)
        for node in range(NODES):
            weight = h * WEIGHTS[node]
            moved += weight * W[CYCLIC_V + node * CYCLIC + r, lane]
        W[increment + (DEGREE - 1) * DIMENSION, lane] = moved
        for k in range(1, DEGREE):
            place = real(0)
            for node in range(NODES):
                place += REACHED_BY[k - 1, node] * W[CYCLIC_V + node * CYCLIC + r, lane]
            W[increment + (k - 1) * DIMENSION, lane] = h * place
        for row in range(0, DEGREE * DIMENSION, DIMENSION):  # nothing was predicted
            W[increment + PREDICTED - INCREMENT + row, lane] = W[increment + row, lane]
    if SEEN > NODES:
        cyclic_ends(W, h, t, lane)
    cyclic_checks(W, h, lane)


@compiled
def cyclic_ends(W, h, t, lane):
    """Find D at the ends of a path without nodes there, and L^-1 (L_vy - p) at q1."""
    rate = 1 / h
    end = NODES + 1
    go_to_start(W, t, lane)
    cyclic_node(W, NODES, lane)
    path_end(W, lane)
    for s in range(OTHERS):
        slope = real(0)
        for k in range(DEGREE):
            slope += END_SLOPE[k] * W[INCREMENT + k * DIMENSION + COORDINATE[s], lane]
        W[NODE_VELOCITY + s, lane] = rate * slope
    if not AUTONOMOUS:
        W[NODE_TIME, lane] = t + h
    cyclic_node(W, end, lane)
    for r in range(CYCLIC):
        gap = real(0)
        for m in range(r, CYCLIC):
            v = real(0)
            for node in range(NODES):
                v += AT_END[node] * W[CYCLIC_V + node * CYCLIC + m, lane]
            row = (end * CYCLIC + m) * CYCLIC
            if m > r:
                v *= W[CYCLIC_FIXED + row + r, lane] + W[CYCLIC_L + row + r, lane]
            gap += v
        gap *= W[CYCLIC_D + end * CYCLIC + r, lane]
        W[CYCLIC_GAP + r, lane] = gap - W[CYCLIC_P + end * CYCLIC + r, lane]


@compiled
def cyclic_checks(W, h, lane):
    """Measure the difference L_vy - p at the end by M_yy^-1, and the change of M_yy in the step.

    The change is the sum over D of sum_i D_i sum_i 1/D_i, minus its value for a constant D.
    """
    jump = real(0)
    change = real(0)
    for r in range(CYCLIC):
        jump += W[CYCLIC_INVERSE + (SEEN - 1) * CYCLIC + r, lane] * W[CYCLIC_GAP + r, lane] ** 2
        if CYCLIC_MOVING[r] > 0:
            pivots = real(0)
            inverses = real(0)
            for node in range(SEEN):
                pivots += W[CYCLIC_D + node * CYCLIC + r, lane]
                inverses += W[CYCLIC_INVERSE + node * CYCLIC + r, lane]
            change += pivots * inverses - SEEN**2
    W[CYCLIC_JUMP_SQUARED, lane] = h**2 * jump
    W[CYCLIC_MASS_CHANGE, lane] = change / SEEN**2
