"""The mass matrix: velocities from momenta and back."""

from collections.abc import Callable
from typing import Any

compiled: Callable[[Any], Any]
real: Callable[[Any], Any]

DIMENSION: int
MOMENTUM: int
VELOCITY: int
NODE_VELOCITY: int
NODE_L_V: int
NODE_L_VV: int
MASS_DIAGONAL: int
MASS: int
ENERGY: int
KINETIC: int
BAND: int
NODE_STRIDE: int
NODE_OFFSET: int
COORDINATE: tuple[int, ...]
MASS_PIVOT: int


@compiled
def keep_mass(W, lane):
    """Keep a constant M, whose factors will take its place."""
    for entry in range(MASS - NODE_L_VV):
        W[MASS + entry, lane] = W[NODE_L_VV + entry, lane]


@compiled
def factor_mass(W, lane):
    """Factorise M = L D L^T in its place; MASS_PIVOT < 0 if M is not positive definite."""
    deficit = real(0)
    for i in range(DIMENSION):
        row_i = NODE_L_VV + i * NODE_STRIDE + NODE_OFFSET
        W[MASS_DIAGONAL + COORDINATE[i], lane] = W[row_i + i, lane]
        for j in range(max(0, i - BAND), i):
            row_j = NODE_L_VV + j * NODE_STRIDE + NODE_OFFSET
            entry = W[row_i + j, lane]
            for k in range(max(0, i - BAND), j):
                entry -= W[NODE_L_VV + k * NODE_STRIDE + NODE_OFFSET + i, lane] * W[row_j + k, lane]
            # L D above the diagonal, L below it, D on it
            W[row_j + i, lane] = entry
        for j in range(max(0, i - BAND), i):
            row_j = NODE_L_VV + j * NODE_STRIDE + NODE_OFFSET
            entry = W[row_j + i, lane] / W[row_j + j, lane]
            W[row_i + j, lane] = entry
            W[row_i + i, lane] -= entry * W[row_j + i, lane]
        pivot = W[row_i + i, lane]
        deficit += pivot - abs(pivot)
    W[MASS_PIVOT, lane] = deficit


@compiled
def momentum_to_solve(W, lane):
    """Return p - a to the solve for the velocity."""
    for s in range(DIMENSION):
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + COORDINATE[s], lane] - W[NODE_L_V + s, lane]


@compiled
def solve_mass(W, lane):
    """Solve L D L^T v = right, which stands in the rows of a node's velocity."""
    for i in range(DIMENSION):
        row_i = NODE_L_VV + i * NODE_STRIDE + NODE_OFFSET
        v = W[NODE_VELOCITY + i, lane]
        for j in range(max(0, i - BAND), i):
            v -= W[row_i + j, lane] * W[NODE_VELOCITY + j, lane]
        W[NODE_VELOCITY + i, lane] = v
    for back in range(DIMENSION):
        i = DIMENSION - 1 - back
        v = W[NODE_VELOCITY + i, lane] / W[NODE_L_VV + i * NODE_STRIDE + NODE_OFFSET + i, lane]
        for j in range(i + 1, min(DIMENSION, i + BAND + 1)):
            v -= W[NODE_L_VV + j * NODE_STRIDE + NODE_OFFSET + i, lane] * W[NODE_VELOCITY + j, lane]
        W[NODE_VELOCITY + i, lane] = v
        W[VELOCITY + COORDINATE[i], lane] = v


@compiled
def momentum(W, lane):
    """Momentum p = M v + a."""
    for s in range(DIMENSION):
        p = W[NODE_L_V + s, lane]
        for b in range(max(0, s - BAND), min(DIMENSION, s + BAND + 1)):
            mass = W[NODE_L_VV + s * NODE_STRIDE + b + NODE_OFFSET, lane]
            p += mass * W[NODE_VELOCITY + b, lane]
        W[MOMENTUM + COORDINATE[s], lane] = p


@compiled
def kinetic_energy(W, lane):
    """Begin the energy with v.(p - a)/2, with the velocity that solve_mass found."""
    kinetic = real(0)
    for s in range(DIMENSION):
        a = COORDINATE[s]
        kinetic += (W[MOMENTUM + a, lane] - W[NODE_L_V + s, lane]) * W[VELOCITY + a, lane]
    W[KINETIC, lane] = kinetic / 2
    W[ENERGY, lane] = kinetic / 2
