"""Constraints of the system in an optimal control problem: equations at steps and at both ends.

Steppers use the same discrete equations. Multipliers act at all control points of a step
except the last. Constraints phi(q) = 0 hold at all control points except the first. Constraints
A v = b hold at the Gauss points. Momenta between steps are not projected. The next multiplier
balances their component in the row space of W, the matrix of all constraints on velocities.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from symsimpson.errors import reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import UNIT, Value, exact, scale
from symsimpson.graph.point_functions import PointFunctions
from symsimpson.graph.rebuild import rebuild
from symsimpson.study.control.symbolic_problem import Limits, SymbolicProblem
from symsimpson.study.control.transcription import lagrange
from symsimpson.support.array_types import Floats

#: Prescribed ends may violate a constraint by this fraction of its change over the motion.
CONSISTENT = 1e-9
#: Between control points, a path may violate a constraint by this fraction of the length of a step
#: times the gradient. A step of degree 1 that turns by 0.8 rad on a circle does.
LARGEST_GAP = 0.1
#: Newton steps that project a guess onto its constraints.
MOST_ITERATIONS = 30


def write_velocity_constraints(problem: SymbolicProblem) -> list[Value]:
    """Return the nodes of Phi v, then of A v - b."""
    graph, functions = problem.graph, problem.constraints
    slopes = (gradient(graph, phi, problem.q) for phi in functions.phi)
    rates = [graph.add(graph.products(slope, problem.v)) for slope in slopes]
    return [*rates, *functions.rates(graph, problem.v)]


def list_constraints(problem: SymbolicProblem) -> list[tuple[str, Value]]:
    """Return names and nodes: phi first, then the constraints on velocities."""
    phi = problem.constraints.phi
    names = [*problem.constraint_names[: len(phi)], *problem.constraint_names]
    return list(zip(names, [*phi, *write_velocity_constraints(problem)], strict=True))


def find_known_values(problem: SymbolicProblem, end: int) -> dict[int, Value]:
    """Return parameters, the time, coordinates and velocities that have a number at an end."""
    state, (low, high) = {*problem.q, *problem.v}, problem.duration

    def number(x: float) -> Value:
        return exact(Fraction(x)), UNIT

    given = {x: number(y) for x, y in problem.fixed_parameters.items()}
    if not end or low == high:
        given[problem.t] = number(end * low)
    for limit in problem.end_limits[end]:
        c, n = limit.value
        if limit.low == limit.high and c == 1 and n in state:
            given[n] = number(limit.low)
    return given


def find_active_limits(problem: SymbolicProblem, end: int, limits: Iterable[Limits]) -> list[bool]:
    """Return which limits are active at an end because of its prescribed values.

    A row of such a limit would be redundant, and its multiplier unbounded.
    """
    given, flags = find_known_values(problem, end), []
    for limit in limits:
        number = _evaluate_known(problem, limit.value, given)
        distance = min(abs(limit.low - number), abs(limit.high - number))
        flags.append(distance <= _estimate_roundoff(problem, limit.value, given))
    return flags


def _evaluate_known(problem: SymbolicProblem, value: Value, given: dict[int, Value]) -> float:
    """Return the number of a node for known values; NaN if it depends on anything else."""
    (node,) = rebuild(problem.graph, [value], given)
    known = not node[0] or not problem.graph.nodes[node[1]].symbols
    return problem.to_number(node) if known else np.nan


def _estimate_roundoff(problem: SymbolicProblem, value: Value, given: dict[int, Value]) -> float:
    """Return the tolerance for a node at known values: CONSISTENT times its largest change."""
    graph, lengths = problem.graph, problem.extents.max(axis=0)
    slopes = rebuild(graph, gradient(graph, value, [*problem.q, *problem.v]), given)
    sizes = [*lengths, *lengths / problem.duration[0]]
    changes = [
        abs(problem.to_number(slope)) * size
        for slope, size in zip(slopes, sizes, strict=True)
        if slope[0] and not graph.nodes[slope[1]].symbols
    ]
    return CONSISTENT * sum(changes)


def find_implied(
    problem: SymbolicProblem, end: int, values: Iterable[tuple[str, Value]]
) -> list[bool]:
    """Return which constraints follow from the boundary conditions of an ``end``, 0 or 1.

    ``values`` has names and nodes of constraints, which are 0 where they hold. Raises InputError
    if the boundary conditions contradict a constraint.
    """
    graph, given = problem.graph, find_known_values(problem, end)
    linkages = {last[1]: (-c, n) for _, last, (c, n) in problem.linkages if end and last[0] == 1}
    flags = []
    for name, value in values:
        residual = _evaluate_known(problem, value, given)
        if abs(residual) > _estimate_roundoff(problem, value, given):
            reject(
                f"{('start', 'end')[end]} contradicts the constraint {name!r}.",
                why=f"Its value there is {residual:.3g}, not 0.",
                remedy="Use system.consistent(q0, v0) to find values that satisfy it.",
            )
        # a linkage maps the constraint to the same function of the initial state, where it holds
        symbols = graph.nodes[value[1]].symbols & {*problem.q, *problem.v, problem.t}
        same = symbols <= linkages.keys() and rebuild(graph, [value], linkages) == [value]
        flags.append(not np.isnan(residual) or (bool(symbols) and same))
    return flags


def build_constraint_blocks(layout: Any, rows: Any) -> list[Any]:
    """Return functions at the control points and Gauss points of steps, with maps and rows.

    Multipliers are multiplied by h, so that the matrix of a step does not depend on h.
    """
    problem, graph, N, d = layout.problem, layout.problem.graph, layout.steps, layout.degree
    constraints = problem.constraints
    phi, rates = constraints.phi, constraints.rates(graph, problem.v)
    names, blocks = [*problem.constraint_names], []
    k, j = (x.ravel() for x in np.mgrid[:N, :d])
    count = np.arange(N * d)
    pulls = constraints.pulls(graph, problem.q, problem.multipliers)
    variables = [*problem.q, *problem.multipliers]
    maps = [*map(layout.select, [*layout.points[k, j].T, *layout.multipliers[k, j].T])]
    forces = layout.build_block(pulls, variables, maps, k, layout.places[j])
    parts = []
    for a in range(layout.n):
        at = np.concatenate([layout.step_rows[k, j, a], layout.step_rows[k, -1, a]])
        factors = np.repeat([-1.0, layout.end_scale / layout.scale], N * d)
        parts.append((at, np.tile(count, 2), factors))
    blocks.append((*forces, parts))
    if phi:
        maps = [*map(layout.select, layout.points[k, j + 1].T)]
        points = layout.build_block(phi, problem.q, maps, k, layout.places[j + 1])
        left_out = layout.dependent_rows.constraints[1]
        parts = []
        for name, out in zip(names, left_out[: len(phi)], strict=False):
            selected = count[: N * d - out]
            at = rows.add(len(selected), 0.0, 0.0, f"constraint {name!r}", 1.0 / N)
            parts.append((at, selected, np.full(len(selected), 1.0 / N)))
        blocks.append((*points, parts))
    if rates:
        places, *tables = (np.array(x, dtype=np.float64) for x in layout.scheme.at_gauss_points)
        maps = [matrix for table in tables for matrix in layout.coordinates_at(table[j], k)]
        inner = layout.build_block(rates, [*problem.q, *problem.v], maps, k, places[j], len(rates))
        parts = []
        for name in names[len(phi) :]:
            at = rows.add(N * d, 0.0, 0.0, f"velocity constraint {name!r}")
            parts.append((at, count, np.ones(N * d)))
        blocks.append((*inner, parts))
    return blocks


def follows_constraints(layout: Any, x: Floats) -> bool:
    """Return whether the path satisfies its constraints approximately between control points.

    The tolerance is proportional to the length of the step. A path that jumps to another branch
    of a constraint exceeds it.
    """
    problem, (N, d, n) = layout.problem, (layout.steps, layout.degree, layout.n)
    m, values = len(problem.constraints.phi), layout.parameter_values(x)
    if not m:
        return True
    middle = (layout.places[:-1] + layout.places[1:]) / 2
    q = x[layout.points]
    between = np.einsum("ij,kja->kia", lagrange(layout.places, middle), q).reshape(-1, n)
    functions = PointFunctions(problem.graph, problem.q, problem.constraints.phi)
    at = {**values, **dict(zip(problem.q, between.T, strict=True))}
    residuals = functions.values(at, N * d).reshape(m, N, d)
    ends = {**values, **dict(zip(problem.q, q[:, 0].T, strict=True))}
    slopes = np.linalg.norm(functions.jacobian(ends, N), axis=2).T
    lengths = np.linalg.norm(np.diff(q, axis=1), axis=2).sum(axis=1)
    tolerance = slopes * (LARGEST_GAP * lengths + CONSISTENT * np.abs(q).max())
    return bool((np.abs(residuals).max(axis=2) <= tolerance).all())


def project_points(layout: Any, x: Floats) -> Floats:
    """Return the control points of a guess, shape (..., n), projected onto phi(q) = 0."""
    problem, q, values = layout.problem, x[layout.points], layout.parameter_values(x)
    phi = problem.constraints.phi
    functions = PointFunctions(problem.graph, problem.q, phi)
    flat = q.reshape(-1, layout.n).copy()
    for _ in range(MOST_ITERATIONS if phi else 0):
        at = {**values, **dict(zip(problem.q, flat.T, strict=True))}
        residuals = functions.values(at, len(flat)).T
        slopes = functions.jacobian(at, len(flat))
        # least squares, as gradients may be linearly dependent or 0
        moves = np.einsum("kac,kc->ka", np.linalg.pinv(slopes, rcond=1e-9), residuals)
        if not np.isfinite(moves).all():
            return q
        flat -= moves
        if np.abs(moves).max() <= CONSISTENT * np.abs(flat).max():
            break
    return flat.reshape(q.shape)


def project_momenta(layout: Any, x: Floats) -> Floats:
    """Return momenta at the ends of steps, projected as a stepper does, shape (N + 1, n).

    They are M v + a, where M v + W^T mu = p - a and W v = b.
    """
    problem, p = layout.problem, x[layout.momenta]
    rates = write_velocity_constraints(problem)
    m, (count, n) = len(rates), p.shape
    functions = PointFunctions(problem.graph, problem.v, [*problem.momenta, *rates])
    at = layout.values_at_step_ends(x, np.zeros_like(p))
    constant = functions.values(at, count).T
    slopes = functions.jacobian(at, count)
    matrix = np.zeros((count, n + m, n + m))
    matrix[:, :, :n] = slopes
    matrix[:, :n, n:] = slopes[:, n:].swapaxes(1, 2)
    right = np.concatenate([p, np.zeros((count, m))], axis=1) - constant
    try:
        v = np.linalg.solve(matrix, right[..., None])[:, :n]
    except np.linalg.LinAlgError:  # the gradient of a constraint is 0 at this iterate
        v = (np.linalg.pinv(matrix) @ right[..., None])[:, :n]
    return np.asarray((slopes[:, :n] @ v)[..., 0] + constant[:, :n])


def correct_costates(layout: Any, x: Floats, normal: Floats, by_p: Floats) -> Floats:
    """Return what the rotation of the constraints adds to the derivatives of the cost by q.

    Momenta between steps have a component ``normal`` = W(q)^T mu, which their projection removes.
    If it is fixed while q changes, the projection no longer removes all of it: the difference is
    - mu dW/dq.
    """
    problem, graph, count = layout.problem, layout.problem.graph, len(by_p)
    rates = write_velocity_constraints(problem)
    constant = rebuild(graph, rates, {v: (exact(Fraction(0)), UNIT) for v in problem.v})
    linear = [graph.add([a, scale(-1, b)]) for a, b in zip(rates, constant, strict=True)]
    at = layout.values_at_step_ends(x, by_p)
    rows = PointFunctions(graph, problem.v, linear).jacobian(at, count)
    weights = np.einsum("kac,ka->kc", np.linalg.pinv(rows), normal)
    slopes = PointFunctions(graph, problem.q, linear).jacobian(at, count)
    return np.asarray(np.einsum("kc,kca->ka", weights, slopes))


#: Newton's method starts from STARTS random points, with at most MOST_CORRECTIONS steps. At least
#: FEWEST points must converge.
STARTS, MOST_CORRECTIONS, FEWEST = 8, 80, 2
#: Least-squares steps change parameters and durations by this fraction. They change states first.
PARAMETER_WEIGHT = 1e-2
#: Normalised rows are 0 within the first number. A row that is 0 within the second at all points
#: follows from the others. Gradients that differ by less than the third are linearly dependent.
ZERO_TOLERANCE, IMPLIED_TOLERANCE, TANGENT_TOLERANCE = 1e-12, 1e-9, 1e-4
#: A constraint belongs to a dependent set if its coefficient exceeds this share of the largest.
#: Points that differ by at most PERTURBATION are on the same branch.
SHARE, PERTURBATION = 0.1, 1e-3
#: Relative round-off error of dependent gradients. Lengths below the fraction TINY of the largest
#: one count as 0, as the sine of pi does.
RANK_TOLERANCE, TINY = 1e-11, 1e-13


class DependentRows(NamedTuple):
    """Flags of redundant rows: conditions of each end, linkages, and constraints at each end."""

    conditions: list[list[bool]]
    linkages: list[bool]
    constraints: list[list[bool]]


def find_dependent_rows(problem: SymbolicProblem) -> DependentRows:
    """Return which boundary rows follow from the rows before them, and are redundant.

    All conditions come before all constraints. The multipliers of a redundant row are unbounded.
    A row is redundant if it is 0 at several points where the others hold. Conditions may also be
    tangent to a constraint, as x = 1 is to the unit circle. The gradient of the constraint is
    then a linear combination of their gradients.

    Raises InputError if conditions contradict a constraint, or are tangent to it.
    """
    positions = len(problem.constraints.phi)
    constraints = list_constraints(problem)
    known = [find_implied(problem, end, constraints) for end in (0, 1)]
    rows = _BoundaryRows(problem, [value for _, value in constraints])
    out = [False] * rows.conditions + known[0] + known[1]
    if len(rows.prescribed) < rows.conditions or not all(known[0] + known[1]):
        places, out, tangent = rows.find_dependent(out)
        if tangent is not None:
            end, k = divmod(tangent - rows.conditions, len(constraints))
            what = rows.describe_known(places, end, velocities=k >= positions)
            where = ("start", "end")[end]
            reject(
                f"{where} is tangent to the constraint {constraints[k][0]!r}.",
                why="Their gradients are linearly dependent, so that multipliers are unbounded.",
                remedy=f"Add {what or 'more values'} to the {where}.",
            )
    flags = iter(out)
    ends = problem.end_limits
    conditions = [[x.low == x.high and next(flags) for x in limits] for limits in ends]
    linkages = [next(flags) for _ in problem.linkages]
    at_ends = [[next(flags) for _ in constraints] for _ in range(2)]
    return DependentRows(conditions, linkages, at_ends)


class _BoundaryRows:
    """Equations at both ends, as functions of both states, unknown parameters and the duration.

    The conditions of the start, of the end and the linkages come first. Then come the constraints
    at the start and at the end.
    """

    def __init__(self, problem: SymbolicProblem, constraints: list[Value]) -> None:
        self.problem, n, (low, high) = problem, len(problem.q), problem.duration
        self.equalities = [[x for x in limits if x.low == x.high] for limits in problem.end_limits]
        a, b = map(len, self.equalities)
        self.conditions = a + b + len(problem.linkages)
        of_constraints = self.conditions + np.arange(2 * len(constraints)).reshape(2, -1)
        self.targets = np.zeros(self.conditions + of_constraints.size)
        self.targets[: a + b] = [x.low for limits in self.equalities for x in limits]
        first: dict[Any, int] = {}
        ends = [(end, x.value[1]) for end in (0, 1) for x in self.equalities[end]]
        for k, (end, node) in enumerate(ends):
            if node in (*problem.q, *problem.v):
                first.setdefault((end, node), k)
        self.prescribed = [*first.values()]
        free = problem.free_nodes
        self.ends: list[tuple[Any, Any, PointFunctions]] = []
        for end, conditions in enumerate((np.arange(a), np.arange(a, a + b))):
            values = [x.value for x in self.equalities[end]]
            values += [(last, first)[1 - end] for _, last, first in problem.linkages] + constraints
            times = [problem.t] if end and low < high else []
            variables = [*problem.q, *problem.v, *free, *times]
            of_both = np.arange(a + b, self.conditions)
            rows = np.concatenate([conditions, of_both, of_constraints[end]])
            columns = np.arange(len(variables))
            columns += np.where(columns < 2 * n, 2 * n * end, 2 * n)
            self.ends.append((rows, columns, PointFunctions(problem.graph, variables, values)))
        lengths = problem.extents.max(axis=0)
        q = np.where(lengths > TINY * lengths.max(), lengths, lengths.max() or 1.0)
        given = [abs(problem.values[i]) or 1.0 for i in problem.free_parameters]
        self.sizes = np.concatenate([q, q / high, q, q / high, given, [high] * (low < high)])
        self.step_weights = np.where(np.arange(len(self.sizes)) < 4 * n, 1.0, PARAMETER_WEIGHT)
        bounds = [*problem.free_bounds, *[problem.duration] * (low < high)]
        anything = np.full(4 * n, np.inf)
        self.low, self.high = (
            np.concatenate([infinity, [pair[k] for pair in bounds]])
            for k, infinity in enumerate((-anything, anything))
        )

    def evaluate(self, w: Floats) -> tuple[Floats, Floats]:
        """Return residuals, and their derivatives by variables that are divided by their sizes."""
        problem, values = self.problem, -self.targets
        slopes = np.zeros((len(values), len(w)))
        for end, (rows, columns, functions) in enumerate(self.ends):
            known = {**problem.fixed_parameters, problem.t: end * problem.duration[0]}
            known |= dict(zip(functions.variables, w[columns], strict=True))
            values[rows] += functions.values(known, 1)[:, 0]
            slopes[np.ix_(rows, columns)] += functions.jacobian(known, 1)[0]
        return values, slopes * self.sizes

    def random_point(self, seed: int) -> Floats:
        """Return a random point, with parameters and a duration between their bounds."""
        rng = np.random.default_rng(seed)
        w: Floats = self.sizes * rng.normal(size=len(self.sizes))
        finite = np.isfinite(self.high - self.low)
        w[finite] = rng.uniform(self.low[finite], self.high[finite])
        return np.clip(w, self.low, self.high)

    def find_zero(self, w: Floats, rows: list[int]) -> Floats | None:
        """Return a point where rows are 0; None if Newton's method does not converge."""
        for _ in range(MOST_CORRECTIONS):
            residuals, slopes = self._evaluate_normalised(w, rows)
            if not (np.isfinite(residuals).all() and np.isfinite(slopes).all()):
                return None
            tolerance = ZERO_TOLERANCE * (1 + np.abs(w / self.sizes).max())
            if np.abs(residuals).max(initial=0.0) <= tolerance:
                return w
            moves = np.linalg.lstsq(slopes * self.step_weights, residuals, rcond=RANK_TOLERANCE)[0]
            w = np.clip(w - self.sizes * self.step_weights * moves, self.low, self.high)
        return None

    def find_dependent(self, out: list[bool]) -> tuple[list[Floats], list[bool], int | None]:
        """Return common zeros of all rows, flags of redundant rows, and one tangent constraint.

        ``out`` has the flags of rows that are known to be redundant.
        """
        places = [self.random_point(seed) for seed in range(STARTS)]
        independent, out = self.prescribed, list(out)
        for row in [
            None,
            *(k for k, redundant in enumerate(out) if not redundant and k not in independent),
        ]:
            if row is not None:
                values = [self._evaluate_normalised(w, [row])[0] for w in places]
                if all(np.abs(value).max() < IMPLIED_TOLERANCE for value in values):
                    out[row] = True
                    continue
                independent = [*independent, row]
            places = [w for w in (self.find_zero(w, independent) for w in places) if w is not None]
            if len(places) < FEWEST:
                return [], out, None
        while tangent := self.find_tangent(places, independent):
            starts = [self.random_point(seed) for seed in range(STARTS)]
            implied = [row for row in tangent if self.is_implied(row, independent, starts)]
            if not implied:  # the solver treats a row that is redundant on one branch only
                perturbed = [w + PERTURBATION * (self.random_point(0) - w) for w in places]
                branch = any(self.is_implied(row, independent, perturbed) for row in tangent)
                return places, out, None if branch else tangent[0]
            out[implied[0]] = True
            independent = [k for k in independent if k != implied[0]]
        return places, out, None

    def is_implied(self, row: int, rows: list[int], places: list[Floats]) -> bool:
        """Return whether a row is 0 at all zeros of the others that Newton's method finds."""
        others = [k for k in rows if k != row]
        zeros = [w for w in (self.find_zero(w, others) for w in places) if w is not None]
        residuals = [np.abs(self._evaluate_normalised(w, [row])[0]).max() for w in zeros]
        return len(residuals) >= FEWEST and max(residuals) < IMPLIED_TOLERANCE

    def find_tangent(self, places: list[Floats], rows: list[int]) -> list[int]:
        """Return constraints whose gradients depend linearly on other rows at all points."""
        given = [k for k in rows if k < self.conditions]
        constraints, shares = [k for k in rows if k >= self.conditions], np.zeros(0)
        for w in places if constraints else []:
            _, slopes = self._evaluate_normalised(w, [*given, *constraints])
            _, sizes, directions = np.linalg.svd(slopes[: len(given)], full_matrices=False)
            directions = directions[sizes > TANGENT_TOLERANCE]
            gradients = slopes[len(given) :]
            vectors, sizes, _ = np.linalg.svd(
                gradients - gradients @ directions.T @ directions, full_matrices=False
            )
            if sizes[-1] > TANGENT_TOLERANCE:
                return []
            shares = np.abs(vectors[:, -1])
        return [constraints[k] for k in np.argsort(-shares) if shares[k] > SHARE * shares.max()]

    def describe_known(self, places: list[Floats], end: int, *, velocities: bool) -> str:
        """Return "x = 1, y = 2": values of an end that all points share and no condition gives."""
        problem, n = self.problem, len(self.problem.q)
        given = {x.value[1] for x in self.equalities[end]}
        first, shared = 2 * n * end + n * velocities, list[str]()
        for a, node in enumerate(problem.v if velocities else problem.q):
            values = np.array([w[first + a] for w in places]) / self.sizes[first + a]
            if node not in given and np.ptp(values) < 10 * TANGENT_TOLERANCE:
                number = round(float(values.mean()), 3) * self.sizes[first + a] + 0.0
                shared.append(f"{'v_' * velocities}{problem.names[a]} = {number:g}")
        return ", ".join(shared)

    def _evaluate_normalised(self, w: Floats, rows: list[int]) -> tuple[Floats, Floats]:
        """Return residuals and gradients of rows, divided by the lengths of the gradients."""
        with np.errstate(all="ignore"):
            values, slopes = (x[rows] for x in self.evaluate(w))
            lengths = np.linalg.norm(slopes, axis=1)
            lengths[lengths == 0] = 1.0
            return values / lengths, slopes / lengths[:, None]
