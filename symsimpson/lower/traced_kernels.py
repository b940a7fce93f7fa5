"""Kernels of small systems, put together from traces of their parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from symsimpson.discrete import reductions
from symsimpson.lower.expression import Expression
from symsimpson.lower.ir import Call, Function, IfActive, Kernel, Row, Statement, Store, stored
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.state_kernels import (
    MANY_STEPS,
    TracedState,
    begun_pivots,
    lanes,
    least_pivot,
    state_kernel,
)
from symsimpson.lower.traced_steps import TracedSolver, TracedSteps

#: Rows to which each part adds its own.
SUMS = """
    CORRECTION_SQUARED INCREMENT_SQUARED VELOCITY_JUMP_SQUARED PREDICTION_ERROR_SQUARED
    CYCLIC_JUMP_SQUARED CYCLIC_MASS_CHANGE
"""
#: What traces a kind of part.
TRACES: dict[type, Callable[..., TracedSolver | TracedSteps]] = {
    reductions.Affine: TracedSolver,
    reductions.Composed: TracedSteps,
    reductions.Constrained: TracedSolver,
    reductions.Coupled: TracedSolver,
    reductions.Linear: TracedSteps,
    reductions.Routh: TracedSolver,
    reductions.Separable: TracedSolver,
}


def step_equations(low: Lowering, computed: Iterable[Level]) -> Function:
    """Trace the equations of a step; values of other levels are known before."""
    eqs, every = low.equations, tuple(range(low.n))
    low.graph.asked.clear()
    part = TracedSolver(low, reductions.Coupled(every, eqs.rows, eqs.columns)).equations()
    size = eqs.unknowns.measured
    rows = part.named("RESIDUAL", size, section="residual D_k L_d")
    matrix = part.named("JACOBIAN", size**2, section="Jacobian D_m D_k L_d")
    stores = [*stored("RESIDUAL", rows), *stored("JACOBIAN", matrix)]
    doc = "Residual and Jacobian of the step, rows in the order of elimination."
    lines = low.statements(stores, computed)
    return Function("step_equations", doc, lines, ("W", "h", "t", "lane"))


class TracedKernels:
    """Makes the kernels of a step from the traces of all parts."""

    def __init__(self, low: Lowering) -> None:
        self._low, self.state = low, TracedState(low)
        self._parts = [TRACES[type(part)](low, part) for part in low.equations.parts]
        #: Control point and coordinate of the increments that an iteration changes.
        self.increments = sorted(x for part in self._parts for x in part.increments)
        self._held = bool(low.multipliers)

    def kernels(self, equations: Function | None) -> list[Kernel]:
        """Return start, legendre, newton, advance and energy.

        Newton's method solves these equations, if they are given; else those of each part.
        """
        newton = []
        if equations is not None:
            body = (Call(equations.name, equations.arguments), Call("solve_in_pairs"))
            newton = [self._newton(body, straight=True)]
        elif self.increments:
            newton = [self._newton(self._iteration())]
        advance = self._advance()
        # what they need of the left node is known before them: it is kept from step to step
        start, legendre = self._start(), self.state.legendre()
        return [start, legendre, *newton, advance, self.state.energy_kernel()]

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
        for name in SUMS.split():
            terms = [part.traced.row(name) for part in parts if part.traced.has(name)]
            if terms:
                value = low.graph.define(name.lower(), low.graph.total(terms), section)
                stores.append(Store(Row(name, 0), value))
        return stores

    def _start(self) -> Kernel:
        """From q and p to the first increments, and to what is kept from step to step."""
        low, state = self._low, self.state
        stores = [Store(row, symbol) for symbol, row in low.hoisted_at(Level.STEP)]
        state.part.begin()
        state.part.run_step("start")
        blocks = ("VELOCITY", "MASS_DIAGONAL", "INCREMENT", "PREDICTED", "MULTIPLIER", "CURVATURE")
        multipliers = [x for part in self._parts for x in part.multipliers]
        unknowns = (*self.increments, *multipliers)
        begun = state.part.stores(blocks, "_first", "increments", unknowns)
        stores += [replace(store, moving=False) for store in begun]
        stores += begun_pivots(low, state.pivots(), "velocity")
        more = ", and increments of constant velocity" if self.increments else ""
        doc = f"Begin at (q, p): what depends on q alone{more}."
        return state_kernel(low, "start", doc, stores)

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
        return Kernel("advance", doc, (replace(MANY_STEPS, body=lanes(closed)),))

    def _predicted(self) -> list[Store]:
        """Predict the next increments from the velocity at q1."""
        low, state = self._low, self.state
        solved = self._solved
        if self._held:
            (part,) = solved
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
