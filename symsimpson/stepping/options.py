"""Types of the arguments of ``Stepper.integrate``, by what it returns."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Required, TypedDict

from numpy.typing import ArrayLike

from symsimpson.stepping.event import Event


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
