"""How searches for orbits and families of orbits end."""

from __future__ import annotations

import enum


class OrbitStatus(enum.IntEnum):
    """How the search for an orbit ended.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.OrbitStatus.SHORTER.success, ss.OrbitStatus.NOT_CONVERGED.success
    (True, False)
    """

    FOUND = 0
    FOUND_COARSE = 1
    SHORTER = 2
    NOT_ISOLATED = 3
    NOT_CONVERGED = 4
    STEP_FAILED = 5
    NOT_RESOLVED = 6
    EQUILIBRIUM = 7
    WRONG_EVENT = 8
    INTERRUPTED = 9

    @property
    def success(self) -> bool:
        """Whether the result is an orbit."""
        return self <= OrbitStatus.NOT_ISOLATED

    @property
    def message(self) -> str:
        """The status as a sentence, with what to do."""
        return _MESSAGES[self]


_MESSAGES = {
    OrbitStatus.FOUND: "The orbit closes up to round-off.",
    OrbitStatus.FOUND_COARSE: "The orbit closes, but not up to round-off. Take more steps.",
    OrbitStatus.SHORTER: "The orbit repeats one of a shorter period, orbit.primitive.",
    OrbitStatus.NOT_ISOLATED: "All motions nearby are periodic, too. This one is the nearest to "
    "the guess.",
    OrbitStatus.NOT_CONVERGED: "Newton's method did not converge. Give a nearer guess, a guess "
    "along the whole orbit (guess=), or take more steps.",
    OrbitStatus.STEP_FAILED: "A step failed. Give a nearer guess, or take more steps.",
    OrbitStatus.NOT_RESOLVED: "The steps do not resolve the orbit. Take more steps.",
    OrbitStatus.EQUILIBRIUM: "The state does not move: it is an equilibrium.",
    OrbitStatus.WRONG_EVENT: "The run missed the event that ends it. Give a nearer guess.",
    OrbitStatus.INTERRUPTED: "The search was interrupted with Ctrl-C.",
}


class FamilyStatus(enum.IntEnum):
    """Why a family ended.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.FamilyStatus.REACHED.name
    'REACHED'
    """

    REACHED = 0
    COUNT = 1
    CLOSED = 2
    EQUILIBRIUM = 3
    STEP_FAILED = 4
    STEP_TOO_SMALL = 5
    INTERRUPTED = 6
    SAME_FAMILY = 7

    @property
    def message(self) -> str:
        """The status as a sentence."""
        return (
            "The family reached the value of to=.",
            "The family has count= new orbits.",
            "The family returned to its first orbit.",
            "The family ends at an equilibrium.",
            "A step of an orbit failed.",
            "No orbit was found beyond the last one, however near.",
            "The family was interrupted with Ctrl-C.",
            "The search returned to the family that it was to leave.",
        )[self]
