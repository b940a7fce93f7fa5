"""Where the unknowns of a problem of optimal control stand, and the programme that they make."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from symsimpson.graph.nodes import Value, scaled
from symsimpson.graph.rebuild import rebuilt
from symsimpson.study.control.constraint_rows import (
    Following,
    following,
    held_blocks,
    held_values,
    pressed,
)
from symsimpson.study.control.problem_parts import Grid, finite_values_at, read_function
from symsimpson.study.control.reading import Limits
from symsimpson.study.control.transcription import Block, PointFunctions, Programme
from symsimpson.support.array_types import Floats, Ints

if TYPE_CHECKING:
    from symsimpson.api.stepper import Stepper
    from symsimpson.schemes.scheme import Scheme
    from symsimpson.study.control.reading import Reading


class Rows:
    """Rows as they come; the first is that of the cost."""

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
        """Return the numbers of further rows between two bounds, and by what they are scaled."""
        self.scales.append(np.array(np.broadcast_to(scale, count)))
        self.low.append(np.full(count, low))
        self.high.append(np.full(count, high))
        self.names += [name] * count
        self.count += count
        return np.arange(self.count - count, self.count)

    def linear(self, at: Ints, columns: Ints, factor: float) -> None:
        """Add unknowns to rows."""
        self.at = np.concatenate([self.at, at.ravel()])
        self.columns = np.concatenate([self.columns, columns.ravel()])
        self.data = np.concatenate([self.data, np.full(at.size, factor)])


#: Of the duration. Measured on four problems: iterations hardly depend on it from 0.1 to 0.2; at h,
#: fine meshes lose the inertia of the Hessian to rounding.
END_SCALE = 0.1
#: Phases are no shorter than this part of the least duration: velocities are moves over times.
SHORTEST = 1e-3


class Layout:
    """Unknowns and rows of a problem, for steps of a scheme.

    The unknowns stand in arrays, by their numbers.
    """

    def __init__(self, read: Reading, scheme: Scheme, grid: Grid) -> None:
        self.read, self.scheme, self.grid, self.steps = read, scheme, grid, grid.count
        phases = len(grid.steps)
        # tables of the scheme: values and slopes of its polynomials at nodes, weights, places
        self.A, self.B = (np.array(x, dtype=np.float64) for x in (scheme.A, scheme.B))
        self.b, self.c, self.places = (
            np.array(x, dtype=np.float64)
            for x in (scheme.quadrature.weights, scheme.quadrature.nodes, scheme.points)
        )
        #: At which nodes the path is a control point.
        self._alone = np.asarray((np.abs(self.A) > 0).sum(axis=1) == 1)
        n, m, d, s = len(read.q), len(read.u), self.A.shape[1] - 1, len(self.b)
        self.n, self.degree, self.nodes, N = n, d, s, self.steps
        block = d * n + n  # control points of a step but for the last, and the momentum
        first = np.arange(N)[:, None, None] * block
        leading = first + np.arange(d)[None, :, None] * n + np.arange(n)
        last = np.append(leading[1:, :1], np.arange(n)[None, None] + N * block, axis=0)
        #: Control points, shape (N, d + 1, n), the first and the last shared with steps beside.
        self.points: Ints = np.concatenate([leading, last], axis=1)
        #: shape (N + 1, n)
        self.momenta: Ints = np.arange(N + 1)[:, None] * block + d * n + np.arange(n)
        self.momenta[-1] = N * block + n + np.arange(n)
        size = N * block + 2 * n
        #: Whether the last node of a step is the first of the next one.
        shared = self.shared = bool(self.c[0] == 0 and self.c[-1] == 1 and s > 1)
        each = s - 1 if shared else s
        # an input may jump where a phase ends
        before = np.arange(N) * each + grid.phase * shared
        #: shape (N, s, m); those at the end of a step are shared with the next one.
        self.inputs: Ints = (
            size + (before[:, None, None] + np.arange(s)[None, :, None]) * m + np.arange(m)
        )
        size += (N * each + shared * phases) * m
        #: At the start and at the end, shape (2, n).
        self.velocities: Ints = size + np.arange(2 * n).reshape(2, n)
        size += 2 * n
        self.parameters: Ints = size + np.arange(len(read.found))  #: Those that are found.
        size += len(read.found)
        low, high = read.duration
        #: Sizes of the steps of phases; none if the duration is given, and there is one phase.
        self.h: Ints = size + np.arange(0 if low == high and phases == 1 else phases)
        size += len(self.h)
        held = len(read.constraints)
        #: Of constraints, times h, at all control points of a step but the last, and at the end.
        self.multipliers: Ints = size + np.arange(N * d * held).reshape(N, d, held)
        self.at_end: Ints = size + N * d * held + np.arange(held)
        self.size = size + (N * d + 1) * held
        #: By which rows of steps but the last are multiplied: M / h of the Jacobian becomes M.
        self.scale = (low if low == high else np.sqrt(low * high)) / N
        #: By which the last row is, in which momenta stand: a time, as h is, so that the programme
        #: does not depend on units, but one that fine steps do not make small.
        self.end_scale = END_SCALE * self.scale * N

    @cached_property
    def stepper(self) -> Stepper:
        """The stepper of the system and the scheme; it compiles nothing until it runs."""
        from symsimpson.api.compiling import compile as compile_stepper  # which solving needs not

        return compile_stepper(self.read.system, self.scheme)

    @cached_property
    def following(self) -> Following:
        """Which rows of the ends follow from others, and are left out."""
        return following(self.read)

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """The bounds of the unknowns."""
        read = self.read
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)

        def bound(where: Ints, pair: tuple[float, float]) -> None:
            low[where], high[where] = pair

        for k, pair in read.of_inputs.items():
            bound(self.inputs[..., k], pair)
        for steps, inputs in zip(self.grid.slices, read.phases, strict=True):
            for k, pair in inputs.items():
                bound(self.inputs[steps, :, k], pair)
        for a, pair in read.of_coordinates.items():
            bound(self.points[:, 0, a], pair)
            bound(self.points[-1, -1, a], pair)
            for i in np.flatnonzero(self._alone):
                bound(self.points[:, int(self.A[i].argmax()), a], pair)
            limit = Limits("", (1, read.q[a]), *pair)
            for end, point in enumerate((self.points[0, 0], self.points[-1, -1])):
                if pressed(read, end, [limit])[0]:
                    bound(point[a], (-np.inf, np.inf))
        for place, pair in zip(self.parameters, read.found_bounds, strict=True):
            bound(place, pair)
        shortest = (SHORTEST if len(self.h) > 1 else 1.0) * read.duration[0]
        for place, n in zip(self.h, self.grid.steps, strict=False):
            bound(place, (shortest / n, read.duration[1] / n))
        return low, high

    def sizes(self, x: Floats) -> Floats:
        """Return the size of the steps of each phase."""
        given = np.array([self.read.duration[0] / self.steps])
        return x[self.h] if len(self.h) else given

    @cached_property
    def programme(self) -> tuple[Programme, Floats, Floats]:
        """The programme, and the bounds of its rows; ``names`` and ``scales`` are theirs."""
        rows, read = Rows(), self.read
        blocks = [self._path(rows)]
        if read.constraints:
            blocks += held_blocks(self, rows)
        self.of_steps = len(blocks)
        blocks += self._ends(rows)
        if len(self.h) > 1:
            shortest, longest = read.duration
            whole = rows.add(1, shortest / longest, 1.0, "duration")
            for place, n in zip(self.h, self.grid.steps, strict=True):
                rows.linear(whole, np.array([place]), n / longest)
        linear = sparse.coo_matrix(
            (rows.data, (rows.at, rows.columns)), shape=(rows.count, self.size)
        )
        self.names, self.scales = rows.names, np.concatenate(rows.scales)
        full_blocks = []
        for functions, maps, fixed, parts in blocks:
            shape = rows.count, maps[0].shape[0]
            of_rows = [sparse.csr_matrix((x, (at, point)), shape=shape) for at, point, x in parts]
            for matrix in of_rows:
                matrix.eliminate_zeros()
            full_blocks.append(Block(functions, maps, of_rows, fixed))
        programme = Programme(full_blocks, linear)
        low, high = (np.concatenate(x) for x in (rows.low, rows.high))
        return programme, low, high

    def _timed(self, k: Ints, places: Floats, h: int | None) -> tuple[list[int], list[Any], Any]:
        """Return the time at places in steps, and their size: as unknowns with maps, or as given.

        ``h`` is the node of the size, where it is asked for. First come the nodes of what is
        unknown of both, with their maps, sparse matrices; then what is given, with the values of
        parameters.
        """
        t, before = self.read.t, self.grid.before(k, places)
        if not len(self.h):
            size = self.read.duration[0] / self.steps
            of_h = {} if h is None else {h: size}
            return [], [], {**self.read.given, t: before[:, 0] * size, **of_h}
        at, phase = np.nonzero(before)
        shape = len(places), self.size
        time = sparse.csr_matrix((before[at, phase], (at, self.h[phase])), shape=shape)
        if h is None:
            return [t], [time], self.read.given
        return [t, h], [time, self.of(self.h[self.grid.phase[k]])], self.read.given

    def parameter_values(self, x: Floats) -> dict[int, float]:
        """Return all parameters where the unknowns are, by their nodes in the graph."""
        read = self.read
        values = dict(zip(read.parameters, read.values, strict=True))
        nodes = (read.parameters[j] for j in read.found)
        return values | dict(zip(nodes, x[self.parameters].tolist(), strict=True))

    @property
    def ends(self) -> Ints:
        """Coordinates at the ends of steps, shape (N + 1, n)."""
        return np.concatenate([self.points[:, 0], self.points[-1:, -1]])

    def at_ends(self, x: Floats, v: Floats) -> dict[int, Any]:
        """Return coordinates, velocities v, parameters and t at the ends of steps, by nodes."""
        read = self.read
        state = zip([*read.q, *read.v], [*x[self.ends].T, *v.T], strict=True)
        times = self.grid.times(self.sizes(x))
        return {**self.parameter_values(x), read.t: times, **dict(state)}

    def of(self, columns: Any, count: int | None = None) -> Any:
        """Return the matrix that takes unknowns to points, one each."""
        columns = np.broadcast_to(columns, len(columns) if count is None else count)
        at = np.arange(len(columns))
        return sparse.csr_matrix((np.ones(len(at)), (at, columns)), shape=(len(at), self.size))

    def on_path(self, table: Floats, k: Ints) -> list[Any]:
        """Return the matrices of coordinates at points of steps k, by rows of a table."""
        at, nodes = np.nonzero(table)
        return [
            sparse.csr_matrix(
                (table[at, nodes], (at, self.points[k[at], nodes, a])),
                shape=(len(table), self.size),
            )
            for a in range(self.n)
        ]

    def block(
        self, values: Any, variables: Any, maps: Any, k: Ints, places: Floats, by_h: int = 0
    ) -> tuple[PointFunctions, list[Any], dict[int, Any]]:
        """Return functions of points of steps k, their maps, and what is given there.

        In ``values`` stand velocities, in maps those times h; the first ones are multiplied by h.
        ``places`` are the times of the points in steps.
        """
        read, graph, count = self.read, self.read.graph, len(places)
        (h,) = graph.numbers(["size of a step"])
        turned: dict[int, Value] = {
            v: graph.multiply([(1, v), graph.power((1, h), -1)]) for v in read.v
        }
        outputs = rebuilt(graph, values, turned)
        outputs[:by_h] = [graph.multiply([x, (1, h)]) for x in outputs[:by_h]]
        timed, timed_maps, fixed = self._timed(k, places, h)
        variables = [*variables, *(read.parameters[i] for i in read.found), *timed]
        maps = [*maps, *(self.of(x, count) for x in self.parameters), *timed_maps]
        return PointFunctions(graph, variables, outputs), maps, fixed

    def _path(self, rows: Rows) -> Any:
        """Return the functions at nodes: forces, momenta, costs and what is bounded there."""
        read, N, s, n, d = self.read, self.steps, self.nodes, self.n, self.degree
        here, count = read.of_coordinates, N * s
        values = [*read.forces, read.running, *read.momenta, *(x.value for x in read.within)]
        values += [(1, read.q[a]) for a in here]
        k, i = np.divmod(np.arange(count), s)
        maps = [*self.on_path(self.A[i], k), *self.on_path(self.B[i], k)]
        maps += [self.of(self.inputs[k, i, a]) for a in range(len(read.u))]
        block = self.block(values, [*read.q, *read.v, *read.u], maps, k, self.c[i], n + 1)
        for node, (symbol, given) in read.signals.items():
            what, whole = f"signals[{symbol}]", read.duration[0]
            function = read_function(what, given, whole)
            block[2][node] = finite_values_at(what, function, (k + self.c[i]) * whole / N)
        scales = np.repeat(np.tile([self.scale] * d + [self.end_scale], N), n)
        steps = rows.add(N * (d + 1) * n, 0.0, 0.0, "step", scales).reshape(N, d + 1, n)
        self.step_rows = steps
        # the last rows of steps are sums of all: p_k+1 - p_k is what forces add to it
        rows.linear(steps[:, 0], self.momenta[:-1], self.scale)
        rows.linear(steps[:, -1], self.momenta[1:], self.end_scale)
        rows.linear(steps[:, -1], self.momenta[:-1], -self.end_scale)
        parts: list[tuple[Any, Any, Any]] = []
        for table, sums in ((self.A, -self.end_scale * self.b), (self.B, 0.0 * self.b)):
            weights = np.column_stack([self.scale * self.b[:, None] * table[:, :-1], sums])
            for a in range(n):
                at = steps[k, :, a].ravel()
                parts.append((at, np.repeat(np.arange(count), d + 1), weights[i].ravel()))
        parts.insert(n, (np.zeros(count, int), np.arange(count), self.b[i]))
        before = np.append(-1, self.grid.phase[:-1])
        again = self.shared & (i == 0) & (self.grid.phase == before)[k]
        at_ends = np.array([[self.c[0] == 0], [self.c[-1] == 1]]) & self._pressed
        for limit, (first, last) in zip(read.within, at_ends.T, strict=True):
            moving = not read.graph.nodes[limit.value[1]].symbols.isdisjoint(read.v)
            out = again.copy()
            out[0], out[-1] = first, last
            some = np.flatnonzero(~out | moving)  # what is without v is the same at shared nodes
            at = rows.add(len(some), limit.low, limit.high, limit.name)
            parts.append((at, some, np.ones(len(some))))
        for a, (low, high) in here.items():
            some = np.flatnonzero(~self._alone[i])
            at = rows.add(len(some), low, high, read.names[a])
            parts.append((at, some, np.ones(len(some))))
        self.path_rows = np.arange(steps.size, rows.count - 1)  #: Of what is bounded on the way.
        return *block, parts

    @cached_property
    def _pressed(self) -> NDArray[np.bool_]:
        """Which limits conditions of the start, and of the end, press to a bound."""
        flags = [pressed(self.read, end, self.read.within) for end in (0, 1)]
        return np.array(flags, dtype=bool).reshape(2, -1)

    def _ends(self, rows: Rows) -> list[Any]:
        """Return the functions at both ends: momenta, conditions, and the final cost."""
        read, graph, blocks = self.read, self.read.graph, []
        ties = [x for x, out in zip(read.tied, self.following.tied, strict=True) if not out]
        tied = [rows.add(1, 0.0, 0.0, f"{name} at both ends")[0] for name, *_ in ties]
        for end, (limits, point) in enumerate(
            zip(read.ends, (self.points[0, 0], self.points[-1, -1]), strict=True)
        ):
            name = ("start", "end")[end]
            pulls = read.held.pulls(graph, read.q, read.multipliers) if end else []
            legendre = [
                graph.add([(1, p), scaled(-1, P), *(scaled(-1, x) for x in pulls[a : a + 1])])
                for a, (p, P) in enumerate(zip(read.p, read.momenta, strict=True))
            ]
            final = [read.final] if end else []
            of_both = [values[1 - end] for _, *values in ties]
            left_out = self.following.conditions[end]
            limits = [x for x, out in zip(limits, left_out, strict=True) if not out]
            limits += [
                Limits(f"constraint {held!r}", value, 0.0, 0.0)
                for k, (held, value) in enumerate(held_values(read))
                if not (self.following.constraints[end][k] or (end and k < len(read.held.phi)))
            ]
            # the velocities of the ends are unknowns of their own
            limits += [
                x
                for x, out in zip(read.within, self._pressed[end], strict=True)
                if x.low < x.high and not out
                if graph.nodes[x.value[1]].symbols.isdisjoint({*read.u, *read.signals})
            ]
            values = [*legendre, *final, *(x.value for x in limits), *of_both]
            variables = [*read.q, *read.v, *read.p, *(read.parameters[i] for i in read.found)]
            unknown = [*point, *self.velocities[end], *self.momenta[-end], *self.parameters]
            if end:
                variables += read.multipliers
                unknown += [*self.at_end]
            timed, timed_maps, fixed = self._timed(np.array([end * self.steps]), np.zeros(1), None)
            at = list(rows.add(self.n, 0.0, 0.0, f"momentum at the {name}"))
            at += [0] * len(final)
            at += [rows.add(1, x.low, x.high, f"{x.name} at the {name}")[0] for x in limits]
            at += tied
            maps = [*(self.of(x, 1) for x in unknown), *timed_maps]
            parts = [([row], [0], [1.0]) for row in at]
            functions = PointFunctions(graph, [*variables, *timed], values)
            blocks.append((functions, maps, fixed, parts))
        return blocks
