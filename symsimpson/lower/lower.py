"""Lowering of discrete equations: what a kernel computes, what it loads from rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import sympy as sp

from symsimpson.declare.constraints import regular_mass
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.jet import (
    Jet,
    derive_constraints,
    derive_cost,
    derive_curvatures,
    derive_slopes,
    watched,
)
from symsimpson.discrete.reductions import Coupled, Routh
from symsimpson.graph.nodes import Value
from symsimpson.lower.emitted_names import NameTable
from symsimpson.lower.expression import Expression, Number
from symsimpson.lower.ir import IfActive, Load, Row, Section, Statement, Store, sections
from symsimpson.lower.levels import Definition, Definitions, Level
from symsimpson.lower.storage import node_stride
from symsimpson.lower.template import JetTemplate, Point

#: A line has about so many symbols if others are put in their place.
MOST_SYMBOLS = 9


class Lowering:
    """Shares names, definitions and rows among the kernels of one module.

    Base symbols stand for rows of the workspace. A definition that a kernel needs but does not
    compute itself, because it was known before, gets a row among the hoisted values.
    """

    def __init__(self, equations: DiscreteEquations) -> None:
        self.equations = equations
        self.names = NameTable(equations.system)
        self.graph = Definitions(self.names)
        self.rows: dict[Expression, Row] = {}
        self.hoisted: dict[Expression, Row] = {}
        coordinates = self.names.coordinates
        self.h = self.graph.declare("h", Level.RUN)
        self.graph.know(equations.h, self.h)
        # nothing that depends on t is kept from step to step: rounded, t + h is not the next t
        #: Stands where a point must not be asked for a coordinate of another part.
        self.nothing = self.graph.named("nothing")
        self.t = self.graph.declare("t", Level.ITERATION)
        self.q = self._base(coordinates, "POSITION", Level.STEP)
        self.q_low = self._base([f"{q}_low" for q in coordinates], "POSITION_LOW", Level.ITERATION)
        self.p = self._base([f"p_{q}" for q in coordinates], "MOMENTUM", Level.STEP)
        self.p_low = self._base(
            [f"p_{q}_low" for q in coordinates], "MOMENTUM_LOW", Level.ITERATION
        )
        self._base([f"mass_{q}" for q in coordinates], "MASS_DIAGONAL", Level.STEP)
        self.v = self._base([f"v_{q}" for q in coordinates], "VELOCITY", Level.STEP)
        for block, suffix in (("INCREMENT", ""), ("PREDICTED", "_predicted")):
            for k in range(1, equations.scheme.degree + 1):
                hints = [f"{q}_X{k}{suffix}" for q in coordinates]
                self._base(hints, block, Level.ITERATION, equations.unknowns.place(k, 0))
        self.node_q = self._base([f"{q}_i" for q in coordinates], "NODE_POSITION", Level.ITERATION)
        self.node_v = self._base(
            [f"v_{q}_i" for q in coordinates], "NODE_VELOCITY", Level.ITERATION
        )
        self.node_t = self._base(["t_i"], "NODE_TIME", Level.ITERATION)[0]
        self.node_u = self._base(
            [f"{u}_i" for u in self.names.inputs], "NODE_INPUT", Level.ITERATION
        )
        held, degree = len(equations.plain.held), equations.scheme.degree
        for k in range(degree if held else 0):  # h mu at the control points 0..d-1, unknowns, too
            place = equations.unknowns.place(degree + 1 + k, 0)
            hints = [f"mu_{k}_{c}" for c in range(held)]
            self._base(hints, "INCREMENT", Level.ITERATION, place)
        self.multipliers = self._base(
            [f"lambda_{c}" for c in range(held)], "MULTIPLIER", Level.ITERATION
        )
        self.weights = self._base(
            [f"w_{k}" for k in range(2 * self.n + 1)] if equations.second else [],
            "NODE_WEIGHT",
            Level.ITERATION,
        )
        #: h, the place of the node at hand in the step, and whether v there goes with 1/h.
        self.step = self._base(["h_i", "c_i", "moving"], "NODE_STEP", Level.ITERATION)
        self._inputs: dict[int, tuple[Expression, ...]] = {}
        symbols = [self.graph.declare(name, Level.RUN) for name in self.names.parameters]
        #: By the names of plain symbols.
        self.parameters = {
            a.name: x for a, x in zip(equations.plain.parameters, symbols, strict=True)
        }
        self.rows |= {symbol: Row("PARAMETER", i) for i, symbol in enumerate(symbols)}
        self.coefficients: tuple[Expression, ...] = ()
        #: 1 over those pivots of M at the start of a run that change along a motion.
        self.scales: list[Expression] = []

    @cached_property
    def template(self) -> JetTemplate:
        """The jet of L and what is evaluated beside it."""
        return self._template(self.equations.jet)

    @cached_property
    def held(self) -> JetTemplate:
        """Constraints, and what of L tells their multipliers."""
        return self._template(derive_constraints(self.equations.plain))

    def cyclic(self, part: Routh) -> JetTemplate:
        """Factors of M of cyclic coordinates, and what else their momenta depend on."""
        return self._template(self.equations.cyclic_jet(part))

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters and inputs that derivatives of a step are taken by."""
        return self.names.of(self.equations.plain, self.equations.varied or ())

    @cached_property
    def slopes(self) -> JetTemplate:
        """Derivatives of F and P by these."""
        return self._template(derive_slopes(self.equations.plain, self._by_name))

    @cached_property
    def cost(self) -> JetTemplate:
        """A running cost and its derivatives."""
        assert self.equations.cost is not None
        return self._template(derive_cost(self.equations.plain, self._by_name, self.equations.cost))

    @cached_property
    def curvatures(self) -> JetTemplate:
        """Second derivatives of these, and of constraints, with weights."""
        eqs = self.equations
        return self._template(derive_curvatures(eqs.plain, eqs.varied or (), eqs.cost))

    @property
    def sized(self) -> bool:
        """Whether a step is differentiated by its size."""
        return self.equations.plain.step[0] in (self.equations.varied or ())

    @property
    def _by_name(self) -> dict[str, Any]:
        return dict(zip(self.varied, self.equations.varied or (), strict=True))

    @cached_property
    def stiffened(self) -> bool:
        """Whether constraints help out an M that is singular without."""
        values = self.equations.system.parameters.values()
        return not regular_mass(self.equations.plain, values)

    @cached_property
    def node(self) -> Point:
        """The node at hand, as loops have it."""
        return Point("i", self.node_q, self.node_v, self.node_t, self.node_u, step=self.step)

    def of_all(self, jet: Jet) -> Self:
        """Return the same with another jet, and all coordinates solved for together."""
        lowering, every = copy(self), Coupled(tuple(range(self.n)), (), ())
        lowering.equations = replace(self.equations, parts=(every,))
        lowering.__dict__["template"] = self._template(jet)
        return lowering

    @cached_property
    def watched(self) -> JetTemplate:
        """The invariants and the powers of forces alone, without the jet of L."""
        return self._template(watched(self.equations.plain))

    def _template(self, jet: Jet) -> JetTemplate:
        return JetTemplate(jet, self.graph, self.names.coordinates, self.parameters, momenta=self.p)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.names.coordinates)

    def _base(
        self, hints: Sequence[str], block: str, level: Level, first: int = 0
    ) -> tuple[Expression, ...]:
        symbols = []
        for i, hint in enumerate(hints):
            known = block == "POSITION"  # these names are already given out
            symbol = self.graph.declare(hint if known else self.names.fresh(hint), level)
            self.rows[symbol] = Row(block, first + i)
            symbols.append(symbol)
        return tuple(symbols)

    def stand(self, places: Sequence[int]) -> None:
        """Let nodes have each coordinate at its place, as bands and loops over them do."""
        for rows, block in ((self.node_q, "NODE_POSITION"), (self.node_v, "NODE_VELOCITY")):
            for symbol, place in zip(rows, places, strict=True):
                self.rows[symbol] = Row(block, place)

    def pivot_scale(self, i: int) -> Expression:
        """Return 1 over a pivot of M at the start of a run."""
        for k in range(len(self.scales), i + 1):
            hint = [f"pivot_scale_{k}"]
            self.scales += self._base(hint, "PIVOT_SCALE", Level.ITERATION, k)
        return self.scales[i]

    def known(self, value: Value) -> Expression:
        """Return a value that is made of parameters."""
        return self.graph.taken(self.equations.plain.graph, value, self._by_node)

    @cached_property
    def _by_node(self) -> dict[int, Expression]:
        """Parameters by their nodes in the graph of the system."""
        graph = self.equations.plain.graph
        return {graph.symbol(name)[1]: parameter for name, parameter in self.parameters.items()}

    def start_point(self) -> Point:
        """Return the point q0; its suffix is that of a node standing there."""
        scheme = self.equations.scheme
        at_start = [i for i in range(scheme.stages) if self.equations.at_start(i)]
        suffix = str(at_start[0]) if at_start else "start"
        return Point(suffix, self.q, t=self.time(0, suffix), u=self.inputs(0))

    def time(self, part: Number, suffix: str) -> Expression | None:
        """Return the time after a part of the step; None if nothing depends on it."""
        if self.equations.plain.autonomous:
            return None
        return self.graph.define(f"t_{suffix}", self.t + part * self.h, "times")

    def inputs(self, node: int) -> tuple[Expression, ...]:
        """Return the inputs at a node; the first of them stands for the start of the step, too."""
        if node not in self._inputs:
            stride, names = node_stride(self.equations.scheme), self.names.inputs
            self._inputs[node] = tuple(
                self._base([f"{u}_{node}"], "INPUT", Level.ITERATION, k * stride + node)[0]
                for k, u in enumerate(names)
            )
        return self._inputs[node]

    def growths(self) -> list[Expression]:
        """Return by how much what is weighted has grown at the nodes, and at the end of a step."""
        places = (*self.equations.scheme.quadrature.nodes, sp.S.One)
        return [self.growth(c) for c in places]

    def growth(self, part: Number) -> Expression:
        """Return by how much what is weighted has grown after a part of the step."""
        grown = self.graph.applied("exp", 2 * self._rate * part * self.h)
        return self.graph.define("growth", grown, "constants")

    def decayed(self, momentum: Expression, impulse: Expression) -> Expression:
        """Return p1 - p0 from p0 and the weighted impulse of the step, without cancellation.

        p1 = exp(-2 gamma h) (p0 + impulse), and exp(-2 x) - 1 = -2 exp(-x) sinh(x).
        """
        x, define = self._rate * self.h, self.graph.define
        half = define("half", self.graph.applied("exp", -x), "constants")
        lost = define("lost", -2 * half * self.graph.applied("sinh", x), "constants")
        return lost * momentum + self.growth(-1) * impulse

    @property
    def _rate(self) -> Expression:
        """The rate gamma at which all momenta decay."""
        assert self.equations.plain.rate is not None
        return self.known(self.equations.plain.rate)

    def statements(
        self, stores: Iterable[Store], computed: Iterable[Level], title: str | None = None
    ) -> tuple[Statement, ...]:
        """Write the statements that a set of stores needs.

        Definitions of the levels in ``computed`` are computed here, in their sections or under
        one ``title``; all else that is needed is loaded from its row.
        """
        stores = tuple(stores)
        levels = set(computed)
        needed = self._needed(stores, levels)
        inputs = [*(s for s in self.rows if s in needed), *self.keep(stores, levels)]
        defined = [
            d for s, d in self.graph.definitions.items() if s in needed and d.level in levels
        ]
        if levels == set(Level):  # a text of its own, in whose sections others have no part
            definitions, asked = self.graph.definitions, self.graph.asked.items()
            defined = [replace(definitions[s], section=x) for s, x in asked if s in needed]
        defined = self._joined([*dict.fromkeys(defined)], stores)
        reads = tuple(Load(s, self.rows.get(s) or self.hoisted[s]) for s in inputs)
        return (
            *((Section("known before", reads),) if reads else ()),
            *sections(defined, title),
            *((Section("results", _results(stores)),) if stores else ()),
        )

    def _joined(
        self, definitions: Sequence[Definition], stores: Iterable[Store]
    ) -> list[Definition]:
        """Let definitions that a text uses once stand in place of their names.

        A product stays by itself in another product: each of them is rounded.
        """
        users: dict[Expression, list[Definition | None]] = {}
        for definition in definitions:
            for symbol in definition.symbols:
                users.setdefault(symbol, []).append(definition)
        for store in stores:
            for symbol in store.value.symbols:
                users.setdefault(symbol, []).append(None)
        graph, joined = self.graph, []
        place: dict[Expression, Expression] = {}
        for definition in definitions:
            here = {s: place[s] for s in definition.symbols if s in place}
            if here:
                values = tuple(graph.replaced(value, here) for value in definition.values)
                definition = replace(definition, values=values)
            symbol, value = definition.targets[0], definition.values[0]
            user, *others = users.get(symbol, [None])
            plain = user is not None and not user.function and not definition.function
            if symbol in graph.passing and plain and not others and user is not None:
                (whole,) = user.values
                terms = [term.node for term in whole.terms] if len(whole.terms) > 1 else []
                short = len(value.symbols) + len(whole.symbols) <= MOST_SYMBOLS
                if short and (value.kind != "product" or symbol.node in terms):
                    place[symbol] = value
                    continue
            joined.append(definition)
        return joined

    def keep(self, stores: Iterable[Store], computed: Iterable[Level]) -> list[Expression]:
        """Give rows to the values that stores need and that are known before these levels."""
        levels, level = set(computed), self.graph.level
        needed = self.needed(stores, levels)
        kept = [s for s in needed if level(s) not in levels and s not in self.rows]
        for symbol in kept:
            assert self.graph.level(symbol) in (Level.RUN, Level.STEP)
            self.hoisted.setdefault(symbol, Row("HOISTED", len(self.hoisted)))
        return kept

    def _needed(self, stores: Iterable[Store], levels: set[Level]) -> set[Expression]:
        """Collect what stores need, through definitions of these levels."""
        needed: set[Expression] = set()
        work = [s for store in stores for s in store.value.symbols]
        while work:
            symbol = work.pop()
            if symbol in needed:
                continue
            needed.add(symbol)
            definition = self.graph.definitions.get(symbol)
            if definition is not None and definition.level in levels:
                work.extend(definition.symbols)
        return needed

    def needed(self, stores: Iterable[Store], levels: Iterable[Level]) -> list[Expression]:
        """List what stores need of all that is defined, through definitions of these levels."""
        needed = self._needed(stores, set(levels))
        return [symbol for symbol in self.graph.definitions if symbol in needed]

    def halves(
        self, first: Iterable[Store], last: Sequence[Store], row: Callable[[int], Row]
    ) -> tuple[tuple[Statement, ...], tuple[Statement, ...], int]:
        """Write two sets of stores as two texts, and count the values between them.

        The second text computes what is known last; ``row`` gives the row of the kth value that it
        reads of the first.
        """
        needed = [s for s in self.needed(last, (Level.LATE,)) if s not in self.rows]
        between = [s for s in needed if Level.RUN < self.graph.level(s) < Level.LATE]
        rows = {s: row(k) for k, s in enumerate(between)}
        stores = [*first, *(Store(rows[s], s) for s in between)]
        opening = self.statements(stores, (Level.STEP, Level.ITERATION))
        self.rows |= rows
        closing = self.statements(last, (Level.LATE,))
        for symbol in between:
            del self.rows[symbol]
        return opening, closing, len(between)

    def hoisted_at(self, level: Level) -> list[tuple[Expression, Row]]:
        """List the hoisted values of a level with their rows."""
        return [
            (symbol, row)
            for symbol, row in self.hoisted.items()
            if self.graph.level(symbol) == level
        ]

    def moved(self, symbol: Expression, to: dict[Expression, Expression]) -> Expression:
        """Return the value that a step-level symbol takes when q and p move on as in ``to``.

        What it is made of is added to ``to``, so that shared definitions are followed once.
        """
        level, section, work = self.graph.level, "the next left node", [symbol]
        while work:
            last = work[-1]
            if last in to or level(last) != Level.STEP:
                work.pop()
                continue
            definition = self.graph.definitions[last]
            before = definition.symbols
            if later := [s for s in before if s not in to and level(s) == Level.STEP]:
                work += reversed(later)
                continue
            (old,) = definition.values
            value = self.graph.replaced(old, {s: to[s] for s in before if s in to})
            if definition.function:
                hint = value.name if value.is_symbol else f"angle_{last.name}_next"
                pair = self.graph.define_sincos(hint, value, section)
                to[last] = pair[definition.targets.index(last)]
            else:
                to[last] = self.graph.define(f"{last.name}_next", value, section)
        return to.get(symbol, symbol)


def _results(stores: Sequence[Store]) -> tuple[Statement, ...]:
    """Put stores in active lanes behind those in all of them."""
    moving = tuple(replace(store, moving=False) for store in stores if store.moving)
    others = tuple(store for store in stores if not store.moving)
    return (*others, *((IfActive(moving),) if moving else ()))
