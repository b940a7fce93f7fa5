"""Sections: a long run of which only the crossings of a surface are kept."""

from __future__ import annotations

from symsimpson.program.program import Program
from symsimpson.results.events import Events, Zeros, gather, zeros
from symsimpson.run.ended import raise_failure
from symsimpson.run.pieces import by_pieces
from symsimpson.stepping.inputs import read_failure
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import read_run

__all__ = ["poincare"]


def poincare(
    program: Program, request: Request, wanted: Zeros, progress: bool | None, on_failure: str
) -> Events:
    """Run, and keep the zeros of an expression.

    Raises InputError, ConvergenceError or Interrupted.
    """
    read_failure(on_failure)
    spec = read_run(program, request)
    run, last, crossings = by_pieces(
        program, spec, lambda piece, before: zeros(piece, wanted), progress
    )
    events = gather(last, wanted, crossings)
    if not last.success and on_failure == "raise":
        raise_failure(run, last, events)
    return events
