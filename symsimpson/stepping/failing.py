"""Why a step of a run failed, by what its workspace holds."""

from __future__ import annotations

import numpy as np

from symsimpson.module.header import Header
from symsimpson.program.status import Status
from symsimpson.support.array_types import Reals


def failure(header: Header, column: Reals, *, last_resort: bool) -> Status:
    """Return why a step failed, from the workspace of one lane.

    ``last_resort`` tells whether the kernels that eliminate with pivoting took it.
    """
    status = Status(int(column[header.layout["STATUS"]]))
    if status is Status.NOT_CONVERGED and _diverged(header, column):
        return Status.DIVERGED
    if status is Status.NOT_FINITE and last_resort and _singular(header, column):
        return Status.SINGULAR_JACOBIAN
    return status


def _diverged(header: Header, column: Reals) -> bool:
    """Return whether the increments became ten times what was predicted, and seen before."""
    at, n, d = header.layout, header.n, header.degree
    predicted = column[at["PREDICTED"] : at["PREDICTED"] + d * n].reshape(d, n)
    masses = column[at["MASS_DIAGONAL"] : at["MASS_DIAGONAL"] + n]
    expected = max((masses * predicted**2).sum(), column[at["LARGEST_SQUARED"]])
    return bool(column[at["INCREMENT_SQUARED"]] > 100 * expected)


def _singular(header: Header, column: Reals) -> bool:
    """Return whether elimination with pivoting met a pivot of zero."""
    at = header.layout
    places = np.arange(at["SOLVE_UNKNOWNS"]) * (at["SOLVE_STRIDE"] + 1)
    return bool((column[at["JACOBIAN"] + at["SOLVE_OFFSET"] + places] == 0).any())
