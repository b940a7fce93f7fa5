"""The functions by which kernels evaluate L at nodes: written out, or by loops over families.

A family is a group of terms of L of the same form, with other coordinates and parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache, partial

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Call, Function, Index, Load, Loop, Row, Section, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.printer import formula
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.discrete.families import Family
from symsimpson.discrete.jet import Jet, derive_jet
from symsimpson.discrete.reductions import Routh
from symsimpson.graph.read import tree_size

__all__ = [
    "BLOCKS",
    "FUNCTIONS",
    "FamilyWriter",
    "Table",
    "cyclic_function",
    "cyclic_values",
    "family_functions",
    "power_function",
    "power_stores",
    "pull_stores",
    "split_loads",
    "unrolled_functions",
]

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
}
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
    "V": "ENERGY",
}
_CLEARED = {
    "F": "clear_gradient",
    "a": "clear_gyroscopic",
    "F_q": "clear_hessian",
    "F_v": "clear_mixed",
    "M": "clear_mass",
    "f_v": "clear_drag",
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
    point = Point("i", low.node_q, low.node_v, low.node_t, low.node_u)
    values = cyclic_values(low, low.cyclic(part), part, point, "cyclic coordinates")
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
    """Write every entry of the jet by lines of its own; coordinates ``stand`` at these places.

    With forces most entries of a large system are zero: loops clear them all before.
    """
    sparse = not low.equations.plain.conservative
    point = Point("i", low.node_q, low.node_v, low.node_t, low.node_u)
    dragged = low.equations.plain.dragged
    size = range(low.n)
    functions = []
    for name in names:
        doc, parts = FUNCTIONS[name]
        stores = []
        asked = (*parts, *(("f_v",) if dragged and "F_v" in parts else ()))
        for what in asked:
            for index in _indices(what, size):
                # L_qv is the transpose of P_q, and df/dv is stored apart: F_v is their sum
                turned = dragged and what == "F_v"
                entry, places = ("P_q", index[::-1]) if turned else (what, index)
                value = low.template.entry(point, "jet", entry, *places)
                stored = index if stand is None else [stand[i] for i in index]
                number = sum(i * low.n**k for k, i in enumerate(reversed(stored)))
                if value != 0 or not sparse:
                    stores.append(Store(Row(BLOCKS[what], number), value, add=what == "V"))
        body = _clearing(asked) if sparse else []
        lines = low.statements(stores, (Level.ITERATION,))
        functions.append(Function(name, doc, (*body, *lines)))
    return functions


def _clearing(parts: Sequence[str]) -> list[Call]:
    """Return what begins the sums that make some parts; that of M begins those of P and a, too."""
    return [Call(_CLEARED[x]) for x in parts if x in _CLEARED and (x != "a" or "M" not in parts)]


def power_stores(low: Lowering, template: JetTemplate, point: Point) -> list[Store]:
    """Store the power of each force, and dL/dt; that of constraints is 0 here."""
    powers = low.equations.plain.powers
    values = [template.entry(point, "powers", "power", name) for name in powers]
    return [Store(Row("POWER", k), value) for k, value in enumerate(values)]


def pull_stores(low: Lowering, point: Point) -> list[Store]:
    """Store the power of constraints A v = b that move, by their multipliers."""
    plain = low.equations.plain
    rolling = range(len(plain.constraints), len(plain.held))
    b = [low.held.entry(point, "powers", "b", c) for c in rolling]
    pulls = (-x * point.multipliers[c] for c, x in zip(rolling, b, strict=True))
    row = Row("POWER", [*plain.powers].index("of constraints"))
    return [Store(row, low.graph.total(pulls))]


def power_function(low: Lowering, template: JetTemplate) -> Function:
    """Write the powers of all forces at a node."""
    stores = power_stores(low, template, Point("i", low.node_q, low.node_v, low.node_t, low.node_u))
    doc = "Power of each force at a node, then the partial dL/dt where L depends on t."
    return Function("node_power", doc, low.statements(stores, (Level.ITERATION,)))


def family_functions(
    low: Lowering, families: Sequence[Family], places: Sequence[int], names: Iterable[str]
) -> tuple[list[Function], dict[str, Table]]:
    """Write a loop over each family, and functions that call these loops.

    Each family has a table, see :class:`FamilyWriter`; these are returned by name.
    """
    tables: dict[str, Table] = {}
    writers = []
    for number, family in enumerate(families, 1):
        writer = FamilyWriter(low, family, f"FAMILY_{number}", derive_jet(family.plain))
        tables[writer.table] = writer.build_table(places)
        writers.append((number, writer))
    functions: list[Function] = []
    for name in names:
        doc, parts = FUNCTIONS[name]
        if low.equations.plain.dragged and "F_v" in parts:
            parts = (*parts, "f_v")
        calls: list[Statement] = [*_clearing(parts)]
        for number, writer in writers:
            stores = _family_stores(writer, parts)
            if stores:
                functions.append(writer.function(f"{name}_{number}", doc, stores))
                calls.append(Call(functions[-1].name))
        functions.append(Function(name, doc, tuple(calls)))
    return functions, tables


class FamilyWriter:
    """Writes loops over the members of one family.

    Its ``table`` has a row for each member, of places of coordinates, the constraint if the term is
    one, and rows of coefficients.
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
        coefficients = [
            indexed(f"c_{s}", "COEFFICIENT", kind) for s, kind in enumerate(self._coefficient_rows)
        ]
        parameters = [
            *coefficients,
            *(low.parameters[a.name] for a in plain.parameters[family.slots :]),
        ]
        self.point = Point(table.lower(), q, v, low.node_t, low.node_u, multipliers=tuple(held))
        self.template = JetTemplate(
            jet,
            low.graph,
            [f"{s}" for s in size],
            {a.name: x for a, x in zip(plain.parameters, parameters, strict=True)},
            momenta=(),
        )

    def build_table(self, places: Sequence[int]) -> Table:
        """Return the table; coefficients that are new get rows in the module."""
        family, rows = self._family, {x: i for i, x in enumerate(self._low.coefficients)}
        known = cache(self._low.known)
        table = []
        for k, member in enumerate(family.coordinates):
            row_numbers = [rows.setdefault(known(x), len(rows)) for x in family.coefficients[k]]
            table.append(
                (*(places[i] for i in member), *family.constraints[k : k + 1], *row_numbers)
            )
        self._low.coefficients = tuple(rows)
        return tuple(table)

    def entries(self, parts: Iterable[str]) -> list[str]:
        """List those of some parts that a member adds to: what a force owes v stands apart."""
        plain = self._family.plain
        other = "F_v" if plain.forces else "f_v"
        return [x for x in parts if x != other and (x != "f_v" or plain.dragged)]

    def function(
        self, name: str, doc: str, stores: Sequence[Store], more: Sequence[Index] = ()
    ) -> Function:
        """Write the loop over members with these stores.

        Loads that are the same for all members stand before the loop; ``more`` indices are looked
        up in each turn.
        """
        constraint = [self.constraint] if self.constraint else []
        columns = [*self.indices, *constraint, *self._coefficient_rows]
        used: list[Statement] = [
            Index(target, f"{self.table}[term, {column}]") for column, target in enumerate(columns)
        ]
        first, *rest = self._low.statements(stores, (Level.ITERATION,))
        outside, inside = split_loads(first)
        members = self._family.coordinates
        doc = f"{doc[:-1]}: {len(members)} terms {self._term_text()}."
        loop = Loop("term", f"range({len(members)})", (*used, *more, *inside, *rest))
        return Function(name, doc, (*outside, loop))

    def _term_text(self) -> str:
        """Return the form of the terms in words."""
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


