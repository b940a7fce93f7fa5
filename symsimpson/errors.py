"""Errors and warnings of the package.

Every message says what is wrong, where, why it is rejected, and what to do.
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
    """The base class of every error that symsimpson raises on purpose.

    Errors can be pickled with all their attributes, so that worker processes can raise them.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _revive, (type(self), self.args, self.__dict__)


def _revive(
    kind: type[SymsimpsonError], arguments: tuple[Any, ...], attributes: dict[str, Any]
) -> SymsimpsonError:
    """Restore a pickled error without a call of its constructor."""
    error = kind.__new__(kind)
    error.args = arguments
    error.__dict__.update(attributes)
    return error


class ModelError(SymsimpsonError):
    """A variational integrator cannot integrate the declared system."""


class SchemeError(SymsimpsonError):
    """The scheme is unknown, cannot be constructed, or does not apply to the system."""


class GenerationError(SymsimpsonError):
    """Code could not be generated or compiled, or it does not match the declared system."""


class StaleKernelError(SymsimpsonError):
    """A generated file has another version of the kernel interface, or it was edited."""


class ModelWarning(UserWarning):
    """The declared system probably contains a mistake."""


class StabilityWarning(UserWarning):
    """The step size is near the stability limit.

    Oscillations may grow without bound, or have a frequency that is too low.
    """


class ResolutionWarning(UserWarning):
    """A run did not resolve a fast part of the motion. Later states are unreliable."""


class ConstraintWarning(UserWarning):
    """A run came close to a state at which the constraints are linearly dependent."""


class InputError(SymsimpsonError, ValueError):
    """An argument, such as a state, a step size or a parameter, is invalid."""


class UnknownNameError(InputError, KeyError):
    """A result has no quantity of this name."""

    __str__ = Exception.__str__  # KeyError would show the message in quotes


class StorageError(SymsimpsonError):
    """A file could not be read or written, or a remote task for a store failed.

    Attributes
    ----------
    trajectory : Trajectory or None
        The states that the run had computed when its checkpoint could not be written. None
        (default) if no run was under way.
    """

    def __init__(self, message: str, *, trajectory: Any = None) -> None:
        super().__init__(message)
        self.trajectory = trajectory


class ConvergenceError(SymsimpsonError):
    """A step of a run failed. ``trajectory`` has the states that were computed before.

    Attributes
    ----------
    trajectory : Trajectory
        The stored states before the failure. For a Poincare section these are the events before
        the failure.
    step : int
        The number of the step that failed, counted from 0.
    time : float
        The time at the start of that step, in the unit of time of the system.
    residual : float
        The size of the last Newton correction, divided by the increment of the step.
    status : Status
        The reason of the failure.
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
    """Ctrl-C stopped a run. ``trajectory`` has the states that were computed before.

    Attributes
    ----------
    trajectory : Trajectory, Ensemble or Events
        The states before the interruption: an Ensemble for many trajectories, Events for a
        Poincare section.
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

    Each part is a complete sentence. ``where`` names the system, the argument or the file. It is
    empty if ``what`` names it. ``cause`` is the error of another library that the traceback shows.
    """
    head = " ".join(part for part in (f"{where}:" if where else "", what, why) if part)
    raise error(f"{head}\n{remedy}" if remedy else head) from cause
