"""The kernels of a module, and which of the two forms a system gets."""

from __future__ import annotations

import sympy as sp

from symsimpson.codegen.coefficients import coefficient_loops
from symsimpson.codegen.ir import Call, Function, Kernel, Module, Row, Statement, Store
from symsimpson.codegen.layout import layout
from symsimpson.codegen.levels import Level
from symsimpson.codegen.looped import (
    composed_kernels,
    energy_kernel,
    equations_kernel,
    looped_kernels,
    pivoted_kernel,
    solve_constants,
    solve_tables,
)
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.stages import StageKernels
from symsimpson.codegen.storage import Storage
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.codegen.terms_of_l import family_functions, unrolled_functions
from symsimpson.codegen.unrolled import (
    STATE,
    increments,
    lanes,
    part_solvers,
    unrolled_kernels,
    velocity,
)
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.families import families, neighbours, ordering
from symsimpson.discrete.reductions import Composed, Linear, Part, Routh, Separable

__all__ = ["UNROLLED_UNKNOWNS", "lower", "unrolled"]

#: Straight lines are written up to about so many: each takes some 3 ms to compile, and loops, of
#: which each is a function of its own, 12 s in all. They run two to five times as fast.
MOST_LINES = 4000
#: Parts with more unknowns are not written out, whatever they are made of.
UNROLLED_UNKNOWNS = 16
#: Nor are explicit steps with more forces, one for each kick and coordinate.
UNROLLED_FORCES = 270
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
    return _unrolled(equations) if unrolled(equations) else _looped(equations)


def unrolled(equations: DiscreteEquations) -> bool:
    """Return whether the parts are written out one by one, or all as loops."""
    few = all(_size(part) <= UNROLLED_UNKNOWNS for part in equations.parts)
    return equations.scheme.exact and few and _lines(equations) <= MOST_LINES


def _lines(equations: DiscreteEquations) -> float:
    """Estimate how many lines all kernels have, from operations that are known before.

    Two kernels evaluate the jet at all nodes and eliminate, others parts of it once.
    """
    operations, stages = equations.jet.operations, equations.scheme.stages
    if any(isinstance(part, Composed) for part in equations.parts):
        return operations + equations.jet.force_operations * stages
    unknowns = [part_unknowns(part) for part in equations.parts]
    elimination = sum(u**2 + u**3 / 12 for u in unknowns)
    return (2 * stages + 1.5) * operations + 2 * elimination


def _unrolled(equations: DiscreteEquations) -> Module:
    low = Lowering(equations)
    storage, degree = Storage.dense(low.n), equations.scheme.degree
    kernels = [*unrolled_kernels(low), _energy(low)]
    if equations.plain.invariants:
        kernels.append(_invariants(low))
    unknowns = sum(part_unknowns(part) for part in equations.parts)
    functions: list[Function] = []
    tables: dict[str, object] = {}
    if equations.rows:
        functions = unrolled_functions(low, ("jet",))
        kernels.append(equations_kernel(storage, degree))
        tables = storage.node_constants() | storage.constants("EQUATION", degree)
    if unknowns:
        solved = {a for _, a in increments(part_solvers(low))}
        following = tuple(int(a not in solved) for a in range(low.n))
        kernels.append(pivoted_kernel(storage, degree, following=any(following)))
        tables |= solve_constants(storage, equations.columns)
        tables |= {"FOLLOWING": following} if any(following) else {}
    return _module(low, storage, functions, kernels, tables, unknowns, constant_mass=False)


def _looped(equations: DiscreteEquations) -> Module:
    low = Lowering(equations)
    part, degree = equations.joined(), equations.scheme.degree
    constant = isinstance(part, (Separable, Composed))
    found = families(equations.plain)
    storage = Storage.dense(low.n)
    if "sparse" in equations.exploit:
        # an explicit step solves with M alone
        met = (
            [family for family in found if family.plain.M] if isinstance(part, Composed) else found
        )
        banded = Storage(*ordering(neighbours(met, low.n)), banded=True)
        if banded.size(degree) < storage.size(degree):
            storage = banded
    names = ("gradient", "mass", "potential")
    if not isinstance(part, Composed):
        names = ("jet", *(("forces",) if constant else ()), *names)
    tables: dict[str, object] = {}
    members = sum(len(family.coordinates) for family in found)
    if storage.banded or members >= FAMILY_MEMBERS * len(found):
        places = sorted(range(low.n), key=storage.order.__getitem__)
        functions, own = family_functions(low, found, places, names)
        tables |= own
    else:
        functions = unrolled_functions(low, names)
    kernels = (
        composed_kernels() if isinstance(part, Composed) else looped_kernels(part, storage, degree)
    )
    kernels.append(energy_kernel())
    if equations.plain.invariants:
        kernels.append(_watched(low))
    blocks = 0
    own_tables = storage.node_constants()
    if not isinstance(part, Composed):
        kernels.append(equations_kernel(storage, degree))
        blocks = len(part.columns)
        own_tables |= {
            **storage.constants("EQUATION", degree),
            **solve_constants(storage, part.columns),
            **solve_tables(part, equations.scheme),
        }
    tables = own_tables | tables
    unknowns = blocks * low.n
    return _module(low, storage, functions, kernels, tables, unknowns, constant_mass=constant)


