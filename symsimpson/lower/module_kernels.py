"""The kernels of a module, written out or as loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.families import Family, constraint_families, families
from symsimpson.discrete.reductions import Composed, Part, Routh, Separable
from symsimpson.lower import terms_of_l
from symsimpson.lower.constraint_functions import constraint_family_functions, constraint_functions
from symsimpson.lower.differentials import differentiating, traces_end
from symsimpson.lower.differentials import sizes as differential_sizes
from symsimpson.lower.facts import equation_constants, facts, sizes, solve_constants, solve_tables
from symsimpson.lower.forms import drifting, few_equations, part_unknowns, solves_all, unrolled
from symsimpson.lower.ir import Call, Function, Kernel, Module, Store, stored
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.specialise import kernel_from_text
from symsimpson.lower.stages import Stages, TracedStages, looped_stages
from symsimpson.lower.state_kernels import MANY_STEPS, keeping_time, lanes, watching_kernels
from symsimpson.lower.storage import Held, LoopKernels, dense, node_stride, smaller
from symsimpson.lower.traced_kernels import TracedKernels, step_equations
from symsimpson.lower.traced_steps import explicit_facts, explicit_tables, own_time
from symsimpson.text.interface import PIVOTED
from symsimpson.text.workspace_layout import layout

#: Loops over families of terms are worth their indices from so many members on, on average.
FAMILY_MEMBERS = 2
#: With more coordinates than this, nodes are not taken as lanes: a solve at each takes n^3/6.
STAGE_COORDINATES = 24


def lower(equations: DiscreteEquations) -> Module:
    """Lower the equations of a step to the kernels of a module."""
    writer = _ModuleWriter(equations)
    if unrolled(equations):
        writer.trace_kernels()
    else:
        writer.write_loops()
    return writer.module()


class _ModuleWriter:
    """Puts kernels, the functions that they call, and tables together."""

    loops: LoopKernels

    def __init__(self, equations: DiscreteEquations) -> None:
        self.equations, self.low = equations, Lowering(equations)
        self.functions: list[Function] = []
        self.kernels: list[Kernel] = []
        self.tables: dict[str, object] = {}
        self.known: dict[str, object] = {}
        self.unknowns = 0
        rolling = len(equations.plain.velocity_constraints)
        self.storage, self.held = dense(self.low.n, len(self.low.multipliers), rolling)

    def _set_loops(self, **more: Any) -> None:
        """Say how loops find coordinates, unknowns and matrix entries."""
        # in a band rows are exchanged, as those of positions are
        in_order = bool(self.equations.plain.velocity_constraints)
        in_order = in_order and not (self.low.stiffened or self.storage.banded)
        degree = self.equations.scheme.degree
        self.loops = LoopKernels(self.storage, degree, self.held, in_order=in_order, **more)

    def _write(self, *names: str) -> None:
        """Add kernels whose texts are in the library."""
        self.kernels += [kernel_from_text(name, self.known) for name in names]

    def trace_kernels(self) -> None:
        """Write the kernels of a small system as straight-line code."""
        low, equations = self.low, self.equations
        storage, held = self.storage, self.held
        written = step_equations(low, (Level.ITERATION,)) if solves_all(equations) else None
        traced = TracedKernels(low)
        self.kernels = [*traced.kernels(written), *watching_kernels(low, traced.state)]
        if written is None and few_equations(equations):
            # nodes have other velocities there than where those of some coordinates follow from p
            written = step_equations(low.of_all(equations.jet), tuple(Level))
        self._set_loops(written=written is not None)
        self.functions = [] if written is None else [written]
        if equations.rows:
            self._add_equations()
        self.unknowns = sum(part_unknowns(part) for part in equations.parts)
        self.unknowns += equations.unknowns.behind
        works = bool(equations.rows and equations.plain.powers)
        following: tuple[int, ...] = ()
        if self.unknowns or works or equations.varied is not None:
            solved = {a for _, a in traced.increments}
            following = tuple(int(a not in solved) for a in range(low.n))
            self.tables |= solve_constants(storage, equations.columns, held)
            self.tables |= {"FOLLOWING": following} if any(following) else {}
        if equations.plain.carried:
            self.tables |= {"CARRIED": len(equations.plain.forces)}
        if works:
            self.functions.append(terms_of_l.power_function(low, low.template))
        self.known = facts(low, self.loops, equations.parts[0], following=any(following))
        # texts that are not traced solve for all coordinates together
        self.known |= {"SEPARABLE": False, "FOLLOWS": False, "CYCLIC": 0}
        names = {"multipliers": held, "equations": equations.rows, PIVOTED: self.unknowns}
        self._write(*(name for name, needed in (names | {"work": works}).items() if needed))

    def _add_equations(self) -> None:
        """Add what loops over the equations of a step call and read."""
        low, equations, held = self.low, self.equations, self.held
        if not self.loops.written or equations.varied is not None:
            names = ("jet", "mass") if held else ("jet",)
            self.functions += terms_of_l.unrolled_functions(low, names)
        if held:
            self.functions += constraint_functions(low, held, range(low.n), drifting=False)
            self.tables |= solve_tables(equations.parts[0], equations.scheme)
        self.tables |= self.storage.node_constants()
        self.tables |= equation_constants(self.storage, equations.scheme.degree, held)

    def write_loops(self) -> None:
        """Write the kernels of a large system as loops."""
        low, equations, plain = self.low, self.equations, self.equations.plain
        storage, held = self.storage, self.held
        terms, kicked = families(plain), drifting(equations)
        if "sparse" in equations.exploit:
            # an explicit step solves with M alone
            both = [family for family in terms if family.plain.M or not kicked]
            met, degree = constraint_families(plain), equations.scheme.degree
            storage, held = smaller(storage, held, both, met, degree, plain.bound)
        part = equations.joined(dense=not storage.banded)
        routh = part if isinstance(part, Routh) else None
        if routh is not None:  # elimination takes the others, and stops
            storage = replace(storage, order=(*part.coordinates, *routh.cyclic))
        self.storage, self.held = storage, held
        constant = isinstance(part, (Separable, Composed))
        places = sorted(range(low.n), key=storage.order.__getitem__)
        low.stand(places)
        own_tables = self._add_jet(places, constant=constant)
        if routh is not None:
            self.functions.append(terms_of_l.cyclic_function(low, routh))
        if held:
            own_tables |= self._add_constraints(held, places)
        constant = constant or equations.system.structure.constant_mass
        self._set_loops(constant_mass=constant, routh=routh)
        if self.loops.pivots:
            low.pivot_scale(low.n - 1)
        self.known = facts(low, self.loops, part) | explicit_facts(low)
        self._write("start", "legendre", *(("newton",) if part.columns else ()), "advance")
        if not part.columns:  # a step without equations is taken as often as a run asks
            advance = self.kernels[-1]
            self.kernels[-1] = replace(advance, body=(replace(MANY_STEPS, body=advance.body),))
        self._write("energy", *(("multipliers",) if held else ()))
        self.kernels += watching_kernels(low, None)
        self.tables = storage.node_constants() | {"MASS_BAND": storage.band_of(plain.M)}
        if isinstance(part, Composed):
            self._add_kicks()
        else:
            self._add_unknowns(part)
        self.tables |= {"CARRIED": len(plain.forces)} if plain.carried else {}
        self.tables |= own_tables | self.loops.pivots

    def _add_jet(self, places: Sequence[int], *, constant: bool) -> dict[str, terms_of_l.Table]:
        """Add the functions that evaluate L and forces; return tables of families."""
        low, equations, terms = self.low, self.equations, families(self.equations.plain)
        structure, kicked = equations.system.structure, drifting(equations)
        names: tuple[str, ...] = ("gradient", "mass", "potential")
        if equations.plain.held or not kicked:
            names = ("jet", *(("forces",) if constant and not kicked else ()), *names)
        if structure.constant_mass and structure.gyroscopic and equations.scheme.by_stages:
            names = (*names, "gyroscopic")
        if not (self.storage.banded or _many(terms)):
            self.functions = terms_of_l.unrolled_functions(low, names, places)
            return {}
        self.functions, tables = terms_of_l.family_functions(low, terms, places, names)
        return tables

    def _add_constraints(self, held: Held, places: Sequence[int]) -> dict[str, terms_of_l.Table]:
        """Add the functions that evaluate constraints; return tables of families."""
        low, plain, kicked = self.low, self.equations.plain, drifting(self.equations)
        met = constraint_families(plain)
        if plain.velocity_constraints or not (self.storage.banded or _many(met)):
            self.functions += constraint_functions(low, held, places, drifting=kicked)
            return {}
        functions, tables = constraint_family_functions(low, met, places, drifting=kicked)
        self.functions += functions
        return tables

    def _add_kicks(self) -> None:
        """Add what steps of kicks and drifts call and read."""
        low = self.low
        self.tables |= explicit_tables(low, range(low.n))
        if self.known["RETIMED"]:
            self.functions.append(own_time(low))
        self.tables |= self.held.constants(self.equations.scheme.degree) if self.held else {}

    def _add_unknowns(self, part: Part) -> None:
        """Add what steps by Newton's method call and read."""
        loops, equations = self.loops, self.equations
        self._write("equations", *((PIVOTED,) if loops.in_order else ()))
        if part.columns and equations.plain.powers:
            self.functions.append(terms_of_l.power_function(self.low, self.low.watched))
            self._write("work")
        self.tables |= equation_constants(loops.storage, loops.degree, loops.held)
        self.tables |= solve_constants(loops.storage, part.columns, loops.held)
        self.tables |= solve_tables(part, equations.scheme)
        if isinstance(part, Separable):
            self.tables["SOLVE_ENTRIES"] = loops.storage.size(len(part.columns))
        if part.columns:
            self.unknowns = part_unknowns(part) + equations.unknowns.behind

    def _stages(self) -> Stages:
        """Return the kernels that iterate on velocities and forces at the nodes, if it pays."""
        by_loops = any(function.name == "gradient" for function in self.functions)
        stages = None
        if self.unknowns:
            stages = _stage_kernels(self.low, self.loops, self.known, by_loops=by_loops)
        if stages is None or stages.functions:  # nothing else takes a by itself
            others = (f for f in self.functions if f.name.split("_")[0] != "gyroscopic")
            self.functions = [*others]
        return stages or Stages()

    def module(self) -> Module:
        """Complete a module: derivatives, retiming, stages, set-up, layout of the workspace.

        Derivatives of a step are taken of all that it consists of.
        """
        low, loops, plain = self.low, self.loops, self.equations.plain
        differentiated = self.equations.varied is not None and unrolled(self.equations)
        by_columns = differentiated and traces_end(low)
        self.known["BY_COLUMNS"] = by_columns
        functions, kernels, tables = differentiating(low, loops, self.known)
        more, self.kernels = keeping_time(low, self.known, [*self.kernels, *kernels])
        self.functions += functions + more
        stages = self._stages()
        self.tables |= tables | stages.tables
        if plain.powers:
            self.tables["NODE_POWERS"] = len(plain.powers)
        if low.names.inputs:
            self.tables["INPUTS"] = len(low.names.inputs)
            self.tables["INPUT_STRIDE"] = node_stride(self.equations.scheme)
        prepare = self._prepare(stages)
        more_sizes = {**stages.sizes, **differential_sizes(low, by_columns=by_columns)}
        first, rows = layout(
            sizes(low, loops, decaying=bool(self.known.get("FRICTION")), **more_sizes)
        )
        return Module(
            low.names,
            (*self.functions, *stages.functions),
            (prepare, *self.kernels, *stages.kernels),
            low.graph.constants,
            first,
            rows,
            self.unknowns,
            self.tables,
            self.known | stages.facts,
        )

    def _prepare(self, stages: Stages) -> Kernel:
        """Return the kernel that begins a run."""
        low, plain = self.low, self.equations.plain
        coefficients, stores, products = terms_of_l.coefficient_loops(low, low.coefficients)
        self.tables |= products
        if plain.rate is not None:
            stores += stored("GROWTH", low.growths())
        if self.known.get("FRICTION"):
            stores += stored("DECAY", map(low.known, plain.rates))
        low.statements(stores, (Level.RUN,))
        stores += [Store(row, symbol) for symbol, row in low.hoisted_at(Level.RUN)]
        doc = "Compute what depends on the parameters and h alone."
        constants = low.statements(stores, (Level.RUN,), "constants")
        begin = (Call("stage_constants", ("W", "h", "lane")),) if stages.kernels else ()
        return Kernel("prepare", doc, lanes((*constants, *coefficients, *begin)))


def _stage_kernels(
    low: Lowering, loops: LoopKernels, known: Mapping[str, object], *, by_loops: bool
) -> Stages | None:
    """Return the kernels that iterate on velocities and forces at the nodes, or None."""
    if not low.equations.scheme.by_stages or low.equations.plain.rate is not None or loops.held:
        return None
    traced = TracedStages(low, known).stages() if low.n <= STAGE_COORDINATES else None
    pays = by_loops and loops.constant_mass and not loops.storage.banded
    return looped_stages(low, known) if traced is None and pays else traced


def _many(groups: Sequence[Family]) -> bool:
    """Return whether families have members enough to be worth a loop."""
    members = sum(len(family.coordinates) for family in groups)
    return members >= FAMILY_MEMBERS * len(groups)