def _family_stores(writer: FamilyWriter, parts: Iterable[str]) -> list[Store]:
    """Return what a member adds to some derivatives of L."""
    stores = []
    for what in writer.entries(parts):
        for index in _indices(what, range(len(writer.indices))):
            value = writer.template.entry(writer.point, "jet", what, *index)
            if value != 0:
                places = [writer.indices[i] for i in index]
                stores.append(Store(_row(what, places), value, add=True))
    return stores


def _row(what: str, places: Sequence[str]) -> Row:
    block = BLOCKS[what]
    if not places:
        return Row(block, 0)
    if len(places) == 1:
        return Row(block, places[0])
    return Row(block, f"{places[0]}*NODE_STRIDE + {places[1]} + NODE_OFFSET")


def split_loads(reads: Statement) -> tuple[list[Statement], list[Statement]]:
    """Split loads into those that are the same in all turns of a loop and the others."""
    outside: list[Statement] = []
    inside: list[Statement] = []
    if isinstance(reads, Section) and all(isinstance(read, Load) for read in reads.body):
        for read in reads.body:
            varies = isinstance(read, Load) and isinstance(read.row.index, str)
            (inside if varies else outside).append(read)
    else:
        inside.append(reads)
    return outside, inside


def _indices(what: str, size: range) -> Iterable[tuple[int, ...]]:
    if what == "V":
        return [()]
    if what in ("F", "P", "a"):
        return [(i,) for i in size]
    return [(i, j) for i in size for j in size]
