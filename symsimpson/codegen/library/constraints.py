"""Constraints: their rows of a step, and velocities that they allow."""

from collections.abc import Callable
from typing import Any

compiled: Callable[[Any], Any]
real: Callable[[Any], Any]
solve_mass: Callable[..., Any]
add_exactly: Callable[..., Any]

DIMENSION: int
DEGREE: int
CONSTRAINTS: int
POSITION: int
INCREMENT: int
PREDICTED: int
MOMENTUM: int
MOMENTUM_LOW: int
VELOCITY: int
NODE_POSITION: int
NODE_VELOCITY: int
NODE_L_VV: int
MULTIPLIER: int
CONSTRAINT: int
CONSTRAINT_Q: int
CONSTRAINT_QQ: int
CONSTRAINT_WEIGHT: int
HELD_Q: int
HELD: int
CURVATURE: int
DEPENDENCE: int
RESIDUAL: int
JACOBIAN: int
SOLVE_STRIDE: int
ROW_OF_POINT: tuple[int, ...]
COLUMN_OF_POINT: tuple[int, ...]


@compiled
def control_point(W, point, lane):
    """Position and multipliers at a control point; there are none of these at the last one."""
    for a in range(DIMENSION):
        W[NODE_POSITION + a, lane] = W[POSITION + a, lane]
        if point > 0:
            W[NODE_POSITION + a, lane] += W[INCREMENT + (point - 1) * DIMENSION + a, lane]
    for c in range(CONSTRAINTS):
        W[MULTIPLIER + c, lane] = real(0)
        if point < DEGREE:
            row = INCREMENT + DEGREE * DIMENSION + point * CONSTRAINTS + c
            W[MULTIPLIER + c, lane] = W[row, lane]


@compiled
def assemble_constraint(W, h, point, lane):
    """Add what a control point contributes: -Phi^T mu to its row, and phi = 0 as one of its own.

    The unknown is h mu, and phi is divided by h: then the matrix is as well conditioned for small
    h as for large ones.
    """
    rate = 1 / h
    behind = DEGREE * DIMENSION
    for a in range(DIMENSION):
        i = ROW_OF_POINT[point] * DIMENSION + a
        for c in range(CONSTRAINTS):
            slope = rate * W[CONSTRAINT_Q + c * DIMENSION + a, lane]
            if point < DEGREE:
                column = behind + point * CONSTRAINTS + c
                W[RESIDUAL + i, lane] -= slope * W[MULTIPLIER + c, lane]
                W[JACOBIAN + i * SOLVE_STRIDE + column, lane] = -slope
            if point > 0:
                row = behind + (point - 1) * CONSTRAINTS + c
                column = COLUMN_OF_POINT[point] * DIMENSION + a
                W[JACOBIAN + row * SOLVE_STRIDE + column, lane] = slope
        if point > 0 and point < DEGREE:
            entry = JACOBIAN + i * SOLVE_STRIDE + COLUMN_OF_POINT[point] * DIMENSION
            for b in range(DIMENSION):
                W[entry + b, lane] -= rate * W[CONSTRAINT_QQ + a * DIMENSION + b, lane]
    if point > 0:
        for c in range(CONSTRAINTS):
            row = behind + (point - 1) * CONSTRAINTS + c
            W[RESIDUAL + row, lane] = rate * W[CONSTRAINT + c, lane]


@compiled
def update_multipliers(W, lane):
    """Apply the Newton correction to the multipliers, which follow where the increments go."""
    first = DEGREE * DIMENSION
    for row in range(first, first + DEGREE * CONSTRAINTS):
        W[INCREMENT + row, lane] -= W[RESIDUAL + row, lane]


@compiled
def clear_multipliers(W, lane):
    """Begin with multipliers of zero: the first iteration finds them, as they enter linearly."""
    first = DEGREE * DIMENSION
    for row in range(first, first + DEGREE * CONSTRAINTS):
        W[INCREMENT + row, lane] = real(0)
        W[PREDICTED + row, lane] = real(0)


@compiled
def carry_multipliers(W, lane):
    """Predict the multipliers of the last step."""
    first = DEGREE * DIMENSION
    for row in range(first, first + DEGREE * CONSTRAINTS):
        W[RESIDUAL + row, lane] = W[INCREMENT + row, lane]


@compiled
def add_pull(W, h, lane):
    """Add the pull -Phi^T mu of constraints at a control point to p1 - p0."""
    for a in range(DIMENSION):
        for c in range(CONSTRAINTS):
            slope = W[CONSTRAINT_Q + c * DIMENSION + a, lane] / h
            W[RESIDUAL + a, lane] -= slope * W[MULTIPLIER + c, lane]


