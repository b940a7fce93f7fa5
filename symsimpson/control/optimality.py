"""Whether multipliers say that no motion nearby costs less.

Solvers divide by the size of multipliers before they compare with a tolerance. Where rows follow
from one another that size has no bound, and a point that is no optimum passes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

if TYPE_CHECKING:
    from symsimpson.control.ipopt import Outcome, Solvable

__all__ = ["optimal"]

Floats = NDArray[np.float64]
#: Slopes of the Lagrangian are 0 below this part of the largest one of the cost, and what rows
#: and bounds could still change of it below this part of the cost. Measured: up to 5e-8 where an
#: optimum was found, from 2e-5 where rows depend on one another.
PART = 1e-5
#: Both are 0 below this, too, or so many times what was asked for: inputs of 0 may be the best.
NOTHING, TIMES = 1e-6, 100


def optimal(
    programme: Solvable, outcome: Outcome, bounds: Any, limits: Any, tolerance: float
) -> bool:
    """Return whether first-order conditions hold, in the units of the programme."""
    nothing = max(NOTHING, TIMES * tolerance)
    cost, rows = programme.values(outcome.x)
    gradient, entries = programme.slopes(outcome.x)
    slopes = sparse.csr_matrix((entries, programme.jacobian_places), shape=programme.shape)
    with np.errstate(invalid="ignore"):  # what has no value is no optimum
        rest = gradient + slopes.T @ outcome.multipliers
        by_bounds = _left(-rest, outcome.x, bounds)
        by_rows = _left(outcome.multipliers, rows, limits)
    steep = np.abs(gradient).max(initial=0.0)
    return bool(
        by_bounds.max(initial=0.0) <= PART * steep + nothing
        and by_rows.max(initial=0.0) <= PART * abs(cost) + nothing
    )


def _left(multipliers: Floats, values: Floats, limits: Any) -> Floats:
    """Return multipliers times how far values are from the bound that each of them belongs to."""
    low, high = limits
    distance = np.where(multipliers > 0, high - values, values - low)
    return np.abs(multipliers) * np.minimum(np.abs(distance), 1.0)
