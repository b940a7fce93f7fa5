"""A run to a wanted error, whose scheme and step are chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.analysis.choose import choose
from symsimpson.analysis.remembered import remembered
from symsimpson.api.compiling import check_system
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.results.sampled import Sampled, Saved
from symsimpson.results.trajectory import Trajectory
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.calling import explained
from symsimpson.support.names import by_name, in_a_row, read_mapping

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
    parameters: Mapping[Any, Any] | None = None,
    schemes: str | Scheme | Sequence[str | Scheme] | None = None,
    every: int | None = 1,
    t_eval: ArrayLike | None = None,
    save: Any = None,
    progress: bool | None = None,
    on_failure: Literal["raise", "return"] = "raise",
) -> Trajectory | Sampled | Saved:
    """Integrate to a wanted error, with a scheme and a step that are chosen for it.

    The choice is that of :func:`symsimpson.choose`, which takes some seconds. It is kept on disk:
    the same call makes no choice again. For many runs of a system, choose once and take the
    stepper.

    Parameters
    ----------
    system : MechanicalSystem
    q0, v0, p0, t_end, error, on, parameters, schemes
        As for :func:`symsimpson.choose`. ``error`` is measured by short runs, not bounded.
    every, t_eval, save, progress, on_failure
        As for :meth:`Stepper.integrate`.

    Returns
    -------
    Trajectory, or a Sampled or Saved
        Its ``message`` says what was chosen, and why.

    Raises
    ------
    InputError
        If the input makes no sense, or no scheme reaches the error.
    ConvergenceError, Interrupted
        As :meth:`Stepper.integrate`.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.integrate(ss.systems.pendulum(), [1.0], v0=[0.0], t_end=20.0, error=1e-8)
    >>> run.success, " with h = " in run.message
    (True, True)
    """
    check_system(system)
    values = read_mapping("parameters", parameters, "m")
    named = {getattr(key, "name", str(key)): value for key, value in values.items()}
    question = {
        "q0": _state_key(q0),
        "v0": _state_key(v0),
        "p0": _state_key(p0),
        "t_end": t_end,
        "error": error,
        "on": on,
        "parameters": sorted((key, repr(value)) for key, value in named.items()),
        "schemes": None if schemes is None else [*map(repr, in_a_row(schemes))],
    }
    given: dict[str, Any] = {"p0": p0, "parameters": parameters}
    choice = remembered(
        system,
        question,
        lambda: choose(system, q0, v0, t_end=t_end, error=error, on=on, schemes=schemes, **given),
    )
    more: dict[str, Any] = {"every": every, "t_eval": t_eval, "save": save}
    run: Trajectory | Sampled | Saved = choice.stepper.integrate(
        q0, v0, h=choice.h, t_end=t_end, progress=progress, on_failure=on_failure, **given, **more
    )
    return replace(run, message=f"{run.message} {choice.reason}")


def _state_key(state: Any) -> Any:
    """Return the text of an initial state, for the key of a stored choice."""
    state = by_name(state)
    if isinstance(state, Mapping):
        return sorted((str(name), repr(value)) for name, value in state.items())
    if state is None:
        return None
    try:
        return repr(np.asarray(state).tolist())
    except ValueError:  # ragged rows, which the run refuses
        return repr(state)
