"""Kernels that iterate the velocities and forces at the nodes, which are the lanes of vector code.

With as many nodes as degrees the path is given by the velocities v_j at its nodes,

    q_i = q0 + sum_j (a_ij/b_j) (h b_j v_j),    p_i = p0 + sum_j (1 - a_ji/b_i) (h b_j f_j),

f_j = L_q(q_j, v_j) and M(q_j) v_j = p_j - a(q_j): a symplectic partitioned Runge-Kutta method. An
iteration takes positions from velocities, forces from positions, momenta from forces and velocities
from momenta, with one small solve a node; what contracts is h^2 K rather than h. All nodes are
treated alike, so they are lanes, and one trajectory fills a vector register.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from math import prod
from typing import Any

from symsimpson.codegen.coupled import end_of
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import (
    Call,
    IfActive,
    IfElse,
    Index,
    Kernel,
    Load,
    Loop,
    Row,
    Section,
    Statement,
    Store,
)
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.pivots import begun_pivots, least_pivot
from symsimpson.codegen.storage import node_stride
from symsimpson.codegen.template import Point
from symsimpson.codegen.turning import Turning
from symsimpson.codegen.unrolled import STATE, lanes, velocity

__all__ = ["StageKernels"]

#: An iteration with more operations a node than this is not written out.
MOST_OPERATIONS = 3000
#: What is computed in the first half of an iteration.
FIRST = (Level.STEP, Level.ITERATION)
#: Nodes are the lanes of a single run, and a vector of them is full; those of members side by side,
#: which are lanes then, are taken one by one.
NODES_AS_VECTOR = "range(STRIDE if LANES == 1 else NODES)"


class StageKernels:
    """Makes the kernels, and knows the rows they need.

    Its ``kernels`` are start_stages, iterate and advance_stages; none if an iteration would be too
    long to write out. The first half of an iteration leaves as many values of a node to the second
    as ``held`` says.
    """

    def __init__(self, low: Lowering) -> None:
        scheme = low.equations.scheme
        self._low, self._nodes, self._scales = low, scheme.stages, len(low.scales)
        self.stride = node_stride(scheme)
        self.held = 0
        #: Pairs of sine and cosine at a node.
        self.angles = 0
        fresh, names = low.names.fresh, low.names.coordinates
        declare = low.graph.declare

        def row(
            name: str, block: str, place: int | str, level: Level = Level.ITERATION
        ) -> Expression:
            symbol = declare(fresh(name), level)
            low.rows[symbol] = Row(block, place)
            return symbol

        def of_nodes(hint: str, block: str, a: int, level: Level) -> list[Expression]:
            return [
                row(f"{hint}{names[a]}_{j}", block, a * self.stride + j, level)
                for j in range(self._nodes)
            ]

        # h b_j v_j and h b_j f_j of all nodes, and what belongs to the node at hand
        self._moves = [of_nodes("dq_", "STAGE_V", a, Level.ITERATION) for a in range(low.n)]
        self._kicks = [of_nodes("dp_", "STAGE_F", a, Level.LATE) for a in range(low.n)]
        self._own = [row(f"dq_{name}_j", "STAGE_V", self._place(a)) for a, name in enumerate(names)]
        self._share = row("h_b", "STAGE_STEP", "node")
        self._rate = row("rate", "STAGE_RATE", "node")
        nodes = range(self._nodes)
        self._mu = [row(f"mu_{j}", "STAGE_MU", self._place(j)) for j in nodes]
        self._nu = [row(f"nu_{j}", "STAGE_NU", self._place(j), Level.LATE) for j in nodes]
        self._next = [
            row(f"ahead_{j}", "STAGE_AHEAD", f"smooth + {self._place(j)}", Level.LATE)
            for j in nodes
        ]
        self._forced = list(low.template.forced)
        iterate, operations = self._iterate()
        self.kernels = (
            [self._start(), iterate, self._advance()] if operations <= MOST_OPERATIONS else []
        )

    @property
    def constants(self) -> tuple[Call, ...]:
        """Return what is done once a run."""
        if not self.kernels:
            return ()
        timed = not self._low.equations.plain.autonomous
        places = (Call("stage_places"),) if timed else ()
        return (Call("stage_constants", ("W", "h", "lane")), *places)

    @property
    def sizes(self) -> dict[str, Any]:
        """Return numbers that the sizes of blocks of stages follow from."""
        timed = not self._low.equations.plain.autonomous
        return {
            "staged": self.stride,
            "staged_values": self.held,
            "staged_times": timed,
            "angles": self.angles,
        }

    def _place(self, k: int) -> str:
        return f"{k * self.stride} + node" if k else "node"

    def _row(self, block: str, k: int) -> Row:
        """Return the row of a value of the node at hand, the kth in a block."""
        return Row(block, self._place(k))

    def _combined(
        self, factors: Sequence[Expression], values: Sequence[Expression], hint: str, section: str
    ) -> Expression:
        """Return a sum of products in two halves that do not wait for each other."""
        define, total = self._low.graph.define, self._low.graph.total
        half = len(values) // 2
        terms = [x * y for x, y in zip(factors, values, strict=True)]
        first = define(f"{hint}_first", total(terms[:half]), section)
        second = define(f"{hint}_second", total(terms[half:]), section)
        return define(hint, first + second, section)

    def _over_nodes(
        self, body: Iterable[Statement], known: Iterable[Statement] = ()
    ) -> list[Statement]:
        """Wrap statements in the loop over nodes; what is the same for all is loaded before it.

        Unless statements before, those ``known``, did so.
        """
        loaded = {x for section in known if isinstance(section, Section) for x in section.body}
        inside: list[Statement] = []
        before: list[Load] = []
        for statement in body:
            if isinstance(statement, Section) and statement.title == "known before":
                reads = [load for load in statement.body if isinstance(load, Load)]
                same = [load for load in reads if "node" not in str(load.row.index)]
                before += [load for load in same if load not in loaded]
                node_loads = tuple(load for load in reads if "node" in str(load.row.index))
                inside = [Section("of this node", node_loads), *inside] if node_loads else inside
            else:
                inside.append(statement)
        loads = [Section("known before", tuple(before))] if before else []
        return [*loads, Loop("node", NODES_AS_VECTOR, tuple(inside))]

    def _iterate(self) -> tuple[Kernel, int]:
        """One iteration: positions, forces; momenta, velocities."""
        low, n, total = self._low, self._low.n, self._low.graph.total
        define, names, entry = low.graph.define, low.names.coordinates, low.template.entry
        q = [
            define(
                f"{names[a]}_j",
                low.q[a] + self._combined(self._mu, self._moves[a], f"shift_{names[a]}", "path"),
                "path",
            )
            for a in range(n)
        ]
        v = [self._velocity(a) for a in range(n)]
        point = Point("j", tuple(q), tuple(v), self._time(), self._inputs())
        kicks = [
            Store(
                self._row("STAGE_F", a),
                define(f"dp_{names[a]}_j", self._share * entry(point, "forces", "F", a), "forces"),
            )
            for a in self._forced
        ]
        p = list(low.p)
        for a in self._forced:
            kick = self._combined(self._nu, self._kicks[a], f"kick_{names[a]}", "momenta")
            p[a] = define(f"p_{names[a]}_j", low.p[a] + kick, "momenta")
        velocities, pivots = velocity(low, point, p, "velocities", suffix="new")
        least = Row("STAGE_PIVOT", "node")
        kicks += least_pivot(low, pivots, least, "velocities", self._scales)
        masses = [entry(point, "velocities", "M", a, a) for a in range(n)]
        new = [
            define(f"dq_{names[a]}_new", self._share * velocities[a], "velocities")
            for a in range(n)
        ]
        correction = total(masses[a] * (new[a] - self._own[a]) ** 2 for a in range(n))
        size = total(masses[a] * new[a] ** 2 for a in range(n))
        closing = [
            Store(Row("STAGE_CORRECTION", "node"), define("correction", correction, "velocities")),
            Store(Row("STAGE_SIZE", "node"), define("size", size, "velocities")),
            *(Store(self._row("STAGE_V", a), new[a]) for a in range(n)),
        ]
        held = [s for s in low.needed_before(closing, Level.LATE) if s not in low.rows]
        opening = low.statements(
            [*kicks, *(Store(self._row("STAGE_HELD", k), symbol) for k, symbol in enumerate(held))],
            FIRST,
        )
        self.held = len(held)
        low.rows |= {symbol: self._row("STAGE_HELD", k) for k, symbol in enumerate(held)}
        ending = low.statements(closing, (Level.LATE,))
        for symbol in held:
            del low.rows[symbol]
        body = (
            *self._opening(opening),
            *self._over_nodes(ending),
            Call("check_stage_convergence"),
            *((Call("check_turns"),) if self.angles else ()),
        )
        operations = sum(
            low.graph.definitions[s].operations for s in low.reached([*kicks, *closing])
        )
        doc = "One iteration for the velocities and forces at all nodes, which are the lanes."
        return Kernel("iterate", doc, lanes((IfActive(body),))), operations

    def _opening(self, body: Sequence[Statement]) -> list[Statement]:
        """Go over the nodes; after a while sines and cosines are turned by what angles change."""
        turning = Turning(self._low, self._row)
        fresh, turned = turning.kept(body), turning.turned(body)
        self.angles = turning.count
        if not self.angles:
            return self._over_nodes(body)
        condition = "W[STAGE_COUNT, lane] < W[STAGE_TURNED, lane]"
        return [IfElse(condition, *(tuple(self._over_nodes(x)) for x in (fresh, turned)))]

    def _afresh(self) -> list[Statement]:
        """Begin the next step with sines and cosines of its own."""
        return [Index("W[STAGE_TURNED, lane]", "FRESH")] if self.angles else []

    def _velocity(self, a: int) -> Expression:
        """Return a node's velocity: what gives its share of q1 - q0 to the last digit.

        With a rounded 1/(h b_j) alone, forces would belong to another velocity than momenta.
        """
        define, name = self._low.graph.define, self._low.names.coordinates[a]
        first = define(f"v_{name}_j_first", self._rate * self._own[a], "path")
        lost = define(f"dq_{name}_j_lost", self._own[a] - self._share * first, "path")
        return define(f"v_{name}_j", first + self._rate * lost, "path")

    def _time(self) -> Expression | None:
        """Return the time at a node; None if nothing depends on it."""
        low = self._low
        if low.equations.plain.autonomous:
            return None
        place = low.graph.fresh("c_j", Level.ITERATION)
        low.rows[place] = Row("STAGE_PLACE", "node")
        return low.graph.define("t_j", low.t + place * low.h, "path")

    def _inputs(self) -> tuple[Expression, ...]:
        """Return the inputs at a node."""
        low, names = self._low, self._low.names
        input_names = [names.fresh(f"{u}_j") for u in names.inputs]
        inputs = tuple(low.graph.declare(u, Level.ITERATION) for u in input_names)
        low.rows |= {u: self._row("INPUT", k) for k, u in enumerate(inputs)}
        return inputs

    def _start(self) -> Kernel:
        """From q and p to velocities that are the same at all nodes."""
        low, point = self._low, self._low.start_point()
        v, pivots = velocity(low, point, low.p, "velocity")
        stores = [Store(Row("VELOCITY", a), v[a]) for a in range(low.n)]
        for a in range(low.n):
            stores.append(
                Store(Row("MASS_DIAGONAL", a), low.template.entry(point, "velocity", "M", a, a))
            )
        stores += begun_pivots(low, pivots, "velocity", self._scales)
        zero = low.graph.of(0)
        stores += [Store(Row(f"STAGE_{name}", 0), zero) for name in ("EXPECTED", "COUNT")]
        same: list[Statement] = [Load(self._share, Row("STAGE_STEP", "node"))]
        for a in range(low.n):
            same.append(Store(self._row("STAGE_V", a), self._share * v[a]))
        loop = Loop("node", NODES_AS_VECTOR, tuple(same))
        body = (*low.statements(stores, STATE), *self._afresh(), loop)
        doc = "Begin at (q, p): the same velocity at all nodes."
        return Kernel("start_stages", doc, lanes(body))

    def _advance(self) -> Kernel:
        """Close a step and extrapolate to the next one."""
        low, n = self._low, self._low.n
        define, names = low.graph.define, low.names.coordinates
        stores = [
            Store(Row("PREVIOUS", i), old)
            for i, old in enumerate((*low.q, *low.q_low, *low.p, *low.p_low))
        ]
        q: list[Expression] = []
        p: list[Expression] = list(low.p)

        def total(values: Sequence[Expression], hint: str) -> Expression:
            parts = [define(f"{hint}_{k}", low.graph.total(values[k::4]), "sums") for k in range(4)]
            halves = [
                define(f"{hint}_half_{k}", low.graph.total(parts[k::2]), "sums") for k in range(2)
            ]
            return define(f"{hint}_all", halves[0] + halves[1], "sums")

        for a, name in enumerate(names):
            change = total(self._moves[a], f"dq_{name}")
            new, rest = low.compensated(name, low.q[a], low.q_low[a], change)
            q.append(new)
            stores += [Store(Row("POSITION", a), new), Store(Row("POSITION_LOW", a), rest)]
        for a in self._forced:
            name = f"p_{names[a]}"
            change = total(self._kicks[a], f"dp_{names[a]}")
            new, rest = low.compensated(name, low.p[a], low.p_low[a], change)
            p[a] = new
            stores += [Store(Row("MOMENTUM", a), new), Store(Row("MOMENTUM_LOW", a), rest)]
        cyclic = [a for a in range(n) if a not in self._forced]
        if cyclic:
            stores.append(Store(Row("CYCLIC_JUMP_SQUARED", 0), self._cyclic_jump(q, p, cyclic)))
        ahead = self._ahead()
        levels = (*FIRST, Level.LATE)
        closing = low.statements(stores, levels)
        following = self._over_nodes(low.statements(ahead, levels), closing)
        # steps that take many iterations are long: there a smoother extrapolation is closer
        smooth = (Index("smooth", str(self._nodes * self.stride)), *following)
        extrapolated = IfElse(
            "W[STAGE_COUNT, lane] > MANY", smooth, (Index("smooth", "0"), *following)
        )
        left = (Call("leave_path"),) if low.equations.looked_at else ()
        pivots = (Call("least_over_nodes"), Call("check_pivots"))
        checked = (Call("check_stage_acceptance"), *(pivots if low.scales else ()))
        accepted = (*checked, *self._afresh())
        body = (*closing, *left, extrapolated, *accepted)
        doc = "Close a step by compensated sums, then extrapolate to the nodes of the next."
        return Kernel("advance_stages", doc, lanes((IfActive(body),)))

    def _cyclic_jump(
        self, q: Sequence[Expression], p: Sequence[Expression], cyclic: Sequence[int]
    ) -> Expression:
        """Return how far velocities of cyclic coordinates at q1 are from those of the path."""
        low, c = self._low, self._low.equations.scheme.quadrature.nodes
        define, section = low.graph.define, "velocity at q1"
        end = replace(end_of(low, q), suffix="closed")  # q1 of Newton's method is another point
        v, _ = velocity(low, end, p, section)
        b = low.equations.scheme.quadrature.weights
        terms = []
        for a in cyclic:
            weights = [
                Fraction(float(prod((1 - y) / (x - y) for y in c if y != x) / b[i]))
                for i, x in enumerate(c)
            ]
            path = low.graph.total(x * w for w, x in zip(weights, self._moves[a], strict=True))
            gap = define(f"gap_{low.names.coordinates[a]}", low.h * v[a] - path, section)
            terms.append(low.template.entry(end, section, "M", a, a) * gap**2)
        return define("cyclic_jump_squared", low.graph.total(terms), section)

    def _ahead(self) -> list[Store]:
        """Extrapolate velocities to the nodes of the next step; forces follow from them."""
        names, section = self._low.names.coordinates, "extrapolation"
        stores = []
        for a, name in enumerate(names):
            value = self._combined(self._next, self._moves[a], f"dq_{name}_ahead", section)
            stores.append(Store(self._row("STAGE_V", a), value))
        return stores
