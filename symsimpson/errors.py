"""Errors and warnings, sorted by who can mend their cause.

Every message says what is wrong, where, why it matters and what to do about it.
"""

from __future__ import annotations

from typing import Any, NoReturn

__all__ = [
    "ConvergenceError",
    "GenerationError",
    "InputError",
    "Interrupted",
    "ModelError",
    "ModelWarning",
    "ResolutionWarning",
    "SchemeError",
    "StabilityWarning",
    "StaleKernelError",
    "StorageError",
    "SymsimpsonError",
    "UnknownNameError",
]


class SymsimpsonError(Exception):
    """The base of every error that symsimpson raises on purpose.

    All of them go through pickle with what they carry, so that they reach the parent of a process.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _revive, (type(self), self.args, self.__dict__)


def _revive(
    kind: type[SymsimpsonError], arguments: tuple[Any, ...], attributes: dict[str, Any]
) -> SymsimpsonError:
    """Make an error as it was, whatever its constructor asks for."""
    error = kind.__new__(kind)
    error.args = arguments
    error.__dict__.update(attributes)
    return error


class ModelError(SymsimpsonError):
    """The declared system is not one that a variational step can integrate."""


class SchemeError(SymsimpsonError):
    """The scheme is unknown, cannot be constructed, or does not apply to the system."""


class GenerationError(SymsimpsonError):
    """A module could not be written, or what was written is not what is declared."""


class StaleKernelError(SymsimpsonError):
    """A generated file belongs to another version of the kernel interface, or was edited."""


class ModelWarning(UserWarning):
    """A declared system is probably not the one that was meant."""


class StabilityWarning(UserWarning):
    """A step is so large that oscillations may grow without bound, or look slower than they are."""


class ResolutionWarning(UserWarning):
    """A run did not resolve a fast part of the motion; the states after it are unreliable."""


class ConstraintWarning(UserWarning):
    """A run came close to a state at which the constraints are linearly dependent."""


class InputError(SymsimpsonError, ValueError):
    """An argument, such as a state, a step or a parameter, is invalid."""


class UnknownNameError(InputError, KeyError):
    """There is no quantity of this name in a result."""

    __str__ = Exception.__str__  # as it is written: a KeyError shows a text in quotes


class StorageError(SymsimpsonError):
    """A file could not be read or written, or a task for a store could not be done elsewhere.

    Attributes
    ----------
    trajectory : Trajectory or None
        What a run had computed when its checkpoint could not be written.
    """

    def __init__(self, message: str, *, trajectory: Any = None) -> None:
        super().__init__(message)
        self.trajectory = trajectory


class ConvergenceError(SymsimpsonError):
    """A step failed; everything computed before it is kept.

    Attributes
    ----------
    trajectory : Trajectory
        All stored states before the failure; of a section, the events before it.
    step : int
        Number of the step that failed, counted from 0.
    time : float
        Time at the start of that step.
    residual : float
        Size of the last Newton correction relative to the step's increment.
    status : Status
        Why it failed.
    """

    def __init__(
        self, message: str, *, trajectory: Any, step: int, time: float, residual: float, status: Any
    ) -> None:
        super().__init__(message)
        self.trajectory = trajectory
        self.step = step
        self.time = time
        self.residual = residual
        self.status = status


class Interrupted(SymsimpsonError, KeyboardInterrupt):
    """Ctrl-C stopped a run; ``trajectory`` holds what was computed.

    For many trajectories that is an Ensemble, for a section the Events.
    """

    def __init__(self, message: str, *, trajectory: Any) -> None:
        super().__init__(message)
        self.trajectory = trajectory


def reject(
    what: str,
    where: str = "",
    why: str = "",
    remedy: str = "",
    *,
    error: type[SymsimpsonError] = InputError,
    cause: BaseException | None = None,
) -> NoReturn:
    """Raise an error about the user's input: "where: what why", and the remedy on the next line.

    Each part is a whole sentence. ``where`` names the system, the argument or the file; leave it
    out where ``what`` names it. ``cause`` is the error of a library to show as well.
    """
    head = " ".join(part for part in (f"{where}:" if where else "", what, why) if part)
    raise error(f"{head}\n{remedy}" if remedy else head) from cause
