"""Derivatives of a step with constraints: what multipliers, and the projection of p, add.

Rows of a variation stand in the order of the equations: of increments, then of multipliers, which
are h mu. The end of the step is projected: M v + Phi^T nu = p - a, Phi v = 0, and p = M v + a. So

    M dv + Phi^T dnu = dp - Hess(nu.phi) dq - P_q dq,    Phi dv = -(v.phi_qq) dq,

with P = L_v, and what is left of the momentum changes by M dv + P_q dq.
"""


@compiled
def project_variations(W, h, t, lane):
    """Project the variations of p at the end of the step; velocities are found once more."""
    factor_at_start(W, t + h, lane)
    solve_velocity(W, lane)
    jet(W, lane)
    if VARIED_BY:
        differentiate_state(W, h, 1, lane)
    for constraint in range(CONSTRAINTS):
        choose_constraint(W, constraint, lane)
        differentiate_constraints(W, lane)
        for variation in range(int(W[TANGENTS, lane])):
            vary_curvature(W, constraint, variation, lane)
    if CARRIED:
        differentiate_carried(W, lane)
        for variation in range(int(W[TANGENTS, lane])):
            vary_carried(W, variation, lane)
    momentum_taken(W, lane)
    allow_no_change(W, lane)
    solve_held(W, lane)
    differentiate_constraints(W, lane)
    for variation in range(int(W[TANGENTS, lane])):
        begin_projection(W, variation, lane)
        solve_held(W, lane)
        close_projection(W, variation, lane)
    solve_velocity(W, lane)


@compiled
def differentiate_constraints(W, lane):
    """Evaluate phi and Phi^T lambda with their derivatives, by parameters too."""
    constrain(W, lane)
    if VARIED_BY:
        constraint_parameter_slopes(W, lane)


@compiled
def times_dq(W, first, i, dq, lane):
    """Multiply a row of Hess(lambda.phi), or of Phi, with a change of q.

    Such matrices begin at ``first``: that of a point at hand, or one of those that are kept.
    """
    total = real(0)
    for b in range(DIMENSION):
        j = HELD_PLACE[b]
        if abs(i - j) <= HELD_BAND:
            entry = first + i * HELD_STRIDE + HELD_OFFSET + j
            total += W[entry, lane] * W[dq + COORDINATE[b], lane]
    return total


@compiled
def vary_constraint(W, h, point, dq, room, parameter, lane):
    """Add to the right side what changes of constraints at a control point and their pull.

    The pull that a parameter changes belongs to dp1 - dp0, too.
    """
    first = POINT_QQ + point * HELD_SIZE
    if point < DEGREE:
        for s in range(DIMENSION):
            row = ROW_OF_POINT[point] * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            W[room + row, lane] += times_dq(W, first, HELD_PLACE[s], dq, lane) / h
            if VARIED_BY and parameter >= 0:
                pull = W[POINT_QA + (point * VARIED + parameter) * DIMENSION + s, lane] / h
                W[room + row, lane] += pull
                W[room + UNKNOWNS + COORDINATE[s], lane] -= pull
    if point > 0:
        for c in range(CONSTRAINTS):
            row = DEGREE * DIMENSION + (point - 1) * CONSTRAINTS + c
            W[room + row, lane] -= times_dq(W, first, HELD_PLACE[DIMENSION + c], dq, lane) / h
            if VARIED_BY and parameter >= 0:
                slope = POINT_A + (point * VARIED + parameter) * CONSTRAINTS + c
                W[room + row, lane] -= W[slope, lane] / h


@compiled
def vary_pull(W, h, point, dq, room, lane):
    """Add to dp1 - dp0 what the pull of constraints at a control point changes by."""
    column = COLUMN_OF_POINT[point]
    for s in range(DIMENSION):
        i = HELD_PLACE[s]
        first = POINT_QQ + point * HELD_SIZE
        row = first + i * HELD_STRIDE + HELD_OFFSET
        pull = times_dq(W, first, i, dq, lane)
        for b in range(DIMENSION):
            if column >= 0 and abs(i - HELD_PLACE[b]) <= HELD_BAND:
                moved = W[room + column * EQUATION_ROW_STEP + b * EQUATION_PLACE_STEP, lane]
                pull += W[row + HELD_PLACE[b], lane] * moved
        for c in range(CONSTRAINTS):
            j = HELD_PLACE[DIMENSION + c]
            if abs(i - j) <= HELD_BAND:
                change = W[room + DEGREE * DIMENSION + point * CONSTRAINTS + c, lane]
                pull += W[row + j, lane] * change
        W[room + UNKNOWNS + COORDINATE[s], lane] -= pull / h


