"""The variables of an optimal control problem, and its nonlinear program."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from symsimpson.graph.nodes import Value, scale
from symsimpson.graph.point_functions import PointFunctions
from symsimpson.graph.rebuild import rebuild
from symsimpson.study.control.constraint_rows import (
    DependentRows,
    build_constraint_blocks,
    find_active_limits,
    find_dependent_rows,
    list_constraints,
)
from symsimpson.study.control.problem_parts import Grid, finite_values_at, read_function
from symsimpson.study.control.symbolic_problem import Limits
from symsimpson.study.control.transcription import FunctionBlock, NonlinearProgram
from symsimpson.support.array_types import Floats, Ints

if TYPE_CHECKING:
    from symsimpson.api.stepper import Stepper
    from symsimpson.schemes.scheme import Scheme
    from symsimpson.study.control.symbolic_problem import SymbolicProblem


class RowBuilder:
    """A list of rows of a nonlinear program; row 0 is the cost."""

    def __init__(self) -> None:
        self.count = 1
        self.low: list[Floats] = []
        self.high: list[Floats] = []
        self.names: list[str] = []
        self.scales: list[Floats] = []
        self.at, self.columns, self.data = (
            np.zeros(0, dtype=k) for k in (np.int64, np.int64, float)
        )

    def add(self, count: int, low: float, high: float, name: str, scale: Any = 1.0) -> Ints:
        """Append rows between two bounds, with their scale, and return their numbers."""
        self.scales.append(np.array(np.broadcast_to(scale, count)))
        self.low.append(np.full(count, low))
        self.high.append(np.full(count, high))
        self.names += [name] * count
        self.count += count
        return np.arange(self.count - count, self.count)

    def add_linear(self, at: Ints, columns: Ints, factor: float) -> None:
        """Add a factor times the variables ``columns`` to the rows ``at``."""
        self.at = np.concatenate([self.at, at.ravel()])
        self.columns = np.concatenate([self.columns, columns.ravel()])
        self.data = np.concatenate([self.data, np.full(at.size, factor)])


#: The scale of the last row of a step, relative to the duration. On four problems, the number of
#: iterations hardly changes from 0.1 to 0.2. With the scale h, round-off errors of fine meshes
#: exceed the inertia in the Hessian.
END_SCALE = 0.1
#: The shortest phase, relative to the least duration: velocities are displacements over durations.
SHORTEST = 1e-3


class Layout:
    """Variables and rows of a problem that a scheme discretises on a grid.

    Attributes such as ``points`` are arrays with the numbers of variables.
    """

    def __init__(self, problem: SymbolicProblem, scheme: Scheme, grid: Grid) -> None:
        self.problem, self.scheme, self.grid, self.steps = problem, scheme, grid, grid.count
        phases = len(grid.steps)
        # tables of the scheme: values and slopes at nodes, weights, nodes, control points
        self.A, self.B = (np.array(x, dtype=np.float64) for x in (scheme.A, scheme.B))
        self.b, self.c, self.places = (
            np.array(x, dtype=np.float64)
            for x in (scheme.quadrature.weights, scheme.quadrature.nodes, scheme.points)
        )
        #: Whether a node coincides with a control point, shape (s,).
        self._nodes_on_points = np.asarray((np.abs(self.A) > 0).sum(axis=1) == 1)
        n, m, d, s = len(problem.q), len(problem.u), self.A.shape[1] - 1, len(self.b)
        self.n, self.degree, self.nodes, N = n, d, s, self.steps
        block = d * n + n  # control points of a step except the last, and the momentum
        first = np.arange(N)[:, None, None] * block
        leading = first + np.arange(d)[None, :, None] * n + np.arange(n)
        last = np.append(leading[1:, :1], np.arange(n)[None, None] + N * block, axis=0)
        #: Control points, shape (N, d + 1, n). Neighbouring steps share their end points.
        self.points: Ints = np.concatenate([leading, last], axis=1)
        #: Momenta between steps, shape (N + 1, n).
        self.momenta: Ints = np.arange(N + 1)[:, None] * block + d * n + np.arange(n)
        self.momenta[-1] = N * block + n + np.arange(n)
        size = N * block + 2 * n
        #: Whether the last node of a step is the first node of the next step.
        shared = self.shared = bool(self.c[0] == 0 and self.c[-1] == 1 and s > 1)
        each = s - 1 if shared else s
        # an input may jump where a phase ends
        before = np.arange(N) * each + grid.phase * shared
        #: Inputs at nodes, shape (N, s, m). Neighbouring steps of a phase share end nodes.
        self.inputs: Ints = (
            size + (before[:, None, None] + np.arange(s)[None, :, None]) * m + np.arange(m)
        )
        size += (N * each + shared * phases) * m
        #: Velocities at the start and at the end, shape (2, n).
        self.velocities: Ints = size + np.arange(2 * n).reshape(2, n)
        size += 2 * n
        #: Unknown parameters.
        self.parameters: Ints = size + np.arange(len(problem.free_parameters))
        size += len(problem.free_parameters)
        low, high = problem.duration
        #: Step size of each phase; empty for a single phase of prescribed duration.
        self.h: Ints = size + np.arange(0 if low == high and phases == 1 else phases)
        size += len(self.h)
        count = len(problem.constraint_names)
        #: Multipliers times h at all control points of a step except the last; and at the end.
        self.multipliers: Ints = size + np.arange(N * d * count).reshape(N, d, count)
        self.end_multipliers: Ints = size + N * d * count + np.arange(count)
        self.size = size + (N * d + 1) * count
        #: Factor of all rows of a step except the last: M / h in the Jacobian becomes M.
        self.scale = (low if low == high else np.sqrt(low * high)) / N
        #: Factor of the last row of a step, which contains momenta. It is a time, as h is, so that
        #: the program does not depend on units. It does not decrease with h.
        self.end_scale = END_SCALE * self.scale * N

    @cached_property
    def stepper(self) -> Stepper:
        """The stepper of the system and the scheme. It compiles its kernels when it runs."""
        from symsimpson.api.compiling import compile as compile_stepper  # not needed to solve

        return compile_stepper(self.problem.system, self.scheme)

    @cached_property
    def dependent_rows(self) -> DependentRows:
        """Flags of redundant boundary rows, which are omitted."""
        return find_dependent_rows(self.problem)

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the variables."""
        problem = self.problem
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)

        def bound(where: Ints, pair: tuple[float, float]) -> None:
            low[where], high[where] = pair

        for k, pair in problem.input_bounds.items():
            bound(self.inputs[..., k], pair)
        for steps, inputs in zip(self.grid.slices, problem.phases, strict=True):
            for k, pair in inputs.items():
                bound(self.inputs[steps, :, k], pair)
        for a, pair in problem.coordinate_bounds.items():
            bound(self.points[:, 0, a], pair)
            bound(self.points[-1, -1, a], pair)
            for i in np.flatnonzero(self._nodes_on_points):
                bound(self.points[:, int(self.A[i].argmax()), a], pair)
            limit = Limits("", (1, problem.q[a]), *pair)
            for end, point in enumerate((self.points[0, 0], self.points[-1, -1])):
                if find_active_limits(problem, end, [limit])[0]:
                    bound(point[a], (-np.inf, np.inf))
        for place, pair in zip(self.parameters, problem.free_bounds, strict=True):
            bound(place, pair)
        shortest = (SHORTEST if len(self.h) > 1 else 1.0) * problem.duration[0]
        for place, n in zip(self.h, self.grid.steps, strict=False):
            bound(place, (shortest / n, problem.duration[1] / n))
        return low, high

    def sizes(self, x: Floats) -> Floats:
        """Return the step size of each phase at the point ``x``."""
        given = np.array([self.problem.duration[0] / self.steps])
        return x[self.h] if len(self.h) else given

    @cached_property
    def nlp(self) -> tuple[NonlinearProgram, Floats, Floats]:
        """The nonlinear program, and the bounds of its rows. Sets ``names`` and ``scales``."""
        rows, problem = RowBuilder(), self.problem
        blocks = [self._build_path_block(rows)]
        if problem.constraint_names:
            blocks += build_constraint_blocks(self, rows)
        self.step_block_count = len(blocks)
        blocks += self._build_end_blocks(rows)
        if len(self.h) > 1:
            shortest, longest = problem.duration
            whole = rows.add(1, shortest / longest, 1.0, "duration")
            for place, n in zip(self.h, self.grid.steps, strict=True):
                rows.add_linear(whole, np.array([place]), n / longest)
        linear = sparse.coo_matrix(
            (rows.data, (rows.at, rows.columns)), shape=(rows.count, self.size)
        )
        self.names, self.scales = rows.names, np.concatenate(rows.scales)
        full_blocks = []
        for functions, maps, fixed, parts in blocks:
            shape = rows.count, maps[0].shape[0]
            row_sizes = [sparse.csr_matrix((x, (at, point)), shape=shape) for at, point, x in parts]
            for matrix in row_sizes:
                matrix.eliminate_zeros()
            full_blocks.append(FunctionBlock(functions, maps, row_sizes, fixed))
        nlp = NonlinearProgram(full_blocks, linear)
        low, high = (np.concatenate(x) for x in (rows.low, rows.high))
        return nlp, low, high

    def _map_times(
        self, k: Ints, places: Floats, h: int | None
    ) -> tuple[list[int], list[Any], Any]:
        """Return the unknown ones of t and h with their maps, and all known values by nodes.

        The time t belongs to points ``places`` in steps ``k``. ``h`` is the node of the step
        size, or None if it is not needed. Maps are sparse matrices. Known values include
        parameters.
        """
        t, before = self.problem.t, self.grid.before(k, places)
        if not len(self.h):
            size = self.problem.duration[0] / self.steps
            of_h = {} if h is None else {h: size}
            return [], [], {**self.problem.fixed_parameters, t: before[:, 0] * size, **of_h}
        at, phase = np.nonzero(before)
        shape = len(places), self.size
        time = sparse.csr_matrix((before[at, phase], (at, self.h[phase])), shape=shape)
        if h is None:
            return [t], [time], self.problem.fixed_parameters
        sizes = self.select(self.h[self.grid.phase[k]])
        return [t, h], [time, sizes], self.problem.fixed_parameters

    def parameter_values(self, x: Floats) -> dict[int, float]:
        """Return the values of all parameters at the point ``x``, by their nodes."""
        problem = self.problem
        values = dict(zip(problem.parameters, problem.values, strict=True))
        return values | dict(zip(problem.free_nodes, x[self.parameters].tolist(), strict=True))

    @property
    def ends(self) -> Ints:
        """Numbers of the coordinates at the ends of steps, shape (N + 1, n)."""
        return np.concatenate([self.points[:, 0], self.points[-1:, -1]])

    def values_at_step_ends(self, x: Floats, v: Floats) -> dict[int, Any]:
        """Return coordinates, velocities ``v``, parameters and t between steps, by nodes."""
        problem = self.problem
        state = zip([*problem.q, *problem.v], [*x[self.ends].T, *v.T], strict=True)
        times = self.grid.times(self.sizes(x))
        return {**self.parameter_values(x), problem.t: times, **dict(state)}

    def select(self, columns: Any, count: int | None = None) -> Any:
        """Return the matrix that selects one variable for each point."""
        columns = np.broadcast_to(columns, len(columns) if count is None else count)
        at = np.arange(len(columns))
        return sparse.csr_matrix((np.ones(len(at)), (at, columns)), shape=(len(at), self.size))

    def coordinates_at(self, table: Floats, k: Ints) -> list[Any]:
        """Return a matrix for each coordinate at points of steps ``k``.

        Each row of ``table`` has the coefficients of the control points for one point.
        """
        at, nodes = np.nonzero(table)
        return [
            sparse.csr_matrix(
                (table[at, nodes], (at, self.points[k[at], nodes, a])),
                shape=(len(table), self.size),
            )
            for a in range(self.n)
        ]

    def build_block(
        self, values: Any, variables: Any, maps: Any, k: Ints, places: Floats, by_h: int = 0
    ) -> tuple[PointFunctions, list[Any], dict[int, Any]]:
        """Return functions at points of steps ``k``, their maps, and the known values there.

        ``values`` contain velocities, but the maps give velocities times h. The first ``by_h``
        values are multiplied by h. ``places`` are the points in steps, from 0 to 1.
        """
        problem, graph, count = self.problem, self.problem.graph, len(places)
        (h,) = graph.numbers(["size of a step"])
        velocities: dict[int, Value] = {
            v: graph.multiply([(1, v), graph.power((1, h), -1)]) for v in problem.v
        }
        outputs = rebuild(graph, values, velocities)
        outputs[:by_h] = [graph.multiply([x, (1, h)]) for x in outputs[:by_h]]
        t_nodes, t_maps, fixed = self._map_times(k, places, h)
        variables = [*variables, *problem.free_nodes, *t_nodes]
        maps = [*maps, *(self.select(x, count) for x in self.parameters), *t_maps]
        return PointFunctions(graph, variables, outputs), maps, fixed

    def _build_path_block(self, rows: RowBuilder) -> Any:
        """Return the functions at nodes: forces, the running cost, momenta and path limits."""
        problem, N, s, n, d = self.problem, self.steps, self.nodes, self.n, self.degree
        here, count = problem.coordinate_bounds, N * s
        values = [*problem.forces, problem.running_cost, *problem.momenta]
        values += [*(x.value for x in problem.path_limits), *((1, problem.q[a]) for a in here)]
        k, i = np.divmod(np.arange(count), s)
        maps = [*self.coordinates_at(self.A[i], k), *self.coordinates_at(self.B[i], k)]
        maps += [self.select(self.inputs[k, i, a]) for a in range(len(problem.u))]
        variables = [*problem.q, *problem.v, *problem.u]
        block = self.build_block(values, variables, maps, k, self.c[i], n + 1)
        for node, (symbol, given) in problem.signals.items():
            what, duration = f"signals[{symbol}]", problem.duration[0]
            function = read_function(what, given, duration)
            block[2][node] = finite_values_at(what, function, (k + self.c[i]) * duration / N)
        scales = np.repeat(np.tile([self.scale] * d + [self.end_scale], N), n)
        steps = rows.add(N * (d + 1) * n, 0.0, 0.0, "step", scales).reshape(N, d + 1, n)
        self.step_rows = steps
        # the last row is the sum of all equations of a step: p_k+1 - p_k equals the forces
        rows.add_linear(steps[:, 0], self.momenta[:-1], self.scale)
        rows.add_linear(steps[:, -1], self.momenta[1:], self.end_scale)
        rows.add_linear(steps[:, -1], self.momenta[:-1], -self.end_scale)
        parts: list[tuple[Any, Any, Any]] = []
        for table, sums in ((self.A, -self.end_scale * self.b), (self.B, 0.0 * self.b)):
            weights = np.column_stack([self.scale * self.b[:, None] * table[:, :-1], sums])
            for a in range(n):
                at = steps[k, :, a].ravel()
                parts.append((at, np.repeat(np.arange(count), d + 1), weights[i].ravel()))
        parts.insert(n, (np.zeros(count, int), np.arange(count), self.b[i]))
        before = np.append(-1, self.grid.phase[:-1])
        again = self.shared & (i == 0) & (self.grid.phase == before)[k]
        values_at_step_ends = np.array([[self.c[0] == 0], [self.c[-1] == 1]]) & self._active_limits
        for limit, (first, last) in zip(problem.path_limits, values_at_step_ends.T, strict=True):
            moving = not problem.graph.nodes[limit.value[1]].symbols.isdisjoint(problem.v)
            out = again.copy()
            out[0], out[-1] = first, last
            selected = np.flatnonzero(~out | moving)  # limits without v agree at shared nodes
            at = rows.add(len(selected), limit.low, limit.high, limit.name)
            parts.append((at, selected, np.ones(len(selected))))
        for a, (low, high) in here.items():
            selected = np.flatnonzero(~self._nodes_on_points[i])
            at = rows.add(len(selected), low, high, problem.names[a])
            parts.append((at, selected, np.ones(len(selected))))
        self.path_rows = np.arange(steps.size, rows.count - 1)  #: Rows of path limits.
        return *block, parts

    @cached_property
    def _active_limits(self) -> NDArray[np.bool_]:
        """True for path limits that prescribed values make active at the start and at the end."""
        flags = [find_active_limits(self.problem, end, self.problem.path_limits) for end in (0, 1)]
        return np.array(flags, dtype=bool).reshape(2, -1)

    def _build_end_blocks(self, rows: RowBuilder) -> list[Any]:
        """Return the functions at both ends: momenta, boundary conditions and the final cost."""
        problem, graph, blocks = self.problem, self.problem.graph, []
        redundant = self.dependent_rows
        linkages = [
            x for x, out in zip(problem.linkages, redundant.linkages, strict=True) if not out
        ]
        linkage_rows = [rows.add(1, 0.0, 0.0, f"{name} at both ends")[0] for name, *_ in linkages]
        for end, (limits, point) in enumerate(
            zip(problem.end_limits, (self.points[0, 0], self.points[-1, -1]), strict=True)
        ):
            name = ("start", "end")[end]
            pulls = problem.constraints.pulls(graph, problem.q, problem.multipliers) if end else []
            legendre = [
                graph.add([(1, p), scale(-1, P), *(scale(-1, x) for x in pulls[a : a + 1])])
                for a, (p, P) in enumerate(zip(problem.p, problem.momenta, strict=True))
            ]
            final = [problem.final_cost] if end else []
            of_both = [values[1 - end] for _, *values in linkages]
            left_out = redundant.conditions[end]
            limits = [x for x, out in zip(limits, left_out, strict=True) if not out]
            limits += [
                Limits(f"constraint {constraint!r}", value, 0.0, 0.0)
                for k, (constraint, value) in enumerate(list_constraints(problem))
                if not (redundant.constraints[end][k] or (end and k < len(problem.constraints.phi)))
            ]
            # path limits apply to the velocities of the ends, which are separate variables
            limits += [
                x
                for x, out in zip(problem.path_limits, self._active_limits[end], strict=True)
                if x.low < x.high and not out
                if graph.nodes[x.value[1]].symbols.isdisjoint({*problem.u, *problem.signals})
            ]
            values = [*legendre, *final, *(x.value for x in limits), *of_both]
            variables = [*problem.q, *problem.v, *problem.p, *problem.free_nodes]
            unknown = [*point, *self.velocities[end], *self.momenta[-end], *self.parameters]
            if end:
                variables += problem.multipliers
                unknown += [*self.end_multipliers]
            step = np.array([end * self.steps])
            t_nodes, t_maps, fixed = self._map_times(step, np.zeros(1), None)
            at = list(rows.add(self.n, 0.0, 0.0, f"momentum at the {name}"))
            at += [0] * len(final)
            at += [rows.add(1, x.low, x.high, f"{x.name} at the {name}")[0] for x in limits]
            at += linkage_rows
            maps = [*(self.select(x, 1) for x in unknown), *t_maps]
            parts = [([row], [0], [1.0]) for row in at]
            functions = PointFunctions(graph, [*variables, *t_nodes], values)
            blocks.append((functions, maps, fixed, parts))
        return blocks
