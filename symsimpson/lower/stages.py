"""Kernels that iterate the velocities and forces at the nodes of a step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Any

from symsimpson.lower.expression import Expression
from symsimpson.lower.ir import (
    Assign,
    Call,
    Function,
    Kernel,
    Load,
    Loop,
    Row,
    Section,
    Statement,
    Store,
)
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.specialise import kernel_from_text
from symsimpson.lower.storage import node_stride
from symsimpson.lower.terms_of_l import split_loads
from symsimpson.lower.traced_kernels import (
    STATE,
    seek_velocity,
    store_first_pivots,
    store_least_pivot,
)
from symsimpson.lower.traced_parts import TracedPart

#: An iteration with more operations a node than this is not written out.
MOST_OPERATIONS = 3000
KERNELS = ("start_stages", "iterate", "advance_stages")
#: Functions that are traced, and what computes the first half of an iteration.
TRACED = ("start_velocity", "end_velocity", "stage_force", "stage_velocity", "stage_ahead")
PHASE_TRACED = ("stage_force", "stage_rate")
FIRST = (Level.STEP, Level.ITERATION)
#: Rows of a node that these read, and tables with a row for each node, by names of their values.
READ = {"STAGE_STEP": "h_b", "STAGE_RATE": "rate", "STAGE_PLACE": "c_j"}
TABLES = {"STAGE_MU": "mu_{}", "STAGE_NU": "nu_{}", "STAGE_AHEAD": "ahead_{}"}
#: An angle of a node, its sine and its cosine, from which later iterations turn them.
TURNED = ("STAGE_ANGLE", "STAGE_SINE", "STAGE_COSINE")
#: What depends on forces of other nodes is known late.
LATE = ("STAGE_NU", "STAGE_F")


class _Node(int):
    """The index of the current node, one after the last; it is printed as ``j``."""

    def __str__(self) -> str:
        return "j"


@dataclass(frozen=True)
class Stages:
    """The kernels of a stage iteration, with their functions, tables, facts and block sizes."""

    kernels: tuple[Kernel, ...] = ()
    functions: tuple[Function, ...] = ()
    tables: dict[str, object] = field(default_factory=dict)
    facts: dict[str, object] = field(default_factory=dict)
    sizes: dict[str, Any] = field(default_factory=dict)


def looped_stages(low: Lowering, known: Mapping[str, object]) -> Stages:
    """Return the kernels of a large system with a constant M.

    Newton's method takes ten to fifty times as long for 60 coordinates that all interact. It is
    faster if its matrix is a band. It is also faster if M must be factorised at each node, as for
    30 coupled pendulums.
    """
    return _complete_stages(low, range(low.n), {**known, "TURNED": False})


def _complete_stages(
    low: Lowering,
    forced: Sequence[int],
    facts: dict[str, object],
    functions: tuple[Function, ...] = (),
    **sizes: Any,
) -> Stages:
    """Return the kernels of a system in which forces act on the ``forced`` coordinates."""
    timed, stride = not low.equations.plain.autonomous, node_stride(low.equations)
    unforced = tuple(a for a in range(low.n) if a not in forced)
    facts |= {"UNFORCED": bool(unforced)}
    return Stages(
        tuple(kernel_from_text(name, facts) for name in KERNELS),
        functions,
        {"STRIDE": stride, "FORCED": tuple(forced), "UNFORCED": unforced},
        facts,
        {"staged": stride, "staged_times": timed, **sizes},
    )


def _node_function(name: str, doc: str, body: Sequence[Statement], *given: str) -> Function:
    """Return a function with a loop over all nodes; common loads come before the loop."""
    first, *rest = body
    outside, inside = split_loads(first)
    loop = Loop("node", "range(STRIDE if LANES == 1 else NODES)", (*inside, *rest))
    return Function(name, doc, (*outside, loop), ("W", *(given or ("h", "t")), "lane"))


class TracedStages:
    """Traces the functions of a node for small systems."""

    def __init__(self, low: Lowering, known: Mapping[str, object]) -> None:
        self._low, self._known, self._scales = low, {**known}, len(low.scales)
        self._stride = node_stride(low.equations)
        self._forced = low.template.forced_coordinates
        if not low.equations.plain.quadratic:
            self._forced = tuple(range(low.n))
        self._node = _Node(low.equations.scheme.stages)
        self._order = [a for part in low.equations.parts for a in part.mass_order]
        facts = {"TRACED": True, "CONSTANT_MASS": False, "GYROSCOPIC": False, "PIVOTS": False}
        self._canonical = low.equations.plain.hamiltonian is not None
        stride = self._node + 1
        tables = {"STRIDE": stride, "INPUT_STRIDE": stride}
        blocks = {"staged": stride, "stride": stride, "staged_times": True}
        names = PHASE_TRACED if self._canonical else TRACED
        self._part = TracedPart(low, self._order, names, {**known, **facts}, tables, blocks)
        self._rows = self._symbols()

    def stages(self) -> Stages | None:
        """Return the kernels of a small system; None if a node has too many operations."""
        low, h, t = self._low, self._low.h, self._low.t
        if self._canonical:
            return self._phase_stages()
        start, end = self._velocity("start_velocity", t), self._velocity("end_velocity", h, t)
        self._run("stage_force", h, t, self._node)
        forces = self._stores("STAGE_F", "dp_{}_j", self._forced, "forces")
        self._trace("stage_velocity", h, t, self._node)
        moves = self._stores("STAGE_V", "dq_{}_new", range(low.n), "velocities")
        for block, name in (("STAGE_CORRECTION", "correction"), ("STAGE_SIZE", "size")):
            value = low.graph.define(name, self._part.row(block, self._node), "velocities")
            moves.append(Store(self._row(block), value))
        pivot = self._row("STAGE_PIVOT")
        forces += store_least_pivot(low, self._pivots(), pivot, "velocities", self._scales)
        needed = low.find_needed([*forces, *moves], tuple(Level))
        reached = [d for s, d in low.graph.definitions.items() if s in needed]
        if sum(definition.operations for definition in reached) > MOST_OPERATIONS:
            return None
        row = partial(self._row, "STAGE_HELD")
        opening, closing, between = low.split_statements(forces, moves, row)
        kept, turned, angles = self._turn_angles(opening)
        functions = [
            Function("start_velocity", "Find the velocity at (q, p).", start, ("W", "t", "lane")),
            _node_function("stage_forces", "Find forces at all nodes.", kept),
            _node_function("stage_velocities", "Find velocities at all nodes.", closing),
            self._extrapolate(),
        ]
        if angles:
            doc = "Find forces, with sines and cosines turned by what angles change."
            functions.append(_node_function("turned_forces", doc, turned))
        if len(self._forced) < low.n:
            doc = "Find the velocity at q1 of coordinates without a force."
            functions.append(Function("end_velocity", doc, end, ("W", "h", "t", "lane")))
        facts = {"PIVOTS": len(low.scales) > self._scales, "TURNED": angles > 0}
        sizes = {"staged_values": between, "angles": angles}
        known = {**self._known, **facts}
        return _complete_stages(low, self._forced, known, tuple(functions), **sizes)

    def _phase_stages(self) -> Stages | None:
        """Return the kernels of a Hamiltonian: forces, then momenta and velocities."""
        low, h, t = self._low, self._low.h, self._low.t
        self._run("stage_force", h, t, self._node)
        forces = self._stores("STAGE_F", "dp_{}_j", range(low.n), "forces")
        self._trace("stage_rate", h, t, self._node)
        moves = self._stores("STAGE_V", "dq_{}_new", range(low.n), "velocities")
        moves += self._stores("STAGE_KICK", "kick_{}_new", range(low.n), "velocities")
        for block, name in (("STAGE_CORRECTION", "correction"), ("STAGE_SIZE", "size")):
            value = low.graph.define(name, self._part.row(block, self._node), "velocities")
            moves.append(Store(self._row(block), value))
        needed = low.find_needed([*forces, *moves], tuple(Level))
        reached = [d for s, d in low.graph.definitions.items() if s in needed]
        if sum(definition.operations for definition in reached) > MOST_OPERATIONS:
            return None
        row = partial(self._row, "STAGE_HELD")
        opening, closing, between = low.split_statements(forces, moves, row)
        functions = (
            _node_function("stage_forces", "Find forces at all nodes.", opening),
            _node_function("stage_velocities", "Find velocities at all nodes.", closing),
        )
        known = {**self._known, "TURNED": False}
        every = range(low.n)
        return _complete_stages(low, every, known, functions, staged_values=between)

    def _velocity(self, function: str, *times: Expression) -> tuple[Statement, ...]:
        """Find the velocity at the start of a run, or at q1 for cyclic coordinates."""
        low, at_start = self._low, function == "start_velocity"
        self._run(function, *times)
        stores = [
            Store(Row(block, a), self._part.row(block, s))
            for s, a in enumerate(self._order)
            for block in ("VELOCITY", "MASS_DIAGONAL")
            if at_start or a not in self._forced
        ]
        if at_start:
            definite = low.equations.plain.definite
            deficit = None if definite else self._part.row("MASS_PIVOT")
            stores += store_first_pivots(low, self._pivots(), "velocity", self._scales, deficit)
        return (*(seek_velocity(low) if at_start else ()), *low.statements(stores, STATE))

    def _extrapolate(self) -> Function:
        """Trace the extrapolation of velocities to the nodes of the next step."""
        self._run("stage_ahead", 0, self._node)
        moves = self._stores("STAGE_Q", "dq_{}_ahead", range(self._low.n), "extrapolation")
        moves = [Store(Row("STAGE_V", store.row.index), store.value) for store in moves]
        lines = self._low.statements(moves, FIRST)
        return _node_function("extrapolate_stages", "Begin the next step.", lines, "smooth")

    def _run(self, function: str, *arguments: Any) -> None:
        """Trace a function, at nodes whose rows hold symbols."""
        self._part.begin()
        for block, values in self._rows.items():
            self._part.set_rows(block, values)
        self._trace(function, *arguments)

    def _trace(self, function: str, *arguments: Any) -> None:
        """Trace a function; its sums keep names, so that they can run in parallel."""
        before = set(self._low.graph.removable)
        self._part.trace.run(function, *arguments, 0)
        self._low.graph.removable &= before

    def _symbols(self) -> dict[str, list[Any]]:
        """Return the symbols of the rows of nodes by block; the current node is the last."""
        names, others = self._low.names, [0] * self._node
        every, order = (*range(self._node), self._node), self._order

        def at_hand(block: str, hints: Iterable[str]) -> list[Any]:
            values = [self._symbol(block, k, hint, self._node) for k, hint in enumerate(hints)]
            return [x for value in values for x in (*others, value)]

        def of_all(block: str, hint: str) -> list[Any]:
            hints = [hint.format(q) for q in names.coordinates]
            return [self._symbol(block, a, f"{hints[a]}_{j!s}", j) for a in order for j in every]

        rows = {block: at_hand(block, [hint]) for block, hint in READ.items()}
        for block, hint in TABLES.items():
            rows[block] = at_hand(block, [hint.format(j) for j in range(self._node)])
        rows["INPUT"] = at_hand("INPUT", [f"{u}_j" for u in names.inputs])
        if self._canonical:
            hints = [f"kick_{names.coordinates[a]}" for a in order]
            values = [
                self._symbol("STAGE_KICK", a, hint, self._node)
                for a, hint in zip(order, hints, strict=True)
            ]
            rows["STAGE_KICK"] = [x for value in values for x in (*others, value)]
            rows["MOMENTUM_WEIGHT"] = [self._weight(a) for a in order]
        return {
            **rows,
            "STAGE_V": of_all("STAGE_V", "dq_{}"),
            "STAGE_F": of_all("STAGE_F", "dp_{}"),
        }

    def _weight(self, a: int) -> Any:
        """Return the symbol of the weight of a momentum."""
        symbol = self._low.graph.fresh(f"mass_p_{self._low.names.coordinates[a]}", Level.STEP)
        self._low.rows[symbol] = Row("MOMENTUM_WEIGHT", a)
        return symbol

    def _symbol(self, block: str, k: int, hint: str, node: int) -> Any:
        """Return a new symbol for the kth value of a node in a block; 0 where there is no force."""
        if block == "STAGE_F" and (node == self._node or k not in self._forced):
            return 0
        level = Level.LATE if block in LATE else Level.ITERATION
        symbol = self._low.graph.fresh(hint, level)
        self._low.rows[symbol] = self._row(block, k, node)
        return symbol

    def _row(self, block: str, k: int = 0, node: int | None = None) -> Row:
        """Return the row of the kth value of a node in a block; default is the current node."""
        if node is not None and node < self._node:
            return Row(block, k * self._stride + node)
        table = ["smooth"] if block == "STAGE_AHEAD" else []
        return Row(block, " + ".join([*table, *([str(k * self._stride)] if k else []), "node"]))

    def _stores(
        self, block: str, hint: str, coordinates: Iterable[int], section: str
    ) -> list[Store]:
        """Store the values of the node, one for each of these coordinates."""
        stores = []
        for a in coordinates:
            first = self._order.index(a) * (self._node + 1)
            name = hint.format(self._low.names.coordinates[a])
            value = self._part.row(block, first + self._node)
            stores.append(Store(self._row(block, a), self._low.graph.define(name, value, section)))
        return stores

    def _pivots(self) -> list[Expression]:
        """Return the pivots of M at the current point."""
        return self._part.mass_pivots()

    def _turn_angles(
        self, body: Iterable[Statement]
    ) -> tuple[list[Statement], list[Statement], int]:
        """Return statements that store sines and cosines, others that turn them, and their number.

        The second statements turn sines and cosines by the change of the angles. They also store
        the squared change.
        """
        fresh = self._low.graph.fresh
        numbers, changes = count(), list[Expression]()

        def keep(call: Call) -> list[Statement]:
            number, (angle,) = next(numbers), call.values
            rows = (self._row(block, number) for block in TURNED)
            return [call, *map(Store, rows, (angle, *call.results))]

        def turn(call: Call) -> list[Statement]:
            (angle,) = call.values
            hints = ("angle_before", "sine_before", "cosine_before", "turn")
            *before, change = (fresh(hint, Level.ITERATION) for hint in hints)
            rows = (self._row(block, len(changes)) for block in TURNED)
            loads = [*map(Load, before, rows)]
            changes.append(change)
            turned = Call("turned", (*before[1:], change), call.results)
            return [*loads, Assign(change, angle - before[0]), turned]

        kept, turned = _rewrite_angles(body, keep), _rewrite_angles(body, turn)
        if changes:
            squares = self._low.graph.total(change**2 for change in changes)
            turned.append(Store(Row("STAGE_TURN", "node"), squares))
        return kept, turned, len(changes)


def _rewrite_angles(
    body: Iterable[Statement], rewrite: Callable[[Call], list[Statement]]
) -> list[Statement]:
    """Return statements in which the calls of sincos are rewritten."""
    statements: list[Statement] = []
    for statement in body:
        match statement:
            case Section():
                inner = tuple(_rewrite_angles(statement.body, rewrite))
                statements.append(replace(statement, body=inner))
            case Call("sincos"):
                statements += rewrite(statement)
            case _:
                statements.append(statement)
    return statements
