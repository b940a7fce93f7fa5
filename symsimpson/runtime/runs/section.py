"""Sections: a long run of which only the crossings of a surface are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from symsimpson.runtime.inputs import read_failure
from symsimpson.runtime.results.events import Events, gather, read_zeros, zeros
from symsimpson.runtime.runs.integrate import raise_failure
from symsimpson.runtime.runs.pieces import by_pieces
from symsimpson.runtime.runs.spec import RunSpec

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["poincare"]


def poincare(
    stepper: Stepper,
    expression: Any,
    spec: RunSpec,
    direction: int,
    wrap: Any,
    progress: bool | None,
    on_failure: str,
) -> Events:
    """Run, and keep the zeros of an expression.

    Raises
    ------
    InputError, ConvergenceError, Interrupted
    """
    read_failure(on_failure)
    wanted = read_zeros(stepper, expression, direction, wrap)
    run, last, found = by_pieces(
        stepper, spec, lambda piece, before: zeros(piece, wanted, begins=before == 0), progress
    )
    events = gather(last, wanted, found)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events
