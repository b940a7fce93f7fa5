"""Functions that emitted modules carry along, written once as ordinary Python.

The emitter copies their text. The names declared here are constants of the emitted module: the
blocks of the workspace and the scheme's tables. Nothing in this file runs in the package itself.
"""

from collections.abc import Callable
from typing import Any

compiled: Callable[[Any], Any]
real: Callable[[Any], Any]

DIMENSION: int
DEGREE: int
UNKNOWNS: int
NEWTON_UNKNOWNS: int
POSITION: int
POSITION_LOW: int
MOMENTUM: int
MOMENTUM_LOW: int
INCREMENT: int
VELOCITY: int
NODE_POSITION: int
NODE_VELOCITY: int
NODE_L_Q: int
NODE_L_V: int
NODE_L_QQ: int
NODE_L_QV: int
NODE_L_VV: int
METRIC: int
RESIDUAL: int
JACOBIAN: int
CORRECTION_SQUARED: int
INCREMENT_SQUARED: int
MISMATCH_SQUARED: int
SURPRISE_SQUARED: int
PREDICTED: int
PREVIOUS: int
SOLVED: int
MASS_PIVOT: int
ROW_ORDER: tuple[int, ...]
COLUMN_ORDER: tuple[int, ...]
POINTS: tuple[float, ...]
WEIGHTS: tuple[float, ...]
BASIS: tuple[tuple[float, ...], ...]
BASIS_SLOPE: tuple[tuple[float, ...], ...]
EXTRAPOLATION: tuple[tuple[float, ...], ...]
END_SLOPE: tuple[float, ...]
START_SLOPE: tuple[float, ...]


@compiled
def sincos(x):
    """Sine and cosine without branches, to 2 ulp for |x| < 5e8; beyond that they are NaN."""
    # x = quarter_turns * pi/2 + r with pi/2 in pieces of 24, 24, 24 and 53 bits: the products
    # with the first pieces are exact. Adding and subtracting 1.5 * 2**52 rounds to an integer.
    quarter_turns = (x * 0.6366197723675814 + 6755399441055744.0) - 6755399441055744.0
    r = (x - quarter_turns * 1.570796251296997) - quarter_turns * 7.549789415861596e-08
    r = (r - quarter_turns * 5.390302529957765e-15) - quarter_turns * 3.2820035428735005e-22
    # minimax polynomials on |r| <= pi/4
    z = r * r
    zz = z * z
    s = (2.7557313691916237e-06 - z * 2.5050758114913125e-08) + zz * 1.5896795630257458e-10
    s = (0.008333333333322413 - z * 0.00019841269829807805) + zz * s
    s = r + r * z * (-0.16666666666666632 + z * s)
    c = (-2.755731435233419e-07 + z * 2.0875723273412855e-09) - zz * 1.1359647812276651e-11
    c = (-0.0013888888888874125 + z * 2.4801587289482188e-05) + zz * c
    c = 1.0 - (0.5 * z - zz * (0.0416666666666666 + z * c))
    # quarter is quarter_turns modulo 4, between -2 and 2
    quarter = (0.25 * quarter_turns + 6755399441055744.0) - 6755399441055744.0
    quarter = quarter_turns - 4.0 * quarter
    odd = abs(quarter) == 1.0
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quarter == -1.0 or abs(quarter) == 2.0 else sine
    cosine = -cosine if quarter >= 1.0 or quarter == -2.0 else cosine
    domain = 0.0 if abs(x) < 5.0e8 else float("nan")
    return sine + domain, cosine + domain


@compiled
def path(W, h, node, lane):
    """Position and velocity of the path at a node."""
    for a in range(DIMENSION):
        q = real(0)
        v = real(0)
        for k in range(DEGREE):
            increment = W[INCREMENT + k * DIMENSION + a, lane]
            q += BASIS[node][k + 1] * increment
            v += BASIS_SLOPE[node][k + 1] * increment
        W[NODE_POSITION + a, lane] = W[POSITION + a, lane] + q
        W[NODE_VELOCITY + a, lane] = v / h


@compiled
def clear(W, lane):
    """Residual p0 in the rows of q0, zero elsewhere; Jacobian zero."""
    for row in range(UNKNOWNS):
        W[RESIDUAL + row, lane] = real(0)
    for a in range(DIMENSION):
        W[RESIDUAL + UNKNOWNS - DIMENSION + a, lane] = W[MOMENTUM + a, lane]
    for entry in range(UNKNOWNS * UNKNOWNS):
        W[JACOBIAN + entry, lane] = real(0)


