"""Solving a step: kernels are called until corrections are rounding.

What is rarely called is no part of the function that is written into each loop over steps: arrays
that it hands on would be counted in every step, which costs a twentieth of a small one.
"""

import numpy as np
from numba import njit

from symsimpson.text.interface import *

#: Lanes of a block; known here, their loops cost nothing for a single trajectory (a third of the
#: time of a small step). This text is compiled with other numbers too.
LANES = 1
MOST_ITERATIONS = 40
#: What is no status: a step that is not solved yet.
UNSOLVED = -1
#: After so many iterations it is asked whether corrections are made of rounding.
FEW_ITERATIONS = 16
#: They are below this part of positions, of moves in a step and of what forces add to them,
#: squared: 2^-52 with room.
ROUND_OFF = 2.0**-92
#: By what the ratio of a correction to the square of the one before is raised in each step (it is
#: kept squared), until it is 1 or seen again: trust fades, so that it is measured anew.
FADING = 1.05**2
#: What is called by compiled code alone has no way in from Python, which takes long to compile.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
DRIVER_OPTIONS = {"nogil": True, "error_model": "numpy", **INNER}
#: For what is called once a run, or where a step fails: it may be slow, and compiles fast.
RARE = {**DRIVER_OPTIONS}
#: For what is called in each step: a call costs reference counts of its arrays.
INLINE = {"inline": "always", **DRIVER_OPTIONS}


def call(address, h, t, workspace):
    """Call a kernel ``void(double, double, double*)`` at an address; the walker does."""
    raise NotImplementedError


@njit(**RARE)
def give_up(active):
    """Mark the lanes that have not converged."""
    for lane in range(LANES):
        if active[lane] > 0.0:
            active[lane] = -NOT_CONVERGED
    return NOT_CONVERGED


@njit(**RARE)
def rounding(W, at, h, lane):
    """Bound the squared size of corrections that are made of rounding, in the metric of M(q0).

    Positions are rounded, and momenta and the terms of forces that take them on. Where these
    cancel, as at an equilibrium, increments may be as small as that.
    """
    size = W[at[LARGEST_SQUARED], lane] + h * h * h * h * W[W.shape[0] - 1, lane]
    for a in range(at[DIMENSION]):
        mass, q = W[at[MASS_DIAGONAL] + a, lane], W[at[POSITION] + a, lane]
        if mass > 0.0:
            moved = h * W[at[MOMENTUM] + a, lane]
            size += mass * q * q + moved * moved / mass
    return ROUND_OFF * size


@njit(**RARE)
def solve_to_rounding(iterate, h, t, W, at):
    """Iterate on; lanes are done, too, whose corrections are made of rounding and do not shrink.

    Corrections are kept in the row IN_DOUBT, which is free until the step is closed.
    """
    active, before = W[at[ACTIVE]], W[at[IN_DOUBT]]
    for lane in range(LANES):
        before[lane] = np.inf
    for _ in range(FEW_ITERATIONS, MOST_ITERATIONS):
        busy = 0
        for lane in range(LANES):
            if active[lane] > 0.0:
                correction = W[at[RELATIVE], lane] * W[at[INCREMENT_SQUARED], lane]
                if correction >= before[lane] and correction <= rounding(W, at, h, lane):
                    active[lane] = 0.0
                before[lane] = correction
            busy += active[lane] > 0.0
        if busy == 0:
            return worst_of(active)
        call(iterate, h, t, W)
    return give_up(active)


@njit(**RARE)
def worst_of(active):
    """Return 0 if all lanes are solved, else the status of one that is not."""
    worst = 0
    for lane in range(LANES):
        if active[lane] < 0.0:
            worst = NOT_FINITE
    return worst


@njit(**INLINE)
def solve_for(iterate, h, t, W, active, relative, contraction):
    """Iterate until every active lane is done; give 0, UNSOLVED, or the status of one that failed.

    The kernel checks that: lanes that are done have ``active`` = 0, failed ones -status. The last
    correction may be left out: it is a part of the one before, which tells how large it would be.
    """
    for lane in range(LANES):
        relative[lane] = np.inf
        contraction[lane] = min(1.0, contraction[lane] * FADING)
    # of a length that the compiler does not know: unrolled, the loop would count references
    for _ in range(FEW_ITERATIONS + (h == 0.0)):
        call(iterate, h, t, W)
        busy = 0
        for lane in range(LANES):
            busy += active[lane] > 0.0
        if busy == 0:
            worst = 0
            for lane in range(LANES):
                if active[lane] < 0.0:
                    worst = NOT_FINITE
            return worst
    return UNSOLVED


@njit(**DRIVER_OPTIONS)
def solve(iterate, h, t, W, at):
    """Iterate until every active lane is done, on the rows of a workspace."""
    status = solve_for(iterate, h, t, W, W[at[ACTIVE]], W[at[RELATIVE]], W[at[CONTRACTION]])
    return solve_to_rounding(iterate, h, t, W, at) if status == UNSOLVED else status
