"""The arguments of a run as the user passed them, before they are checked."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, Required, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.stepping.event import Event


class Request(NamedTuple):
    """Unread arguments of :meth:`Stepper.integrate` and :meth:`Stepper.ensemble`."""

    #: Initial state; exactly one of v0 and p0 is not None.
    q0: Any
    v0: Any = None
    p0: Any = None
    #: Step size and length; exactly one of ``t_end`` and ``steps`` is not None.
    h: Any = None
    t_end: Any = None
    steps: Any = None
    t0: Any = 0.0
    #: Values by symbol or by name.
    parameters: Any = None
    inputs: Any = None
    every: Any = None  #: Number of steps between stored states; None for the last state only.
    #: Derivatives of the final state, by the initial state and by parameters or inputs.
    tangents: Any = None
    sensitivities: Any = None
    #: Times, or quantities, that the run stores instead of all states.
    t_eval: Any = None
    save: Any = None
    checkpoint: Any = None  #: Path of the checkpoint file.
    #: Sums over steps, and reductions of observed values.
    record: Any = None
    reduce: Any = None
    events: Any = None  #: Events that act on the run.
    exact_h: bool = False  #: Whether ``h`` must divide the duration up to ``t_end``.

    @property
    def varied(self) -> bool:
        """True if the request includes derivatives."""
        return self.tangents is not None or self.sensitivities is not None

    @property
    def recorded(self) -> bool:
        """True if the run records rows in addition to states."""
        return self.varied or self.record is not None or self.reduce is not None

    @property
    def carried(self) -> Any:
        """Requested variations of the initial state: 0 with sensitivities only."""
        if self.tangents is None and self.sensitivities is not None:
            return 0
        return self.tangents


def step_request(q: Any, v: Any, p: Any, h: Any, t: Any, parameters: Any, inputs: Any) -> Request:
    """Make the request for one step; raise InputError unless exactly one of v and p is given."""
    if (v is None) == (p is None):
        reject(
            f"a step needs exactly one of v and p, but has {'neither' if v is None else 'both'}.",
            remedy="Pass velocities as v=[...], or momenta as p=[...].",
        )
    return Request(
        q, v, p, h, steps=1, t0=t, parameters=parameters, inputs=inputs_for_one_step(inputs)
    )


def inputs_for_one_step(inputs: Any) -> Any:
    """Convert the inputs of one step to inputs of a run of one step."""
    if isinstance(inputs, Mapping):
        return {key: _first_axis(value) for key, value in inputs.items()}
    return inputs if inputs is None else _first_axis(inputs)


def _first_axis(value: Any) -> Any:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths: the reader of inputs rejects them
        return value
    return array[None] if array.ndim else value


class Options(TypedDict, total=False):
    """Keyword arguments that all runs accept."""

    h: Required[Any]
    p0: ArrayLike | None
    t_end: Any
    steps: int | None
    t0: Any
    parameters: Mapping[Any, Any] | None
    inputs: Any
    events: Sequence[Event] | None
    exact_h: bool
    progress: bool | None
    on_failure: Literal["raise", "return"]


class RunOptions(Options, total=False):
    """Keyword arguments of a run that stores its states."""

    every: int | None
    t_eval: None
    save: None
    tangents: ArrayLike | None
    sensitivities: Any
    record: str | Sequence[str] | None
    reduce: Mapping[str, Any] | None
    checkpoint: str | os.PathLike[str] | None
    checkpoint_every: int | None


class TimesOptions(Options, total=False):
    """Keyword arguments of a run that stores states at times ``t_eval``."""

    t_eval: Required[ArrayLike]
    save: None


class SavedOptions(Options, total=False):
    """Keyword arguments of a run that stores the quantities ``save``."""

    save: Required[Any]
    t_eval: ArrayLike | None
    every: int | None
