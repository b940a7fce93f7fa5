"""The functions by which loops over nodes evaluate L: as straight lines, or family by family."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import sympy as sp

from symsimpson.codegen.ir import Call, Function, Index, Load, Loop, Row, Section, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import JetTemplate, Point
from symsimpson.discrete.families import Family
from symsimpson.discrete.jet import derive_jet

__all__ = ["FUNCTIONS", "family_functions", "straight_functions"]

#: What loops ask for, and which derivatives that is.
FUNCTIONS = {
    "jet": ("L_q, L_v, L_qq, L_qv and L_vv = M at a node.", ("L_q", "L_v", "L_qq", "L_qv", "L_vv")),
    "forces": ("L_q and L_qq at a node.", ("L_q", "L_qq")),
    "gradient": ("L_q at a node.", ("L_q",)),
    "mass": ("M and a at a node.", ("a", "L_vv")),
    "potential": ("Add V to the energy.", ("V",)),
}
_BLOCKS = {"L_q": "NODE_L_Q", "L_v": "NODE_L_V", "a": "NODE_L_V", "L_qq": "NODE_L_QQ",
           "L_qv": "NODE_L_QV", "L_vv": "NODE_L_VV", "V": "ENERGY"}  # fmt: skip
_CLEARED = {"L_q": "clear_gradient", "L_qq": "clear_hessian", "L_qv": "clear_mixed",
            "L_vv": "clear_mass"}  # fmt: skip


def straight_functions(low: Lowering, names: Iterable[str]) -> list[Function]:
    """Write every entry of the jet as straight lines."""
    point = Point("i", low.node_q, low.node_v)
    size = range(low.n)
    found = []
    for name in names:
        doc, parts = FUNCTIONS[name]
        stores = []
        for what in parts:
            for index in _indices(what, size):
                value = _value(low, low.template, point, what, index)
                number = sum(i * low.n**k for k, i in enumerate(reversed(index)))
                stores.append(Store(Row(_BLOCKS[what], number), value, add=what == "V"))
        found.append(Function(name, doc, low.statements(stores, (Level.ITERATION,))))
    return found


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
    rows: dict[sp.Expr, int] = {}
    tables: dict[str, tuple[tuple[int, ...], ...]] = {}
    writers = []
    for number, family in enumerate(families, 1):
        table = []
        for member, values in zip(family.coordinates, family.coefficients, strict=True):
            own = [rows.setdefault(value, len(rows)) for value in values]
            table.append((*(places[i] for i in member), *own))
        tables[f"FAMILY_{number}"] = tuple(table)
        writers.append(_FamilyWriter(low, family, number))
    low.coefficients = tuple(rows)
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

        def base(wish: str, block: str, index: str) -> sp.Symbol:
            symbol = names.fresh(wish)
            low.rows[symbol] = Row(block, index)
            return low.graph.declare(symbol, Level.ITERATION)

        q = tuple(base(f"q_{s}", "NODE_POSITION", self._indices[s]) for s in size)
        v = tuple(base(f"v_{s}", "NODE_VELOCITY", self._indices[s]) for s in size)
        own = [base(f"c_{s}", "COEFFICIENT", kind) for s, kind in enumerate(self._kinds)]
        parameters = [*own, *(low.parameters[a] for a in plain.parameters[family.slots :])]
        self._point = Point(f"f{number}", q, v)
        self._template = JetTemplate(
            derive_jet(plain), plain, low.graph, [f"{s}" for s in size],
            dict(zip(plain.parameters, parameters, strict=True)), momenta=(),
        )  # fmt: skip

    def function(self, name: str, parts: Iterable[str]) -> Function | None:
        """Write the loop over members that adds up some derivatives."""
        stores = []
        for what in parts:
            for index in _indices(what, range(len(self._point.q))):
                value = _value(self._low, self._template, self._point, what, index)
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
        n = len(plain.q)
        kinetic = sp.Add(*(plain.mass[a, b] * plain.v[a] * plain.v[b] / 2
                           for a in range(n) for b in range(n)))  # fmt: skip
        linear = sp.Add(*(a * v for a, v in zip(plain.gyroscopic, plain.v, strict=True)))
        shown = {
            s: sp.Symbol(f"c_{k}") for k, s in enumerate(plain.parameters[: self._family.slots])
        }
        shown |= {a: self._low.parameters[a] for a in plain.parameters[self._family.slots :]}
        term = kinetic + linear - plain.potential
        return sp.sstr(term.xreplace(shown))[:60]

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
    if what in ("L_q", "L_v", "a"):
        return [(i,) for i in size]
    return [(i, j) for i in size for j in size]


def _value(
    low: Lowering, template: JetTemplate, point: Point, what: str, index: tuple[int, ...]
) -> sp.Expr:
    if what == "L_v":
        value = template.momentum(point, "jet", index[0])
        return low.graph.define(f"Lv_{index[0]}_{point.suffix}", value, "jet")
    if what == "V":
        return template.output(point, "jet", ("V",))
    return template.entry(point, "jet", "M" if what == "L_vv" else what, *index)
