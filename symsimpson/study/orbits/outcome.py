"""How searches for orbits and families of orbits end."""

from __future__ import annotations

import enum
from typing import Self


class _Outcome(enum.IntEnum):
    """A number with a message: a sentence, and what to do."""

    message: str

    def __new__(cls, number: int, message: str) -> Self:
        outcome = int.__new__(cls, number)
        outcome._value_, outcome.message = number, message
        return outcome


class OrbitStatus(_Outcome):
    """How the search for an orbit ended.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.OrbitStatus.SHORTER.success, ss.OrbitStatus.NOT_CONVERGED.success
    (True, False)
    """

    FOUND = 0, "The orbit closes up to round-off."
    FOUND_COARSE = 1, "The orbit closes, but not up to round-off. Take more steps."
    SHORTER = 2, "The orbit repeats one of a shorter period, orbit.primitive."
    NOT_ISOLATED = 3, "Motions nearby have the same period. This orbit is the nearest to the guess."
    NOT_CONVERGED = (
        4,
        "Newton's method did not converge. Give a nearer guess, a guess along the whole orbit "
        "(guess=), or take more steps.",
    )
    STEP_FAILED = 5, "A step failed. Give a nearer guess, or take more steps."
    NOT_RESOLVED = 6, "The steps do not resolve the orbit. Take more steps."
    EQUILIBRIUM = 7, "The state does not move: it is an equilibrium."
    WRONG_EVENT = 8, "The run missed the event that ends it. Give a nearer guess."
    INTERRUPTED = 9, "The search was interrupted with Ctrl-C."

    @property
    def success(self) -> bool:
        """Whether the result is an orbit."""
        return self <= OrbitStatus.NOT_ISOLATED


class FamilyStatus(_Outcome):
    """Why a family ended.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.FamilyStatus.REACHED.name
    'REACHED'
    """

    REACHED = 0, "The family reached the value of to=."
    COUNT = 1, "The family has count= new orbits."
    CLOSED = 2, "The family returned to its first orbit."
    EQUILIBRIUM = 3, "The family ends at an equilibrium."
    STEP_FAILED = 4, "A step of an orbit failed."
    STEP_TOO_SMALL = 5, "No orbit was found beyond the last one, however near."
    INTERRUPTED = 6, "The family was interrupted with Ctrl-C."
    SAME_FAMILY = 7, "The search returned to the family that it was to leave."
