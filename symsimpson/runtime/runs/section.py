"""Sections: a long run of which only the crossings of a surface are kept."""

from __future__ import annotations

from symsimpson.runtime.inputs import read_failure
from symsimpson.runtime.program import Program
from symsimpson.runtime.results.events import Events, Zeros, gather, zeros
from symsimpson.runtime.runs.integrate import raise_failure
from symsimpson.runtime.runs.pieces import by_pieces
from symsimpson.runtime.runs.request import Request
from symsimpson.runtime.runs.spec import read_run

__all__ = ["poincare"]


def poincare(
    program: Program, request: Request, wanted: Zeros, progress: bool | None, on_failure: str
) -> Events:
    """Run, and keep the zeros of an expression.

    Raises
    ------
    InputError, ConvergenceError, Interrupted
    """
    read_failure(on_failure)
    spec = read_run(program, request)
    run, last, found = by_pieces(
        program, spec, lambda piece, before: zeros(piece, wanted, begins=before == 0), progress
    )
    events = gather(last, wanted, found)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events