@compiled
def stiffen_mass(W, lane):
    """Add w Phi^T Phi to M, which is positive definite then if M is for what constraints allow.

    Velocities with Phi v = 0 do not see it. Each w is the trace of M in units of its row of Phi.
    """
    trace = real(0)
    for a in range(DIMENSION):
        trace += W[NODE_L_VV + a * DIMENSION + a, lane]
    for c in range(CONSTRAINTS):
        square = real(0)
        for a in range(DIMENSION):
            square += W[CONSTRAINT_Q + c * DIMENSION + a, lane] ** 2
        W[CONSTRAINT_WEIGHT + c, lane] = trace / (square if square > 0 else real(1))
    for c in range(CONSTRAINTS):
        for a in range(DIMENSION):
            slope = W[CONSTRAINT_WEIGHT + c, lane] * W[CONSTRAINT_Q + c * DIMENSION + a, lane]
            for b in range(DIMENSION):
                entry = slope * W[CONSTRAINT_Q + c * DIMENSION + b, lane]
                W[NODE_L_VV + a * DIMENSION + b, lane] += entry


@compiled
def factor_constraints(W, lane):
    """Keep M^-1 Phi^T, and factorise Phi M^-1 Phi^T = L D L^T.

    DEPENDENCE becomes the smallest pivot relative to its diagonal: zero where a constraint follows
    from others.
    """
    for c in range(CONSTRAINTS):
        for a in range(DIMENSION):
            W[NODE_VELOCITY + a, lane] = W[CONSTRAINT_Q + c * DIMENSION + a, lane]
        solve_mass(W, lane)
        for a in range(DIMENSION):
            W[HELD_Q + c * DIMENSION + a, lane] = W[VELOCITY + a, lane]
        for e in range(c + 1):
            entry = real(0)
            for a in range(DIMENSION):
                slope = W[CONSTRAINT_Q + e * DIMENSION + a, lane]
                entry += slope * W[HELD_Q + c * DIMENSION + a, lane]
            W[HELD + c * CONSTRAINTS + e, lane] = entry
    least = real(1)
    for c in range(CONSTRAINTS):
        row = HELD + c * CONSTRAINTS
        whole = W[row + c, lane]
        for e in range(c):
            entry = W[row + e, lane]
            for k in range(e):
                entry -= W[HELD + k * CONSTRAINTS + c, lane] * W[HELD + e * CONSTRAINTS + k, lane]
            # L D above the diagonal, L below it, D on it
            W[HELD + e * CONSTRAINTS + c, lane] = entry
            W[row + e, lane] = entry / W[HELD + e * CONSTRAINTS + e, lane]
            W[row + c, lane] -= entry * W[row + e, lane]
        share = W[row + c, lane] / (whole if whole > 0 else real(1))
        least = share if not share >= least else least
    W[DEPENDENCE, lane] = least


@compiled
def hold_velocity(W, lane):
    """Take from VELOCITY what constraints do not allow: Phi v becomes CURVATURE.

    MULTIPLIER becomes what it takes, v - M^-1 Phi^T nu.
    """
    for c in range(CONSTRAINTS):
        value = -W[CURVATURE + c, lane]
        for a in range(DIMENSION):
            value += W[CONSTRAINT_Q + c * DIMENSION + a, lane] * W[VELOCITY + a, lane]
        for e in range(c):
            value -= W[HELD + c * CONSTRAINTS + e, lane] * W[MULTIPLIER + e, lane]
        W[MULTIPLIER + c, lane] = value
    for back in range(CONSTRAINTS):
        c = CONSTRAINTS - 1 - back
        value = W[MULTIPLIER + c, lane] / W[HELD + c * CONSTRAINTS + c, lane]
        for e in range(c + 1, CONSTRAINTS):
            value -= W[HELD + e * CONSTRAINTS + c, lane] * W[MULTIPLIER + e, lane]
        W[MULTIPLIER + c, lane] = value
    for c in range(CONSTRAINTS):
        for a in range(DIMENSION):
            part = W[HELD_Q + c * DIMENSION + a, lane] * W[MULTIPLIER + c, lane]
            W[VELOCITY + a, lane] -= part


@compiled
def allow_no_change(W, lane):
    """Velocities stay on the constraints: Phi v = 0."""
    for c in range(CONSTRAINTS):
        W[CURVATURE + c, lane] = real(0)


@compiled
def project_momentum(W, lane):
    """Take from p what constraints do not allow, Phi^T nu."""
    for a in range(DIMENSION):
        taken = real(0)
        for c in range(CONSTRAINTS):
            taken += W[CONSTRAINT_Q + c * DIMENSION + a, lane] * W[MULTIPLIER + c, lane]
        add_exactly(W, MOMENTUM + a, MOMENTUM_LOW + a, W[MOMENTUM_LOW + a, lane] - taken, lane)


@compiled
def push_to_solve(W, lane):
    """Return what accelerates to the solve for v', of which constraints ask Phi v' = -v.phi_qq.v.

    What was added to M stands on the right-hand side, too.
    """
    for a in range(DIMENSION):
        W[NODE_VELOCITY + a, lane] = W[RESIDUAL + a, lane]
        for c in range(CONSTRAINTS):
            weight = W[CONSTRAINT_WEIGHT + c, lane] * W[CURVATURE + c, lane]
            W[NODE_VELOCITY + a, lane] += weight * W[CONSTRAINT_Q + c * DIMENSION + a, lane]
