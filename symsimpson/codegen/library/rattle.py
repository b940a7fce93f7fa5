"""Explicit steps that constraints hold: kicks, and drifts that end where phi = 0."""

from collections.abc import Callable
from typing import Any

compiled: Callable[[Any], Any]
real: Callable[[Any], Any]
allow_no_change: Callable[..., Any]
constraint_forces: Callable[..., Any]
constraint_values: Callable[..., Any]
free_velocity: Callable[..., Any]
reached: Callable[..., Any]
solve_held: Callable[..., Any]

DIMENSION: int
CONSTRAINTS: int
POSITION: int
INCREMENT: int
MOMENTUM: int
VELOCITY: int
NODE_POSITION: int
NODE_VELOCITY: int
MASS_DIAGONAL: int
COORDINATE: tuple[int, ...]
CONSTRAINT: int
CONSTRAINT_FORCE: int
CURVATURE: int
DRIFTS: tuple[float, ...]
RESIDUAL: int
INFINITE: float
ROUNDED: float
MOST_CORRECTIONS: int


@compiled
def free_velocity(W, lane):
    """Solve for the velocity that constraints allow, and take from p what they do not."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_VELOCITY + s, lane] = W[MOMENTUM + a, lane] + W[RESIDUAL + a, lane]
    allow_no_change(W, lane)
    solve_held(W, lane)
    constraint_forces(W, lane)
    for a in range(DIMENSION):
        W[RESIDUAL + a, lane] -= W[CONSTRAINT_FORCE + a, lane]


@compiled
def reached(W, lane):
    """Position after the increments so far."""
    for s in range(DIMENSION):
        a = COORDINATE[s]
        W[NODE_POSITION + s, lane] = W[POSITION + a, lane] + W[INCREMENT + a, lane]


@compiled
def drift_held(W, h, part, lane):
    """Move by M^-1 (p - Phi^T mu), with Phi at the start and mu for which phi = 0 at the end.

    Corrections take Phi at the start for both, so that one factorisation serves all: each leaves a
    part of the error that is small with h. What does not converge becomes NaN.
    """
    share = h * DRIFTS[part]
    free_velocity(W, lane)
    for a in range(DIMENSION):
        W[INCREMENT + a, lane] += share * W[VELOCITY + a, lane]
    before = INFINITE
    done = False
    for _ in range(MOST_CORRECTIONS):
        reached(W, lane)
        constraint_values(W, lane)
        for s in range(DIMENSION):
            W[NODE_VELOCITY + s, lane] = real(0)
        for c in range(CONSTRAINTS):
            W[CURVATURE + c, lane] = -W[CONSTRAINT + c, lane] / share
        solve_held(W, lane)
        constraint_forces(W, lane)
        correction = real(0)
        size = real(0)
        for s in range(DIMENSION):
            a = COORDINATE[s]
            change = share * W[VELOCITY + a, lane]
            W[INCREMENT + a, lane] += change
            W[RESIDUAL + a, lane] -= W[CONSTRAINT_FORCE + a, lane]
            correction += W[MASS_DIAGONAL + a, lane] * change**2
            size += W[MASS_DIAGONAL + a, lane] * W[NODE_POSITION + s, lane] ** 2
        if correction <= ROUNDED * size and (4 * correction >= before or correction == 0):
            done = True
            break
        before = correction
    if not done:
        W[RESIDUAL, lane] = INFINITE - INFINITE
    reached(W, lane)
