"""Constraints: their rows of a step, and velocities that satisfy them.

Coordinates and constraints share one order of places, in which interacting ones are close.
HELD_PLACE has the place of each coordinate, then of each constraint. CONSTRAINT_AT has the
constraint at a place, or -1.

Velocity constraints A v = b hold at Gauss points of the path. In each block their rows follow the
rows of phi. Their multipliers act at the control points, like the multipliers of phi.
"""


@compiled
def at_point(W, h, t, point, lane):
    """Go to a control point of the path, with its multipliers; the last one has none."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane]
        if point > 0:
            W[NODE_POSITION + s, lane] += W[INCREMENT + (point - 1) * DIMENSION + a, lane]
    clear(W, MULTIPLIER, CONSTRAINTS, lane)
    if point < DEGREE:
        first = INCREMENT + DEGREE * DIMENSION + point * CONSTRAINTS
        copy(W, first, MULTIPLIER, CONSTRAINTS, lane)
    if (ROLLING or MOVING) and not AUTONOMOUS:
        W[NODE_TIME, lane] = t + POINTS[point] * h


@compiled
def constraint_forces(W, lane):
    """Find Phi^T lambda, the negative of the constraint forces."""
    for s in range(DIMENSION):
        i = HELD_PLACE[s]
        row = CONSTRAINT_QQ + i * HELD_STRIDE + HELD_OFFSET
        force = real(0)
        for j in range(max(0, i - HELD_BAND), min(HELD_PLACES, i + HELD_BAND + 1)):
            if CONSTRAINT_AT[j] >= 0:
                force += W[row + j, lane] * W[MULTIPLIER + CONSTRAINT_AT[j], lane]
        W[CONSTRAINT_FORCE + COORDINATE[s], lane] = force


@compiled
def assemble_constraints(W, h, t, kept, lane):
    """Add the constraints to the rows of a step; store their derivatives if ``kept`` is 1."""
    for point in range(DEGREE + 1 if HOLONOMIC > 0 else DEGREE):
        at_point(W, h, t, point, lane)
        constrain(W, lane)
        assemble_constraint(W, h, point, lane)
        if DIFFERENTIATED and kept > 0:
            keep_point(W, h, point, lane)
    if ROLLING:
        for node in range(NODES, NODES + DEGREE):
            at_node(W, h, t, node, lane)
            rates(W, lane)
            assemble_rates(W, h, node, lane)
            if DIFFERENTIATED and kept > 0:
                keep_rates(W, h, node, lane)


@compiled
def assemble_constraint(W, h, point, lane):
    """Add the constraints at a control point: -Phi^T mu in its row, and the row phi = 0.

    The unknown is h mu, and phi is divided by h. Then the condition of the matrix does not depend
    on h.
    """
    rate = 1 / h
    if point < DEGREE:
        for s in range(DIMENSION):
            i = HELD_PLACE[s]
            there = ROW_OF_POINT[point] * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            for j in range(max(0, i - HELD_BAND), min(HELD_PLACES, i + HELD_BAND + 1)):
                if CONSTRAINT_AT[j] >= 0:
                    slope = rate * W[CONSTRAINT_QQ + i * HELD_STRIDE + HELD_OFFSET + j, lane]
                    W[RESIDUAL + there, lane] -= slope * W[MULTIPLIER + CONSTRAINT_AT[j], lane]
    if point > 0:
        for c in range(CONSTRAINTS):
            row = DEGREE * DIMENSION + (point - 1) * CONSTRAINTS + c
            W[RESIDUAL + row, lane] = rate * W[CONSTRAINT + c, lane]
    for i in range(HELD_PLACES):
        held = CONSTRAINT_AT[i] >= 0
        row = point - 1 if held else ROW_OF_POINT[point]
        scale = rate if held else -rate
        here = HELD_SHIFT + row * HELD_PULL_STEP if held else row * HELD_ROW_STEP
        entry = JACOBIAN + (here + i * HELD_PLACE_STEP) * SOLVE_STRIDE + SOLVE_OFFSET
        for j in range(max(0, i - HELD_BAND), min(HELD_PLACES, i + HELD_BAND + 1)):
            pulls = CONSTRAINT_AT[j] >= 0
            column = point if pulls else COLUMN_OF_POINT[point]
            there = HELD_SHIFT + column * HELD_PULL_STEP if pulls else column * HELD_ROW_STEP
            if row >= 0 and column >= 0 and column < DEGREE:
                W[entry + there + j * HELD_PLACE_STEP, lane] += (
                    scale * W[CONSTRAINT_QQ + i * HELD_STRIDE + HELD_OFFSET + j, lane]
                )


@compiled
def join_equations(W, lane):
    """Add the matrix of the nodes to the matrix of all unknowns; reorder the residual."""
    for row in range(DEGREE):
        for s in range(DIMENSION):
            there = row * HELD_ROW_STEP + HELD_PLACE[s] * HELD_PLACE_STEP
            here = row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            for column in range(DEGREE):
                source = JACOBIAN + here * EQUATION_STRIDE + EQUATION_OFFSET
                source += column * EQUATION_ROW_STEP
                target = JACOBIAN + there * SOLVE_STRIDE + SOLVE_OFFSET + column * HELD_ROW_STEP
                for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
                    W[target + HELD_PLACE[b] * HELD_PLACE_STEP, lane] += W[
                        source + b * EQUATION_PLACE_STEP, lane
                    ]
    reorder_rows(W, RESIDUAL, 0, lane)


@compiled
def reorder_rows(W, first, back, lane):
    """Permute rows of increments and multipliers to the order of elimination, or back."""
    copy(W, first, HELD_RIGHT, DEGREE * HELD_PLACES, lane)
    for row in range(DEGREE):
        for s in range(DIMENSION):
            there = row * HELD_ROW_STEP + HELD_PLACE[s] * HELD_PLACE_STEP
            here = row * EQUATION_ROW_STEP + s * EQUATION_PLACE_STEP
            source = HELD_RIGHT + (there if back > 0 else here)
            W[first + (here if back > 0 else there), lane] = W[source, lane]
        for c in range(CONSTRAINTS):
            there = HELD_SHIFT + row * HELD_PULL_STEP
            there += HELD_PLACE[DIMENSION + c] * HELD_PLACE_STEP
            here = DEGREE * DIMENSION + row * CONSTRAINTS + c
            source = HELD_RIGHT + (there if back > 0 else here)
            W[first + (here if back > 0 else there), lane] = W[source, lane]


@compiled
def stiffen(W, h, lane):
    """Add w Phi^T phi to the rows of increments, so that their pivots are regular if M is not.

    The weight w makes this term as large as M at the start of the step.
    """
    for row in range(DEGREE):
        k, m = ROW_ORDER[row], COLUMN_ORDER[row]
        for s in range(DIMENSION):
            i = row * HELD_ROW_STEP + HELD_PLACE[s] * HELD_PLACE_STEP
            here = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET
            for c in range(CONSTRAINTS):
                place = HELD_SHIFT + HELD_PLACE[DIMENSION + c] * HELD_PLACE_STEP
                scale = h * ROW_STIFFNESS[row] * W[CONSTRAINT_WEIGHT + c, lane]
                share = scale * W[here + place + k * HELD_PULL_STEP, lane]
                asked = place + (m - 1) * HELD_PULL_STEP
                W[RESIDUAL + i, lane] -= share * W[RESIDUAL + asked, lane]
                there = JACOBIAN + asked * SOLVE_STRIDE + SOLVE_OFFSET
                for j in range(SOLVE_UNKNOWNS):
                    W[here + j, lane] -= share * W[there + j, lane]


@compiled
def border_mass(W, lane):
    """Write M, bordered by Phi, and a weight w of each constraint.

    M + w Phi^T Phi is definite if M is definite for velocities with Phi v = 0. Each w is the trace
    of M over the coordinates near the constraint, divided by the square of its row of Phi.
    """
    first = HELD + HELD_OFFSET
    slopes = CONSTRAINT_QQ + HELD_OFFSET
    clear(W, HELD, HELD_SIZE, lane)
    for s in range(DIMENSION):
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            entry = W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            W[first + HELD_PLACE[s] * HELD_STRIDE + HELD_PLACE[b], lane] = entry
    for c in range(CONSTRAINTS):
        i = HELD_PLACE[DIMENSION + c]
        trace = real(0)
        square = real(0)
        for j in range(max(0, i - HELD_BAND), min(HELD_PLACES, i + HELD_BAND + 1)):
            if CONSTRAINT_AT[j] < 0:
                slope = W[slopes + i * HELD_STRIDE + j, lane]
                trace += W[first + j * HELD_STRIDE + j, lane]
                square += slope**2
                W[first + i * HELD_STRIDE + j, lane] = slope
                W[first + j * HELD_STRIDE + i, lane] = slope
        if TRACED:
            W[CONSTRAINT_WEIGHT + c, lane] = trace / square
        else:
            W[CONSTRAINT_WEIGHT + c, lane] = trace / (square if square > 0 else real(1))


@compiled
def weigh_constraints(W, lane):
    """Add w Phi^T Phi to M, which changes nothing for velocities with Phi v = 0."""
    first = HELD + HELD_OFFSET
    slopes = CONSTRAINT_QQ + HELD_OFFSET
    for c in range(CONSTRAINTS):
        i = HELD_PLACE[DIMENSION + c]
        begin = max(0, i - HELD_BAND)
        end = min(HELD_PLACES, i + HELD_BAND + 1)
        for j in range(begin, end):
            if CONSTRAINT_AT[j] < 0:
                share = W[CONSTRAINT_WEIGHT + c, lane] * W[slopes + i * HELD_STRIDE + j, lane]
                for k in range(max(begin, j - HELD_BAND), min(end, j + HELD_BAND + 1)):
                    if CONSTRAINT_AT[k] < 0:
                        more = share * W[slopes + i * HELD_STRIDE + k, lane]
                        W[first + j * HELD_STRIDE + k, lane] += more


@compiled
def factor_held(W, lane):
    """Factorise the bordered matrix; MASS_PIVOT is twice the sum of negative pivots.

    Each constraint follows its coordinates. If M is definite, pivots of coordinates are positive,
    and pivots of constraints negative. INDEPENDENCE is the smallest ratio of such a pivot to its
    value without the other constraints. It is zero if a constraint follows from others.
    """
    first = HELD + HELD_OFFSET
    for s in range(DIMENSION):
        i = HELD_PLACE[s]
        W[MASS_DIAGONAL + COORDINATE[s], lane] = W[first + i * HELD_STRIDE + i, lane]
    factor_symmetric(W, first, HELD_PLACES, HELD_BAND, HELD_STRIDE, lane)
    deficit = real(0)
    least = real(1)
    for i in range(HELD_PLACES):
        pivot = W[first + i * HELD_STRIDE + i, lane]
        c = CONSTRAINT_AT[i]
        if c < 0:
            deficit += pivot - abs(pivot)
        elif not TRACED:
            whole = real(0)
            for j in range(max(0, i - HELD_BAND), i):
                if CONSTRAINT_AT[j] < 0:
                    row_j = first + j * HELD_STRIDE
                    whole += W[first + i * HELD_STRIDE + j, lane] * W[row_j + i, lane]
            share = -pivot / (whole if whole > 0 else real(1))
            least = share if not share >= least else least
            W[HELD_PIVOT + c, lane] = -pivot
    W[MASS_PIVOT, lane] = deficit
    W[INDEPENDENCE, lane] = least


@compiled
def solve_held(W, lane):
    """Solve M v + Phi^T nu = b, Phi v = CURVATURE: v replaces b, and MULTIPLIER is nu."""
    for s in range(DIMENSION):
        i = HELD_PLACE[s]
        right = W[NODE_VELOCITY + s, lane]
        for j in range(max(0, i - HELD_BAND), min(HELD_PLACES, i + HELD_BAND + 1)):
            c = CONSTRAINT_AT[j]
            if c >= 0 and WEIGHTED:  # what was added to M
                share = W[CONSTRAINT_WEIGHT + c, lane] * W[CURVATURE + c, lane]
                right += share * W[CONSTRAINT_QQ + i * HELD_STRIDE + HELD_OFFSET + j, lane]
        W[HELD_RIGHT + i, lane] = right
    for c in range(CONSTRAINTS):
        W[HELD_RIGHT + HELD_PLACE[DIMENSION + c], lane] = W[CURVATURE + c, lane]
    solve_symmetric(W, HELD + HELD_OFFSET, HELD_RIGHT, HELD_PLACES, HELD_BAND, HELD_STRIDE, lane)
    for s in range(DIMENSION):
        v = W[HELD_RIGHT + HELD_PLACE[s], lane]
        W[NODE_VELOCITY + s, lane] = v
        W[VELOCITY + COORDINATE[s], lane] = v
    for c in range(CONSTRAINTS):
        W[MULTIPLIER + c, lane] = W[HELD_RIGHT + HELD_PLACE[DIMENSION + c], lane]


@compiled
def take_momentum(W, lane):
    """Subtract Phi^T nu from p1 - p0, in the rows of the residual."""
    constraint_forces(W, lane)
    for a in range(DIMENSION):
        W[RESIDUAL + a, lane] -= W[CONSTRAINT_FORCE + a, lane]


@compiled
def push_of_jet(W, lane):
    """Find M v' + Phi^T lambda = L_q - (d L_v/dq) v of a system without forces."""
    for s in range(DIMENSION):
        push = W[NODE_L_Q + s, lane]
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            turned = W[NODE_L_QV + b * NODE_STRIDE + s + NODE_OFFSET, lane]
            push -= turned * W[NODE_VELOCITY + b, lane]
        W[RESIDUAL + s, lane] = push


