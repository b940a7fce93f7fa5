"""Checks of a solver's outcome: it must be a motion of the system and a local minimum of the cost.

Solvers divide residuals by the size of the multipliers. If rows are redundant, this size is
unbounded, and a solver may accept a point that is not optimal. Solvers also stop at saddle points,
for example on a straight path towards an obstacle that can be passed on either side.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from symsimpson.graph.nodes import ZERO
from symsimpson.graph.point_functions import PointFunctions
from symsimpson.study.control.constraint_rows import follows_constraints, write_velocity_constraints
from symsimpson.study.control.layout import Layout
from symsimpson.study.control.result import FOUND, ControlResult, ControlStatus
from symsimpson.study.control.solver import ScaledProgram, SolverOutcome, compute_violations
from symsimpson.study.control.transcription import lagrange, lagrange_slopes
from symsimpson.support.array_types import Floats

#: The status by the name that Ipopt returns.
STATUSES = {
    "Solve_Succeeded": ControlStatus.SOLVED,
    "Solved_To_Acceptable_Level": ControlStatus.ACCEPTABLE,
    "Infeasible_Problem_Detected": ControlStatus.INFEASIBLE,
    "Not_Enough_Degrees_Of_Freedom": ControlStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": ControlStatus.ITERATION_LIMIT,
    "User_Requested_Stop": ControlStatus.INTERRUPTED,
    "Invalid_Number_Detected": ControlStatus.NOT_FINITE,
}
#: With this number of additional Gauss nodes, the quadrature sums of a step may change by this
#: fraction of the work of forces. Measured: 0.06 to 0.9 for motions that do not persist with finer
#: steps, 0.01 to 0.03 for ten steps of a swing-up, and 0.04 for a single switch in three steps.
EXTRA_NODES, TOLERANCE = 4, 0.05
#: The cost may change by the same fraction. Costs below LEAST are round-off errors, as are forces
#: below the fraction NO_FORCE of momenta, for example where the optimal inputs are 0.
NO_FORCE, LEAST = 1e-10, 1e-15


def is_resolved_between_nodes(layout: Any, x: Floats) -> bool:
    """Return whether the equations and the cost hardly change with more quadrature nodes.

    The discrete equations depend on forces at nodes only. If inputs chatter from node to node, or
    if steps are too long, their solution need not be a motion of the system. The check evaluates
    the same polynomials of positions and inputs at other nodes. It omits costs with signals, which
    are known at nodes only.
    """
    problem, u = layout.problem, x[layout.inputs]
    known = problem.graph.nodes[problem.running_cost[1]].symbols.isdisjoint(problem.signals)
    running = problem.running_cost if known else ZERO
    functions = PointFunctions(problem.graph, [], [*problem.forces, *problem.momenta, running])
    rows, forces, cost, size = _integrate_steps(layout, functions, x, layout.c, layout.b, u)
    places, weights = np.polynomial.legendre.leggauss(layout.nodes + EXTRA_NODES)
    places = (places + 1) / 2
    inputs = np.einsum("ij,kjm->kim", lagrange(layout.c, places), u)
    finer, _, finer_cost, finer_size = _integrate_steps(
        layout, functions, x, places, weights / 2, inputs
    )
    # displacements convert all changes to work: those of each step, and those of the whole motion
    # for forces where bodies hardly move
    changes = np.abs(finer - rows).max(axis=1)
    displacements = np.abs(np.diff(x[layout.points], axis=1))
    moves = not any(
        (changes * displacement).sum() > TOLERANCE * (forces * displacement).sum()
        for displacement in (displacements.sum(axis=1), displacements.sum((0, 1)))
    )
    return moves and not abs(finer_cost - cost) > TOLERANCE * max(size, finer_size) + LEAST


def _integrate_steps(
    layout: Any,
    functions: PointFunctions,
    x: Floats,
    places: Floats,
    weights: Floats,
    inputs: Floats,
) -> tuple[Floats, Floats, float, float]:
    """Return quadrature sums of steps, sizes of forces, the running cost, and its absolute sum.

    The sums have shape (N, d + 1, n), the sizes (N, n). Sizes are at least the round-off error of
    the momenta.
    """
    problem, q = layout.problem, x[layout.points]
    sizes, (N, s, n) = layout.sizes(x), (layout.steps, len(places), layout.n)
    h = sizes[layout.grid.phase]
    k, i = (index.ravel() for index in np.mgrid[:N, :s])
    values, slopes = lagrange(layout.places, places), lagrange_slopes(layout.places, places)
    positions = np.einsum("ij,kja->aki", values, q)
    velocities = np.einsum("ij,kja->aki", slopes, q) / h[:, None]
    known = [*problem.q, *problem.v, *problem.u]
    at = [*positions, *velocities, *np.moveaxis(inputs, -1, 0)]
    times = layout.grid.before(k, places[i]) @ sizes
    point = {node: value.ravel() for node, value in zip(known, at, strict=True)}
    point |= {**layout.parameter_values(x), problem.t: times}
    *both, cost = functions.values(point, N * s).reshape(-1, N, s)
    F, P = np.reshape(both, (2, n, N, s))
    F, cost = F * h[:, None], (cost * h[:, None]) @ weights
    rows = np.einsum("i,ij,aki->kja", weights, values, F)
    rows += np.einsum("i,ij,aki->kja", weights, slopes, P)
    forces = np.einsum("i,aki->ka", weights, np.abs(F) + NO_FORCE * np.abs(P))
    return rows, forces, float(cost.sum()), float(np.abs(cost).sum())


#: The mass matrix, scaled to a diagonal of 1, is singular if an eigenvalue is below this number.
SINGULAR = 1e-9
#: Weight of the constraints' gradients relative to the mass matrix.
CONSTRAINT_WEIGHT = 1e6


def has_positive_mass(layout: Any, x: Floats) -> bool:
    """Return whether M is positive definite on admissible velocities at the ends of steps.

    M may be singular at some of them, for example at a pole of spherical angles. A negative
    eigenvalue is never allowed.
    """
    problem, n = layout.problem, layout.n
    count = layout.steps + 1
    at = layout.values_at_step_ends(x, np.zeros((count, n)))
    rows = [*problem.momenta, *write_velocity_constraints(problem)]
    slopes = PointFunctions(problem.graph, problem.v, rows).jacobian(at, count)
    slopes = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    masses = np.abs(np.einsum("kii->ki", slopes[:, :n]))
    sizes = np.sqrt(np.where(masses > 0, masses, 1.0))
    slopes = slopes / sizes[:, None]
    mass, normals = slopes[:, :n] / sizes[:, :, None], slopes[:, n:]
    lengths = np.linalg.norm(normals, axis=2, keepdims=True)
    normals = normals / np.where(lengths > 0, lengths, 1.0)
    least = np.linalg.eigvalsh(mass + CONSTRAINT_WEIGHT * normals.swapaxes(1, 2) @ normals)[:, 0]
    return bool((least > -SINGULAR).all() and (least > SINGULAR).any())


#: At an optimum, the gradient of the Lagrangian is below the first fraction of the largest slope of
#: the cost. Complementarity is below the second fraction of the cost. Measured: up to 5e-8 at
#: optima, and 2e-5 from round-off errors in atomic units. With dependent rows: from 7e-3 of slopes,
#: or 2e-5 of the cost.
SLOPE_FRACTION, COST_FRACTION = 1e-4, 1e-5
#: Absolute tolerance of both, and its least multiple of the solver's tolerance: optimal inputs may
#: be 0.
SMALLEST_TOLERANCE, TOLERANCE_FACTOR = 1e-6, 100
#: A bound is active if the distance is below NEAR, or if the multiplier exceeds this fraction of
#: the distance.
NEAR, ACTIVE = 1e-6, 1e-3
#: Lanczos' method searches for curvatures near -SHIFTS times the last regularisation of the solver,
#: or times SMALLEST_SHIFT of the largest entry. It takes at most CURVATURES steps for each shift.
#: Curvatures below the fraction FLAT of a shift count as 0.
SMALLEST_SHIFT, SHIFTS, CURVATURES, FLAT = 1e-3, (1.0, 1e-2, 1e-4), 40, 1e-2
#: In the first factorisations, the barriers of bounds may hide the curvature of the cost.
FEW_FACTORISATIONS = 6
#: Length of the step away from a saddle point, in scaled variables.
STEP_LENGTH = 0.1
#: A search creeps if the last iterations, this many, are regularised with violations below NEAR.
SLOW = 100
#: Regularisation of dependent equations, and of bounds. The second is larger, so that equations get
#: the multipliers.
ROW_REGULARISATION, BOUND_REGULARISATION = 1e-12, 1e-6
#: Least multipliers are computed only if rows are satisfied within this tolerance.
FEASIBLE = 1e-9


def is_optimal(
    nlp: ScaledProgram, outcome: SolverOutcome, bounds: Any, limits: Any, tolerance: float
) -> bool:
    """Return whether the first-order optimality conditions hold, in scaled variables.

    If they do not hold with the multipliers of the solver, they are checked with the multipliers
    of least size. A bound that repeats a condition makes the solver's multipliers inaccurate, and
    is harmless.
    """
    nothing = max(SMALLEST_TOLERANCE, TOLERANCE_FACTOR * tolerance)
    cost, rows = nlp.values(outcome.x)
    gradient, entries = nlp.slopes(outcome.x)
    slopes = sparse.csr_matrix((entries, nlp.jacobian_places), shape=nlp.shape)
    # variables that are far smaller than their sizes have large derivatives
    units = np.maximum(np.asarray(abs(slopes).max(axis=0).todense()).ravel(), 1.0)
    steep, excess = (
        np.abs(gradient).max(initial=0.0),
        np.maximum(limits[0] - rows, rows - limits[1]),
    )

    def holds(multipliers: Floats) -> bool:
        with np.errstate(invalid="ignore"):  # NaN is not optimal
            lagrangian = (gradient + slopes.T @ multipliers) / units
            by_bounds = _complementarity(-lagrangian, outcome.x, bounds).max(initial=0.0)
            by_rows = _complementarity(multipliers, rows, limits).max(initial=0.0)
        stationary = by_bounds <= SLOPE_FRACTION * steep + nothing
        return bool(stationary and by_rows <= COST_FRACTION * abs(cost) + nothing)

    if holds(outcome.multipliers):
        return True
    finite = np.isfinite(gradient).all() and np.isfinite(entries).all()
    if not (finite and excess.max(initial=0.0) < FEASIBLE) or (bounds[0] == bounds[1]).all():
        return False
    return holds(_compute_least_multipliers(gradient, slopes, outcome.x, rows, bounds, limits))


def _compute_least_multipliers(
    gradient: Floats, slopes: Any, x: Floats, rows: Floats, bounds: Any, limits: Any
) -> Floats:
    """Return multipliers of least size that minimise the gradient of the Lagrangian."""
    free = ~_find_active(np.zeros_like(x), x, bounds)
    active = np.flatnonzero(_find_active(np.zeros_like(rows), rows, limits))
    active_slopes = slopes[active][:, free]
    soft = np.where((limits[0] == limits[1])[active], ROW_REGULARISATION, BOUND_REGULARISATION)
    size = active_slopes.shape[1]
    blocks = [[sparse.identity(size), active_slopes.T], [active_slopes, -sparse.diags(soft)]]
    right = np.concatenate([gradient[free], np.zeros(len(active))])
    multipliers = np.zeros(len(rows))
    multipliers[active] = -splu(sparse.bmat(blocks, format="csc")).solve(right)[size:]
    return multipliers


def _complementarity(multipliers: Floats, values: Floats, limits: Any) -> Floats:
    """Return the absolute products of multipliers and distances from their bounds."""
    low, high = limits
    distance = np.where(multipliers > 0, high - values, values - low)
    return np.abs(multipliers) * np.minimum(np.abs(distance), 1.0)


def is_creeping(outcome: SolverOutcome) -> bool:
    """Return whether a search used all iterations while it converged slowly to a saddle point.

    Regularised matrices keep the search between both sides. Each iteration reduces the distance
    by a few percent.
    """
    shifts, violations = (
        np.array(outcome.history.get(name, [])[-SLOW:])
        for name in ("regularization_size", "inf_pr")
    )
    limited = outcome.ipopt_status == "Maximum_Iterations_Exceeded" and len(shifts) == SLOW
    return bool(limited and (shifts > 0).all() and (violations < NEAR).all())


def find_descent_step(
    nlp: ScaledProgram, outcome: SolverOutcome, bounds: Any, limits: Any
) -> Floats | None:
    """Return a step of negative curvature along the active constraints; None if there is none.

    The search takes place if the solver regularised its last matrix, or factorised only a few.
    The barriers of bounds may require regularisation of the first matrices.
    """
    shifts = outcome.history.get("regularization_size", [0.0])
    barriers = any(
        ((low < high) & (np.isfinite(low) | np.isfinite(high))).any()
        for low, high in (bounds, limits)
    )
    if len(shifts) > (FEW_FACTORISATIONS if barriers else 1) and not shifts[-1]:
        return None
    x, (cost, rows) = outcome.x, nlp.values(outcome.x)
    gradient, entries = nlp.slopes(x)
    slopes = sparse.csr_matrix((entries, nlp.jacobian_places), shape=nlp.shape)
    free = ~_find_active(gradient + slopes.T @ outcome.multipliers, x, bounds)
    active_slopes = slopes[_find_active(outcome.multipliers, rows, limits)][:, free]
    curved = _build_hessian(nlp, x, 1.0, outcome.multipliers)[free][:, free]
    finite = np.isfinite(active_slopes.data).all() and np.isfinite(curved.data).all()
    if not active_slopes.shape[1] or not finite:
        return None
    largest = shifts[-1] or SMALLEST_SHIFT * np.abs(curved.data).max(initial=0.0)
    for part in SHIFTS if largest else ():
        direction = _find_negative_curvature(curved, active_slopes, part * largest)
        if direction is not None:
            direction /= np.abs(direction).max()
            # inputs of a phase of length 0 have no curvature
            if not -(direction @ (curved @ direction)) > COST_FRACTION * abs(cost):
                return None
            step = np.zeros(len(x))
            step[free] = STEP_LENGTH * direction
            return step
    return None


def _build_hessian(nlp: ScaledProgram, x: Floats, cost: float, multipliers: Floats) -> Any:
    """Return the full Hessian of ``cost`` times the cost plus multipliers times the rows."""
    entries = nlp.curvatures(x, cost, multipliers), nlp.hessian_places
    upper = sparse.csr_matrix(entries, shape=(len(x), len(x)))
    return upper + upper.T - sparse.diags(upper.diagonal())


def _find_negative_curvature(curved: Any, active: Any, shift: float) -> Floats | None:
    """Return a direction in the kernel of ``active`` with a curvature near minus a shift; or None.

    Lanczos' method is applied to the inverse of the projected matrix plus the shift.
    """
    count, size = active.shape
    shifted = curved + shift * sparse.identity(size)
    blocks = [[shifted, active.T], [active, -ROW_REGULARISATION * sparse.identity(count)]]
    try:
        factors = splu(sparse.bmat(blocks, format="csc"))
    except RuntimeError:  # the matrix is singular
        return None
    directions, images = np.zeros((0, size)), np.zeros((0, size))
    direction = factors.solve(np.random.default_rng(0).normal(size=size + count))[:size]
    for _ in range(min(CURVATURES, size)):
        before = np.linalg.norm(direction)
        for _ in range(2):
            direction = direction - directions.T @ (directions @ direction)
        length = np.linalg.norm(direction)
        if not length > NEAR * before:
            break
        directions = np.vstack([directions, direction / length])
        direction = factors.solve(np.concatenate([directions[-1], np.zeros(count)]))[:size]
        images = np.vstack([images, direction])
    if not len(directions):
        return None
    values, vectors = np.linalg.eigh(directions @ images.T)
    # eigenvalues are 1 / (curvature + shift)
    for value, vector in zip(values[[0, -1]], vectors.T[[0, -1]], strict=True):
        if value < 0 or value * shift * (1 - FLAT) > 1:
            steepest: Floats = vector @ directions
            if steepest @ (curved @ steepest) < 0:
                return steepest
    return None


def _find_active(multipliers: Floats, values: Floats, limits: Any) -> NDArray[np.bool_]:
    """Return whether a bound is active for each value."""
    distance = np.minimum(values - limits[0], limits[1] - values)
    active: NDArray[np.bool_] = (distance < NEAR) | (np.abs(multipliers) > ACTIVE * distance)
    return active


def make_result(layout: Layout, outcome: SolverOutcome, best: bool) -> ControlResult:
    """Return the result of a search; ``best`` says whether the optimality conditions hold."""
    x, violations = outcome.x, compute_violations(layout, outcome.x)
    cost, _ = layout.nlp[0].values(x)
    worst = int(np.argmax(violations)) if violations.size else 0
    status = STATUSES.get(outcome.ipopt_status, ControlStatus.RESTORATION_FAILED)
    if status in FOUND and not has_positive_mass(layout, x):
        status = ControlStatus.NO_MASS
    elif status in FOUND and not (
        follows_constraints(layout, x) and is_resolved_between_nodes(layout, x)
    ):
        status = ControlStatus.NOT_RESOLVED
    elif status in FOUND and not best:
        status = ControlStatus.NOT_OPTIMAL
    name, violation = (layout.names[worst], violations[worst]) if violations.size else ("", 0.0)
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
