"""Lowering of discrete equations to definitions, loads and stores of kernels."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
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
    derive_invariants,
    derive_slopes,
)
from symsimpson.discrete.reductions import Coupled, Routh
from symsimpson.graph.nodes import Value
from symsimpson.lower.emitted_names import NameTable
from symsimpson.lower.expression import Expression, Number
from symsimpson.lower.ir import IfActive, Load, Row, Section, Statement, Store, sections
from symsimpson.lower.levels import Definition, Definitions, Level
from symsimpson.lower.storage import node_stride
from symsimpson.lower.template import JetTemplate, Point

#: The most symbols of a line after substitution.
MOST_SYMBOLS = 9


class Lowering:
    """Shares names, definitions and rows among the kernels of one module.

    Base symbols are the values of rows of the workspace. A kernel may need a definition that
    another kernel computes. That definition gets a row among the hoisted values.
    """

    def __init__(self, equations: DiscreteEquations) -> None:
        self.equations = equations
        self.names = NameTable(equations.system)
        self.graph = Definitions(self.names)
        self.rows: dict[Expression, Row] = {}
        self.hoisted: dict[Expression, Row] = {}
        coordinates, base = self.names.coordinates, self._base
        self.h = self.graph.declare("h", Level.RUN)
        self.graph.bind(equations.h, self.h)
        # steps reuse no value that depends on t: rounded, t + h is not the next t
        #: Marks the coordinates of other parts at a point of a part.
        self.nothing = self.graph.make_symbol("nothing")
        self.t = self.graph.declare("t", Level.ITERATION)
        self.q = base(coordinates, "POSITION", Level.STEP)
        self.q_low = base([f"{q}_low" for q in coordinates], "POSITION_LOW")
        self.p = base([f"p_{q}" for q in coordinates], "MOMENTUM", Level.STEP)
        self.p_low = base([f"p_{q}_low" for q in coordinates], "MOMENTUM_LOW")
        base([f"mass_{q}" for q in coordinates], "MASS_DIAGONAL", Level.STEP)
        self.v = base([f"v_{q}" for q in coordinates], "VELOCITY", Level.STEP)
        for block, suffix in (("INCREMENT", ""), ("PREDICTED", "_predicted")):
            for k in range(1, equations.scheme.degree + 1):
                hints = [f"{q}_X{k}{suffix}" for q in coordinates]
                base(hints, block, first=equations.unknowns.place(k, 0))
        self.node_q = base([f"{q}_i" for q in coordinates], "NODE_POSITION")
        self.node_v = base([f"v_{q}_i" for q in coordinates], "NODE_VELOCITY")
        (self.node_t,) = base(["t_i"], "NODE_TIME")
        self.node_u = base([f"{u}_i" for u in self.names.inputs], "NODE_INPUT")
        held, degree = len(equations.plain.constraint_names), equations.scheme.degree
        for k in range(degree if held else 0):  # h mu at the control points 0..d-1, unknowns, too
            place = equations.unknowns.place(degree + 1 + k, 0)
            base([f"mu_{k}_{c}" for c in range(held)], "INCREMENT", first=place)
        self.multipliers = base([f"lambda_{c}" for c in range(held)], "MULTIPLIER")
        weights = 2 * self.n + 1 if equations.second else 0
        self.weights = base([f"w_{k}" for k in range(weights)], "NODE_WEIGHT")
        #: h, the place of the node at hand in the step, and whether v there goes with 1/h.
        self.step = base(["h_i", "c_i", "moving"], "NODE_STEP")
        self.grid = base(["on_grid", "t_first", "steps_before"], "TIME_GRID")
        self._inputs: dict[int, tuple[Expression, ...]] = {}
        symbols = [self.graph.declare(name, Level.RUN) for name in self.names.parameters]
        #: By the names of plain symbols.
        names = (a.name for a in equations.plain.parameters)
        self.parameters = dict(zip(names, symbols, strict=True))
        graph = equations.plain.graph
        self._by_node = {graph.symbol(name)[1]: x for name, x in self.parameters.items()}
        self.rows |= {symbol: Row("PARAMETER", i) for i, symbol in enumerate(symbols)}
        self.coefficients: tuple[Expression, ...] = ()
        #: 1 over the pivots of M at the start of a run, for pivots that change along a motion.
        self.scales: list[Expression] = []

    @cached_property
    def template(self) -> JetTemplate:
        """The jet of L, with energies and other outputs."""
        return self._template(self.equations.jet)

    @cached_property
    def constraint_jet(self) -> JetTemplate:
        """The jet of the constraints, with the terms of L that give their multipliers."""
        return self._template(derive_constraints(self.equations.plain))

    def cyclic(self, part: Routh) -> JetTemplate:
        """The jet of cyclic coordinates: the factors of their M, and their momenta."""
        return self._template(self.equations.cyclic_jet(part))

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the varied parameters and inputs."""
        return self.names.of(self.equations.plain, self.equations.varied or ())

    @cached_property
    def slopes(self) -> JetTemplate:
        """Derivatives of F and P by the varied parameters."""
        return self._template(derive_slopes(self.equations.plain, self._by_name))

    @cached_property
    def cost(self) -> JetTemplate:
        """A running cost and its derivatives."""
        assert self.equations.cost is not None
        return self._template(derive_cost(self.equations.plain, self._by_name, self.equations.cost))

    @cached_property
    def curvatures(self) -> JetTemplate:
        """Second derivatives of F, P, the running cost and constraints, with weights."""
        eqs = self.equations
        return self._template(derive_curvatures(eqs.plain, eqs.varied or (), eqs.cost))

    @property
    def varies_h(self) -> bool:
        """True if a step is differentiated by its size h."""
        return self.equations.plain.step[0] in (self.equations.varied or ())

    @property
    def _by_name(self) -> dict[str, Any]:
        return dict(zip(self.varied, self.equations.varied or (), strict=True))

    @cached_property
    def singular_mass(self) -> bool:
        """True if M is singular, and regular only together with the constraints."""
        values = self.equations.system.parameters.values()
        return not regular_mass(self.equations.plain, values)

    @cached_property
    def node(self) -> Point:
        """The current node of a loop."""
        return Point("i", self.node_q, self.node_v, self.node_t, self.node_u, step=self.step)

    def with_jet(self, jet: Jet) -> Self:
        """Return a copy with another jet and all coordinates in one coupled part."""
        lowering, every = copy(self), Coupled(tuple(range(self.n)), (), ())
        lowering.equations = replace(self.equations, parts=(every,))
        lowering.__dict__["template"] = self._template(jet)
        return lowering

    @cached_property
    def observed(self) -> JetTemplate:
        """The jet of the invariants and the powers of forces, without L."""
        return self._template(derive_invariants(self.equations.plain))

    def _template(self, jet: Jet) -> JetTemplate:
        return JetTemplate(jet, self.graph, self.names.coordinates, self.parameters, momenta=self.p)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.names.coordinates)

    def _base(
        self, hints: Sequence[str], block: str, level: Level = Level.ITERATION, first: int = 0
    ) -> tuple[Expression, ...]:
        symbols = []
        for i, hint in enumerate(hints):
            known = block == "POSITION"  # these names are already given out
            symbol = self.graph.declare(hint if known else self.names.fresh(hint), level)
            self.rows[symbol] = Row(block, first + i)
            symbols.append(symbol)
        return tuple(symbols)

    def set_places(self, places: Sequence[int]) -> None:
        """Put each coordinate of a node in the row of its place in the storage order."""
        for rows, block in ((self.node_q, "NODE_POSITION"), (self.node_v, "NODE_VELOCITY")):
            for symbol, place in zip(rows, places, strict=True):
                self.rows[symbol] = Row(block, place)

    def pivot_scale(self, i: int) -> Expression:
        """Return 1 over a pivot of M at the start of a run."""
        for k in range(len(self.scales), i + 1):
            self.scales += self._base([f"pivot_scale_{k}"], "PIVOT_SCALE", first=k)
        return self.scales[i]

    def import_value(self, value: Value) -> Expression:
        """Return a value that depends on parameters only."""
        return self.graph.import_value(self.equations.plain.graph, value, self._by_node)

    def start_point(self) -> Point:
        """Return the point q0, with the suffix of the node at the start if there is one."""
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
        """Return the inputs at a node; the first node also serves as the start of the step."""
        if node not in self._inputs:
            stride, names = node_stride(self.equations), self.names.inputs
            self._inputs[node] = tuple(
                self._base([f"{u}_{node}"], "INPUT", first=k * stride + node)[0]
                for k, u in enumerate(names)
            )
        return self._inputs[node]

    def growth_factors(self) -> list[Expression]:
        """Return the growth factors exp(2 gamma c h) at the nodes and at the end of a step."""
        places = (*self.equations.scheme.quadrature.nodes, sp.S.One)
        return [self.growth_factor(c) for c in places]

    def growth_factor(self, part: Number) -> Expression:
        """Return the growth factor exp(2 gamma c h) after a part c of the step."""
        grown = self.graph.apply("exp", 2 * self._rate * part * self.h)
        return self.graph.define("growth", grown, "constants")

    def damp(self, momentum: Expression, impulse: Expression) -> Expression:
        """Return p1 - p0 from p0 and the weighted impulse of the step, without cancellation.

        p1 = exp(-2 gamma h) (p0 + impulse), and exp(-2 x) - 1 = -2 exp(-x) sinh(x).
        """
        x, define = self._rate * self.h, self.graph.define
        half = define("half", self.graph.apply("exp", -x), "constants")
        lost = define("lost", -2 * half * self.graph.apply("sinh", x), "constants")
        return lost * momentum + self.growth_factor(-1) * impulse

    @property
    def _rate(self) -> Expression:
        """The rate gamma at which all momenta decay."""
        assert self.equations.plain.rate is not None
        return self.import_value(self.equations.plain.rate)

    def statements(
        self, stores: Iterable[Store], computed: Iterable[Level], title: str | None = None
    ) -> tuple[Statement, ...]:
        """Write the statements that a set of stores needs.

        The text computes definitions of the levels in ``computed``, in their sections or under one
        ``title``. It loads all other values from their rows.
        """
        stores = tuple(stores)
        levels = set(computed)
        needed = self.find_needed(stores, levels)
        inputs = [*(s for s in self.rows if s in needed), *self.hoist(stores, levels)]
        definitions, asked = self.graph.definitions, self.graph.requests.items()
        defined = [d for s, d in definitions.items() if s in needed and d.level in levels]
        if levels == set(Level):  # a text of its own, in whose sections others have no part
            defined = [replace(definitions[s], section=x) for s, x in asked if s in needed]
        defined = self._substitute_once([*dict.fromkeys(defined)], stores)
        # stores in active lanes follow the stores in all lanes
        everywhere = [store for store in stores if not store.moving]
        moving = tuple(replace(store, moving=False) for store in stores if store.moving)
        active = (IfActive(moving),) if moving else ()
        reads = tuple(Load(s, self.rows.get(s) or self.hoisted[s]) for s in inputs)
        return (
            *((Section("known before", reads),) if reads else ()),
            *sections(defined, title),
            *((Section("results", (*everywhere, *active)),) if stores else ()),
        )

    def _substitute_once(
        self, definitions: Sequence[Definition], stores: Iterable[Store]
    ) -> list[Definition]:
        """Substitute definitions that a text uses once.

        A product within a product keeps its own line, so that it is rounded there.
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
                values = tuple(graph.substitute(value, here) for value in definition.values)
                definition = replace(definition, values=values)
            symbol, value = definition.targets[0], definition.values[0]
            user, *others = users.get(symbol, [None])
            plain = user is not None and not user.function and not definition.function
            if symbol in graph.removable and plain and not others and user is not None:
                (whole,) = user.values
                terms = [term.node for term in whole.terms] if len(whole.terms) > 1 else []
                short = len(value.symbols) + len(whole.symbols) <= MOST_SYMBOLS
                if short and (value.kind != "product" or symbol.node in terms):
                    place[symbol] = value
                    continue
            joined.append(definition)
        return joined

    def hoist(self, stores: Iterable[Store], computed: Iterable[Level]) -> list[Expression]:
        """Give rows to the values that stores need and that other kernels compute."""
        levels, level = set(computed), self.graph.level
        needed = self.find_needed(stores, levels) - self.rows.keys()
        kept = [s for s in self.graph.definitions if s in needed and level(s) not in levels]
        for symbol in kept:
            assert level(symbol) in (Level.RUN, Level.STEP)
            self.hoisted.setdefault(symbol, Row("HOISTED", len(self.hoisted)))
        return kept

    def find_needed(self, stores: Iterable[Store], levels: Collection[Level]) -> set[Expression]:
        """Collect the symbols that stores need, through definitions of these levels."""
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

    def split_statements(
        self, first: Iterable[Store], last: Sequence[Store], row: Callable[[int], Row]
    ) -> tuple[tuple[Statement, ...], tuple[Statement, ...], int]:
        """Write two sets of stores as two texts, and count the values between them.

        The second text computes definitions of the level LATE. ``row`` gives the row of the kth
        value that the first text leaves for the second.
        """
        needed, level = self.find_needed(last, (Level.LATE,)) - self.rows.keys(), self.graph.level
        defined = [s for s in self.graph.definitions if s in needed]
        between = [s for s in defined if Level.RUN < level(s) < Level.LATE]
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
        return [(x, row) for x, row in self.hoisted.items() if self.graph.level(x) == level]

    def advance_symbol(self, symbol: Expression, to: dict[Expression, Expression]) -> Expression:
        """Return the value of a step-level symbol at the next q and p, given in ``to``.

        The operands of the symbol are added to ``to``, so that shared definitions are moved once.
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
            value = self.graph.substitute(old, {s: to[s] for s in before if s in to})
            if definition.function:
                hint = value.name if value.is_symbol else f"angle_{last.name}_next"
                pair = self.graph.define_sincos(hint, value, section)
                to[last] = pair[definition.targets.index(last)]
            else:
                to[last] = self.graph.define(f"{last.name}_next", value, section)
        return to.get(symbol, symbol)
