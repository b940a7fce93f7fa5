"""Kernels of a state (q, p), and of the steps of small systems, built from traces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce

from symsimpson.declare.retimed import RUN_PARAMETERS
from symsimpson.discrete import reductions
from symsimpson.discrete.jet import derive_original_terms, derive_rate
from symsimpson.discrete.reductions import Constrained, Coupled
from symsimpson.lower.expression import Expression
from symsimpson.lower.forms import has_drifts
from symsimpson.lower.ir import (
    Call,
    Function,
    IfActive,
    Kernel,
    Loop,
    Row,
    Statement,
    Store,
    store_rows,
)
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.specialise import kernel_from_text
from symsimpson.lower.storage import Border, Storage
from symsimpson.lower.template import JetTemplate, Point
from symsimpson.lower.terms_of_l import power_stores, pull_stores
from symsimpson.lower.traced_parts import TracedPart
from symsimpson.lower.traced_steps import TracedSolver, TracedSteps, traced_facts

#: Levels that a kernel computes which is called on a bare state (q, p).
STATE = (Level.STEP, Level.ITERATION)
#: A kernel takes as many steps as a run asks for.
MANY_STEPS = Loop("step", "range(int(W[COUNT, 0]))", ())


def lane_loop(body: Iterable[Statement]) -> tuple[Statement, ...]:
    """Wrap statements in the loop over lanes."""
    return (Loop("lane", "range(LANES)", tuple(body)),)


def state_kernel(
    low: Lowering,
    name: str,
    doc: str,
    stores: Iterable[Store],
    before: Sequence[Statement] = (),
    after: Sequence[Statement] = (),
) -> Kernel:
    """Return a kernel that stores values at a state, ``before`` and ``after`` other statements."""
    return Kernel(name, doc, lane_loop((*before, *low.statements(stores, STATE), *after)))


class TracedState:
    """Velocities, momenta and energies, computed at a state.

    Coordinates are in the order in which M is factorised. Cyclic coordinates come first, because
    the back substitution of L D L^T finds the last ones first.
    """

    def __init__(self, low: Lowering) -> None:
        self._low, plain = low, low.equations.plain
        parts = low.equations.parts
        order = [a for part in parts for a in part.mass_order]
        count = len(plain.constraint_names) if isinstance(parts[0], Constrained) else 0
        rolling = len(plain.velocity_constraints)
        held = Border.dense(low.n, count, rolling, in_order=True)
        facts = traced_facts(low, Coupled(tuple(order), (), ()), held)
        facts["ITERATED"] = any(part.columns for part in parts)
        tables = held.constants(low.equations.scheme.degree) if held else {}
        names = ("start", "legendre", "energy", "factor", "solve_velocity", "find_pivots")
        storage = Storage(tuple(order), low.n - 1, banded=False)
        tables["MASS_BAND"] = storage.band_of(low.template.places("M"))
        self.part = TracedPart(low, order, names, facts, tables, reduction=held)

    def velocity(self, *, end: Iterable[TracedPart] = ()) -> list[Expression]:
        """Return the velocities at (q, p), or at the ``end`` of a step, which other parts have."""
        part, low = self.part, self._low
        part.begin()
        rows = ("POSITION", "MOMENTUM", *(() if low.equations.plain.quadratic else ("VELOCITY",)))
        for other in (others := [*end]):
            part.copy_rows(other, rows)
        part.run("go_to_start", low.t + low.h if others else low.t)
        part.trace.place = "end" if others else low.start_point().suffix
        for text in ("mass", "factor", "solve_velocity"):
            part.run(text)
        v = part.name_rows("VELOCITY", low.n, section="velocity")
        velocity = dict(zip(part.coordinates, v, strict=True))
        return [velocity[a] for a in range(low.n)]

    def pivots(self) -> list[Expression]:
        """Return the pivots of M that were found with the velocity."""
        part, low, n = self.part, self._low, self._low.n
        if part.held is None:
            return part.mass_pivots()
        if not (low.singular_mass or low.equations.system.structure.constant_mass):
            part.run("find_pivots")
        return part.diagonal("HELD", n + part.held.count)[:n]

    def energy(self) -> list[Store]:
        """Return the energy, its kinetic part, and the velocities."""
        self.part.begin()
        self.part.run_step("energy")
        return self.part.stores(("ENERGY", "KINETIC", "VELOCITY"), "_value", "energy")

    def deficit(self) -> Expression | None:
        """Return a negative number where an indefinite M is singular; None for a definite M."""
        return None if self._low.equations.plain.definite else self.part.row("MASS_PIVOT")

    def legendre(self) -> Kernel:
        """Return the momentum of a velocity."""
        self.part.begin()
        self.part.run_step("legendre")
        stores = [
            replace(x, moving=False) for x in self.part.stores(("MOMENTUM",), "_of_v", "momentum")
        ]
        return state_kernel(self._low, "legendre", "p = dL/dv from q and v.", stores)


def store_first_pivots(
    low: Lowering,
    pivots: Sequence[Expression],
    section: str,
    first: int = 0,
    deficit: Expression | None = None,
) -> list[Store]:
    """Store the deficit of the pivots at the start of a run, and the scales of pivots.

    The default deficit is the sum of negative pivots.
    """
    define = low.graph.define
    if deficit is None:
        signed = [d for d in pivots if not low.graph.is_positive(d)]
        deficits = [define("deficit", d - low.graph.apply("abs", d), section) for d in signed]
        deficit = low.graph.total(deficits)
    deficit = define("deficit", deficit, section)
    scales = [define("scale", 1 / d, section) for d in _varying_pivots(low, pivots)]
    rows = [Store(Row("PIVOT_SCALE", i), scale) for i, scale in enumerate(scales, first)]
    return [Store(Row("MASS_PIVOT", 0), deficit), *rows]


def store_least_pivot(
    low: Lowering, pivots: Sequence[Expression], row: Row, section: str, first: int = 0
) -> list[Store]:
    """Store the smallest ratio of a pivot of M to its value at the start.

    The ratio is negative if a pivot has changed its sign. A constant M needs no store.
    """
    moving = _varying_pivots(low, pivots)
    ratios = [d * low.pivot_scale(i) for i, d in enumerate(moving, first)]
    if not ratios:
        return []
    least = reduce(lambda x, y: low.graph.apply("min", x, y), ratios)
    return [Store(row, low.graph.define("least_pivot", least, section))]


def _varying_pivots(low: Lowering, pivots: Sequence[Expression]) -> list[Expression]:
    """Return the pivots that change along a motion."""
    return [d for d in pivots if low.graph.level(d) > Level.RUN]


def seek_velocity(low: Lowering) -> tuple[Statement, ...]:
    """Return the call that finds the velocity of p, if L is not quadratic in the velocities."""
    if low.equations.plain.quadratic:
        return ()
    return (Call("invert_momentum", ("W", "t", "lane")),)


def observation_kernels(low: Lowering, state: TracedState | None) -> list[Kernel]:
    """Return the kernels of invariants and of powers; loops have no traced ``state``."""
    kernels, plain = [], low.equations.plain
    if plain.invariants:
        template, point, before = _observed_point(low, state)
        entry = partial(template.entry, point, "invariants", "invariant")
        stores = store_rows("INVARIANT", map(entry, plain.invariants))
        doc = "Quantities that the exact flow conserves, at (q, p)."
        kernels.append(state_kernel(low, "invariants", doc, stores, before))
    if plain.powers:
        template, point, before = _observed_point(low, None if plain.carried else state)
        after: tuple[Statement, ...] = ()
        if plain.carried:
            pulls = pull_stores(low, replace(point, multipliers=low.multipliers))
            before = (Call("find_allowed_velocity", ("W", "t", "lane")),)
            after = (Call("find_multipliers"), *low.statements(pulls, STATE))
        stores = power_stores(low, template, point)
        doc = "Power of each force, then dL/dt where L depends on t, at (q, p)."
        kernels.append(state_kernel(low, "power", doc, stores, before, after))
    return kernels


def _observed_point(
    low: Lowering, state: TracedState | None
) -> tuple[JetTemplate, Point, tuple[Statement, ...]]:
    """Return the template and point of a state, and the call that finds its velocities."""
    if state is None:
        moving = low.v if low.equations.plain.hamiltonian is None else low.p
        point = Point("state", low.q, moving, low.t, low.inputs(0))
        return low.observed, point, (Call("find_velocity", ("W", "t", "lane")),)
    start, v = low.start_point(), tuple(state.velocity())
    return low.template, replace(start, suffix=f"{start.suffix}_state", v=v), seek_velocity(low)


def add_user_time(
    low: Lowering, facts: Mapping[str, object], kernels: Sequence[Kernel]
) -> tuple[list[Function], list[Kernel]]:
    """Return functions and kernels; in a retimed system they give energies in the user's time.

    t_1 = t_0 + h sum_i b_i g(Q_i) is the momentum of E0 taken as a coordinate, and so has the
    order of the scheme.
    """
    retiming, plain = low.equations.system.retiming, low.equations.plain
    if retiming is None:
        return [], [*kernels]
    state = TracedState(low.with_jet(derive_original_terms(retiming)))
    parameters = [*low.equations.system.parameters]
    places = [parameters.index(symbol) for symbol in RUN_PARAMETERS]
    names = [plain.parameters[place].name for place in places]
    start_energy, first_rate = (low.parameters[name] for name in names)
    jet = derive_rate(plain, retiming)

    def rate(point: Point, energy: Expression = start_energy) -> Expression:
        """Return g at a point, as the user gave it."""
        known = {**low.parameters, names[0]: energy}
        template = JetTemplate(jet, low.graph, low.names.coordinates, known, momenta=low.p)
        return template.entry(point, "rate", "rate")

    changed = {"legendre": state.legendre()}
    here = Store(Row("RATE", 0), rate(Point("state", low.q)) / first_rate)
    total, kinetic, *velocity = state.energy()
    doc = "The Hamiltonian at (q, p), its kinetic part, dq/dt, and dt/dtau."
    seek = seek_velocity(low)
    changed["energy"] = state_kernel(low, "energy", doc, [total, kinetic, *velocity, here], seek)
    in_tau = [
        Store(total.row, here.value * (total.value - start_energy)),
        Store(kinetic.row, here.value * kinetic.value),
        here,
    ]
    doc = "K = (H - E0) dt/dtau, the Hamiltonian of tau, its kinetic part, and dt/dtau."
    energy_in_tau = state_kernel(low, "energy_in_tau", doc, in_tau, seek)
    begun = zip(places, (total.value, rate(Point("begin", low.q), total.value)), strict=True)
    begun_stores = [Store(Row("PARAMETER", place), value) for place, value in begun]
    doc = "E0 and the rate at (q, p), where a run begins."
    retime = state_kernel(low, "retime", doc, begun_stores)
    others = [changed.get(kernel.name, kernel) for kernel in kernels]
    others += [energy_in_tau, retime, kernel_from_text("clock", facts)]
    if has_drifts(low.equations):
        return [], others
    store = Store(Row("RATE", 0), rate(Point("i", low.node_q)) / first_rate)
    lines = low.statements([store], (Level.ITERATION,))
    return [Function("time_rate", "dt/dtau at a node.", lines)], others


#: Rows with sums over all parts.
SUMS = """
    CORRECTION_SQUARED INCREMENT_SQUARED VELOCITY_JUMP_SQUARED PREDICTION_ERROR_SQUARED
    CYCLIC_JUMP_SQUARED CYCLIC_MASS_CHANGE
