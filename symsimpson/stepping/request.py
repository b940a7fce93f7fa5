"""Arguments of runs as users give them: the one form in which all readers take them."""

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

    #: Where it begins; one of the last two is None.
    q0: Any
    v0: Any = None
    p0: Any = None
    #: One of ``t_end`` and ``steps`` is None.
    h: Any = None
    t_end: Any = None
    steps: Any = None
    t0: Any = 0.0
    #: Values by symbol or by name.
    parameters: Any = None
    inputs: Any = None
    every: Any = None  #: Steps from one stored state to the next, or None.
    #: What is differentiated.
    tangents: Any = None
    sensitivities: Any = None
    #: Times, or quantities, that alone are kept.
    t_eval: Any = None
    save: Any = None
    checkpoint: Any = None  #: A file to resume from.
    #: What is added up over steps, and what values of states are reduced to.
    record: Any = None
    reduce: Any = None
    events: Any = None  #: Events that act on the run.
    exact_h: bool = False  #: Whether ``h`` must divide the time up to ``t_end``.

    @property
    def varied(self) -> bool:
        """Whether derivatives are asked for."""
        return self.tangents is not None or self.sensitivities is not None

    @property
    def recorded(self) -> bool:
        """Whether something is recorded beside states."""
        return self.varied or self.record is not None or self.reduce is not None

    @property
    def carried(self) -> Any:
        """The variations of the state that are asked for: none where it is parameters alone."""
        alone = self.tangents is None and self.sensitivities is not None
        return 0 if alone else self.tangents


def step_request(q: Any, v: Any, p: Any, h: Any, t: Any, parameters: Any, inputs: Any) -> Request:
    """Return the request for one step; raise InputError unless it has one of v and p."""
    if (v is None) == (p is None):
        reject(
            f"a step needs exactly one of v and p, and has {'neither' if v is None else 'both'}.",
            remedy="Pass velocities as v=[...], or momenta as p=[...].",
        )
    return Request(q, v, p, h, steps=1, t0=t, parameters=parameters, inputs=of_a_step(inputs))


def of_a_step(inputs: Any) -> Any:
    """Return inputs of one step as those of a run of one step."""
    if isinstance(inputs, Mapping):
        return {key: _first_axis(value) for key, value in inputs.items()}
    return inputs if inputs is None else _first_axis(inputs)


def _first_axis(value: Any) -> Any:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of several lengths: what reads them says what is wrong
        return value
    return array[None] if array.ndim else value


class Options(TypedDict, total=False):
    """Arguments of all runs."""

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
    """Arguments of a run that keeps its states."""

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
    """Arguments of a run that keeps states at chosen times."""

    t_eval: Required[ArrayLike]
    save: None


class SavedOptions(Options, total=False):
    """Arguments of a run that keeps chosen quantities."""

    save: Required[Any]
    t_eval: ArrayLike | None
    every: int | None