@compiled
def choose_constraint(W, constraint, lane):
    """Let the multiplier of one constraint be 1, and the others 0."""
    for c in range(CONSTRAINTS):
        W[MULTIPLIER + c, lane] = real(1) if c == constraint else real(0)


@compiled
def vary_curvature(W, constraint, variation, lane):
    """Find -(v.phi_qq) dq of a constraint and what a parameter changes of -Phi v.

    It stands after the right side for dv.
    """
    dq = TANGENT + variation * 2 * DIMENSION
    total = real(0)
    for s in range(DIMENSION):
        change = times_dq(W, CONSTRAINT_QQ, HELD_PLACE[s], dq, lane)
        total -= W[VELOCITY + COORDINATE[s], lane] * change
    parameter = parameter_of(W, variation, lane)
    if VARIED_BY and parameter >= 0:
        for s in range(DIMENSION):
            slope = W[CONSTRAINT_QA + parameter * DIMENSION + s, lane]
            total -= W[VELOCITY + COORDINATE[s], lane] * slope
    W[work_row_of(W, variation, lane) + DIMENSION + constraint, lane] = total


@compiled
def momentum_taken(W, lane):
    """Find what the projection has taken from p at the end of the step that was taken."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        before = W[PREVIOUS + 2 * DIMENSION + a, lane] + W[RESIDUAL + a, lane]
        W[NODE_VELOCITY + s, lane] = before - W[MOMENTUM + a, lane]


@compiled
def turned_momentum(W, s, dq, lane):
    """Multiply a row of P_q with a change of q."""
    total = real(0)
    for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
        slope = W[NODE_L_QV + b * NODE_STRIDE + s + NODE_OFFSET, lane]
        total += slope * W[dq + COORDINATE[b], lane]
    return total


@compiled
def begin_projection(W, variation, lane):
    """Let the right side of a variation be what is solved next: dp - Hess(nu.phi) dq - P_q dq.

    A parameter changes P and the pull as well.
    """
    dq = TANGENT + variation * 2 * DIMENSION
    room = work_row_of(W, variation, lane)
    for s in range(DIMENSION):
        right = W[dq + DIMENSION + COORDINATE[s], lane]
        right -= times_dq(W, CONSTRAINT_QQ, HELD_PLACE[s], dq, lane)
        W[NODE_VELOCITY + s, lane] = right - turned_momentum(W, s, dq, lane)
    parameter = parameter_of(W, variation, lane)
    if VARIED_BY and parameter >= 0:
        for s in range(DIMENSION):
            slope = W[CONSTRAINT_QA + parameter * DIMENSION + s, lane]
            W[NODE_VELOCITY + s, lane] -= slope
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[NODE_VELOCITY + P_A_PLACE[row], lane] -= W[NODE_P_A + row, lane]
    for c in range(CONSTRAINTS):
        W[CURVATURE + c, lane] = W[room + DIMENSION + c, lane]


@compiled
def close_projection(W, variation, lane):
    """Find dp = M dv + P_q dq of the projected momentum, and what a parameter changes of P."""
    dq = TANGENT + variation * 2 * DIMENSION
    dp = dq + DIMENSION
    for s in range(DIMENSION):
        change = turned_momentum(W, s, dq, lane)
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            mass = W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            change += mass * W[NODE_VELOCITY + b, lane]
        W[dp + COORDINATE[s], lane] = change
    parameter = parameter_of(W, variation, lane)
    if VARIED_BY and parameter >= 0:
        for row in range(P_A_FROM[parameter], P_A_FROM[parameter + 1]):
            W[dp + COORDINATE[P_A_PLACE[row]], lane] += W[NODE_P_A + row, lane]
