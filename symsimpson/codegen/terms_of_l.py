"""The functions by which loops over nodes evaluate L: line by line, or family by family."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import sympy as sp

from symsimpson.codegen.ir import Call, Function, Index, Load, Loop, Row, Section, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.discrete.families import Family
from symsimpson.discrete.jet import derive_jet
from symsimpson.graph.nodes import Value
from symsimpson.graph.read import tree_size

__all__ = [
    "FUNCTIONS", "constraint_functions", "family_functions", "power_function", "power_stores",
    "unrolled_functions",
]  # fmt: skip

#: What loops ask for, and which derivatives that is.
FUNCTIONS = {
    "jet": ("F, P, F_q, F_v and P_v = M at a node.", ("F", "P", "F_q", "F_v", "M")),
    "forces": ("F and F_q at a node.", ("F", "F_q")),
    "gradient": ("F at a node.", ("F",)),
    "mass": ("M and a at a node.", ("a", "M")),
    "potential": ("Add V to the energy.", ("V",)),
}
#: Terms of more nodes are not shown.
_SHOWN = 100
_BLOCKS = {"F": "NODE_L_Q", "P": "NODE_L_V", "a": "NODE_L_V", "F_q": "NODE_L_QQ",
           "F_v": "NODE_L_QV", "f_v": "NODE_F_V", "M": "NODE_L_VV", "V": "ENERGY"}  # fmt: skip
_CLEARED = {"F": "clear_gradient", "F_q": "clear_hessian", "F_v": "clear_mixed",
            "M": "clear_mass", "f_v": "clear_drag"}  # fmt: skip


def unrolled_functions(low: Lowering, names: Iterable[str]) -> list[Function]:
    """Write every entry of the jet by lines of its own.

    Large systems with forces are not families of terms: what is zero is cleared by loops.
    """
    sparse = not low.equations.plain.conservative
    point = Point("i", low.node_q, low.node_v, low.node_t, low.node_u)
    dragged = low.equations.plain.dragged
    size = range(low.n)
    found = []
    for name in names:
        doc, parts = FUNCTIONS[name]
        stores = []
        asked = (*parts, *(("f_v",) if dragged and "F_v" in parts else ()))
        for what in asked:
            for index in _indices(what, size):
                # L_qv is the transpose of P_q; F_v has what forces depend on beside it
                turned = dragged and what == "F_v"
                entry, places = ("P_q", index[::-1]) if turned else (what, index)
                value = low.template.entry(point, "jet", entry, *places)
                number = sum(i * low.n**k for k, i in enumerate(reversed(index)))
                if value != 0 or not sparse:
                    stores.append(Store(Row(_BLOCKS[what], number), value, add=what == "V"))
        cleared = [x for x in asked if x in _CLEARED] if sparse else []
        body = [Call(_CLEARED[x], ("W", "lane")) for x in cleared]
        lines = low.statements(stores, (Level.ITERATION,))
        found.append(Function(name, doc, (*body, *lines)))
    return found


def constraint_functions(low: Lowering) -> list[Function]:
    """Write constraints at a point, and what they do to a state."""
    n, held = low.n, range(len(low.multipliers))
    point = Point("c", low.node_q, low.node_v, low.node_t, low.node_u, low.multipliers)

    def entry(what: str, *index: int) -> sp.Expr:
        return low.held.entry(point, "constraints", what, *index)

    def function(name: str, doc: str, stores: Iterable[Store]) -> Function:
        return Function(name, doc, low.statements(stores, (Level.ITERATION,)))

    slopes = [
        Store(Row("CONSTRAINT_Q", c * n + a), entry("Phi", c, a)) for c in held for a in range(n)
    ]
    whole = [
        *(Store(Row("CONSTRAINT", c), entry("phi", c)) for c in held),
        *slopes,
        *(
            Store(Row("CONSTRAINT_QQ", a * n + b), entry("pull", a, b))
            for a in range(n)
            for b in range(n)
        ),
    ]
    pushes = [
        *(Store(Row("RESIDUAL", a), entry("push", a)) for a in range(n)),
        *(Store(Row("CURVATURE", c), -entry("curve", c)) for c in held),
    ]
    return [
        function("constraint_slopes", "Phi at a point.", slopes),
        function("constrain", "phi, Phi and the second derivatives of lambda.phi.", whole),
        function("pushes", "What accelerates, M v' + Phi^T lambda, and Phi v' at a state.", pushes),
    ]


def power_stores(low: Lowering, point: Point) -> list[Store]:
    """Store what changes the energy at a point."""
    return [
        Store(Row("POWER", k), low.template.entry(point, "powers", "power", name))
        for k, name in enumerate(low.equations.plain.powers)
    ]


def power_function(low: Lowering) -> Function:
    """Write what changes the energy at a node."""
    stores = power_stores(low, Point("i", low.node_q, low.node_v, low.node_t, low.node_u))
    doc = "Power of each force at a node, then dL/dt where L depends on t."
    return Function("node_power", doc, low.statements(stores, (Level.ITERATION,)))


def family_functions(
    low: Lowering, families: Sequence[Family], places: Sequence[int], names: Iterable[str]
) -> tuple[list[Function], dict[str, tuple[tuple[int, ...], ...]]]:
    """Write a loop over the members of each family.

    Returns
    -------
    functions : list of Function
    tables : dict
        For each family the places of its members' coordinates, then the rows of their coefficients.
    """
    rows: dict[Value, int] = {}
    tables: dict[str, tuple[tuple[int, ...], ...]] = {}
    writers = []
    for number, family in enumerate(families, 1):
        table = []
        for member, values in zip(family.coordinates, family.coefficients, strict=True):
            own = [rows.setdefault(value, len(rows)) for value in values]
            table.append((*(places[i] for i in member), *own))
        tables[f"FAMILY_{number}"] = tuple(table)
        writers.append(_FamilyWriter(low, family, number))
    low.coefficients = tuple(map(low.equations.plain.written, rows))
    functions: list[Function] = []
    for name in names:
        doc, parts = FUNCTIONS[name]
        calls: list[Statement] = [Call(_CLEARED[p], ("W", "lane")) for p in parts if p in _CLEARED]
        for writer in writers:
            function = writer.function(name, parts)
            if function is not None:
                functions.append(function)
                calls.append(Call(function.name, ("W", "lane")))
        functions.append(Function(name, doc, tuple(calls)))
    return functions, tables


class _FamilyWriter:
    """Writes the loops of one family."""

    def __init__(self, low: Lowering, family: Family, number: int) -> None:
        self._low, self._family, self._number = low, family, number
        plain = family.plain
        names = low.names
        size = range(len(plain.q))
        self._indices = [names.fresh(f"i{s}").name for s in size]
        self._kinds = [names.fresh(f"k{s}").name for s in range(family.slots)]

        def base(hint: str, block: str, index: str) -> sp.Symbol:
            symbol = names.fresh(hint)
            low.rows[symbol] = Row(block, index)
            return low.graph.declare(symbol, Level.ITERATION)

        q = tuple(base(f"q_{s}", "NODE_POSITION", self._indices[s]) for s in size)
        v = tuple(base(f"v_{s}", "NODE_VELOCITY", self._indices[s]) for s in size)
        own = [base(f"c_{s}", "COEFFICIENT", kind) for s, kind in enumerate(self._kinds)]
        parameters = [*own, *(low.parameters[a] for a in plain.parameters[family.slots :])]
        self._point = Point(f"f{number}", q, v)
        self._template = JetTemplate(
            derive_jet(plain), low.graph, [f"{s}" for s in size],
            dict(zip(plain.parameters, parameters, strict=True)), momenta=(),
        )  # fmt: skip

    def function(self, name: str, parts: Iterable[str]) -> Function | None:
        """Write the loop over members that adds up some derivatives."""
        stores = []
        for what in parts:
            for index in _indices(what, range(len(self._point.q))):
                value = self._template.entry(self._point, "jet", what, *index)
                if value != 0:
                    stores.append(Store(self._row(what, index), value, add=True))
        if not stores:
            return None
        table = f"FAMILY_{self._number}"
        used: list[Statement] = [
            Index(target, f"{table}[term, {column}]")
            for column, target in enumerate((*self._indices, *self._kinds))
        ]
        first, *rest = self._low.statements(stores, (Level.ITERATION,))
        outside, inside = _split(first)
        members = self._family.coordinates
        doc = f"{FUNCTIONS[name][0][:-1]}: {len(members)} terms {self._term()}."
        loop = Loop("term", f"range({len(members)})", (*used, *inside, *rest))
        return Function(f"{name}_{self._number}", doc, (*outside, loop))

    def _term(self) -> str:
        plain = self._family.plain
        if tree_size(plain.graph, plain.L) > _SHOWN:
            return "of one kind"
        slots = plain.parameters[: self._family.slots]
        shown = {s: sp.Symbol(f"c_{k}") for k, s in enumerate(slots)}
        shown |= {a: self._low.parameters[a] for a in plain.parameters[self._family.slots :]}
        return sp.sstr(plain.written(plain.L).xreplace(shown))[:60]

    def _row(self, what: str, index: tuple[int, ...]) -> Row:
        block, places = _BLOCKS[what], [self._indices[i] for i in index]
        if not places:
            return Row(block, 0)
        if len(places) == 1:
            return Row(block, places[0])
        return Row(block, f"{places[0]}*NODE_STRIDE + {places[1]} + NODE_OFFSET")


def _split(reads: Statement) -> tuple[list[Statement], list[Statement]]:
    """Split loads into those that are the same for all members and the others."""
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