@compiled
def assemble_rates(W, h, node, lane):
    """Write the rows A v = b of the step at a point, in the place of rows phi = 0."""
    point = node - NODES
    for c in range(HOLONOMIC, CONSTRAINTS):
        rate = c - FIRST_SIDE
        row = RESIDUAL + DEGREE * DIMENSION + point * CONSTRAINTS + c
        W[row, lane] = W[SLIP + c - HOLONOMIC, lane]
        i = HELD_PLACE[DIMENSION + c]
        row = HELD_SHIFT + point * HELD_PULL_STEP + i * HELD_PLACE_STEP
        row = JACOBIAN + row * SOLVE_STRIDE
        for column in range(DEGREE):
            k = COLUMN_ORDER[column]
            for s in range(DIMENSION):
                a = rate * DIMENSION + COORDINATE[s]
                j = HELD_PLACE[s]
                entry = column * HELD_ROW_STEP + j * HELD_PLACE_STEP
                if abs(i - j) <= HELD_BAND:
                    W[row + SOLVE_OFFSET + entry, lane] = (
                        BASIS[node, k] * W[SLIP_Q + a, lane]
                        + BASIS_SLOPE[node, k] / h * W[SLIP_V + a, lane]
                    )


@compiled
def keep_rates(W, h, node, lane):
    """Store h times the derivatives of A v - b by q and by parameters."""
    point = node - NODES + 1
    first = POINT_QQ + point * HELD_SIZE + HELD_OFFSET
    for c in range(HOLONOMIC, CONSTRAINTS):
        i = HELD_PLACE[DIMENSION + c]
        for s in range(DIMENSION):
            rate = SLIP_Q + (c - FIRST_SIDE) * DIMENSION + COORDINATE[s]
            if abs(i - HELD_PLACE[s]) <= HELD_BAND:
                W[first + i * HELD_STRIDE + HELD_PLACE[s], lane] = h * W[rate, lane]
    if VARIED_BY:
        if SIZED:
            go_to_place(W, h, PLACES[node], real(1), lane)
        rate_parameter_slopes(W, lane)
        for j in range(VARIED):
            for c in range(HOLONOMIC, CONSTRAINTS):
                rate = SLIP_A + j * (CONSTRAINTS - FIRST_SIDE) + c - FIRST_SIDE
                slope = POINT_A + (point * VARIED + j) * CONSTRAINTS + c
                W[slope, lane] = h * W[rate, lane]


