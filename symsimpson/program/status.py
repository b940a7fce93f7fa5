"""How a run ended."""

from __future__ import annotations

from enum import IntEnum

from symsimpson.text import interface


class Status(IntEnum):
    """How a run ended; 0 is success. ``message`` says it in a sentence, with what to do.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.Status.SUCCESS == 0, ss.Status(2).name
    (True, 'NOT_CONVERGED')
    """

    SUCCESS = interface.SUCCESS
    INTERRUPTED = interface.INTERRUPTED
    NOT_CONVERGED = interface.NOT_CONVERGED
    NOT_FINITE = interface.NOT_FINITE
    STEP_TOO_LARGE = interface.STEP_TOO_LARGE
    BAD_INPUT = interface.BAD_INPUT
    COORDINATE_SINGULARITY = interface.COORDINATE_SINGULARITY
    DIVERGED = interface.DIVERGED
    SINGULAR_JACOBIAN = interface.SINGULAR_JACOBIAN
    FILE_ERROR = interface.FILE_ERROR
    SINGULAR_CONSTRAINTS = interface.SINGULAR_CONSTRAINTS
    RATE_NOT_POSITIVE = interface.RATE_NOT_POSITIVE
    EVENTS_ACCUMULATE = interface.EVENTS_ACCUMULATE
    TOLERANCE_NOT_MET = interface.TOLERANCE_NOT_MET
    SINGULAR_LEGENDRE = interface.SINGULAR_LEGENDRE

    @property
    def message(self) -> str:
        """The outcome as a sentence."""
        return _MESSAGES[self]


#: What else may end a run, whatever h: no smaller step helps there.
_TO_INFINITY = (
    "Where smaller steps end at the same time, the motion runs to infinity: look at the sign of "
    "the potential."
)
#: What to do about a singular point of the coordinates.
REGULAR = (
    "Use coordinates that are regular there, such as Cartesian ones held by a constraint (see the "
    "guide to constraints); a smaller h helps only where the passage is wide enough."
)
_MESSAGES = {
    Status.SUCCESS: "The run reached its end.",
    Status.INTERRUPTED: "The run was interrupted; what was computed is kept.",
    Status.NOT_CONVERGED: (
        "Newton's method did not converge. The step is too large for this motion, or the mass "
        f"matrix is nearly singular there: try a smaller h. {_TO_INFINITY}"
    ),
    Status.DIVERGED: (
        "Newton's method diverged: the increments grew to many times what was expected. The step "
        f"is far too large for this motion: try a smaller h. {_TO_INFINITY}"
    ),
    Status.SINGULAR_JACOBIAN: (
        "The equations of the step do not determine it: their Jacobian is singular, as for a step "
        "at which stiffness and inertia just cancel. Try another h."
    ),
    Status.NOT_FINITE: (
        "A NaN or an infinity occurred. The motion left the domain of T or V or reached a singular "
        "point, or the step is far too large: check the state before the step, or try a smaller h. "
        f"{_TO_INFINITY}"
    ),
    Status.STEP_TOO_LARGE: (
        "The equations of the step have a solution, but it is not continuously connected to the "
        "state as h goes to 0. The step is too large for this motion: try a smaller h. "
        f"{_TO_INFINITY}"
    ),
    Status.COORDINATE_SINGULARITY: (
        "The motion passes a singular point of the coordinates (a pole of spherical angles, say) "
        f"faster than the step resolves: its direction behind that point would be lost. {REGULAR}"
    ),
    Status.SINGULAR_CONSTRAINTS: (
        "One of them follows from the others there, so the constraint forces are not determined, "
        "and a linkage may continue along either branch. The states before are kept: end the run "
        "there, or choose lengths at which the linkage does not fold."
    ),
    Status.RATE_NOT_POSITIVE: (
        "The rate dt/dtau is not a positive number there, so time would not advance. Give a rate "
        "that is positive along the whole motion, or take smaller steps if one jumped too far."
    ),
    Status.EVENTS_ACCUMULATE: (
        "Impacts follow each other ever faster, or at rest: the bodies stay in contact from there. "
        "What was computed is kept, up to the last impact. Replace the contact by a constraint "
        "there, or end the run by a terminal event."
    ),
    Status.TOLERANCE_NOT_MET: (
        "The run reached its end, but its error is larger than the one asked for, or is not known. "
        "The motion may be chaotic, or pass a kink: ask for a larger error, or a shorter time."
    ),
    Status.SINGULAR_LEGENDRE: (
        "The mass matrix is singular or indefinite at the end of that step, so velocities do not "
        "follow from momenta. The states before are kept. End the run before, or look for masses "
        "that vanish; if the motion does not come there, try a smaller h."
    ),
    Status.FILE_ERROR: (
        "The checkpoint could not be written; what was computed is kept. Make room, or choose "
        "another file."
    ),
    Status.BAD_INPUT: (
        "The run could not begin: the mass matrix is not positive definite there, or the velocity "
        "is not finite. Check the masses, and that q0 is no singular point of the coordinates."
    ),
}
