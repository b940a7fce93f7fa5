"""Why a step of a run failed, by what its workspace holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from symsimpson.program.status import Status

if TYPE_CHECKING:
    from symsimpson.stepping.run import Run

__all__ = ["failure"]


def failure(run: Run) -> Status:
    """Return why the last step of a run failed."""
    status = Status(int(run.value("STATUS")))
    if status is Status.NOT_CONVERGED and _diverged(run):
        return Status.DIVERGED
    if status is Status.NOT_FINITE and run.last_resort and _singular(run):
        return Status.SINGULAR_JACOBIAN
    return status


def _diverged(run: Run) -> bool:
    """Return whether the increments became ten times what was predicted, and seen before."""
    n, d = run.header.n, run.header.degree
    predicted = run.rows("PREDICTED", d * n).reshape(d, n)
    expected = max(
        (run.rows("MASS_DIAGONAL", n) * predicted**2).sum(), run.value("LARGEST_SQUARED")
    )
    return bool(run.value("INCREMENT_SQUARED") > 100 * expected)


def _singular(run: Run) -> bool:
    """Return whether elimination with pivoting met a pivot of zero."""
    at = run.header.layout
    places = np.arange(at["SOLVE_UNKNOWNS"]) * (at["SOLVE_STRIDE"] + 1)
    return bool((run.W[at["JACOBIAN"] + at["SOLVE_OFFSET"] + places, 0] == 0).any())
