"""The outcome of a run."""

from __future__ import annotations

from enum import IntEnum

from symsimpson.text import interface


class Status(IntEnum):
    """The outcome of a run; 0 is success. ``message`` explains it and names a remedy.

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
    CONTACT_PARADOX = interface.CONTACT_PARADOX
    CONTACT_UNDECIDED = interface.CONTACT_UNDECIDED

    @property
    def message(self) -> str:
        """The explanation of the outcome, with a remedy."""
        return _MESSAGES[self]


#: The other usual cause of failed steps, against which a smaller h does not help.
_TO_INFINITY = (
    "If runs with smaller steps end at the same time, the motion runs to infinity: look at the "
    "sign of the potential."
)
#: The remedy for a singular point of the coordinates.
REGULAR = (
    "Use coordinates that are regular there, such as Cartesian coordinates with a constraint (see "
    "the guide to constraints). A smaller h helps only if the motion does not pass too close."
)
_MESSAGES = {
    Status.SUCCESS: "The run reached its end.",
    Status.INTERRUPTED: "The run was interrupted. The states before are kept.",
    Status.NOT_CONVERGED: (
        "Newton's method did not converge. The step is too large for this motion, or the mass "
        f"matrix is nearly singular there: try a smaller h. {_TO_INFINITY}"
    ),
    Status.DIVERGED: (
        "Newton's method diverged: the increments became many times larger than expected. The step "
        f"is far too large for this motion: try a smaller h. {_TO_INFINITY}"
    ),
    Status.SINGULAR_JACOBIAN: (
        "The Jacobian of the step's equations is singular, so they have no unique solution. This "
        "happens at a step size for which stiffness and inertia cancel. Try another h."
    ),
    Status.NOT_FINITE: (
        "A NaN or an infinity occurred. The motion left the domain of T or V or reached a singular "
        "point, or the step is far too large. Check the state before the step, or try a smaller h. "
        f"{_TO_INFINITY}"
    ),
    Status.STEP_TOO_LARGE: (
        "The equations of the step have a solution, but it is not continuously connected to the "
        "state as h goes to 0. The step is too large for this motion: try a smaller h. "
        f"{_TO_INFINITY}"
    ),
    Status.COORDINATE_SINGULARITY: (
        "The motion passes a singular point of the coordinates, such as a pole of spherical "
        "angles. The step does not resolve this passage, so the direction after it would be wrong. "
        f"{REGULAR}"
    ),
    Status.SINGULAR_CONSTRAINTS: (
        "One constraint follows from the others there, so the constraint forces are not "
        "determined. A linkage may continue along either branch. The states before are kept. End "
        "the run there, or choose lengths at which the linkage does not fold."
    ),
    Status.RATE_NOT_POSITIVE: (
        "The rate dt/dtau is not a positive number there, so time would not advance. Give a rate "
        "that is positive along the whole motion. If a step jumped too far, take smaller steps."
    ),
    Status.EVENTS_ACCUMULATE: (
        "Impacts follow each other ever faster, or at rest: the bodies stay in contact from there. "
        "The states up to the last impact are kept. Declare the gap as a symsimpson.Contact, which "
        "can rest, or end the run with a terminal event."
    ),
    Status.TOLERANCE_NOT_MET: (
        "The run reached its end, but its error is unknown or larger than the wanted error. The "
        "motion may be chaotic, or pass a kink. Allow a larger error, or choose a shorter time."
    ),
    Status.SINGULAR_LEGENDRE: (
        "The mass matrix is singular or indefinite at the end of that step, so velocities do not "
        "follow from momenta. The states before are kept. End the run earlier, or look for masses "
        "that vanish. If the motion does not reach such a point, try a smaller h."
    ),
    Status.CONTACT_PARADOX: (
        "A contact slides so that its normal force has no value, or several (Painleve). The "
        "friction is too large for rigid bodies there. The states before are kept. Use a smaller "
        "coefficient of friction, or end the run earlier."
    ),
    Status.CONTACT_UNDECIDED: (
        "Contacts or friction elements change without end at this time, or too many of them may "
        "change at once. The states before are kept. Use fewer contacts, or an h that differs a "
        "little."
    ),
    Status.FILE_ERROR: (
        "The checkpoint could not be written. The states before are kept. Free space on the disk, "
        "or choose another file."
    ),
    Status.BAD_INPUT: (
        "The run could not begin: the mass matrix is not positive definite there, or the velocity "
        "is not finite. Check the masses, and that q0 is no singular point of the coordinates."
    ),
}
