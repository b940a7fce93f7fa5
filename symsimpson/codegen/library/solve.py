"""Newton corrections."""

from collections.abc import Callable
from typing import Any

compiled: Callable[[Any], Any]
real: Callable[[Any], Any]

DIMENSION: int
SOLVE_UNKNOWNS: int
INCREMENT: int
MASS_DIAGONAL: int
BLOCKS: int
SOLVE_ROW_STEP: int
SOLVE_PLACE_STEP: int
SOLVE_STRIDE: int
SOLVE_OFFSET: int
SOLVE_LOWER: int
SOLVE_UPPER: int
COORDINATE: tuple[int, ...]
FOLLOWING: tuple[int, ...]
SOLVE_COLUMNS: tuple[int, ...]
RESIDUAL: int
JACOBIAN: int
CORRECTION_SQUARED: int
INCREMENT_SQUARED: int


@compiled
def solve_pivoted(W, lane):
    """Solve J x = R in place by Gaussian elimination with row pivoting; x takes the place of R."""
    for k in range(SOLVE_UNKNOWNS):
        last = min(SOLVE_UNKNOWNS, k + SOLVE_LOWER + 1)
        end = min(SOLVE_UNKNOWNS, k + SOLVE_UPPER + 1)
        row_k = JACOBIAN + k * SOLVE_STRIDE + SOLVE_OFFSET
        pivot = k
        largest = abs(W[row_k + k, lane])
        for i in range(k + 1, last):
            here = abs(W[JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET + k, lane])
            if here > largest:
                largest = here
                pivot = i
        if pivot != k:
            row_pivot = JACOBIAN + pivot * SOLVE_STRIDE + SOLVE_OFFSET
            for j in range(k, end):
                swap = W[row_k + j, lane]
                W[row_k + j, lane] = W[row_pivot + j, lane]
                W[row_pivot + j, lane] = swap
            swap = W[RESIDUAL + k, lane]
            W[RESIDUAL + k, lane] = W[RESIDUAL + pivot, lane]
            W[RESIDUAL + pivot, lane] = swap
        inverse = 1 / W[row_k + k, lane]
        for i in range(k + 1, last):
            row_i = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET
            factor = W[row_i + k, lane] * inverse
            for j in range(k + 1, end):
                W[row_i + j, lane] -= factor * W[row_k + j, lane]
            W[RESIDUAL + i, lane] -= factor * W[RESIDUAL + k, lane]
    for back in range(SOLVE_UNKNOWNS):
        k = SOLVE_UNKNOWNS - 1 - back
        row_k = JACOBIAN + k * SOLVE_STRIDE + SOLVE_OFFSET
        x = W[RESIDUAL + k, lane]
        for j in range(k + 1, min(SOLVE_UNKNOWNS, k + SOLVE_UPPER + 1)):
            x -= W[row_k + j, lane] * W[RESIDUAL + j, lane]
        W[RESIDUAL + k, lane] = x / W[row_k + k, lane]


@compiled
def update_increments(W, lane):
    """Apply the Newton correction and measure it and the increments by the diagonal of M(q0)."""
    correction_squared = real(0)
    increment_squared = real(0)
    for row in range(BLOCKS):
        first = INCREMENT + (SOLVE_COLUMNS[row] - 1) * DIMENSION
        for s in range(DIMENSION):
            a = COORDINATE[s]
            correction = -W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane]
            increment = W[first + a, lane] + correction
            W[first + a, lane] = increment
            correction_squared += W[MASS_DIAGONAL + a, lane] * correction**2
            increment_squared += W[MASS_DIAGONAL + a, lane] * increment**2
    W[CORRECTION_SQUARED, lane] = correction_squared
    W[INCREMENT_SQUARED, lane] = increment_squared


@compiled
def solve_following(W, lane):
    """Solve for coordinates whose increments follow from those of the others, which are held."""
    for row in range(BLOCKS):
        for s in range(DIMENSION):
            i = row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP
            if FOLLOWING[s] == 0:
                W[RESIDUAL + i, lane] = real(0)
                for j in range(SOLVE_UNKNOWNS):
                    entry = JACOBIAN + i * SOLVE_STRIDE + SOLVE_OFFSET + j
                    W[entry, lane] = real(1) if i == j else real(0)
    solve_pivoted(W, lane)
    update_increments(W, lane)


@compiled
def clear_following(W, lane):
    """Leave out of a correction what follows from the rest of it."""
    for row in range(BLOCKS):
        for s in range(DIMENSION):
            if FOLLOWING[s] != 0:
                W[RESIDUAL + row * SOLVE_ROW_STEP + s * SOLVE_PLACE_STEP, lane] = real(0)
                W[INCREMENT + row * DIMENSION + s, lane] = real(0)