def _module(
    low: Lowering,
    storage: Storage,
    functions: list[Function],
    kernels: list[Kernel],
    tables: dict[str, object],
    unknowns: int,
    *,
    constant_mass: bool,
) -> Module:
    """Add what is computed once a run, when it is known what that is; lay out the workspace."""
    for_stages: tuple[Statement, ...] = ()
    stage_sizes: dict[str, int] = {}
    if low.equations.scheme.by_stages and low.n <= STAGE_COORDINATES:
        stages = StageKernels(low)
        kernels = [*kernels, *stages.kernels]
        stage_sizes = stages.sizes
        if stages.kernels:
            tables = {**tables, "STRIDE": stages.stride}
            for_stages = (Call("stage_constants", ("W", "h", "lane")),)
    own = [value.xreplace(low.parameters) for value in low.coefficients]
    loops, stores, products = coefficient_loops(low, own)
    tables = {**tables, **products}
    low.statements(stores, (Level.RUN,))
    stores += [Store(row, symbol) for symbol, row in low.hoisted_at(Level.RUN)]
    doc = "What depends on the parameters and h alone."
    known = low.statements(stores, (Level.RUN,), "constants")
    prepare = Kernel("prepare", doc, lanes((*known, *loops, *for_stages)))
    sizes = {
        "PARAMETER": len(low.names.parameters),
        "INVARIANT": len(low.names.invariants),
        "HOISTED": len(low.hoisted),
        "COEFFICIENT": len(low.coefficients),
        **stage_sizes,
    }
    first, rows = layout(storage, low.equations.unknowns, sizes, constant_mass=constant_mass)
    return Module(
        low.names, tuple(functions), (prepare, *kernels), low.graph.constants, first, rows,
        unknowns, tables,
    )  # fmt: skip


def _size(part: Part) -> int:
    """Measure a part by its unknowns or multipliers, others by what their text is as long as."""
    if isinstance(part, Linear):
        return 2 * len(part.coordinates)
    if isinstance(part, Composed):
        forces = len(part.coordinates) * len(part.drifts)
        return UNROLLED_UNKNOWNS * forces // UNROLLED_FORCES
    multipliers = len(part.cyclic) * len(part.annihilator) if isinstance(part, Routh) else 0
    return max(part_unknowns(part), multipliers)


def part_unknowns(part: Part) -> int:
    """Count the unknowns that a part solves for together."""
    return len(part.coordinates) * len(part.columns)


def _energy(low: Lowering) -> Kernel:
    """H = v.(p - a)/2 + V, and the first of the two alone."""
    point, section = low.start_point(), "energy"
    v, _ = velocity(low, point, low.p, "velocity")
    terms = [
        v[i] * (low.p[i] - low.template.entry(point, section, "a", i)) / 2 for i in range(low.n)
    ]
    kinetic = low.graph.define("kinetic_value", sp.Add(*terms), section)
    value = sp.Add(low.template.entry(point, section, "V"), kinetic)
    stores = (
        Store(Row("ENERGY", 0), low.graph.define("energy_value", value, section)),
        Store(Row("KINETIC", 0), kinetic),
        *(Store(Row("VELOCITY", a), v[a]) for a in range(low.n)),
    )
    doc = "The Hamiltonian at (q, p), its kinetic part, and the velocities."
    return Kernel("energy", doc, lanes(low.statements(stores, STATE)))


def _invariants(low: Lowering) -> Kernel:
    """The quantities to watch, of a system that is written out."""
    start, section = low.start_point(), "velocity"
    v, _ = velocity(low, start, low.p, section)
    return _watching(low, low.template, Point(f"{start.suffix}_state", start.q, tuple(v)))


def _watched(low: Lowering) -> Kernel:
    """The quantities to watch, where loops solve for the velocities."""
    names = ("path_start", "mass", "factor_mass", "momentum_to_solve", "solve_mass")
    before = tuple(Call(name, ("W", "lane")) for name in names)
    return _watching(low, low.watched, Point("state", low.q, low.v), before)


def _watching(
    low: Lowering, template: JetTemplate, point: Point, before: tuple[Call, ...] = ()
) -> Kernel:
    section = "invariants"
    stores = [
        Store(Row("INVARIANT", i), template.entry(point, section, "invariant", name))
        for i, name in enumerate(low.equations.plain.invariants)
    ]
    doc = "Quantities that the exact flow conserves, at (q, p)."
    return Kernel("invariants", doc, lanes((*before, *low.statements(stores, STATE))))
