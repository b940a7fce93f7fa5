"""Whether no motion nearby costs less, by multipliers and by curvature.

Solvers divide by the size of multipliers before they compare with a tolerance. Where rows follow
from one another that size has no bound, and a point that is no optimum passes. They end, too, where
the cost is flat and falls to both sides, as straight before an obstacle with a way to each side.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from symsimpson.control.ipopt import Outcome, Solvable
from symsimpson.support.array_types import Floats

__all__ = ["creeping", "downhill", "hessian", "optimal"]

#: Slopes of the Lagrangian are 0 below this part of the largest one of the cost, and what rows
#: and bounds could still change of it below that part of the cost. Measured: up to 5e-8 where an
#: optimum was found, 2e-5 of rounding in units of atoms; where rows depend on one another from
#: 7e-3 of slopes, or 2e-5 of the cost.
PART, OF_COST = 1e-4, 1e-5
#: Both are 0 below this, too, or so many times what was asked for: inputs of 0 may be the best.
NOTHING, TIMES = 1e-6, 100
#: Unknowns and rows are held at bounds within NEAR, or where multipliers are more than this part of
#: how far they are from it.
NEAR, PRESSED = 1e-6, 1e-3
#: Curvatures are sought near what the solver bent its last matrix by, or this part of the largest
#: entry, and near these parts of that: so many each time, and below this part of it they are 0.
BENT, SHIFTS, CURVATURES, FLAT = 1e-3, (1.0, 1e-2, 1e-4), 40, 1e-2
#: Up to so many matrices barriers may hide what the cost does.
FEW = 6
#: Solvers begin again this far aside, in units of sizes.
ASIDE = 0.1
#: Where the last of so many matrices are bent, and rows satisfied within NEAR, a solver creeps.
SLOW = 100
#: Rows that depend on one another keep so much of a matrix that has an inverse; bounds more, so
#: that multipliers are those of equations.
SOFT, SOFTER = 1e-12, 1e-6
#: The least multipliers are looked at where rows are satisfied within this.
EXACT = 1e-9


def optimal(
    programme: Solvable, outcome: Outcome, bounds: Any, limits: Any, tolerance: float
) -> bool:
    """Return whether first-order conditions hold, in the units of the programme.

    Where they do not with the multipliers of the solver, those of least size are asked: beside a
    condition a bound that says the same makes multipliers rounding, and does no harm.
    """
    nothing = max(NOTHING, TIMES * tolerance)
    cost, rows = programme.values(outcome.x)
    gradient, entries = programme.slopes(outcome.x)
    slopes = sparse.csr_matrix((entries, programme.jacobian_places), shape=programme.shape)
    # unknowns that are far smaller than their units move rows much
    units = np.maximum(np.asarray(abs(slopes).max(axis=0).todense()).ravel(), 1.0)
    steep, off = np.abs(gradient).max(initial=0.0), np.maximum(limits[0] - rows, rows - limits[1])

    def holds(multipliers: Floats) -> bool:
        with np.errstate(invalid="ignore"):  # what has no value is no optimum
            rest = (gradient + slopes.T @ multipliers) / units
            by_bounds = _left(-rest, outcome.x, bounds).max(initial=0.0)
            by_rows = _left(multipliers, rows, limits).max(initial=0.0)
        return bool(
            by_bounds <= PART * steep + nothing and by_rows <= OF_COST * abs(cost) + nothing
        )

    if holds(outcome.multipliers):
        return True
    finite = np.isfinite(gradient).all() and np.isfinite(entries).all()
    if not (finite and off.max(initial=0.0) < EXACT) or (bounds[0] == bounds[1]).all():
        return False
    return holds(_least(gradient, slopes, outcome.x, rows, bounds, limits))


def _least(
    gradient: Floats, slopes: Any, x: Floats, rows: Floats, bounds: Any, limits: Any
) -> Floats:
    """Return the least multipliers with which slopes are nearest to 0; of bounds even less."""
    free = ~_held(np.zeros_like(x), x, bounds)
    active = np.flatnonzero(_held(np.zeros_like(rows), rows, limits))
    held = slopes[active][:, free]
    soft = np.where((limits[0] == limits[1])[active], SOFT, SOFTER)
    blocks = [[sparse.identity(held.shape[1]), held.T], [held, -sparse.diags(soft)]]
    right = np.concatenate([gradient[free], np.zeros(len(active))])
    multipliers = np.zeros(len(rows))
    multipliers[active] = -splu(sparse.bmat(blocks, format="csc")).solve(right)[held.shape[1] :]
    return multipliers


def _left(multipliers: Floats, values: Floats, limits: Any) -> Floats:
    """Return multipliers times how far values are from the bound that each of them belongs to."""
    low, high = limits
    distance = np.where(multipliers > 0, high - values, values - low)
    return np.abs(multipliers) * np.minimum(np.abs(distance), 1.0)


def creeping(outcome: Outcome) -> bool:
    """Return whether a search used up its iterations on the way to where the cost is flat.

    There the cost falls to both sides; bent matrices keep the search between them, and it comes
    nearer by some parts of a hundred in each iteration.
    """
    bent, off = (
        np.array(outcome.history.get(name, [])[-SLOW:])
        for name in ("regularization_size", "inf_pr")
    )
    limited = outcome.ipopt_status == "Maximum_Iterations_Exceeded" and len(bent) == SLOW
    return bool(limited and (bent > 0).all() and (off < NEAR).all())


def downhill(programme: Solvable, outcome: Outcome, bounds: Any, limits: Any) -> Floats | None:
    """Return a step aside, along what holds, on which the cost falls to both sides; None if none.

    It is sought where the solver had to bend the last of its matrices, or made none; barriers of
    bounds bend the first ones.
    """
    bent = outcome.history.get("regularization_size", [0.0])
    barriers = any(
        ((low < high) & (np.isfinite(low) | np.isfinite(high))).any()
        for low, high in (bounds, limits)
    )
    if len(bent) > (FEW if barriers else 1) and not bent[-1]:
        return None
    x, (cost, rows) = outcome.x, programme.values(outcome.x)
    gradient, entries = programme.slopes(x)
    slopes = sparse.csr_matrix((entries, programme.jacobian_places), shape=programme.shape)
    free = ~_held(gradient + slopes.T @ outcome.multipliers, x, bounds)
    held = slopes[_held(outcome.multipliers, rows, limits)][:, free]
    curved = hessian(programme, x, 1.0, outcome.multipliers)[free][:, free]
    if not held.shape[1] or not all(np.isfinite(a.data).all() for a in (held, curved)):
        return None
    largest = bent[-1] or BENT * np.abs(curved.data).max(initial=0.0)
    for part in SHIFTS if largest else ():
        way = _bent_down(curved, held, part * largest)
        if way is not None:
            way /= np.abs(way).max()
            if not -(way @ (curved @ way)) > OF_COST * abs(cost):  # inputs of an arc without length
                return None
            step = np.zeros(len(x))
            step[free] = ASIDE * way
            return step
    return None


def hessian(programme: Solvable, x: Floats, cost: float, multipliers: Floats) -> Any:
    """Return the whole Hessian of cost times the cost, and multipliers times the rows."""
    entries = programme.curvatures(x, cost, multipliers), programme.hessian_places
    upper = sparse.csr_matrix(entries, shape=(len(x), len(x)))
    return upper + upper.T - sparse.diags(upper.diagonal())


def _bent_down(curved: Any, held: Any, shift: float) -> Floats | None:
    """Return a way along rows on which a matrix is negative, with a curvature near minus a shift.

    It is Lanczos' method, for the inverse of what the matrix is along rows, plus the shift.
    """
    count, size = held.shape
    moved = curved + shift * sparse.identity(size)
    blocks = [[moved, held.T], [held, -SOFT * sparse.identity(count)]]
    try:
        factors = splu(sparse.bmat(blocks, format="csc"))
    except RuntimeError:  # it has no inverse
        return None
    ways, turned = np.zeros((0, size)), np.zeros((0, size))
    way = factors.solve(np.random.default_rng(0).normal(size=size + count))[:size]
    for _ in range(min(CURVATURES, size)):
        before = np.linalg.norm(way)
        for _ in range(2):
            way = way - ways.T @ (ways @ way)
        length = np.linalg.norm(way)
        if not length > NEAR * before:
            break
        ways = np.vstack([ways, way / length])
        way = factors.solve(np.concatenate([ways[-1], np.zeros(count)]))[:size]
        turned = np.vstack([turned, way])
    if not len(ways):
        return None
    values, mixed = np.linalg.eigh(ways @ turned.T)
    # 1 / (curvature + shift)
    for value, mix in zip(values[[0, -1]], mixed.T[[0, -1]], strict=True):
        if value < 0 or value * shift * (1 - FLAT) > 1:
            steepest: Floats = mix @ ways
            if steepest @ (curved @ steepest) < 0:
                return steepest
    return None


def _held(multipliers: Floats, values: Floats, limits: Any) -> NDArray[np.bool_]:
    """Return which values stay at a bound."""
    distance = np.minimum(values - limits[0], limits[1] - values)
    held: NDArray[np.bool_] = (distance < NEAR) | (np.abs(multipliers) > PRESSED * distance)
    return held