@compiled
def assemble(W, h, node, lane):
    """Add a node's part to D_k L_d and to D_k D_m L_d."""
    for row in range(DEGREE):
        k = ROW_ORDER[row]
        weight_q = h * WEIGHTS[node] * BASIS[node][k]
        weight_v = WEIGHTS[node] * BASIS_SLOPE[node][k]
        for a in range(DIMENSION):
            i = row * DIMENSION + a
            W[RESIDUAL + i, lane] += (
                weight_q * W[NODE_L_Q + a, lane] + weight_v * W[NODE_L_V + a, lane]
            )
            for column in range(DEGREE):
                m = COLUMN_ORDER[column]
                weight_qq = weight_q * BASIS[node][m]
                weight_qv = WEIGHTS[node] * BASIS[node][k] * BASIS_SLOPE[node][m]
                weight_vq = weight_v * BASIS[node][m]
                weight_vv = weight_v * BASIS_SLOPE[node][m] / h
                entry = JACOBIAN + i * UNKNOWNS + column * DIMENSION
                for b in range(DIMENSION):
                    ab = a * DIMENSION + b
                    ba = b * DIMENSION + a
                    W[entry + b, lane] += (
                        weight_qq * W[NODE_L_QQ + ab, lane]
                        + weight_qv * W[NODE_L_QV + ab, lane]
                        + weight_vq * W[NODE_L_QV + ba, lane]
                        + weight_vv * W[NODE_L_VV + ab, lane]
                    )


@compiled
def solve_pivoted(W, lane):
    """Solve J x = R in place by Gaussian elimination with row pivoting; x takes the place of R."""
    for k in range(NEWTON_UNKNOWNS):
        pivot = k
        for i in range(k + 1, NEWTON_UNKNOWNS):
            here = abs(W[JACOBIAN + i * NEWTON_UNKNOWNS + k, lane])
            if here > abs(W[JACOBIAN + pivot * NEWTON_UNKNOWNS + k, lane]):
                pivot = i
        if pivot != k:
            for j in range(k, NEWTON_UNKNOWNS):
                swap = W[JACOBIAN + k * NEWTON_UNKNOWNS + j, lane]
                W[JACOBIAN + k * NEWTON_UNKNOWNS + j, lane] = W[JACOBIAN + pivot * NEWTON_UNKNOWNS + j, lane]
                W[JACOBIAN + pivot * NEWTON_UNKNOWNS + j, lane] = swap
            swap = W[RESIDUAL + k, lane]
            W[RESIDUAL + k, lane] = W[RESIDUAL + pivot, lane]
            W[RESIDUAL + pivot, lane] = swap
        inverse = 1 / W[JACOBIAN + k * NEWTON_UNKNOWNS + k, lane]
        for i in range(k + 1, NEWTON_UNKNOWNS):
            factor = W[JACOBIAN + i * NEWTON_UNKNOWNS + k, lane] * inverse
            for j in range(k + 1, NEWTON_UNKNOWNS):
                W[JACOBIAN + i * NEWTON_UNKNOWNS + j, lane] -= (
                    factor * W[JACOBIAN + k * NEWTON_UNKNOWNS + j, lane]
                )
            W[RESIDUAL + i, lane] -= factor * W[RESIDUAL + k, lane]
    for back in range(NEWTON_UNKNOWNS):
        k = NEWTON_UNKNOWNS - 1 - back
        x = W[RESIDUAL + k, lane]
        for j in range(k + 1, NEWTON_UNKNOWNS):
            x -= W[JACOBIAN + k * NEWTON_UNKNOWNS + j, lane] * W[RESIDUAL + j, lane]
        W[RESIDUAL + k, lane] = x / W[JACOBIAN + k * NEWTON_UNKNOWNS + k, lane]


@compiled
def update_increments(W, lane):
    """Apply the Newton correction and measure it and the increments in the metric of M(q0)."""
    correction_squared = real(0)
    increment_squared = real(0)
    for column in range(DEGREE):
        k = COLUMN_ORDER[column] - 1
        for a in range(DIMENSION):
            correction = -W[RESIDUAL + column * DIMENSION + a, lane]
            increment = W[INCREMENT + k * DIMENSION + a, lane] + correction
            W[INCREMENT + k * DIMENSION + a, lane] = increment
            correction_squared += W[METRIC + a, lane] * correction**2
            increment_squared += W[METRIC + a, lane] * increment**2
    W[CORRECTION_SQUARED, lane] = correction_squared
    W[INCREMENT_SQUARED, lane] = increment_squared


@compiled
def clear_momentum(W, lane):
    """Begin the sum that makes p1 - p0."""
    for a in range(DIMENSION):
        W[RESIDUAL + a, lane] = real(0)


@compiled
def accumulate(W, h, node, lane):
    """Add a node's part to p1 - p0 = h sum_i b_i L_q(q_i, v_i)."""
    for a in range(DIMENSION):
        W[RESIDUAL + a, lane] += h * WEIGHTS[node] * W[NODE_L_Q + a, lane]


