"""The kernels of a module, written out or as loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate

from symsimpson.codegen.coefficients import coefficient_loops
from symsimpson.codegen.constraint_functions import (
    constraint_family_functions,
    constraint_functions,
)
from symsimpson.codegen.constraint_order import Held, dense, smaller
from symsimpson.codegen.differentials import few_columns
from symsimpson.codegen.forms import few_equations, part_unknowns, solves_all, unrolled
from symsimpson.codegen.ir import Function, Kernel, Module, Row, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.loop_tables import equation_constants, solve_constants, solve_tables
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.looped_stages import LoopedStages
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.retimed_kernels import keeping_time
from symsimpson.codegen.sizes import drifting, sizes
from symsimpson.codegen.stages import StageKernels
from symsimpson.codegen.storage import Storage, node_stride
from symsimpson.codegen.tangents import differentiating
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.codegen.terms_of_l import (
    family_functions,
    power_function,
    power_stores,
    pull_stores,
    unrolled_functions,
)
from symsimpson.codegen.unrolled import (
    STATE,
    energy_stores,
    increments,
    lanes,
    part_solvers,
    step_equations,
    unrolled_kernels,
    velocity,
)
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.families import Family, constraint_families, families
from symsimpson.discrete.reductions import Composed, Constrained, Separable
from symsimpson.module.interface import PIVOTED
from symsimpson.module.workspace_layout import layout

__all__ = ["lower"]

#: Loops over families of terms are worth their indices from so many members on, on average.
FAMILY_MEMBERS = 2
#: With more coordinates than this, nodes are not taken as lanes: a solve at each takes n^3/6.
STAGE_COORDINATES = 24


def lower(equations: DiscreteEquations) -> Module:
    """Lower the equations of a step to kernels.

    Parameters
    ----------
    equations : DiscreteEquations

    Returns
    -------
    Module
        Kernels, constants, layout of the workspace and the library functions they call.
    """
    return _unrolled_module(equations) if unrolled(equations) else _looped_module(equations)


def _unrolled_module(equations: DiscreteEquations) -> Module:
    low = Lowering(equations)
    storage, held = dense(low.n, len(low.multipliers))
    degree = equations.scheme.degree
    written = step_equations(low, (Level.ITERATION,)) if solves_all(equations) else None
    kernels = [*unrolled_kernels(low, written), _energy(low)]
    if equations.plain.invariants:
        kernels.append(_invariants(low))
    kernels += [_power(low, low.template, _state(low))] if equations.plain.powers else []
    if written is None and few_equations(equations):
        # nodes have other velocities there than where those of some coordinates follow from p
        written = step_equations(low.of_all(equations.jet), tuple(Level))
    unknowns = sum(part_unknowns(part) for part in equations.parts) + equations.unknowns.behind
    functions = [] if written is None else [written]
    loops = _loops(low, storage, held, constant_mass=False, written=written)
    tables: dict[str, object] = {}
    follow = False
    if equations.rows:
        if written is None or equations.varied is not None:
            functions += unrolled_functions(low, ("jet", "mass") if held else ("jet",))
        if held:
            functions += constraint_functions(low, held, range(low.n), drifting=False)
            kernels.append(loops.multipliers())
            (part,) = equations.parts
            assert isinstance(part, Constrained)
            tables |= solve_tables(part, equations.scheme)
        kernels.append(loops.equations())
        tables |= storage.node_constants() | equation_constants(storage, degree, held)
    works = bool(equations.rows and equations.plain.powers)
    if unknowns or works or equations.varied is not None:
        solved = {a for _, a in increments(part_solvers(low))}
        following = tuple(int(a not in solved) for a in range(low.n))
        tables |= solve_constants(storage, equations.columns, held)
        follow = any(following)
        tables |= {"FOLLOWING": following} if follow else {}
    if unknowns:
        kernels.append(loops.pivoted(following=follow))
    if works:
        functions.append(power_function(low, low.template))
        kernels.append(loops.work(following=follow))
    return _finish_module(low, loops, functions, kernels, tables, unknowns)


def _looped_module(equations: DiscreteEquations) -> Module:
    low = Lowering(equations)
    part, degree = equations.joined(), equations.scheme.degree
    constant = isinstance(part, (Separable, Composed))
    structure = equations.system.structure
    plain = equations.plain
    terms, met = families(plain), constraint_families(plain)
    storage, held = dense(low.n, len(low.multipliers), len(plain.velocity_constraints))
    rolling = plain.velocity_constraints
    if "sparse" in equations.exploit:
        # an explicit step solves with M alone
        both = [family for family in terms if family.plain.M or not isinstance(part, Composed)]
        storage, held = smaller(storage, held, both, met, degree, plain.bound)
    names: tuple[str, ...] = ("gradient", "mass", "potential")
    kicked = drifting(equations)
    if held or not kicked:
        names = ("jet", *(("forces",) if constant and not kicked else ()), *names)
    if structure.constant_mass and structure.gyroscopic and equations.scheme.by_stages:
        names = (*names, "gyroscopic")
    tables: dict[str, object] = {}
    places = sorted(range(low.n), key=storage.order.__getitem__)
    low.stand(places)
    if storage.banded or _many(terms):
        functions, family_tables = family_functions(low, terms, places, names)
        tables |= family_tables
    else:
        functions = unrolled_functions(low, names)
    if held and not rolling and (storage.banded or _many(met)):
        more, family_tables = constraint_family_functions(low, met, places, drifting=kicked)
        functions += more
        tables |= family_tables
    elif held:
        functions += constraint_functions(low, held, places, drifting=kicked)
    loops = _loops(low, storage, held, constant_mass=constant or structure.constant_mass)
    tables |= loops.pivots
    if loops.pivots:
        low.pivot_scale(low.n - 1)
    kernels = loops.composed() if isinstance(part, Composed) else loops.step(part)
    kernels.append(loops.energy())
    if held:
        kernels.append(loops.multipliers())
    if equations.plain.invariants:
        kernels.append(_watched(low, loops.before_state()))
    if equations.plain.powers:
        state = Point("state", low.q, low.v, low.t, low.inputs(0))
        if plain.carried:
            behind = low.statements(
                pull_stores(low, replace(state, multipliers=low.multipliers)), STATE
            )
            around = loops.before_pushes(), (*loops.pushed(), *behind)
            kernels.append(_power(low, low.watched, state, *around))
        else:
            kernels.append(_power(low, low.watched, state, loops.before_state()))
    blocks = 0
    own_tables = {**storage.node_constants(), "MASS_BAND": storage.band_of(plain.M)}
    if not isinstance(part, Composed):
        kernels.append(loops.equations())
        kernels += [loops.pivoted(following=False)] if loops.in_order else []
        if part.columns and equations.plain.powers:
            functions.append(power_function(low, low.watched))
            kernels.append(loops.work(following=False))
        blocks = len(part.columns)
        own_tables |= {
            **equation_constants(storage, degree, held),
            **solve_constants(storage, part.columns, held),
            **solve_tables(part, equations.scheme),
        }
    else:
        own_tables |= {} if loops.alike else {"REACHED": tuple(accumulate(part.drifts))}
        own_tables |= held.constants(degree) if held else {}
    own_tables |= {"CARRIED": len(plain.forces)} if plain.carried else {}
    tables = own_tables | tables
    unknowns = blocks * low.n + (equations.unknowns.behind if blocks else 0)
    return _finish_module(low, loops, functions, kernels, tables, unknowns)


def _stage_kernels(
    low: Lowering, loops: LoopKernels, *, by_loops: bool
) -> StageKernels | LoopedStages | None:
    """Return the kernels that iterate on velocities and forces at the nodes, or None."""
    plain = low.equations.plain
    if not low.equations.scheme.by_stages or plain.rate is not None or loops.held:
        return None
    written = StageKernels(low) if low.n <= STAGE_COORDINATES else None
    if written is not None and written.kernels:
        return written
    pays = by_loops and loops.constant_mass and not loops.storage.banded
    return LoopedStages(low, loops) if pays else None


def _many(groups: Sequence[Family]) -> bool:
    """Return whether families have members enough to be worth a loop."""
    members = sum(len(family.coordinates) for family in groups)
    return members >= FAMILY_MEMBERS * len(groups)


def _loops(
    low: Lowering,
    storage: Storage,
    held: Held | None,
    *,
    constant_mass: bool,
    written: Function | None = None,
) -> LoopKernels:
    plain = low.equations.plain
    return LoopKernels(
        storage,
        low.equations.scheme.degree,
        plain.autonomous,
        plain.dragged,
        bool(plain.u),
        plain.rate is not None,
        held,
        constant_mass,
        # in a band rows are exchanged, as those of positions are
        bool(plain.velocity_constraints) and not (low.stiffened or storage.banded),
        plain.carried,
        None if written is None else written.call,
    )


def _finish_module(
    low: Lowering,
    loops: LoopKernels,
    functions: list[Function],
    kernels: list[Kernel],
    tables: dict[str, object],
    unknowns: int,
) -> Module:
    """Complete a module: derivatives, retiming, stages, set-up, tables, layout of the workspace.

    Derivatives of a step are taken of all that it is made of.
    """
    # the order of elimination in which Newton's method needs no exchange of rows serves here, too
    written = any(kernel.name == PIVOTED for kernel in kernels) and not loops.held
    in_order = written and unknowns == low.equations.unknowns.size and few_columns(low)
    more, own_kernels, own_tables = differentiating(
        low, loops, loops.storage.order, following="FOLLOWING" in tables, in_order=in_order
    )
    functions, kernels, tables = functions + more, kernels + own_kernels, tables | own_tables
    more, kernels = keeping_time(low, loops, kernels)
    functions = functions + more
    for_stages: tuple[Statement, ...] = ()
    by_loops = any(function.name == "gradient" for function in functions)
    stages = _stage_kernels(low, loops, by_loops=by_loops) if unknowns else None
    if not isinstance(stages, LoopedStages):  # nothing else takes a by itself
        functions = [f for f in functions if f.name.split("_")[0] != "gyroscopic"]
    if stages is not None:
        kernels = [*kernels, *stages.kernels]
        tables = {**tables, "STRIDE": stages.stride}
        for_stages = stages.constants
    if low.equations.plain.powers:
        tables = {**tables, "NODE_POWERS": len(low.equations.plain.powers)}
    if low.names.inputs:
        stride = node_stride(low.equations.scheme)
        tables = {**tables, "INPUTS": len(low.names.inputs), "INPUT_STRIDE": stride}
    coefficients, stores, products = coefficient_loops(low, low.coefficients)
    tables = {**tables, **products}
    if loops.damped:
        places = (*low.scheme.nodes, low.graph.of(1))
        stores += [Store(Row("GROWTH", i), low.growth(c)) for i, c in enumerate(places)]
    low.statements(stores, (Level.RUN,))
    stores += [Store(row, symbol) for symbol, row in low.hoisted_at(Level.RUN)]
    doc = "Compute what depends on the parameters and h alone."
    known = low.statements(stores, (Level.RUN,), "constants")
    prepare = Kernel("prepare", doc, lanes((*known, *coefficients, *for_stages)))
    first, rows = layout(sizes(low, loops, stages, by_columns=in_order))
    return Module(
        low.names,
        tuple(functions),
        (prepare, *kernels),
        low.graph.constants,
        first,
        rows,
        unknowns,
        tables,
    )


def _energy(low: Lowering) -> Kernel:
    doc = "The Hamiltonian at (q, p), its kinetic part, and the velocities."
    return Kernel("energy", doc, lanes(low.statements(energy_stores(low), STATE)))


def _invariants(low: Lowering) -> Kernel:
    """Return the kernel of the invariants, for velocities that are written out."""
    return _watching(low, low.template, _state(low))


def _state(low: Lowering) -> Point:
    """Return the state with its velocities, of a system that is written out."""
    start = low.start_point()
    v, _ = velocity(low, start, low.p, "velocity")
    return Point(f"{start.suffix}_state", start.q, tuple(v), start.t, start.u)


def _power(
    low: Lowering,
    template: JetTemplate,
    point: Point,
    before: tuple[Statement, ...] = (),
    behind: tuple[Statement, ...] = (),
) -> Kernel:
    """Return the kernel of the powers of forces, then dL/dt where L depends on t."""
    stores = power_stores(low, template, point)
    doc = "Power of each force, then dL/dt where L depends on t, at (q, p)."
    return Kernel("power", doc, lanes((*before, *low.statements(stores, STATE), *behind)))


def _watched(low: Lowering, before: tuple[Statement, ...]) -> Kernel:
    """Return the kernel of the invariants, where loops solve for the velocities ``before``."""
    state = Point("state", low.q, low.v, low.start_point().t)
    return _watching(low, low.watched, state, before)


def _watching(
    low: Lowering, template: JetTemplate, point: Point, before: tuple[Statement, ...] = ()
) -> Kernel:
    section = "invariants"
    stores = [
        Store(Row("INVARIANT", i), template.entry(point, section, "invariant", name))
        for i, name in enumerate(low.equations.plain.invariants)
    ]
    doc = "Quantities that the exact flow conserves, at (q, p)."
    return Kernel("invariants", doc, lanes((*before, *low.statements(stores, STATE))))
