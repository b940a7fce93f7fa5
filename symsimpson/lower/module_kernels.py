"""The kernels of a module, as straight-line code or as loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from symsimpson.declare.plain import Plain
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.families import Family, find_constraint_families, find_families
from symsimpson.discrete.reductions import Composed, Part, Routh, Separable
from symsimpson.lower import terms_of_l
from symsimpson.lower.constraint_functions import constraint_family_functions, constraint_functions
from symsimpson.lower.differentials import derivative_kernels, traces_end
from symsimpson.lower.differentials import sizes as differential_sizes
from symsimpson.lower.facts import equation_constants, facts, sizes, solve_constants, solve_tables
from symsimpson.lower.forms import (
    has_drifts,
    has_few_equations,
    is_unrolled,
    part_unknowns,
    solves_unreduced,
)
from symsimpson.lower.ir import Call, Function, Kernel, Module, Store, store_rows
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.specialise import kernel_from_text
from symsimpson.lower.stages import Stages, TracedStages, looped_stages
from symsimpson.lower.storage import Border, Storage, choose_storage, node_stride, pivot_places
from symsimpson.lower.traced_kernels import (
    MANY_STEPS,
    TracedKernels,
    add_user_time,
    lane_loop,
    observation_kernels,
    step_equations,
)
from symsimpson.lower.traced_steps import explicit_facts, explicit_tables, time_function
from symsimpson.text.interface import PIVOTED
from symsimpson.text.workspace_layout import layout

#: The least average number of members of families for which loops pay.
FAMILY_MEMBERS = 2
#: Families with this many times the nodes of all energies repeat what their terms share.
REPEATED = 4
#: The most coordinates for nodes as lanes: the solve at each node takes n^3/6 operations.
STAGE_COORDINATES = 24


def lower(equations: DiscreteEquations) -> Module:
    """Lower the equations of a step to the kernels of a module."""
    writer = _ModuleWriter(equations)
    if equations.plain.hamiltonian is not None:
        writer.write_canonical()
    elif is_unrolled(equations):
        writer.trace_kernels()
    else:
        writer.write_loops()
    return writer.module()


class _ModuleWriter:
    """Collects the kernels, functions and tables of a module."""

    def __init__(self, equations: DiscreteEquations) -> None:
        self.equations, self.low = equations, Lowering(equations)
        self.functions: list[Function] = []
        self.kernels: list[Kernel] = []
        self.tables: dict[str, object] = {}
        self.known: dict[str, object] = {}
        self.unknowns = 0
        rolling = len(equations.plain.velocity_constraints)
        self.storage = Storage.dense(self.low.n)
        self.held = Border.dense(self.low.n, len(self.low.multipliers), rolling)
        self.routh: Routh | None = None

    def _write(self, *names: str) -> None:
        """Add kernels whose texts are in the library."""
        self.kernels += [kernel_from_text(name, self.known) for name in names]

    def trace_kernels(self) -> None:
        """Write the kernels of a small system as straight-line code."""
        low, equations = self.low, self.equations
        storage, held = self.storage, self.held
        written = step_equations(low, (Level.ITERATION,)) if solves_unreduced(equations) else None
        traced = TracedKernels(low)
        self.kernels = [*traced.kernels(written), *observation_kernels(low, traced.state)]
        if written is None and has_few_equations(equations):
            # here no velocity follows from p, so that nodes need definitions of their own
            written = step_equations(low.with_jet(equations.jet), tuple(Level))
        self.functions = [] if written is None else [written]
        if not equations.plain.quadratic:  # velocities are found by loops
            self.functions += terms_of_l.unrolled_functions(low, ("mass",))
            self.tables |= self.storage.node_constants() | {"MASS_BAND": low.n - 1}
        if equations.rows:
            self._add_equations(written)
        self.unknowns = sum(part_unknowns(part) for part in equations.parts)
        self.unknowns += equations.unknowns.others_size
        works = bool(equations.rows and equations.plain.powers)
        following: tuple[int, ...] = ()
        if self.unknowns or works or equations.varied is not None:
            solved = {a for _, a in traced.increments}
            following = tuple(int(a not in solved) for a in range(low.n))
            self.tables |= solve_constants(storage, equations.columns, held)
            self.tables |= {"FOLLOWING": following} if any(following) else {}
        self.tables |= _side_tables(equations.plain)
        if works:
            self.functions.append(terms_of_l.power_function(low, low.template))
        self.known = facts(low, equations.parts[0], storage, held)
        self.known |= {"FOLLOWING": any(following), "IN_PAIRS": written is not None}
        # texts that are not traced solve for all coordinates together
        self.known |= {"SEPARABLE": False, "FOLLOWS": False, "CYCLIC": 0}
        names = {"multipliers": held, "equations": equations.rows, PIVOTED: self.unknowns}
        self._write(*(name for name, needed in (names | {"work": works}).items() if needed))

    def _add_equations(self, written: Function | None) -> None:
        """Add the functions and tables for loops over the equations of a step."""
        low, equations, held = self.low, self.equations, self.held
        if written is None or equations.varied is not None:
            names = ("jet", "mass") if held else ("jet",)
            self.functions += terms_of_l.unrolled_functions(low, names)
        if held:
            self.functions += constraint_functions(low, held, range(low.n), drifting=False)
            self.tables |= solve_tables(equations.parts[0], equations.scheme)
        self.tables |= self.storage.node_constants()
        self.tables |= equation_constants(self.storage, equations.scheme.degree, held)

    def write_canonical(self) -> None:
        """Write the kernels of a system that is declared by its Hamiltonian."""
        low, equations, n = self.low, self.equations, self.low.n
        regular = equations.system.structure.momentum_rank == n
        (part,) = equations.parts
        explicit = isinstance(part, Composed)
        names = ("gradient", "velocity", "potential", *(("mass",) if regular else ()))
        names += () if explicit else ("phase_jet",)
        self.functions = terms_of_l.unrolled_functions(low, names)
        self.known = facts(low, part, self.storage, None)
        self.known |= {"REGULAR": regular, "PIVOTS": False} | explicit_facts(low)
        texts = {"start": "start_phase", "newton": "newton_phase", "advance": "advance_phase"}
        if explicit:
            texts = {"start": "begin_phase", "advance": "compose_phase"}
        texts |= {"legendre": "phase_momentum", "energy": "phase_energy"}
        if equations.plain.powers and not explicit:
            self.functions.append(terms_of_l.power_function(low, low.template))
            texts["work"] = "phase_work"
        for name, text in texts.items():
            self.kernels.append(replace(kernel_from_text(text, self.known), name=name))
        self.kernels += observation_kernels(low, None)
        if isinstance(part, Composed):  # one call takes many steps
            advance = self.kernels[1]
            self.kernels[1] = replace(advance, body=(replace(MANY_STEPS, body=advance.body),))
            self.tables = self.storage.node_constants() | explicit_tables(low, range(n))
            self.tables |= {"KICKS": part.kicks, "DRIFTS": part.drifts}
            self.tables["MASS_BAND"] = n - 1
            return
        storage, points = Storage.dense(n), 2 * equations.scheme.degree
        columns = tuple(range(1, points + 1))
        self.tables = storage.node_constants() | {"MASS_BAND": n - 1}
        self.tables |= {"SOLVE_COLUMNS": columns, "SOLVE_UNKNOWNS": n * points}
        self.tables |= storage.constants("SOLVE", points) | storage.bounds("SOLVE", points)
        self.tables |= {"STRIDE": node_stride(equations), "UNFORCED": ()}
        self.unknowns = equations.unknowns.size

    def write_loops(self) -> None:
        """Write the kernels of a large system as loops."""
        low, equations, plain = self.low, self.equations, self.equations.plain
        storage, held = self.storage, self.held
        terms, kicked = find_families(plain), has_drifts(equations)
        if "sparse" in equations.exploit and plain.definite and plain.quadratic:
            # an explicit step solves with M alone
            both = [family for family in terms if family.plain.M or not kicked]
            met, degree = find_constraint_families(plain), equations.scheme.degree
            storage, held = choose_storage(
                storage, held, both, met, degree, plain.constrained_coordinates
            )
        part = equations.as_single_part(dense=not storage.banded)
        self.routh = routh = part if isinstance(part, Routh) else None
        if routh is not None:  # elimination takes the others, and stops
            storage = replace(storage, order=(*part.coordinates, *routh.cyclic))
        self.storage, self.held = storage, held
        constant = isinstance(part, (Separable, Composed))
        places = sorted(range(low.n), key=storage.order.__getitem__)
        low.set_places(places)
        own_tables = self._add_jet(places, constant=constant)
        if routh is not None:
            self.functions.append(terms_of_l.cyclic_function(low, routh))
        if held:
            own_tables |= self._add_constraints(held, places)
        constant = constant or equations.system.structure.constant_mass
        self.known = facts(low, part, storage, held) | explicit_facts(low)
        self.known |= {"CONSTANT_MASS": constant, "PIVOTS": not constant}
        if not constant:
            low.pivot_scale(low.n - 1)
        self._write("start", "legendre", *(("newton",) if part.columns else ()), "advance")
        if not part.columns:  # an explicit kernel takes many steps in one call
            advance = self.kernels[-1]
            self.kernels[-1] = replace(advance, body=(replace(MANY_STEPS, body=advance.body),))
        self._write("energy", *(("multipliers",) if held else ()))
        self.kernels += observation_kernels(low, None)
        self.tables = storage.node_constants() | {"MASS_BAND": storage.band_of(plain.M)}
        if isinstance(part, Composed):
            self.tables |= explicit_tables(low, range(low.n))
            if self.known["RETIMED"]:
                self.functions.append(time_function(low))
            self.tables |= held.constants(equations.scheme.degree) if held else {}
        else:
            self._add_unknowns(part)
        self.tables |= _side_tables(plain)
        self.tables |= own_tables
        if not constant:
            self.tables["PIVOT_AT"] = pivot_places(storage, held)

    def _add_jet(self, places: Sequence[int], *, constant: bool) -> dict[str, terms_of_l.Table]:
        """Add the functions that evaluate L and forces; return tables of families."""
        low, equations, terms = self.low, self.equations, find_families(self.equations.plain)
        structure, kicked = equations.system.structure, has_drifts(equations)
        names: tuple[str, ...] = ("gradient", "mass", "potential")
        if equations.plain.constraint_names or not kicked:
            names = ("jet", *(("forces",) if constant and not kicked else ()), *names)
        if structure.constant_mass and structure.gyroscopic and equations.scheme.by_stages:
            names = (*names, "gyroscopic")
        large = _are_large(terms) and equations.plain.quadratic
        large = large and not _repeat_nodes(terms, equations.plain)
        if not (self.storage.banded or large):
            self.functions = terms_of_l.unrolled_functions(low, names, places)
            return {}
        self.functions, tables = terms_of_l.family_functions(low, terms, places, names)
        return tables

    def _add_constraints(self, held: Border, places: Sequence[int]) -> dict[str, terms_of_l.Table]:
        """Add the functions that evaluate constraints; return tables of families."""
        low, plain, kicked = self.low, self.equations.plain, has_drifts(self.equations)
        met = find_constraint_families(plain)
        listed = bool(plain.velocity_constraints) or plain.moving
        if listed or not (self.storage.banded or _are_large(met)):
            self.functions += constraint_functions(low, held, places, drifting=kicked)
            return {}
        functions, tables = constraint_family_functions(low, met, places, drifting=kicked)
        self.functions += functions
        return tables

    def _add_unknowns(self, part: Part) -> None:
        """Add the kernels, functions and tables of Newton's method."""
        storage, equations = self.storage, self.equations
        self._write("equations", *((PIVOTED,) if self.known["NEWTON_IN_ORDER"] else ()))
        if part.columns and equations.plain.powers:
            self.functions.append(terms_of_l.power_function(self.low, self.low.observed))
            self._write("work")
        self.tables |= equation_constants(storage, equations.scheme.degree, self.held)
        self.tables |= solve_constants(storage, part.columns, self.held)
        self.tables |= solve_tables(part, equations.scheme)
        if isinstance(part, Separable):
            self.tables["SOLVE_ENTRIES"] = storage.size(len(part.columns))
        if part.columns:
            self.unknowns = part_unknowns(part) + equations.unknowns.others_size

    def _stages(self) -> Stages:
        """Return the kernels that iterate on velocities and forces at the nodes, if it pays."""
        by_loops = any(function.name == "gradient" for function in self.functions)
        by_loops = by_loops and not self.storage.banded
        stages = None
        if self.unknowns:
            stages = _stage_kernels(self.low, self.known, by_loops=by_loops)
        if stages is None or stages.functions:  # nothing else takes a by itself
            others = (f for f in self.functions if f.name.split("_")[0] != "gyroscopic")
            self.functions = [*others]
        return stages or Stages()

    def module(self) -> Module:
        """Complete the module: add derivatives, the user's time, stages, set-up and the layout.

        Derivatives cover every part of a step.
        """
        low, plain, storage, held = self.low, self.equations.plain, self.storage, self.held
        differentiated = self.equations.varied is not None and is_unrolled(self.equations)
        differentiated = differentiated and plain.hamiltonian is None
        by_columns = differentiated and traces_end(low)
        self.known["BY_COLUMNS"] = by_columns
        functions, kernels, tables = derivative_kernels(low, storage, held, self.known)
        more, self.kernels = add_user_time(low, self.known, [*self.kernels, *kernels])
        self.functions += functions + more
        stages = self._stages()
        self.tables |= tables | stages.tables
        if plain.powers:
            self.tables["NODE_POWERS"] = len(plain.powers)
        if low.names.inputs:
            self.tables["INPUTS"] = len(low.names.inputs)
            self.tables["INPUT_STRIDE"] = node_stride(self.equations)
        prepare = self._prepare(stages)
        more_sizes = {**stages.sizes, **differential_sizes(low, by_columns=by_columns)}
        blocks, rows = layout(sizes(low, self.known, storage, held, self.routh, **more_sizes))
        if "SOUGHT" in blocks:
            places = [blocks["MOMENTUM"], blocks["VELOCITY"]]
            given, sought = places[::-1] if plain.hamiltonian else places
            self.tables |= {"GIVEN": given, "FOUND": sought}
        return Module(
            low.names,
            (*self.functions, *stages.functions),
            (prepare, *self.kernels, *stages.kernels),
            low.graph.constants,
            blocks,
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
            stores += store_rows("GROWTH", low.growth_factors())
        if self.known.get("FRICTION"):
            stores += store_rows("DECAY", map(low.import_value, plain.rates))
        low.statements(stores, (Level.RUN,))
        stores += [Store(row, symbol) for symbol, row in low.hoisted_at(Level.RUN)]
        doc = "Compute what depends on the parameters and h alone."
        constants = low.statements(stores, (Level.RUN,), "constants")
        begin = (Call("stage_constants", ("W", "h", "lane")),) if stages.kernels else ()
        return Kernel("prepare", doc, lane_loop((*constants, *coefficients, *begin)))


def _stage_kernels(low: Lowering, known: Mapping[str, object], *, by_loops: bool) -> Stages | None:
    """Return the kernels that iterate on velocities and forces at the nodes, or None."""
    canonical = low.equations.plain.hamiltonian is not None
    possible = canonical or low.equations.scheme.by_stages
    if not possible or low.equations.plain.rate is not None or known["HELD"]:
        return None
    traced = TracedStages(low, known).stages() if low.n <= STAGE_COORDINATES else None
    pays = canonical or (by_loops and known["CONSTANT_MASS"])
    return looped_stages(low, known) if traced is None and pays else traced


def _side_tables(plain: Plain) -> dict[str, object]:
    """Return the place of the work of constraints, and the first one with a right-hand side."""
    tables: dict[str, object] = {"CARRIED": len(plain.forces)} if plain.carried else {}
    first = {"FIRST_SIDE": plain.first_side}
    return tables | (first if plain.velocity_constraints or plain.moving else {})


def _repeat_nodes(groups: Sequence[Family], plain: Plain) -> bool:
    """Return whether the terms of families share most of their nodes, as in robots."""
    whole = plain.graph.descendants(n for _, n in (plain.T, *plain.energies))
    parts = sum(len(family.plain.graph.nodes) for family in groups)
    return parts > REPEATED * len(whole)


def _are_large(groups: Sequence[Family]) -> bool:
    """Return whether families have enough members for loops."""
    members = sum(len(family.coordinates) for family in groups)
    return members >= FAMILY_MEMBERS * len(groups)
