"""Kernels of a state (q, p): velocities, energies, momenta, invariants, powers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce

from symsimpson.declare.retimed import OWN
from symsimpson.discrete.jet import derive_original_terms, derive_rate
from symsimpson.discrete.reductions import Constrained, Coupled
from symsimpson.lower.expression import Expression
from symsimpson.lower.forms import drifting
from symsimpson.lower.ir import Call, Function, Kernel, Loop, Row, Statement, Store, stored
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.specialise import kernel_from_text
from symsimpson.lower.storage import Held
from symsimpson.lower.template import JetTemplate, Point
from symsimpson.lower.terms_of_l import power_stores, pull_stores
from symsimpson.lower.traced_parts import TracedPart
from symsimpson.lower.traced_steps import traced_facts

#: Levels that a kernel computes which is called on a bare state (q, p).
STATE = (Level.STEP, Level.ITERATION)
#: A kernel takes as many steps as a run asks for.
MANY_STEPS = Loop("step", "range(int(W[COUNT, 0]))", ())


def lanes(body: Iterable[Statement]) -> tuple[Statement, ...]:
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
    return Kernel(name, doc, lanes((*before, *low.statements(stores, STATE), *after)))


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

    def energy_kernel(self) -> Kernel:
        """Return the kernel of these."""
        doc = "The Hamiltonian at (q, p), its kinetic part, and the velocities."
        return state_kernel(self._low, "energy", doc, self.energy())

    def legendre(self) -> Kernel:
        """Return the momentum of a velocity."""
        self.part.begin()
        self.part.run_step("legendre")
        stores = [
            replace(x, moving=False) for x in self.part.stores(("MOMENTUM",), "_of_v", "momentum")
        ]
        return state_kernel(self._low, "legendre", "p = dL/dv from q and v.", stores)


def begun_pivots(
    low: Lowering, pivots: Sequence[Expression], section: str, first: int = 0
) -> list[Store]:
    """Store what tells whether M is positive definite where a run begins, and scales of pivots."""
    define, signed = low.graph.define, [d for d in pivots if not low.graph.is_positive(d)]
    deficits = [define("deficit", d - low.graph.applied("abs", d), section) for d in signed]
    deficit = define("deficit", low.graph.total(deficits), section)
    scales = [define("scale", 1 / d, section) for d in _moving(low, pivots)]
    rows = [Store(Row("PIVOT_SCALE", i), scale) for i, scale in enumerate(scales, first)]
    return [Store(Row("MASS_PIVOT", 0), deficit), *rows]


def least_pivot(
    low: Lowering, pivots: Sequence[Expression], row: Row, section: str, first: int = 0
) -> list[Store]:
    """Store the smallest pivot of M, each in units of that at the start; nothing if M is constant.

    The sign of a pivot in these units tells whether it is another one than at the start.
    """
    moving = _moving(low, pivots)
    ratios = [d * low.pivot_scale(i) for i, d in enumerate(moving, first)]
    if not ratios:
        return []
    least = reduce(lambda x, y: low.graph.applied("min", x, y), ratios)
    return [Store(row, low.graph.define("least_pivot", least, section))]


def _moving(low: Lowering, pivots: Sequence[Expression]) -> list[Expression]:
    """Return the pivots that change along a motion."""
    return [d for d in pivots if low.graph.level(d) > Level.RUN]


def watching_kernels(low: Lowering, state: TracedState | None) -> list[Kernel]:
    """Return the kernels of invariants and of powers; loops have no traced ``state``."""
    kernels, plain = [], low.equations.plain
    if plain.invariants:
        template, point, before = _watched(low, state)
        entry = partial(template.entry, point, "invariants", "invariant")
        stores = stored("INVARIANT", map(entry, plain.invariants))
        doc = "Quantities that the exact flow conserves, at (q, p)."
        kernels.append(state_kernel(low, "invariants", doc, stores, before))
    if plain.powers:
        template, point, before = _watched(low, None if plain.carried else state)
        after: tuple[Statement, ...] = ()
        if plain.carried:
            pulls = pull_stores(low, replace(point, multipliers=low.multipliers))
            before = (Call("find_allowed_velocity", ("W", "t", "lane")),)
            after = (Call("find_multipliers"), *low.statements(pulls, STATE))
        stores = power_stores(low, template, point)
        doc = "Power of each force, then dL/dt where L depends on t, at (q, p)."
        kernels.append(state_kernel(low, "power", doc, stores, before, after))
    return kernels


def _watched(
    low: Lowering, state: TracedState | None
) -> tuple[JetTemplate, Point, tuple[Statement, ...]]:
    """Return what is evaluated at a state, the state, and the call that finds its velocities."""
    if state is None:
        point = Point("state", low.q, low.v, low.t, low.inputs(0))
        return low.watched, point, (Call("find_velocity", ("W", "t", "lane")),)
    start, v = low.start_point(), tuple(state.velocity())
    return low.template, replace(start, suffix=f"{start.suffix}_state", v=v), ()


def keeping_time(
    low: Lowering, facts: Mapping[str, object], kernels: Sequence[Kernel]
) -> tuple[list[Function], list[Kernel]]:
    """Return functions and kernels; those of a retimed system have energies of the user's time.

    t_1 = t_0 + h sum_i b_i g(Q_i) is the momentum of E0 taken as a coordinate, and so has the
    order of the scheme.
    """
    retiming, plain = low.equations.system.retiming, low.equations.plain
    if retiming is None:
        return [], [*kernels]
    state = TracedState(low.of_all(derive_original_terms(retiming)))
    parameters = [*low.equations.system.parameters]
    places = [parameters.index(symbol) for symbol in OWN]
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
    changed["energy"] = state_kernel(low, "energy", doc, [total, kinetic, *velocity, here])
    in_tau = [
        Store(total.row, here.value * (total.value - start_energy)),
        Store(kinetic.row, here.value * kinetic.value),
        here,
    ]
    doc = "K = (H - E0) dt/dtau, the Hamiltonian of tau, its kinetic part, and dt/dtau."
    energy_in_tau = state_kernel(low, "energy_in_tau", doc, in_tau)
    begun = zip(places, (total.value, rate(Point("begin", low.q), total.value)), strict=True)
    begun_stores = [Store(Row("PARAMETER", place), value) for place, value in begun]
    doc = "E0 and the rate at (q, p), where a run begins."
    retime = state_kernel(low, "retime", doc, begun_stores)
    others = [changed.get(kernel.name, kernel) for kernel in kernels]
    others += [energy_in_tau, retime, kernel_from_text("clock", facts)]
    if drifting(low.equations):
        return [], others
    store = Store(Row("RATE", 0), rate(Point("i", low.node_q)) / first_rate)
    lines = low.statements([store], (Level.ITERATION,))
    return [Function("time_rate", "dt/dtau at a node.", lines)], others