"""
#: The class that traces each kind of part.
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
    low.graph.requests.clear()
    part = TracedSolver(low, reductions.Coupled(every, eqs.rows, eqs.columns)).equations()
    size = eqs.unknowns.measured
    rows = part.name_rows("RESIDUAL", size, section="residual D_k L_d")
    matrix = part.name_rows("JACOBIAN", size**2, section="Jacobian D_m D_k L_d")
    stores = [*store_rows("RESIDUAL", rows), *store_rows("JACOBIAN", matrix)]
    doc = "Residual and Jacobian of the step, rows in the order of elimination."
    lines = low.statements(stores, computed)
    return Function("step_equations", doc, lines, ("W", "h", "t", "lane"))


class TracedKernels:
    """Builds the kernels of a step from the traces of all parts."""

    def __init__(self, low: Lowering) -> None:
        self._low, self.state = low, TracedState(low)
        self._parts = [TRACES[type(part)](low, part) for part in low.equations.parts]
        #: Control point and coordinate of the increments that an iteration changes.
        self.increments = sorted(x for part in self._parts for x in part.increments)
        self._constrained = bool(low.multipliers)

    def kernels(self, equations: Function | None) -> list[Kernel]:
        """Return start, legendre, newton, advance and energy.

        Newton's method solves ``equations`` if they are given, else the equations of each part.
        """
        newton = []
        if equations is not None:
            body = (Call(equations.name, equations.arguments), Call("solve_in_pairs"))
            newton = [self._newton(body, straight=True)]
        elif self.increments:
            newton = [self._newton(self._iteration())]
        advance = self._advance()
        # they come last, because they reuse values of the left node that steps store
        start, legendre = self._start(), self.state.legendre()
        doc = "The Hamiltonian at (q, p), its kinetic part, and the velocities."
        energy = state_kernel(
            self._low, "energy", doc, self.state.energy(), seek_velocity(self._low)
        )
        return [start, legendre, *newton, advance, energy]

    def _newton(self, body: Sequence[Statement], *, straight: bool = False) -> Kernel:
        update = (IfActive((Call("update_increments"),)),) if straight else ()
        names = (
            ("check_rounding", "check_convergence") if self._constrained else ("check_convergence",)
        )
        doc = "One Newton iteration for the increments X_k of the control points."
        return Kernel("newton", doc, lane_loop((*body, *update, *map(Call, names))), straight)

    def _iteration(self) -> tuple[Statement, ...]:
        """Correct the increments, and measure corrections and increments."""
        stores: list[Store] = []
        parts = self._iterated_parts
        blocks = ["INCREMENT"]
        if len({a for _, a in self.increments}) > 1:
            blocks += ["OWN_CORRECTION", "OWN_INCREMENT"]
        for part in parts:
            part.iterate()
            stores += part.traced.stores(blocks, "_new", "update", part.unknowns)
        stores += self._sums(parts, "update")
        return self._low.statements(stores, (Level.ITERATION,))

    @property
    def _iterated_parts(self) -> list[TracedSolver]:
        """The parts that are solved by iteration."""
        return [x for x in self._parts if isinstance(x, TracedSolver) and x.increments]

    def _sums(self, parts: Sequence[TracedSolver], section: str) -> list[Store]:
        """Return the stores of sums over all parts."""
        low, stores = self._low, []
        for name in SUMS.split():
            terms = [part.traced.row(name) for part in parts if part.traced.has(name)]
            if terms:
                value = low.graph.define(name.lower(), low.graph.total(terms), section)
                stores.append(Store(Row(name, 0), value))
        return stores

    def _start(self) -> Kernel:
        """Return the kernel that begins at (q, p): first increments and values that steps reuse."""
        low, state = self._low, self.state
        stores = [Store(row, symbol) for symbol, row in low.hoisted_at(Level.STEP)]
        state.part.begin()
        state.part.run_step("start")
        blocks = ("VELOCITY", "MASS_DIAGONAL", "INCREMENT", "PREDICTED", "MULTIPLIER", "CURVATURE")
        multipliers = [x for part in self._parts for x in part.multipliers]
        unknowns = (*self.increments, *multipliers)
        begun = state.part.stores(blocks, "_first", "increments", unknowns)
        stores += [replace(store, moving=False) for store in begun]
        stores += store_first_pivots(low, state.pivots(), "velocity", deficit=state.deficit())
        more = ", and increments of constant velocity" if self.increments else ""
        doc = f"Begin at (q, p): what depends on q alone{more}."
        return state_kernel(low, "start", doc, stores, seek_velocity(low))

    def _advance(self) -> Kernel:
        """Close a step and predict the next one."""
        low = self._low
        for part in self._parts:
            part.close()
        stores = self._predict() if self.increments else []
        to: dict[Expression, Expression] = {}
        for part in self._parts:
            traced = part.traced
            blocks = ["POSITION", "POSITION_LOW", "MOMENTUM", "MOMENTUM_LOW"]
            stores += traced.stores([*blocks, "PASSED"], "_next", "compensated sums")
            blocks = ["POSITION", "MOMENTUM", *(["MASS_DIAGONAL"] if part.increments else [])]
            to |= traced.map_symbols(blocks)
        low.hoist(stores, (Level.ITERATION,))
        for symbol, row in low.hoisted_at(Level.STEP):
            following = low.advance_symbol(symbol, to)
            if following != symbol:  # else it depends on constant momenta only
                stores.append(Store(row, following, moving=True))
        closed = low.statements(stores, (Level.ITERATION,))
        if self.increments:
            doc = "Close a step: p1 and q1 by compensated sums, then predict the next increments."
            names = ["expect_rounding"] if self._constrained else []
            names += ["check_acceptance", *(["check_pivots"] if low.scales else [])]
            return Kernel(
                "advance", doc, lane_loop((Call("keep_step"), *closed, *map(Call, names)))
            )
        doc = "Take as many steps as W[COUNT] says, without Newton's method."
        return Kernel("advance", doc, (replace(MANY_STEPS, body=lane_loop(closed)),))

    def _predict(self) -> list[Store]:
        """Predict the next increments from the velocity at q1."""
        low, state = self._low, self.state
        solved = self._iterated_parts
        if self._constrained:
            (part,) = solved
            pivots = part.pivots()
        else:
            if not low.equations.plain.quadratic:
                for other in self._parts:
                    other.traced.run("end_slope", low.h)
            state.velocity(end=[part.traced for part in self._parts])
            pivots = state.pivots()
        stores: list[Store] = []
        for part in solved:
            if not self._constrained:
                part.traced.copy_rows(state.part, ("VELOCITY", "MASS_DIAGONAL"))
            part.traced.run("predict", low.h)
            wanted = part.unknowns
            stores += part.traced.stores(("INCREMENT", "PREDICTED"), "_next", "predictor", wanted)
            stores += part.traced.stores(("TAKEN",), "_taken", "velocity")
            diagonal = part.traced.stores(("MASS_DIAGONAL",), "_next", "velocity")
            stores += [x for x in diagonal if low.graph.level(x.value) > Level.RUN]
        stores += store_least_pivot(low, pivots, Row("MASS_PIVOT", 0), "velocity at q1")
        return stores + self._sums(solved, "predictor")
