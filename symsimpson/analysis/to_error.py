"""A run to a wanted error, whose scheme and step are chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.analysis.choose import Choice, arguments, select
from symsimpson.analysis.remembered import remembered
from symsimpson.api.compiling import check_system
from symsimpson.errors import ResolutionWarning, StabilityWarning
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.program.input_values import read_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.program.status import Status
from symsimpson.results.sampled import Sampled, Saved
from symsimpson.results.trajectory import Trajectory
from symsimpson.schemes.scheme import Scheme
from symsimpson.stepping.driving import Samples
from symsimpson.support.calling import explained, warn, without_step_warnings
from symsimpson.support.names import by_name, read_mapping

if TYPE_CHECKING:
    from symsimpson.stepping.event import Event

__all__ = ["integrate"]


@explained()
def integrate(
    system: MechanicalSystem,
    q0: ArrayLike,
    v0: ArrayLike | None = None,
    *,
    p0: ArrayLike | None = None,
    t_end: float,
    error: float = 1e-6,
    on: Literal["state", "energy"] = "state",
    t0: float = 0.0,
    parameters: Mapping[Any, Any] | None = None,
    inputs: Mapping[Any, Any] | None = None,
    events: Sequence[Event] | None = None,
    schemes: str | Scheme | Sequence[str | Scheme] | None = None,
    every: int | None = 1,
    t_eval: ArrayLike | None = None,
    save: Any = None,
    progress: bool | None = None,
    on_failure: Literal["raise", "return"] = "raise",
) -> Trajectory | Sampled | Saved:
    """Integrate with a given error tolerance: scheme and step size are chosen for it.

    The choice is that of :func:`symsimpson.choose`, which takes some seconds. It is stored on disk,
    unless events or functions of t act on the run: the same call runs at once the next time. For
    many runs of a system, choose once and take the stepper.

    Parameters
    ----------
    system : MechanicalSystem
    q0, v0, p0, t_end, error, on, t0, parameters, inputs, events, schemes
        As for :func:`symsimpson.choose`. ``error`` bounds the difference from a run with half the
        step size along the whole path; ``run.error_estimate`` is that difference.
    every, t_eval, save, progress, on_failure
        As for :meth:`Stepper.integrate`.

    Returns
    -------
    Trajectory, or a Sampled or Saved
        Its ``message`` states what was chosen, and why. If six refinements do not reach the error,
        its ``status`` is ``TOLERANCE_NOT_MET``.

    Raises
    ------
    InputError
        If the input makes no sense, or runs with small steps fail.
    ConvergenceError, Interrupted
        As :meth:`Stepper.integrate`.

    Warns
    -----
    ResolutionWarning
        If the error is not reached: with the time from which the bound fails.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.integrate(ss.systems.pendulum(), [1.0], v0=[0.0], t_end=20.0, error=1e-8)
    >>> run.success, " with h = " in run.message, run.error_estimate <= 1e-8
    (True, True, True)
    """
    check_system(system)
    parameters = read_mapping("parameters", parameters, "m")
    asked: dict[str, Any]
    asked = {"q0": q0, "v0": v0, "p0": p0, "t0": t0, "t_end": t_end, "error": error, "on": on}
    asked |= {"parameters": parameters, "inputs": inputs, "events": events, "schemes": schemes}

    def make() -> Choice:
        return select(system, asked, strict=False)

    if events is not None or _acts(inputs):
        choice = make()
    else:
        duration = read_number("t_end", t_end, FLOAT64) - read_number("t0", t0, FLOAT64)
        question = {name: _key(x) for name, x in asked.items()}
        choice = remembered(system, question, duration, make)
    more: dict[str, Any] = {"every": every, "t_eval": t_eval, "save": save}
    more |= arguments(choice, asked) | {"progress": progress, "on_failure": on_failure}
    with without_step_warnings(StabilityWarning, ResolutionWarning):
        run: Trajectory | Sampled | Saved = choice.stepper.integrate(q0, v0, p0=p0, **more)
    message, status = f"{run.message} {choice.reason}", run.status
    if choice.error_estimate > error and run.success:
        status = Status.TOLERANCE_NOT_MET
        message = f"{system.name}: {status.message} {choice.reason}"
        warn(message, ResolutionWarning)
    return replace(run, status=status, message=message, error_estimate=choice.error_estimate)


def _acts(inputs: Any) -> bool:
    """Return whether one of the inputs is a function, of which nothing is known."""
    given = inputs.values() if isinstance(inputs, Mapping) else (inputs,)
    return any(map(callable, given))


def _key(value: Any) -> Any:
    """Return the text of an argument, for the key of a stored choice."""
    value = by_name(value)
    if isinstance(value, Mapping):
        return sorted((str(name), _key(x)) for name, x in value.items())
    if isinstance(value, Samples):
        return [_key(value.values), repr(value.period)]
    try:
        return repr(np.asarray(value).tolist())
    except ValueError:  # ragged rows, which the run refuses
        return repr(value)
