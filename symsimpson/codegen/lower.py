"""From discrete equations to kernels: what is computed where, and in which rows it is kept."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Self

import sympy as sp

from symsimpson.codegen.ir import Load, Row, Section, Statement, Store
from symsimpson.codegen.levels import Graph, Level
from symsimpson.codegen.names import NameTable
from symsimpson.codegen.sections import sections
from symsimpson.codegen.storage import node_stride
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.discrete.constraints import derive_constraints
from symsimpson.discrete.curvatures import derive_curvatures
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.jet import Jet, watched
from symsimpson.discrete.reductions import Coupled
from symsimpson.discrete.slopes import derive_cost, derive_slopes
from symsimpson.mechanics.constraints import regular_mass

__all__ = ["Lowering"]


class Lowering:
    """Shares names, definitions and rows among the kernels of one module.

    Base symbols stand for rows of the workspace. A definition that a kernel needs but does not
    compute itself, because it was known before, gets a row among the hoisted values.
    """

    def __init__(self, equations: DiscreteEquations) -> None:
        self.equations = equations
        self.names = NameTable(equations.system)
        self.graph = Graph(self.names)
        self.rows: dict[sp.Symbol, Row] = {}
        self.hoisted: dict[sp.Symbol, Row] = {}
        coordinates = self.names.coordinates
        self.h = self.graph.declare(equations.h, Level.RUN)
        # nothing that depends on t is kept from step to step: rounded, t + h is not the next t
        self.t = self.graph.declare(sp.Symbol("t", real=True), Level.ITERATION)
        self.q = self._base(coordinates, "POSITION", Level.STEP)
        self.q_low = self._base([f"{q}_low" for q in coordinates], "POSITION_LOW", Level.ITERATION)
        self.p = self._base([f"p_{q}" for q in coordinates], "MOMENTUM", Level.STEP)
        self.p_low = self._base(
            [f"p_{q}_low" for q in coordinates], "MOMENTUM_LOW", Level.ITERATION
        )
        self.mass_diagonal = self._base(
            [f"mass_{q}" for q in coordinates], "MASS_DIAGONAL", Level.STEP
        )
        self.v = self._base([f"v_{q}" for q in coordinates], "VELOCITY", Level.STEP)
        self.increments = [
            self._base(
                [f"{q}_X{k}" for q in coordinates],
                "INCREMENT",
                Level.ITERATION,
                equations.unknowns.place(k, 0),
            )
            for k in range(1, equations.scheme.degree + 1)
        ]
        self.predicted = [
            self._base(
                [f"{q}_X{k}_predicted" for q in coordinates],
                "PREDICTED",
                Level.ITERATION,
                equations.unknowns.place(k, 0),
            )
            for k in range(1, equations.scheme.degree + 1)
        ]
        self.node_q = self._base([f"{q}_i" for q in coordinates], "NODE_POSITION", Level.ITERATION)
        self.node_v = self._base(
            [f"v_{q}_i" for q in coordinates], "NODE_VELOCITY", Level.ITERATION
        )
        self.node_t = self._base(["t_i"], "NODE_TIME", Level.ITERATION)[0]
        self.node_u = self._base(
            [f"{u}_i" for u in self.names.inputs], "NODE_INPUT", Level.ITERATION
        )
        held, degree = len(equations.plain.constraints), equations.scheme.degree
        #: h mu at the control points 0..d-1, unknowns of a step with constraints.
        self.impulses = [
            self._base(
                [f"mu_{k}_{c}" for c in range(held)],
                "INCREMENT",
                Level.ITERATION,
                equations.unknowns.place(degree + 1 + k, 0),
            )
            for k in range(degree if held else 0)
        ]
        self.multipliers = self._base(
            [f"lambda_{c}" for c in range(len(equations.plain.constraints))],
            "MULTIPLIER",
            Level.ITERATION,
        )
        self.weights = self._base(
            [f"w_{k}" for k in range(2 * self.n + 1)] if equations.second else [],
            "NODE_WEIGHT",
            Level.ITERATION,
        )
        #: h, the place of the node at hand in the step, and whether v there goes with 1/h.
        self.step = self._base(["h_i", "c_i", "moving"], "NODE_STEP", Level.ITERATION)
        self._inputs: dict[int, tuple[sp.Symbol, ...]] = {}
        self.active = self._base(["active"], "ACTIVE", Level.RUN)[0]
        own = [sp.Symbol(name, real=True) for name in self.names.parameters]
        self.parameters = dict(zip(equations.plain.parameters, own, strict=True))
        for i, symbol in enumerate(own):
            self.rows[self.graph.declare(symbol, Level.RUN)] = Row("PARAMETER", i)
        self.coefficients: tuple[sp.Expr, ...] = ()

    @cached_property
    def template(self) -> JetTemplate:
        """The jet of L and what is evaluated beside it."""
        return self._template(self.equations.jet)

    @cached_property
    def held(self) -> JetTemplate:
        """Constraints, and what of L tells their multipliers."""
        return self._template(derive_constraints(self.equations.plain))

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
    def _by_name(self) -> dict[str, sp.Symbol]:
        return dict(zip(self.varied, self.equations.varied or (), strict=True))

    @cached_property
    def stiffened(self) -> bool:
        """Whether constraints help out an M that is singular without."""
        values = self.equations.system.parameters.values()
        return not regular_mass(self.equations.plain, values)

    def of_all(self, jet: Jet) -> Self:
        """Return the same with another jet, and all coordinates solved for together."""
        own, every = copy(self), Coupled(tuple(range(self.n)), (), ())
        own.equations = replace(self.equations, parts=(every,))
        own.__dict__["template"] = self._template(jet)
        return own

    @cached_property
    def watched(self) -> JetTemplate:
        """The invariants alone, without the jet of L."""
        return self._template(watched(self.equations.plain))

    def _template(self, jet: Jet) -> JetTemplate:
        return JetTemplate(jet, self.graph, self.names.coordinates, self.parameters, momenta=self.p)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.names.coordinates)

    def _base(
        self, hints: Sequence[str], block: str, level: Level, first: int = 0
    ) -> tuple[sp.Symbol, ...]:
        symbols = []
        for i, hint in enumerate(hints):
            known = block in ("POSITION", "ACTIVE")  # these names are already given out
            symbol = sp.Symbol(hint, real=True) if known else self.names.fresh(hint)
            self.rows[symbol] = Row(block, first + i)
            symbols.append(self.graph.declare(symbol, level))
        return tuple(symbols)

    def start_point(self) -> Point:
        """Return the point q0; its suffix is that of a node standing there."""
        scheme = self.equations.scheme
        at_start = [i for i in range(scheme.stages) if self.equations.at_start(i)]
        suffix = str(at_start[0]) if at_start else "start"
        return Point(suffix, self.q, t=self.time(sp.S.Zero, suffix), u=self.inputs(0))

    def time(self, part: sp.Expr, suffix: str) -> sp.Expr | None:
        """Return the time after a part of the step; None if nothing depends on it."""
        if self.equations.plain.autonomous:
            return None
        return self.graph.define(f"t_{suffix}", self.t + part * self.h, "times")

    def inputs(self, node: int) -> tuple[sp.Symbol, ...]:
        """Return the inputs at a node; the first of them stands for the start of the step, too."""
        if node not in self._inputs:
            stride, names = node_stride(self.equations.scheme), self.names.inputs
            self._inputs[node] = tuple(
                self._base([f"{u}_{node}"], "INPUT", Level.ITERATION, k * stride + node)[0]
                for k, u in enumerate(names)
            )
        return self._inputs[node]

    def growth(self, part: sp.Expr) -> sp.Expr:
        """Return by how much what is weighted has grown after a part of the step; 1 for most."""
        rate = self.equations.plain.rate
        if rate is None:
            return sp.S.One
        gamma = self.equations.plain.written(rate).xreplace(self.parameters)
        return self.graph.define("growth", sp.exp(2 * gamma * part * self.h), "constants")

    def decayed(self, momentum: sp.Expr, impulse: sp.Expr) -> sp.Expr:
        """Return p1 - p0 from what p0 is at the start and the weighted impulse of the step.

        p1 = exp(-2 gamma h) (p0 + impulse); the difference from p0 is taken without cancellation.
        """
        rate = self.equations.plain.rate
        if rate is None:
            return impulse
        gamma = self.equations.plain.written(rate).xreplace(self.parameters)
        return self.lost(2 * gamma * self.h) * momentum + self.growth(sp.S.NegativeOne) * impulse

    def lost(self, exponent: sp.Expr) -> sp.Expr:
        """Return exp(-x) - 1, to the last digit for small x too."""
        half = self.graph.define("half", sp.exp(-exponent / 2), "constants")
        return self.graph.define("lost", -2 * half * sp.sinh(exponent / 2), "constants")

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
        reads = tuple(Load(s, self.rows.get(s) or self.hoisted[s]) for s in inputs)
        return (
            *((Section("known before", reads),) if reads else ()),
            *sections(list(dict.fromkeys(defined)), title),
            *((Section("results", stores),) if stores else ()),
        )

    def keep(self, stores: Iterable[Store], computed: Iterable[Level]) -> list[sp.Symbol]:
        """Give rows to the values that stores need and that are known before these levels."""
        levels = set(computed)
        needed = self._needed(stores, levels)
        kept = [
            s
            for s, definition in self.graph.definitions.items()
            if s in needed and definition.level not in levels and s not in self.rows
        ]
        for symbol in kept:
            assert self.graph.levels[symbol] in (Level.RUN, Level.STEP)
            self.hoisted.setdefault(symbol, Row("HOISTED", len(self.hoisted)))
        return kept

    def _needed(self, stores: Iterable[Store], levels: set[Level]) -> set[sp.Symbol]:
        """Collect what stores need, through definitions of these levels."""
        needed: set[sp.Symbol] = set()
        work = [s for store in stores for s in self._symbols(store)]
        while work:
            symbol = work.pop()
            if symbol in needed:
                continue
            needed.add(symbol)
            definition = self.graph.definitions.get(symbol)
            if definition is not None and definition.level in levels:
                work.extend(definition.value.free_symbols)
        return needed

    def reached(self, stores: Iterable[Store]) -> list[sp.Symbol]:
        """List all that is defined for stores, whatever its level."""
        needed = self._needed(stores, set(Level))
        return [symbol for symbol in self.graph.definitions if symbol in needed]

    def needed_before(self, stores: Iterable[Store], level: Level) -> list[sp.Symbol]:
        """List what definitions of a level need of the levels of an iteration before it."""
        needed = self._needed(stores, {level})
        return [
            symbol
            for symbol, definition in self.graph.definitions.items()
            if symbol in needed and Level.RUN < definition.level < level
        ]

    def hoisted_at(self, level: Level) -> list[tuple[sp.Symbol, Row]]:
        """List the hoisted values of a level with their rows."""
        return [
            (symbol, row)
            for symbol, row in self.hoisted.items()
            if self.graph.levels[symbol] == level
        ]

    def moved(self, symbol: sp.Symbol, to: dict[sp.Symbol, sp.Expr]) -> sp.Expr:
        """Return the value that a step-level symbol takes when q and p move on as in ``to``.

        What it is made of is added to ``to``, so that shared definitions are followed once.
        """
        levels, section, work = self.graph.levels, "the next left node", [symbol]
        while work:
            last = work[-1]
            if last in to or levels[last] != Level.STEP:
                work.pop()
                continue
            definition = self.graph.definitions[last]
            before = sorted(definition.value.free_symbols, key=str)  # the order of the lines
            if later := [s for s in before if s not in to and levels[s] == Level.STEP]:
                work += reversed(later)
                continue
            value = definition.value.xreplace({s: to.get(s, s) for s in before})
            if definition.is_sincos:
                hint = value.name if value.is_Symbol else f"angle_{last.name}_next"
                pair = self.graph.define_sincos(hint, value, section)
                to[last] = pair[definition.targets.index(last)]
            else:
                to[last] = self.graph.define(f"{last.name}_next", value, section)
        return to.get(symbol, symbol)

    def moved_on(self, a: int, change: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """Add to a coordinate, and to what rounding took from it."""
        return self.compensated(self.names.coordinates[a], self.q[a], self.q_low[a], change)

    def compensated(
        self, name: str, old: sp.Symbol, low: sp.Symbol, increment: sp.Expr
    ) -> tuple[sp.Expr, sp.Expr]:
        """Add an increment to a value with its low part: exact sum of two numbers (Knuth)."""
        section = "compensated sums"
        define = self.graph.define
        total = define(f"{name}_step", increment + low, section)
        new = define(f"{name}_next", old + total, section)
        taken = define(f"{name}_taken", new - old, section)
        rest = define(f"{name}_rest", new - taken, section)
        lost_old = define(f"{name}_lost", old - rest, section)
        lost_new = define(f"{name}_lost", total - taken, section)
        return new, define(f"{name}_low_next", lost_old + lost_new, section)

    def _symbols(self, store: Store) -> Iterable[sp.Symbol]:
        yield from store.value.free_symbols
        if store.keep is not None:
            yield store.keep
            yield self.active