@compiled
def vary_carried(W, variation, lane):
    """Add b_q dq and b_a da to A dv."""
    dq = TANGENT + variation * 2 * DIMENSION
    room = work_row_of(W, variation, lane)
    parameter = variation - int(W[TANGENTS, lane]) + VARIED
    for c in range(FIRST_SIDE, CONSTRAINTS):
        for a in range(DIMENSION):
            slope = W[SLIP_Q + (c - FIRST_SIDE) * DIMENSION + a, lane]
            W[room + DIMENSION + c, lane] += slope * W[dq + a, lane]
        if VARIED_BY and parameter >= 0:
            slope = SLIP_A + parameter * (CONSTRAINTS - FIRST_SIDE) + c - FIRST_SIDE
            W[room + DIMENSION + c, lane] += W[slope, lane]


@compiled
def pull_carried(W, lane):
    """Add z.b_q to the derivative of a cost by q1, and z.b_a to those by parameters."""
    for c in range(FIRST_SIDE, CONSTRAINTS):
        for a in range(DIMENSION):
            slope = W[SLIP_Q + (c - FIRST_SIDE) * DIMENSION + a, lane]
            W[ADJOINT + a, lane] += W[MULTIPLIER + c, lane] * slope
    if VARIED_BY:
        for j in range(VARIED):
            for c in range(FIRST_SIDE, CONSTRAINTS):
                slope = SLIP_A + j * (CONSTRAINTS - FIRST_SIDE) + c - FIRST_SIDE
                W[COST_END + j, lane] += W[MULTIPLIER + c, lane] * W[slope, lane]
