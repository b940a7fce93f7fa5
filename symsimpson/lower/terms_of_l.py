"""Functions that evaluate L at nodes: straight-line code, or loops over families."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache, partial, reduce
from itertools import product

from symsimpson.discrete.families import Family
from symsimpson.discrete.jet import Jet, derive_jet
from symsimpson.discrete.reductions import Routh
from symsimpson.graph.nodes import Exact
from symsimpson.graph.read import tree_size
from symsimpson.lower.expression import Expression
from symsimpson.lower.ir import (
    Call,
    Excerpt,
    Function,
    Load,
    Loop,
    Row,
    Section,
    Statement,
    Store,
    store_rows,
)
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.printer import formula
from symsimpson.lower.template import JetTemplate, Point

#: Rows of integers.
Table = tuple[tuple[int, ...], ...]
#: Functions of a node, and the entries of the jet that they store: F = L_q + f with forces f,
#: P = L_v, a = L_v at v = 0, and derivatives of these.
FUNCTIONS = {
    "jet": ("F, P, F_q, F_v and P_v = M at a node.", ("F", "P", "F_q", "F_v", "M")),
    "forces": ("F and F_q at a node.", ("F", "F_q")),
    "gradient": ("F at a node.", ("F",)),
    "mass": ("M and a at a node.", ("a", "M")),
    "gyroscopic": ("a at a node.", ("a",)),
    "potential": ("Add V to the energy.", ("V",)),
    "velocity": ("The velocity H_p.", ("P",)),
    "phase_jet": ("F, H_p and their derivatives at a node.", ("F", "P", "F_q", "F_v", "P_q", "M")),
}
_CLEARED = "W[{} + row, lane] = real(0)"
#: Terms of more nodes are not shown.
_SHOWN = 100
BLOCKS = {
    "F": "NODE_L_Q",
    "P": "NODE_L_V",
    "a": "NODE_L_V",
    "F_q": "NODE_L_QQ",
    "F_v": "NODE_L_QV",
    "f_v": "NODE_F_V",
    "M": "NODE_L_VV",
    "P_q": "NODE_P_Q",
    "V": "ENERGY",
}


def cyclic_values(
    low: Lowering, template: JetTemplate, part: Routh, point: Point, section: str
) -> Iterator[tuple[str, tuple[int, ...], Expression]]:
    """Yield D and L of cyclic coordinates, and their momenta at v_y = 0: block, index and value."""
    entry = partial(template.entry, point, section)
    for r, y in enumerate(part.cyclic):
        assert point.v is not None
        moved = (entry("M", y, x) * point.v[x] for x in part.coordinates)
        yield "CYCLIC_D", (r,), entry("D", y)
        yield "CYCLIC_P", (r,), low.graph.total([entry("a", y), *moved])
        for c, z in enumerate(part.cyclic[:r]):
            yield "CYCLIC_FIXED", (r, c), entry("L0", y, z)
            yield "CYCLIC_L", (r, c), entry("L", y, z)


def cyclic_function(low: Lowering, part: Routh) -> Function:
    """Write D and L of cyclic coordinates, and their momenta at v_y = 0, at a node."""
    values = cyclic_values(low, low.cyclic(part), part, low.node, "cyclic coordinates")
    places = {1: "node * CYCLIC + {}", 2: "(node * CYCLIC + {}) * CYCLIC + {}"}
    stores = [
        Store(Row(block, places[len(index)].format(*index)), value)
        for block, index, value in values
    ]
    doc = "M = L D L^T of cyclic coordinates at a node, and their momenta without their velocities."
    lines = low.statements(stores, (Level.ITERATION,))
    return Function("cyclic_mass", doc, lines, ("W", "node", "lane"))


def unrolled_functions(
    low: Lowering, names: Iterable[str], stand: Sequence[int] | None = None
) -> list[Function]:
    """Write every entry of the jet by lines of its own; ``stand`` has the places of coordinates.

    With forces most entries of a large system are zero. Loops clear them all first.
    """
    sparse = not low.equations.plain.conservative
    plain = low.equations.plain
    dragged = plain.dragged and plain.hamiltonian is None
    functions = []
    for name in names:
        doc, parts = FUNCTIONS[name]
        stores = []
        for what, index, key in jet_entries(parts, low.n, dragged=dragged):
            value = low.template.entry(low.node, "jet", *key)
            stored = index if stand is None else [stand[i] for i in index]
            if value != 0 or not sparse:
                row = Row(BLOCKS[what], position(stored, low.n))
                stores.append(Store(row, value, add=what == "V"))
        body = _clearing(_with_drag(parts, dragged=dragged)) if sparse else []
        lines = low.statements(stores, (Level.ITERATION,))
        functions.append(Function(name, doc, (*body, *lines)))
    return functions


def jet_entries(
    parts: Sequence[str], n: int, *, dragged: bool
) -> Iterator[tuple[str, tuple[int, ...], tuple[str, *tuple[int, ...]]]]:
    """Yield the name of each value of a node, its index, and its entry in the jet."""
    for what in _with_drag(parts, dragged=dragged):
        for index in _indices(what, n):
            # L_qv is the transpose of P_q, and df/dv is stored apart: F_v is their sum
            turned = dragged and what == "F_v"
            yield what, index, ("P_q", *index[::-1]) if turned else (what, *index)


def position(index: Iterable[int], size: int) -> int:
    """Return the flat index of an entry of an array of this size in each direction."""
    return reduce(lambda place, k: place * size + k, index, 0)


def _with_drag(parts: Sequence[str], *, dragged: bool) -> Sequence[str]:
    """Return the parts of the jet, with df/dv where forces depend on velocities."""
    return (*parts, "f_v") if dragged and "F_v" in parts else parts


def _clearing(parts: Iterable[str]) -> list[Loop]:
    """Return the loops that set the sums over the terms of L to zero, except the sum V."""
    size = {True: "NODE_L_QV - NODE_L_QQ", False: "DIMENSION"}
    return [
        Loop(
            "row", f"range({size['_' in x or x == 'M']})", (Excerpt((_CLEARED.format(BLOCKS[x]),)),)
        )
        for x in parts
        if x != "V"
    ]


def power_stores(low: Lowering, template: JetTemplate, point: Point) -> list[Store]:
    """Store the power of each force, and dL/dt; the power of constraints is 0 here."""
    powers = low.equations.plain.powers
    values = [template.entry(point, "powers", "power", name) for name in powers]
    return store_rows("POWER", values)


def pull_stores(low: Lowering, point: Point) -> list[Store]:
    """Store the power of constraints that move, by their multipliers."""
    plain = low.equations.plain
    some = range(plain.first_side, len(plain.constraint_names))
    b = [low.constraint_jet.entry(point, "powers", "b", c) for c in some]
    pulls = (-x * point.multipliers[c] for c, x in zip(some, b, strict=True))
    row = Row("POWER", [*plain.powers].index("of constraints"))
    return [Store(row, low.graph.total(pulls))]


def power_function(low: Lowering, template: JetTemplate) -> Function:
    """Write the powers of all forces at a node."""
    stores = power_stores(low, template, low.node)
    doc = "Power of each force at a node, then the partial dL/dt where L depends on t."
    return Function("node_power", doc, low.statements(stores, (Level.ITERATION,)))


def family_functions(
    low: Lowering, families: Sequence[Family], places: Sequence[int], names: Iterable[str]
) -> tuple[list[Function], dict[str, Table]]:
    """Write a loop over each family, and functions that call these loops.

    The second result has the table of each family, see :class:`FamilyWriter`.
    """
    tables: dict[str, Table] = {}
    writers = []
    for number, family in enumerate(families, 1):
        writer = FamilyWriter(low, family, f"FAMILY_{number}", derive_jet(family.plain))
        tables[writer.table] = writer.build_table(places)
        writers.append((number, writer))
    functions: list[Function] = []
    for name in names:
        doc, known = FUNCTIONS[name]
        parts = _with_drag(known, dragged=low.equations.plain.dragged)
        calls: list[Statement] = [*_clearing(parts)]
        for number, writer in writers:
            if stores := writer.stores(parts):
                functions.append(writer.function(f"{name}_{number}", doc, stores))
                calls.append(Call(functions[-1].name))
        functions.append(Function(name, doc, tuple(calls)))
    return functions, tables


class FamilyWriter:
    """Writes loops over the members of one family of terms that have the same form.

    Its ``table`` has a row for each member. The row lists the places of the coordinates, the index
    of the constraint if the term is one, and the rows of coefficients.
    """

    def __init__(self, low: Lowering, family: Family, table: str, jet: Jet) -> None:
        self._low, self._family, self.table = low, family, table
        plain = family.plain
        names = low.names
        size = range(len(plain.q))
        self.indices = [names.fresh(f"i{s}") for s in size]
        self.constraint = names.fresh("c") if family.constraints else ""
        self._coefficient_rows = [names.fresh(f"k{s}") for s in range(family.slots)]

        def indexed(hint: str, block: str, index: str) -> Expression:
            """Return a symbol for the row of a block that an index of the loop names."""
            symbol = low.graph.fresh(hint, Level.ITERATION)
            low.rows[symbol] = Row(block, index)
            return symbol

        q = tuple(indexed(f"q_{s}", "NODE_POSITION", self.indices[s]) for s in size)
        v = tuple(indexed(f"v_{s}", "NODE_VELOCITY", self.indices[s]) for s in size)
        held = [indexed("l", "MULTIPLIER", self.constraint)] if family.constraints else []
        rows = enumerate(self._coefficient_rows)
        parameters = [indexed(f"c_{s}", "COEFFICIENT", row) for s, row in rows]
        parameters += [low.parameters[a.name] for a in plain.parameters[family.slots :]]
        known = dict(zip((a.name for a in plain.parameters), parameters, strict=True))
        self.point = Point(table.lower(), q, v, low.node_t, low.node_u, multipliers=tuple(held))
        self.template = JetTemplate(jet, low.graph, [*map(str, size)], known, momenta=())

    def build_table(self, places: Sequence[int]) -> Table:
        """Return the table; coefficients that are new get rows in the module."""
        family, rows = self._family, {x: i for i, x in enumerate(self._low.coefficients)}
        known = cache(self._low.import_value)
        table = []
        for k, member in enumerate(family.coordinates):
            row_numbers = [rows.setdefault(known(x), len(rows)) for x in family.coefficients[k]]
            at = [places[i] for i in member]
            table.append((*at, *family.constraints[k : k + 1], *row_numbers))
        self._low.coefficients = tuple(rows)
        return tuple(table)

    def stores(self, parts: Iterable[str]) -> list[Store]:
        """Return the stores of a member for some derivatives of L; df/dv of a force is separate."""
        plain, stores = self._family.plain, []
        other = "F_v" if plain.forces else "f_v"
        for what in (x for x in parts if x != other and (x != "f_v" or plain.dragged)):
            for index in _indices(what, len(self.indices)):
                value = self.template.entry(self.point, "jet", what, *index)
                if value != 0:
                    places = [self.indices[i] for i in index]
                    row = places[0] if places else 0
                    if len(places) == 2:
                        row = f"{places[0]}*NODE_STRIDE + {places[1]} + NODE_OFFSET"
                    stores.append(Store(Row(BLOCKS[what], row), value, add=True))
        return stores

    def function(
        self, name: str, doc: str, stores: Iterable[Store], more: Sequence[str] = ()
    ) -> Function:
        """Write the loop over members with these stores.

        Loads that are the same for all members come before the loop. ``more`` lines look up
        indices in each turn.
        """
        constraint = [self.constraint] if self.constraint else []
        columns = [*self.indices, *constraint, *self._coefficient_rows]
        lines = (f"{x} = {self.table}[term, {column}]" for column, x in enumerate(columns))
        looked_up = Excerpt((*lines, *more))
        first, *rest = self._low.statements(stores, (Level.ITERATION,))
        outside, inside = split_loads(first)
        members = self._family.coordinates
        doc = f"{doc[:-1]}: {len(members)} terms {self._term_text()}."
        loop = Loop("term", f"range({len(members)})", (looked_up, *inside, *rest))
        return Function(name, doc, (*outside, loop))

    def _term_text(self) -> str:
        """Return the formula of the terms, for the docstring."""
        plain = self._family.plain
        (term,) = plain.constraints.values() or [f for f in plain.f if f[0]] or [plain.L]
        if tree_size(plain.graph, term) > _SHOWN:
            return "of one kind"
        slots = self._family.slots
        shown = {s.name: f"c_{k}" for k, s in enumerate(plain.parameters[:slots])}
        shown |= {a.name: self._low.parameters[a.name].name for a in plain.parameters[slots:]}
        shown |= {s.name: name for s, name in zip(plain.u, self._low.names.inputs, strict=True)}
        shown[plain.t.name] = "t"
        return formula(plain.graph, term, shown)[:60]


def split_loads(reads: Statement) -> tuple[list[Statement], list[Statement]]:
    """Split loads into loop-invariant ones and the others."""
    outside: list[Statement] = []
    inside: list[Statement] = []
    if isinstance(reads, Section) and all(isinstance(read, Load) for read in reads.body):
        for read in reads.body:
            varies = isinstance(read, Load) and isinstance(read.row.index, str)
            (inside if varies else outside).append(read)
    else:
        inside.append(reads)
    return outside, inside


def _indices(what: str, n: int) -> Iterator[tuple[int, ...]]:
    """Yield the indices of a number, of a vector or of a matrix."""
    directions = {"V": 0, "F": 1, "P": 1, "a": 1}.get(what, 2)
    return product(range(n), repeat=directions)


#: Fewer products of one kind are written out.
FEWEST = 8


def coefficient_loops(
    low: Lowering, values: Sequence[Expression]
) -> tuple[list[Statement], list[Store], dict[str, object]]:
    """Generate the loops, single stores and tables that compute the coefficients of L.

    ``values`` are the coefficients in the order of their rows. They depend on the parameters of
    ``low``. A loop computes at least FEWEST products of one form; single stores compute the rest.
    Each row of a table has the row of a coefficient, then the rows of its parameters.
    """
    kinds: dict[tuple[Exact, int], list[tuple[int, ...]]] = defaultdict(list)
    stores = []
    for row, value in enumerate(values):
        places = _parameter_rows(low, value)
        number = value.coefficient
        if places:
            kinds[number, len(places)].append((row, *places))
        else:
            stores.append(_coefficient_store(low, row, value))
    loops: list[Statement] = []
    tables: dict[str, object] = {}
    for (number, _), members in kinds.items():
        if len(members) < FEWEST:
            stores += [_coefficient_store(low, row, values[row]) for row, *_ in members]
            continue
        name = f"PRODUCTS_{len(tables) + 1}"
        tables[name] = tuple(members)
        loops.append(_coefficient_loop(low, name, number, members))
    return loops, sorted(stores, key=lambda store: int(store.row.index)), tables


def _parameter_rows(low: Lowering, product: Expression) -> tuple[int, ...]:
    """Return the rows of the parameters in a pure product; () for any other expression."""
    factors = [Expression(low.graph, (e, n)) for n, e in low.graph.factors(product.node)]
    rows = [low.rows[factor] for factor in factors if factor in low.rows]
    return tuple(sorted(int(row.index) for row in rows)) if len(rows) == len(factors) else ()


def _coefficient_store(low: Lowering, row: int, value: Expression) -> Store:
    return Store(Row("COEFFICIENT", row), low.graph.split(value, "constants")[0])


def _coefficient_loop(
    low: Lowering, table: str, number: Exact, members: Sequence[tuple[int, ...]]
) -> Statement:
    """Write the loop over products of one kind."""
    target, *indices = [low.names.fresh("row") for _ in members[0]]
    factors = []
    for index in indices:
        factors.append(low.graph.fresh("factor", Level.RUN))
        low.rows[factors[-1]] = Row("PARAMETER", index)
    value = low.graph.split(low.graph.product([number, *factors]), "constants")[0]
    rows = enumerate((target, *indices))
    read = Excerpt(tuple(f"{name} = {table}[term, {k}]" for k, name in rows))
    body = low.statements([Store(Row("COEFFICIENT", target), value)], (Level.RUN,))
    inside = [part for section in body if isinstance(section, Section) for part in section.body]
    return Loop("term", f"range({len(members)})", (read, *inside))