@compiled
def close_step(W, lane):
    """Add the increments to q and p, with what rounding lost carried along."""
    for row in range(4 * DIMENSION):
        W[PREVIOUS + row, lane] = W[POSITION + row, lane]
    for row in range(UNKNOWNS):
        W[PREVIOUS + 4 * DIMENSION + row, lane] = W[PREDICTED + row, lane]
        W[SOLVED + row, lane] = W[INCREMENT + row, lane]
    surprise_squared = real(0)
    for a in range(DIMENSION):
        for row in range(a, UNKNOWNS, DIMENSION):
            surprise = W[INCREMENT + row, lane] - W[PREDICTED + row, lane]
            surprise_squared += W[METRIC + a, lane] * surprise**2
        increment = W[INCREMENT + (DEGREE - 1) * DIMENSION + a, lane] + W[POSITION_LOW + a, lane]
        old = W[POSITION + a, lane]
        new = old + increment
        taken = new - old
        W[POSITION + a, lane] = new
        W[POSITION_LOW + a, lane] = (old - (new - taken)) + (increment - taken)
        increment = W[RESIDUAL + a, lane] + W[MOMENTUM_LOW + a, lane]
        old = W[MOMENTUM + a, lane]
        new = old + increment
        taken = new - old
        W[MOMENTUM + a, lane] = new
        W[MOMENTUM_LOW + a, lane] = (old - (new - taken)) + (increment - taken)
    W[SURPRISE_SQUARED, lane] = surprise_squared


@compiled
def solve_mass(W, lane):
    """Solve M v = p - a by L D L^T; MASS_PIVOT < 0 if M is not positive definite."""
    deficit = real(0)
    for i in range(DIMENSION):
        W[METRIC + i, lane] = W[NODE_L_VV + i * DIMENSION + i, lane]
        v = W[MOMENTUM + i, lane] - W[NODE_L_V + i, lane]
        for j in range(i):
            entry = W[NODE_L_VV + i * DIMENSION + j, lane]
            for k in range(j):
                entry -= (
                    W[NODE_L_VV + k * DIMENSION + i, lane] * W[NODE_L_VV + j * DIMENSION + k, lane]
                )
            # L D above the diagonal, L below it, D on it
            W[NODE_L_VV + j * DIMENSION + i, lane] = entry
        for j in range(i):
            entry = W[NODE_L_VV + j * DIMENSION + i, lane] / W[NODE_L_VV + j * DIMENSION + j, lane]
            W[NODE_L_VV + i * DIMENSION + j, lane] = entry
            W[NODE_L_VV + i * DIMENSION + i, lane] -= entry * W[NODE_L_VV + j * DIMENSION + i, lane]
            v -= entry * W[VELOCITY + j, lane]
        pivot = W[NODE_L_VV + i * DIMENSION + i, lane]
        deficit += pivot - abs(pivot)
        W[VELOCITY + i, lane] = v
    for back in range(DIMENSION):
        i = DIMENSION - 1 - back
        v = W[VELOCITY + i, lane] / W[NODE_L_VV + i * DIMENSION + i, lane]
        for j in range(i + 1, DIMENSION):
            v -= W[NODE_L_VV + j * DIMENSION + i, lane] * W[VELOCITY + j, lane]
        W[VELOCITY + i, lane] = v
    W[MASS_PIVOT, lane] = deficit


@compiled
def straight(W, h, lane):
    """Increments of a path with the constant velocity v."""
    for k in range(DEGREE):
        for a in range(DIMENSION):
            increment = POINTS[k + 1] * h * W[VELOCITY + a, lane]
            W[INCREMENT + k * DIMENSION + a, lane] = increment
            W[PREDICTED + k * DIMENSION + a, lane] = increment


@compiled
def predict(W, h, lane):
    """Extrapolate the last path, bent to leave the new point with its velocity v."""
    mismatch_squared = real(0)
    for a in range(DIMENSION):
        mismatch = h * W[VELOCITY + a, lane]
        for j in range(DEGREE):
            mismatch -= END_SLOPE[j] * W[INCREMENT + j * DIMENSION + a, lane]
        mismatch_squared += W[METRIC + a, lane] * mismatch**2
        for k in range(DEGREE):
            increment = START_SLOPE[k] * mismatch
            for j in range(DEGREE):
                increment += EXTRAPOLATION[k][j] * W[INCREMENT + j * DIMENSION + a, lane]
            W[RESIDUAL + k * DIMENSION + a, lane] = increment
    for row in range(UNKNOWNS):
        W[INCREMENT + row, lane] = W[RESIDUAL + row, lane]
        W[PREDICTED + row, lane] = W[RESIDUAL + row, lane]
    W[MISMATCH_SQUARED, lane] = mismatch_squared


@compiled
def kinetic_energy(W, lane):
    """v.(p - a)/2 with the velocity and the a that solve_mass used."""
    kinetic = real(0)
    for a in range(DIMENSION):
        kinetic += (W[MOMENTUM + a, lane] - W[NODE_L_V + a, lane]) * W[VELOCITY + a, lane]
    return kinetic / 2
