"""Judgement of a solver's outcome: a motion of the system, whose cost is least among those nearby.

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

from symsimpson.graph.nodes import ZERO
from symsimpson.study.control.constraint_rows import held_rates, resolved
from symsimpson.study.control.layout import Layout
from symsimpson.study.control.result import FOUND, STATUSES, ControlResult, ControlStatus
from symsimpson.study.control.solver import Outcome, Scaled, violations
from symsimpson.study.control.transcription import PointFunctions, lagrange, lagrange_slopes
from symsimpson.support.array_types import Floats

#: With so many more nodes of Gauss, sums over nodes in the equations of steps may change by this
#: part of what forces do. Measured: motions that no finer step has come to 0.06 to 0.9, ten steps
#: of a swing-up to 0.01 to 0.03, a single switch in three steps to 0.04.
MORE, OFF = 4, 0.05
#: The cost may change by as much. Costs below LEAST are rounding, and forces below this part of
#: momenta: none act where the best inputs are none.
NO_FORCE, LEAST = 1e-10, 1e-15


def balanced(layout: Any, x: Floats) -> bool:
    """Return whether equations of steps hold with more nodes, and the cost is what it is.

    Equations of steps see forces at nodes alone. Where inputs chatter from node to node, or steps
    are far too long, a motion that satisfies them need not be one of the system. Paths and inputs
    are the same polynomials. Signals are known at nodes alone.
    """
    read, u = layout.read, x[layout.inputs]
    known = read.graph.nodes[read.running[1]].symbols.isdisjoint(read.signals)
    running = read.running if known else ZERO
    functions = PointFunctions(read.graph, [], [*read.forces, *read.momenta, running])
    rows, done, cost, size = _sums(layout, functions, x, layout.c, layout.b, u)
    places, weights = np.polynomial.legendre.leggauss(layout.nodes + MORE)
    places = (places + 1) / 2
    inputs = np.einsum("ij,kjm->kim", lagrange(layout.c, places), u)
    finer, _, finer_cost, finer_size = _sums(layout, functions, x, places, weights / 2, inputs)
    # by the ways of coordinates all are of one unit: by those of steps, in which inputs do work,
    # and by those of whole motions, as a push where bodies hardly move tells where they go
    off, ways = np.abs(finer - rows).max(axis=1), np.abs(np.diff(x[layout.points], axis=1))
    moves = not any(
        (off * way).sum() > OFF * (done * way).sum() for way in (ways.sum(axis=1), ways.sum((0, 1)))
    )
    return moves and not abs(finer_cost - cost) > OFF * max(size, finer_size) + LEAST


def _sums(
    layout: Any,
    functions: PointFunctions,
    x: Floats,
    places: Floats,
    weights: Floats,
    inputs: Floats,
) -> tuple[Floats, Floats, float, float]:
    """Return sums over nodes in the equations of steps, (N, d + 1, n), and the sizes of forces.

    Forces that are rounding of momenta have the size of that. Then come the running cost, and what
    it is without signs.
    """
    read, q = layout.read, x[layout.points]
    sizes, (N, s, n) = layout.sizes(x), (layout.steps, len(places), layout.n)
    h = sizes[layout.grid.phase]
    k, i = (index.ravel() for index in np.mgrid[:N, :s])
    values, slopes = lagrange(layout.places, places), lagrange_slopes(layout.places, places)
    positions = np.einsum("ij,kja->aki", values, q)
    velocities = np.einsum("ij,kja->aki", slopes, q) / h[:, None]
    known = [*read.q, *read.v, *read.u]
    at = [*positions, *velocities, *np.moveaxis(inputs, -1, 0)]
    times = layout.grid.before(k, places[i]) @ sizes
    point = {node: value.ravel() for node, value in zip(known, at, strict=True)}
    point |= {**layout.parameter_values(x), read.t: times}
    *both, cost = functions.values(point, N * s).reshape(-1, N, s)
    F, P = np.reshape(both, (2, n, N, s))
    F, cost = F * h[:, None], (cost * h[:, None]) @ weights
    rows = np.einsum("i,ij,aki->kja", weights, values, F)
    rows += np.einsum("i,ij,aki->kja", weights, slopes, P)
    done = np.einsum("i,aki->ka", weights, np.abs(F) + NO_FORCE * np.abs(P))
    return rows, done, float(cost.sum()), float(np.abs(cost).sum())


#: With diagonals of 1, the mass matrix is singular where an eigenvalue is below this part.
SINGULAR = 1e-9
#: So much what constraints forbid weighs beside masses.
HEAVY = 1e6


def massive(layout: Any, x: Floats) -> bool:
    """Return whether M is positive definite on what constraints allow, at the ends of steps.

    It may be singular at some of them, as at a pole of spherical angles, but nowhere negative.
    """
    read, n = layout.read, layout.n
    count = layout.steps + 1
    at = layout.at_ends(x, np.zeros((count, n)))
    rows = [*read.momenta, *held_rates(read)]
    slopes = PointFunctions(read.graph, read.v, rows).jacobian(at, count)
    slopes = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    masses = np.abs(np.einsum("kii->ki", slopes[:, :n]))
    sizes = np.sqrt(np.where(masses > 0, masses, 1.0))
    slopes = slopes / sizes[:, None]
    mass, held = slopes[:, :n] / sizes[:, :, None], slopes[:, n:]
    lengths = np.linalg.norm(held, axis=2, keepdims=True)
    held = held / np.where(lengths > 0, lengths, 1.0)
    least = np.linalg.eigvalsh(mass + HEAVY * held.swapaxes(1, 2) @ held)[:, 0]
    return bool((least > -SINGULAR).all() and (least > SINGULAR).any())


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
    programme: Scaled, outcome: Outcome, bounds: Any, limits: Any, tolerance: float
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


def downhill(programme: Scaled, outcome: Outcome, bounds: Any, limits: Any) -> Floats | None:
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
    curved = _hessian(programme, x, 1.0, outcome.multipliers)[free][:, free]
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


def _hessian(programme: Scaled, x: Floats, cost: float, multipliers: Floats) -> Any:
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


def result_of(layout: Layout, outcome: Outcome, best: bool) -> ControlResult:
    """Return what a solver came to, and whether it is an optimum by its multipliers."""
    x, off = outcome.x, violations(layout, outcome.x)
    cost, _ = layout.programme[0].values(x)
    worst = int(np.argmax(off)) if off.size else 0
    status = STATUSES.get(outcome.ipopt_status, ControlStatus.RESTORATION_FAILED)
    if status in FOUND and not massive(layout, x):
        status = ControlStatus.NO_MASS
    elif status in FOUND and not (resolved(layout, x) and balanced(layout, x)):
        status = ControlStatus.NOT_RESOLVED
    elif status in FOUND and not best:
        status = ControlStatus.NOT_OPTIMAL
    name, violation = (layout.names[worst], off[worst]) if off.size else ("", 0.0)
    if np.isfinite(violation) and not np.isfinite(cost):
        name, violation = "cost", np.nan
    return ControlResult(
        layout,
        x,
        outcome.multipliers,
        cost,
        status,
        outcome.iterations,
        outcome.seconds,
        outcome.in_functions,
        float(violation),
        name,
        outcome.history,
    )
