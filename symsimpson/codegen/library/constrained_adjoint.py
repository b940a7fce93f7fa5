"""The adjoint of a step with constraints: of their pull, and of the projection at its end.

With K = [[M, Phi^T], [Phi, 0]] at the end and (a, b) the derivatives of the cost by q1 and p1,
K (x, z) = (M b, 0). Before the projection they are x by the momentum, and by q1

    a + P_q^T (b - x) - Hess(nu.phi) x - Hess(z.phi) v.

At control points the multipliers u of the rows phi = 0 stand beside w of the others.
"""


@compiled
def undo_projection(W, h, t, lane):
    """Carry derivatives of a cost from the end of the step to before its projection."""
    exchange_steps(W, lane)
    impulse_of_step(W, h, t, lane)
    exchange_steps(W, lane)
    take_end(W, lane)
    factor_at_start(W, t + h, lane)
    solve_velocity(W, lane)
    jet(W, lane)
    if VARIED_BY:
        differentiate_state(W, h, 1, lane)
    keep_end(W, lane)
    momentum_of_adjoint(W, lane)
    allow_no_change(W, lane)
    solve_held(W, lane)
    differentiate_constraints(W, lane)
    pull_curvature(W, lane)
    if CARRIED:
        differentiate_carried(W, lane)
        pull_carried(W, lane)
    take_projected(W, lane)
    differentiate_constraints(W, lane)
    pull_projection(W, lane)


@compiled
def times_column(W, first, i, x, lane):
    """Multiply a column of derivatives of Phi^T lambda by q, or of Phi^T, with a vector."""
    total = real(0)
    for b in range(DIMENSION):
        j = HELD_PLACE[b]
        if abs(i - j) <= HELD_BAND:
            entry = first + j * HELD_STRIDE + HELD_OFFSET + i
            total += W[entry, lane] * W[x + COORDINATE[b], lane]
    return total


@compiled
def take_end(W, lane):
    """Go to the end of the step that was taken, with the momentum before its projection."""
    for a in range(DIMENSION):
        end = SOLVED + (DEGREE - 1) * DIMENSION + a
        W[POSITION + a, lane] = W[PREVIOUS + a, lane] + W[end, lane]
        before = W[PREVIOUS + 2 * DIMENSION + a, lane]
        W[MOMENTUM + a, lane] = before + W[RESIDUAL + a, lane]


@compiled
def keep_end(W, lane):
    """Keep v and nu of the end."""
    for a in range(DIMENSION):
        W[ADJOINT_START + a, lane] = W[VELOCITY + a, lane]
    for c in range(CONSTRAINTS):
        W[HELD_CHANGE + c, lane] = W[MULTIPLIER + c, lane]


@compiled
def momentum_of_adjoint(W, lane):
    """Let M b be what is solved for next."""
    for s in range(DIMENSION):
        right = real(0)
        for c in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            mass = W[NODE_L_VV + s * NODE_STRIDE + c + NODE_OFFSET, lane]
            right += mass * W[ADJOINT + DIMENSION + COORDINATE[c], lane]
        W[NODE_VELOCITY + s, lane] = right


@compiled
def pull_curvature(W, lane):
    """Add P_q^T (b - x) - Hess(z.phi) v to the derivative by q1; x stands where velocities do.

    Parameters change P and the pull as well.
    """
    for s in range(DIMENSION):
        slope = -times_column(W, CONSTRAINT_QQ, HELD_PLACE[s], ADJOINT_START, lane)
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
def take_projected(W, lane):
    """Let x be the derivative by the momentum, and nu the multipliers."""
    for a in range(DIMENSION):
        W[ADJOINT + DIMENSION + a, lane] = W[VELOCITY + a, lane]
    for c in range(CONSTRAINTS):
        W[MULTIPLIER + c, lane] = W[HELD_CHANGE + c, lane]


@compiled
def pull_projection(W, lane):
    """Add -Hess(nu.phi) x to the derivative by q1, and what parameters change of the pull."""
    for s in range(DIMENSION):
        W[ADJOINT + COORDINATE[s], lane] -= times_column(
            W, CONSTRAINT_QQ, HELD_PLACE[s], ADJOINT + DIMENSION, lane
        )
    if VARIED_BY:
        for j in range(VARIED):
            for s in range(DIMENSION):
                x = W[ADJOINT + DIMENSION + COORDINATE[s], lane]
                W[COST_END + j, lane] -= W[CONSTRAINT_QA + j * DIMENSION + s, lane] * x


@compiled
def pull_point(W, h, point, lane):
    """Add to the right side what the pull of constraints at a control point contributes."""
    first, b = POINT_QQ + point * HELD_SIZE, ADJOINT + DIMENSION
    if point < DEGREE:
        column = COLUMN_OF_POINT[point]
        for s in range(DIMENSION):
            if column >= 0:
                row = column * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
                W[ADJOINT_RIGHT + row, lane] -= times_column(W, first, HELD_PLACE[s], b, lane) / h
        for c in range(CONSTRAINTS):
            row = DEGREE * DIMENSION + point * CONSTRAINTS + c
            slope = times_column(W, first, HELD_PLACE[DIMENSION + c], b, lane)
            W[ADJOINT_RIGHT + row, lane] -= slope / h


@compiled
def pulled(W, point, s, lane):
    """Return w - b of a coordinate at a control point."""
    row = ROW_OF_POINT[point] * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
    return W[ADJOINT_RIGHT + row, lane] - W[ADJOINT + DIMENSION + COORDINATE[s], lane]


@compiled
def pull_start_of_point(W, h, point, lane):
    """Add the derivatives by q0 and by parameters that go through a control point."""
    first = POINT_QQ + point * HELD_SIZE + HELD_OFFSET
    for s in range(DIMENSION):
        i = HELD_PLACE[s]
        slope = real(0)
        for b in range(DIMENSION):
            if point < DEGREE and abs(i - HELD_PLACE[b]) <= HELD_BAND:
                entry = first + HELD_PLACE[b] * HELD_STRIDE + i
                slope += W[entry, lane] * pulled(W, point, b, lane)
        for c in range(CONSTRAINTS):
            j = HELD_PLACE[DIMENSION + c]
            if point > 0 and abs(i - j) <= HELD_BAND:
                u = W[ADJOINT_RIGHT + DEGREE * DIMENSION + (point - 1) * CONSTRAINTS + c, lane]
                slope -= W[first + j * HELD_STRIDE + i, lane] * u
        W[ADJOINT_START + s, lane] += slope / h
    if VARIED_BY:
        for j in range(VARIED):
            slope = real(0)
            for s in range(DIMENSION):
                if point < DEGREE:
                    pull = W[POINT_QA + (point * VARIED + j) * DIMENSION + s, lane]
                    slope += pull * pulled(W, point, s, lane)
            for c in range(CONSTRAINTS):
                if point > 0:
                    u = W[ADJOINT_RIGHT + DEGREE * DIMENSION + (point - 1) * CONSTRAINTS + c, lane]
                    slope -= W[POINT_A + (point * VARIED + j) * CONSTRAINTS + c, lane] * u
            W[COST_SLOPE + j * NODES, lane] += slope / h
