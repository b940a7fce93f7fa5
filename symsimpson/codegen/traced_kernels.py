"""Kernels of small systems: texts of the library, traced for each part and put together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from symsimpson.codegen.constraint_order import Held
from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Call, Function, IfActive, Kernel, Loop, Row, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.pivots import begun_pivots, least_pivot
from symsimpson.codegen.traced_explicit import TracedSteps
from symsimpson.codegen.traced_parts import TracedPart
from symsimpson.codegen.traced_solver import TracedSolver, traced_facts
from symsimpson.discrete.reductions import (
    Affine,
    Composed,
    Constrained,
    Coupled,
    Linear,
    Routh,
    Separable,
)

__all__ = ["STATE", "TRACES", "TracedKernels", "TracedState", "lanes", "step_equations"]

#: Levels that a kernel computes which is called on a bare state (q, p).
STATE = (Level.STEP, Level.ITERATION)
#: Rows to which each part adds its own.
SUMS = (
    "CORRECTION_SQUARED",
    "INCREMENT_SQUARED",
    "VELOCITY_JUMP_SQUARED",
    "PREDICTION_ERROR_SQUARED",
    "CYCLIC_JUMP_SQUARED",
    "CYCLIC_MASS_CHANGE",
)


#: What traces a kind of part.
TRACES: dict[type, Callable[..., TracedSolver | TracedSteps]] = {
    Affine: TracedSolver,
    Composed: TracedSteps,
    Constrained: TracedSolver,
    Coupled: TracedSolver,
    Linear: TracedSteps,
    Routh: TracedSolver,
    Separable: TracedSolver,
}


def lanes(body: Iterable[Statement]) -> tuple[Statement, ...]:
    """Wrap statements in the loop over lanes."""
    return (Loop("lane", "range(LANES)", tuple(body)),)


def step_equations(low: Lowering, computed: Iterable[Level]) -> Function:
    """Trace the equations of a step; values of other levels are known before."""
    eqs, every = low.equations, tuple(range(low.n))
    low.graph.asked.clear()
    part = TracedSolver(low, Coupled(every, eqs.rows, eqs.columns)).equations()
    size = eqs.unknowns.measured
    rows = part.named("RESIDUAL", size, section="residual D_k L_d")
    matrix = part.named("JACOBIAN", size**2, section="Jacobian D_m D_k L_d")
    stores = [Store(Row("RESIDUAL", i), value) for i, value in enumerate(rows)]
    stores += [Store(Row("JACOBIAN", i), value) for i, value in enumerate(matrix)]
    doc = "Residual and Jacobian of the step, rows in the order of elimination."
    lines = low.statements(stores, computed)
    return Function("step_equations", doc, lines, ("W", "h", "t", "lane"))


class TracedState:
    """Velocities, momenta and energies, computed at a state.

    Coordinates stand in the order in which M is factorised: cyclic ones first, as what comes last
    in L D L^T is found first.
    """

    def __init__(self, low: Lowering) -> None:
        self._low, plain = low, low.equations.plain
        parts = low.equations.parts
        order = [a for part in parts for a in part.mass_order]
        count = len(plain.held) if isinstance(parts[0], Constrained) else 0
        rolling = len(plain.velocity_constraints)
        held = Held.dense(low.n, count, rolling, in_order=True) if count else None
        facts = traced_facts(low, Coupled(tuple(order), (), ()), held)
        facts["ITERATED"] = any(part.columns for part in parts)
        tables = held.constants(low.equations.scheme.degree) if held else {}
        names = ("start", "legendre", "energy", "factor", "solve_velocity", "find_pivots")
        entries = low.template.places("M")
        place = {a: s for s, a in enumerate(order)}
        band = max((abs(place[a] - place[b]) for a, b in entries), default=0)
        tables |= {"MASS_BAND": band}
        self.part = TracedPart(low, order, names, facts, tables, reduction=held)

    def velocity(self, *, end: Iterable[TracedPart] = ()) -> list[Expression]:
        """Return the velocities of (q, p), or at the end of a step, where other parts have it."""
        part, low = self.part, self._low
        part.begin()
        for other in (others := [*end]):
            part.take(other, ("POSITION", "MOMENTUM"))
        part.run("go_to_start", low.t + low.h if others else low.t)
        part.trace.place = "end" if others else low.start_point().suffix
        for text in ("mass", "factor", "solve_velocity"):
            part.run(text)
        v = part.named("VELOCITY", low.n, section="velocity")
        velocity = dict(zip(part.coordinates, v, strict=True))
        return [velocity[a] for a in range(low.n)]

    def pivots(self) -> list[Expression]:
        """Return the pivots of M that were found with the velocity."""
        part, low, n = self.part, self._low, self._low.n
        if part.held is None:
            return part.diagonal("NODE_L_VV", n)
        if not (low.stiffened or low.equations.system.structure.constant_mass):
            part.run("find_pivots")
        return part.diagonal("HELD", n + part.held.count)[:n]

    def energy(self) -> list[Store]:
        """Return the energy, its kinetic part, and the velocities."""
        self.part.begin()
        self.part.run_step("energy")
        return self.part.stores(("ENERGY", "KINETIC", "VELOCITY"), "_value", "energy")

    def legendre(self) -> Kernel:
        """Return the momentum of a velocity."""
        self.part.begin()
        self.part.run_step("legendre")
        stores = [
            replace(x, moving=False) for x in self.part.stores(("MOMENTUM",), "_of_v", "momentum")
        ]
        lines = self._low.statements(stores, STATE)
        return Kernel("legendre", "p = dL/dv from q and v.", lanes(lines))


class TracedKernels:
    """Makes the kernels of a step from the traces of all parts."""

    def __init__(self, low: Lowering) -> None:
        self._low, self._state = low, TracedState(low)
        self._parts = [TRACES[type(part)](low, part) for part in low.equations.parts]
        #: Control point and coordinate of the increments that an iteration changes.
        self.increments = sorted(x for part in self._parts for x in part.increments)
        self._held = bool(low.multipliers)

    def kernels(self, equations: Function | None) -> list[Kernel]:
        """Return start, legendre, newton and advance.

        Newton's method solves these equations, if they are given; else those of each part.
        """
        newton = []
        if equations is not None:
            body = (equations.call, Call("solve_in_pairs"))
            newton = [self._newton(body, straight=True)]
        elif self.increments:
            newton = [self._newton(self._iteration())]
        advance = self._advance()
        # what they need of the left node is known before them: it is kept from step to step
        return [self._start(), self._state.legendre(), *newton, advance]

    def _newton(self, body: Sequence[Statement], *, straight: bool = False) -> Kernel:
        update = (IfActive((Call("update_increments"),)),) if straight else ()
        names = ("check_rounding", "check_convergence") if self._held else ("check_convergence",)
        doc = "One Newton iteration for the increments X_k of the control points."
        return Kernel("newton", doc, lanes((*body, *update, *map(Call, names))), straight)

    def _iteration(self) -> tuple[Statement, ...]:
        """Correct the increments, and measure corrections and increments."""
        stores: list[Store] = []
        parts = self._solved
        blocks = ["INCREMENT"]
        if len({a for _, a in self.increments}) > 1:
            blocks += ["OWN_CORRECTION", "OWN_INCREMENT"]
        for part in parts:
            part.iterate()
            stores += part.traced.stores(blocks, "_new", "update", part.unknowns)
        stores += self._sums(parts, "update")
        return self._low.statements(stores, (Level.ITERATION,))

    @property
    def _solved(self) -> list[TracedSolver]:
        """The parts that are solved by iteration."""
        return [x for x in self._parts if isinstance(x, TracedSolver) and x.increments]

    def _sums(self, parts: Sequence[TracedSolver], section: str) -> list[Store]:
        """Return what all parts add to the same rows."""
        low, stores = self._low, []
        for name in SUMS:
            terms = [part.traced.row(name) for part in parts if part.traced.has(name)]
            if terms:
                value = low.graph.define(name.lower(), low.graph.total(terms), section)
                stores.append(Store(Row(name, 0), value))
        return stores

    def _start(self) -> Kernel:
        """From q and p to the first increments, and to what is kept from step to step."""
        low, state = self._low, self._state
        stores = [Store(row, symbol) for symbol, row in low.hoisted_at(Level.STEP)]
        state.part.begin()
        state.part.run_step("start")
        blocks = ("VELOCITY", "MASS_DIAGONAL", "INCREMENT", "PREDICTED", "MULTIPLIER", "CURVATURE")
        begun = state.part.stores(
            blocks, "_first", "increments", (*self.increments, *self._multipliers)
        )
        stores += [replace(store, moving=False) for store in begun]
        stores += begun_pivots(low, state.pivots(), "velocity")
        more = ", and increments of constant velocity" if self.increments else ""
        doc = f"Begin at (q, p): what depends on q alone{more}."
        return Kernel("start", doc, lanes(low.statements(stores, STATE)))

    @property
    def _multipliers(self) -> list[tuple[int, int]]:
        return [x for part in self._parts for x in part.multipliers]

    def _advance(self) -> Kernel:
        """Close a step and predict the next one."""
        low = self._low
        for part in self._parts:
            part.close()
        stores = self._predicted() if self.increments else []
        to: dict[Expression, Expression] = {}
        for part in self._parts:
            traced = part.traced
            blocks = ["POSITION", "POSITION_LOW", "MOMENTUM", "MOMENTUM_LOW"]
            stores += traced.stores([*blocks, "PASSED"], "_next", "compensated sums")
            blocks = ["POSITION", "MOMENTUM", *(["MASS_DIAGONAL"] if part.increments else [])]
            to |= traced.moved(blocks)
        low.keep(stores, (Level.ITERATION,))
        for symbol, row in low.hoisted_at(Level.STEP):
            following = low.moved(symbol, to)
            if following != symbol:  # it is made of constant momenta alone
                stores.append(Store(row, following, moving=True))
        closed = low.statements(stores, (Level.ITERATION,))
        if self.increments:
            doc = "Close a step: p1 and q1 by compensated sums, then predict the next increments."
            names = ["expect_rounding"] if self._held else []
            names += ["check_acceptance", *(["check_pivots"] if low.scales else [])]
            return Kernel("advance", doc, lanes((Call("keep_step"), *closed, *map(Call, names))))
        doc = "Take as many steps as W[COUNT] says, without Newton's method."
        return Kernel("advance", doc, (Loop("step", "range(int(W[COUNT, 0]))", lanes(closed)),))

    def _predicted(self) -> list[Store]:
        """Predict the next increments from the velocity at q1."""
        low, state = self._low, self._state
        solved = self._solved
        if self._held:
            (part,) = solved
            if low.equations.plain.carried:
                part.traced.run("keep_taken")
            part.traced.run("carry_multipliers")
            pivots = part.pivots()
        else:
            state.velocity(end=[part.traced for part in self._parts])
            pivots = state.pivots()
        stores: list[Store] = []
        for part in solved:
            if not self._held:
                part.traced.take(state.part, ("VELOCITY", "MASS_DIAGONAL"))
            part.traced.run("predict", low.h)
            wanted = part.unknowns
            stores += part.traced.stores(("INCREMENT", "PREDICTED"), "_next", "predictor", wanted)
            stores += part.traced.stores(("TAKEN",), "_taken", "velocity")
            diagonal = part.traced.stores(("MASS_DIAGONAL",), "_next", "velocity")
            stores += [x for x in diagonal if low.graph.level(x.value) > Level.RUN]
        stores += least_pivot(low, pivots, Row("MASS_PIVOT", 0), "velocity at q1")
        return stores + self._sums(solved, "predictor")
