"""The agreement between generated modules and the driver that calls their kernels.

A kernel is a function ``kernel(h, t, workspace)``. Everything that a run remembers stands in the
workspace: blocks of rows, one column for each lane (:mod:`symsimpson.text.workspace_layout`).
What both sides must know is said here and there, and nowhere else. The driver's text names these
constants, and the places in DRIVER_LAYOUT, which stand in this module by their names, too.
"""

from symsimpson.text.workspace_layout import DRIVER_LAYOUT

#: Number of the agreement; modules with another number are refused.
INTERFACE = 14

#: The type of a kernel, and what the compiler is told: contract and nsz keep NaN checks and
#: compensated sums, "fast" would delete both.
SIGNATURE = "void(float64, float64, CPointer(float64))"
OPTIONS = '{"fastmath": {"contract", "nsz"}, "error_model": "numpy"}'

globals().update(DRIVER_LAYOUT)
#: Behind these, what recorders leave to be stored: pairs of a first row and a number of rows.
RECORDED = len(DRIVER_LAYOUT)
#: From TIME to RATE, which stands behind it.
RATE_BEHIND = 6

#: Rows for each expression whose sign is waited for: its side of zero, its size of late, its value
#: and the one before. Values below a part of the size are rounding.
WATCHED, SIZE_WATCHED, VALUE_WATCHED, ZERO = 4, 1, 2, 64 * 2.0**-52
#: What is left of the size of an expression in each step, unless its terms are as large.
FADED = 2.0**-10

#: A rate dt/dtau below this part of the first has nearly vanished.
STANDING = 1e-8

# values in STATUS, and negative ones in ACTIVE
SUCCESS, INTERRUPTED, NOT_CONVERGED, NOT_FINITE, STEP_TOO_LARGE, BAD_INPUT = range(6)
COORDINATE_SINGULARITY, DIVERGED, SINGULAR_JACOBIAN, FILE_ERROR = range(6, 10)
SINGULAR_CONSTRAINTS, ARRIVED, RATE_NOT_POSITIVE, EVENTS_ACCUMULATE, MET = range(10, 15)
TOLERANCE_NOT_MET, SINGULAR_LEGENDRE, CONTACT_PARADOX, CONTACT_UNDECIDED = range(15, 19)

# values in IN_DOUBT
ACCEPTED, TO_BE_VERIFIED, UNRESOLVED, POSSIBLY_UNRESOLVED, SMALL_MASS = range(5)

#: Pivots of M, in units of those at the start, below the first are looked at, and those below a
#: part of these; what is below the last is rounding.
SMALL_PIVOT, SMALLER, LOST_PIVOT = 0.05, 0.25, 2.0**-44

#: How a set of kernels takes a step: by none but itself; by Newton's method; by an iteration over
#: stages; by Newton's method where that failed, with the energy watched as in all steps by stages.
EXPLICIT, NEWTON, STAGES, NEWTON_AFTER_STAGES = range(4)

#: A set of kernels as the driver takes it: the mode, then addresses, 0 where there is none; from
#: RECORDERS on, those of all that are called behind each step.
MODE, PREPARE, START, ITERATE, ADVANCE, MEASURE, RECORDERS = range(7)

#: The kernels of each set by name, in that order; recorders may follow.
KERNEL_SETS = {
    EXPLICIT: ("prepare", "start", "", "advance", ""),
    NEWTON: ("prepare", "start", "newton", "advance", ""),
    STAGES: ("prepare", "start_stages", "iterate", "advance_stages", ""),
    NEWTON_AFTER_STAGES: ("prepare", "start", "newton", "advance", "energy"),
}
#: What takes the place of Newton's method, or of another kernel, where a pivot was zero.
WITH_PIVOTS = "_pivoted"
PIVOTED = f"newton{WITH_PIVOTS}"
#: Kernels whose scratch is looked at: the equations, and pivots where Newton's method fails.
LOOKED_AT = ("equations", "newton", PIVOTED)
#: All kernels that a module may have.
KERNELS = (
    "prepare",
    "start",
    "legendre",
    "newton",
    "newton_pivoted",
    "advance",
    "start_stages",
    "iterate",
    "advance_stages",
    "energy",
    "invariants",
    "equations",
    "power",
    "work",
    "multipliers",
    "tangent",
    "tangent_pivoted",
    "momentum_slopes",
    "adjoint",
    "start_adjoint",
    "record",
    "step_cost",
    "running_cost",
    "curvature",
    "retime",
    "clock",
    "energy_in_tau",
)


def constants() -> dict[str, int | float]:
    """Return what the text of the driver takes from here: places, statuses, modes."""
    return {name: value for name, value in globals().items() if type(value) in (int, float)}


#: Functions of one number that modules may call, in every arithmetic.
MATH = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh"),
    *("atanh", "exp", "log", "sqrt", "erf", "erfc"),
)
