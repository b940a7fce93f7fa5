"""The kernels of a module, written out or as loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from symsimpson.codegen.coefficients import coefficient_loops
from symsimpson.codegen.constraint_functions import (
    constraint_family_functions,
    constraint_functions,
)
from symsimpson.codegen.constraint_order import Held, dense, smaller
from symsimpson.codegen.differentials import differentiating, few_columns
from symsimpson.codegen.facts import facts
from symsimpson.codegen.forms import few_equations, part_unknowns, solves_all, unrolled
from symsimpson.codegen.ir import Call, Function, Kernel, Loop, Module, Row, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.loop_tables import (
    equation_constants,
    loop_sizes,
    solve_constants,
    solve_tables,
)
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.retimed_kernels import keeping_time
from symsimpson.codegen.sizes import drifting, sizes
from symsimpson.codegen.specialise import kernel_from_text
from symsimpson.codegen.stages import Stages, looped_stages, traced_stages
from symsimpson.codegen.storage import Storage, node_stride
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.codegen.terms_of_l import (
    cyclic_function,
    family_functions,
    power_function,
    power_stores,
    pull_stores,
    unrolled_functions,
)
from symsimpson.codegen.traced_explicit import explicit_facts, explicit_tables, own_time
from symsimpson.codegen.traced_kernels import (
    STATE,
    TracedKernels,
    TracedState,
    lanes,
    step_equations,
)
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.families import Family, constraint_families, families
from symsimpson.discrete.reductions import Composed, Constrained, Routh, Separable
from symsimpson.module.interface import PIVOTED
from symsimpson.module.workspace_layout import layout

__all__ = ["lower"]

#: Loops over families of terms are worth their indices from so many members on, on average.
FAMILY_MEMBERS = 2
#: With more coordinates than this, nodes are not taken as lanes: a solve at each takes n^3/6.
STAGE_COORDINATES = 24
_AT_STATE = ("W", "t", "lane")


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
    rolling = len(equations.plain.velocity_constraints)
    storage, held = dense(low.n, len(low.multipliers), rolling)
    degree = equations.scheme.degree
    written = step_equations(low, (Level.ITERATION,)) if solves_all(equations) else None
    traced = TracedKernels(low)
    kernels = [*traced.kernels(written), _energy(low)]
    if equations.plain.invariants:
        kernels.append(_invariants(low))
    if equations.plain.carried:
        kernels.append(_looped_power(low))
    elif equations.plain.powers:
        kernels.append(_power(low, low.template, _state(low)))
    if written is None and few_equations(equations):
        # nodes have other velocities there than where those of some coordinates follow from p
        written = step_equations(low.of_all(equations.jet), tuple(Level))
    unknowns = sum(part_unknowns(part) for part in equations.parts) + equations.unknowns.behind
    functions = [] if written is None else [written]
    loops = _loops(low, storage, held, constant_mass=False, written=written)
    tables: dict[str, object] = {}
    names: list[str] = []
    follow = False
    if equations.rows:
        if written is None or equations.varied is not None:
            functions += unrolled_functions(low, ("jet", "mass") if held else ("jet",))
        if held:
            functions += constraint_functions(low, held, range(low.n), drifting=False)
            names += ["multipliers"]
            (part,) = equations.parts
            assert isinstance(part, Constrained)
            tables |= solve_tables(part, equations.scheme)
        names += ["equations"]
        tables |= storage.node_constants() | equation_constants(storage, degree, held)
        tables |= loop_sizes(loops)
    works = bool(equations.rows and equations.plain.powers)
    if unknowns or works or equations.varied is not None:
        solved = {a for _, a in traced.increments}
        following = tuple(int(a not in solved) for a in range(low.n))
        tables |= solve_constants(storage, equations.columns, held)
        follow = any(following)
        tables |= {"FOLLOWING": following} if follow else {}
    if unknowns:
        names += [PIVOTED]
    if equations.plain.carried:
        tables |= {"CARRIED": len(equations.plain.forces)}
    if works:
        functions.append(power_function(low, low.template))
        names += ["work"]
    known = facts(low, loops, equations.parts[0], following=follow)
    # texts that are not traced solve for all coordinates together
    known |= {"SEPARABLE": False, "FOLLOWS": False, "CYCLIC": 0}
    kernels += [kernel_from_text(name, known) for name in names]
    return _finish_module(low, loops, functions, kernels, tables, unknowns, known)


def _looped_module(equations: DiscreteEquations) -> Module:
    low = Lowering(equations)
    degree = equations.scheme.degree
    structure = equations.system.structure
    plain = equations.plain
    terms, met = families(plain), constraint_families(plain)
    storage, held = dense(low.n, len(low.multipliers), len(plain.velocity_constraints))
    rolling = plain.velocity_constraints
    if "sparse" in equations.exploit:
        # an explicit step solves with M alone
        both = [family for family in terms if family.plain.M or not drifting(equations)]
        storage, held = smaller(storage, held, both, met, degree, plain.bound)
    part = equations.joined(dense=not storage.banded)
    constant = isinstance(part, (Separable, Composed))
    routh = part if isinstance(part, Routh) else None
    if routh is not None:  # elimination takes the others, and stops
        storage = replace(storage, order=(*part.coordinates, *routh.cyclic))
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
        functions = unrolled_functions(low, names, places)
    functions += [] if routh is None else [cyclic_function(low, routh)]
    if held and not rolling and (storage.banded or _many(met)):
        more, family_tables = constraint_family_functions(low, met, places, drifting=kicked)
        functions += more
        tables |= family_tables
    elif held:
        functions += constraint_functions(low, held, places, drifting=kicked)
    constant = constant or structure.constant_mass
    loops = replace(_loops(low, storage, held, constant_mass=constant), routh=routh)
    tables |= loops.pivots
    if loops.pivots:
        low.pivot_scale(low.n - 1)
    known = facts(low, loops, part) | explicit_facts(low)
    step = ("start", "legendre", *(("newton",) if part.columns else ()), "advance", "energy")
    kernels = [_kernel(name, known) for name in (*step, *(("multipliers",) if held else ()))]
    if equations.plain.invariants:
        kernels.append(_watched(low, (Call("find_velocity", _AT_STATE),)))
    if equations.plain.powers:
        kernels.append(_looped_power(low))
    blocks = 0
    own_tables = {**storage.node_constants(), "MASS_BAND": storage.band_of(plain.M)}
    if not isinstance(part, Composed):
        kernels.append(kernel_from_text("equations", known))
        kernels += [kernel_from_text(PIVOTED, known)] if loops.in_order else []
        if part.columns and equations.plain.powers:
            functions.append(power_function(low, low.watched))
            kernels.append(kernel_from_text("work", known))
        blocks = len(part.columns)
        own_tables |= {
            **equation_constants(storage, degree, held),
            **solve_constants(storage, part.columns, held),
            **solve_tables(part, equations.scheme),
            **loop_sizes(loops),
        }
        if isinstance(part, Separable):
            own_tables["SOLVE_ENTRIES"] = storage.size(blocks)
    else:
        own_tables |= explicit_tables(low, range(low.n))
        functions += [own_time(low)] if known["RETIMED"] else []
        own_tables |= held.constants(degree) if held else {}
    own_tables |= {"CARRIED": len(plain.forces)} if plain.carried else {}
    tables = own_tables | tables
    unknowns = blocks * len(part.coordinates) + (equations.unknowns.behind if blocks else 0)
    return _finish_module(low, loops, functions, kernels, tables, unknowns, known)


def _kernel(name: str, known: Mapping[str, object]) -> Kernel:
    """Return a kernel of loops; a step without equations is taken as many times as it is told."""
    kernel = kernel_from_text(name, known)
    if name != "advance" or known["ITERATED"]:
        return kernel
    return replace(kernel, body=(Loop("step", "range(int(W[COUNT, 0]))", kernel.body),))


def _stage_kernels(
    low: Lowering, loops: LoopKernels, known: Mapping[str, object], *, by_loops: bool
) -> Stages | None:
    """Return the kernels that iterate on velocities and forces at the nodes, or None."""
    plain = low.equations.plain
    if not low.equations.scheme.by_stages or plain.rate is not None or loops.held:
        return None
    traced = traced_stages(low, known) if low.n <= STAGE_COORDINATES else None
    pays = by_loops and loops.constant_mass and not loops.storage.banded
    return looped_stages(low, known) if traced is None and pays else traced


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
        held,
        constant_mass,
        # in a band rows are exchanged, as those of positions are
        bool(plain.velocity_constraints) and not (low.stiffened or storage.banded),
        plain.carried,
        written is not None,
    )


def _finish_module(
    low: Lowering,
    loops: LoopKernels,
    functions: list[Function],
    kernels: list[Kernel],
    tables: dict[str, object],
    unknowns: int,
    known: dict[str, object],
) -> Module:
    """Complete a module: derivatives, retiming, stages, set-up, tables, layout of the workspace.

    Derivatives of a step are taken of all that it is made of.
    """
    # the order of elimination in which Newton's method needs no exchange of rows serves here, too
    written = any(kernel.name == PIVOTED for kernel in kernels) and not loops.held
    in_order = written and unknowns == low.equations.unknowns.size and few_columns(low)
    known = known | {"BY_COLUMNS": in_order}
    more, own_kernels, own_tables = differentiating(low, loops, known)
    functions, kernels, tables = functions + more, kernels + own_kernels, tables | own_tables
    more, kernels = keeping_time(low, known, kernels)
    functions = functions + more
    for_stages: tuple[Statement, ...] = ()
    by_loops = any(function.name == "gradient" for function in functions)
    stages = _stage_kernels(low, loops, known, by_loops=by_loops) if unknowns else None
    if stages is None or stages.functions:  # nothing else takes a by itself
        functions = [f for f in functions if f.name.split("_")[0] != "gyroscopic"]
    if stages is not None:
        kernels, functions = [*kernels, *stages.kernels], [*functions, *stages.functions]
        tables = {**tables, **stages.tables}
        for_stages = stages.constants
    if low.equations.plain.powers:
        tables = {**tables, "NODE_POWERS": len(low.equations.plain.powers)}
    if low.names.inputs:
        stride = node_stride(low.equations.scheme)
        tables = {**tables, "INPUTS": len(low.names.inputs), "INPUT_STRIDE": stride}
    coefficients, stores, products = coefficient_loops(low, low.coefficients)
    tables = {**tables, **products}
    if low.equations.plain.rate is not None:
        stores += [Store(Row("GROWTH", i), x) for i, x in enumerate(low.growths())]
    if decaying := bool(known.get("FRICTION")):
        rates = enumerate(map(low.known, low.equations.plain.rates))
        stores += [Store(Row("DECAY", a), rate) for a, rate in rates]
    low.statements(stores, (Level.RUN,))
    stores += [Store(row, symbol) for symbol, row in low.hoisted_at(Level.RUN)]
    doc = "Compute what depends on the parameters and h alone."
    constants = low.statements(stores, (Level.RUN,), "constants")
    prepare = Kernel("prepare", doc, lanes((*constants, *coefficients, *for_stages)))
    first, rows = layout(sizes(low, loops, stages, by_columns=in_order, decaying=decaying))
    return Module(
        low.names,
        tuple(functions),
        (prepare, *kernels),
        low.graph.constants,
        first,
        rows,
        unknowns,
        tables,
        {**known, **(stages.facts if stages is not None else {})},
    )


def _energy(low: Lowering) -> Kernel:
    doc = "The Hamiltonian at (q, p), its kinetic part, and the velocities."
    return Kernel("energy", doc, lanes(low.statements(TracedState(low).energy(), STATE)))


def _invariants(low: Lowering) -> Kernel:
    """Return the kernel of the invariants, for velocities that are written out."""
    return _watching(low, low.template, _state(low))


def _state(low: Lowering) -> Point:
    """Return the state with its velocities, of a system that is written out."""
    start = low.start_point()
    v = TracedState(low).velocity()
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


def _looped_power(low: Lowering) -> Kernel:
    """Return the kernel of powers, where loops solve for velocities and for multipliers."""
    state = Point("state", low.q, low.v, low.t, low.inputs(0))
    if not low.equations.plain.carried:
        return _power(low, low.watched, state, (Call("find_velocity", _AT_STATE),))
    pulls = pull_stores(low, replace(state, multipliers=low.multipliers))
    behind = (Call("find_multipliers"), *low.statements(pulls, STATE))
    return _power(low, low.watched, state, (Call("find_allowed_velocity", _AT_STATE),), behind)


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
