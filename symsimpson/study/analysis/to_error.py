"""A run to a wanted error, whose scheme and step are chosen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

import symsimpson
from symsimpson.api.compiling import check_system
from symsimpson.api.compiling import compile as compile_system
from symsimpson.declare.retimed import RetimedSystem
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import ResolutionWarning, StabilityWarning
from symsimpson.program.cache import kept
from symsimpson.program.input_values import read_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.program.status import Status
from symsimpson.results.sampled import Sampled, Saved
from symsimpson.results.trajectory import Trajectory
from symsimpson.schemes.scheme import Scheme
from symsimpson.stepping.driving import Samples
from symsimpson.study.analysis.choose import Choice, arguments, select
from symsimpson.support.calling import explained, warn, without_step_warnings
from symsimpson.support.names import by_name, read_mapping

if TYPE_CHECKING:
    from symsimpson.stepping.event import Event


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

    :func:`symsimpson.choose` chooses them, which takes some seconds. The choice is stored on disk,
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
    given = getattr(inputs, "functions", inputs)  # as a result of optimal control has them
    values = given.values() if isinstance(given, Mapping) else (given,)
    if events is not None or any(map(callable, values)):  # what these do is not known
        choice = select(system, asked, strict=False)
    else:
        choice = _stored_choice(system, asked)
    more: dict[str, Any] = {"every": every, "t_eval": t_eval, "save": save}
    more |= arguments(choice, asked) | {"progress": progress, "on_failure": on_failure}
    with without_step_warnings(StabilityWarning, ResolutionWarning):
        run: Trajectory | Sampled | Saved = choice.stepper.integrate(q0, v0, p0=p0, **more)
    message, status = f"{run.message} {choice.reason}", run.status
    if choice.error_estimate > error and run.success:
        status = Status.TOLERANCE_NOT_MET
        message = f"{system.name}: {choice.reason} {status.message}"
        warn(message, ResolutionWarning)
    return replace(run, status=status, message=message, error_estimate=choice.error_estimate)


def _stored_choice(system: MechanicalSystem, asked: Mapping[str, Any]) -> Choice:
    """Return the choice that was stored for the same arguments, or make it and store it."""
    t_end, t0 = (read_number(name, asked[name], FLOAT64) for name in ("t_end", "t0"))
    values = sorted((symbol.name, value) for symbol, value in system.parameters.items())
    question = sorted((name, _key(x)) for name, x in asked.items())

    def read(record: Any) -> Choice:
        h, error = float(record["h"]), float(record["error"])
        if not (0 < h / (t_end - t0) < math.inf and error >= 0):
            raise ValueError("no step, or no error")
        whole = system.retimed("encounters") if record["adapting"] is True else system
        return Choice(compile_system(whole, str(record["scheme"])), h, str(record["reason"]), error)

    def make() -> Choice:
        return select(system, asked, strict=False)

    def content(choice: Choice) -> dict[str, Any]:
        declared = choice.stepper.program.declared
        return {
            "scheme": choice.stepper.scheme,
            "h": choice.h,
            "reason": choice.reason,
            "error": choice.error_estimate,
            "adapting": isinstance(declared, RetimedSystem) and declared is not system,
        }

    key = repr(["whole path", symsimpson.__version__, system.digest, values, question])
    return kept("choices", key, read, make, content)


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
