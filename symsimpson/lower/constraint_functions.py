"""The functions by which kernels evaluate constraints, one by one or in loops over families."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

from symsimpson.discrete.families import Family
from symsimpson.discrete.jet import derive_constraints
from symsimpson.lower.expression import Expression
from symsimpson.lower.ir import Call, Function, Row, Store
from symsimpson.lower.levels import Level
from symsimpson.lower.lower import Lowering
from symsimpson.lower.storage import Held
from symsimpson.lower.template import Point
from symsimpson.lower.terms_of_l import FamilyWriter, Table

DOCS = {
    "constraint_slopes": "Phi = dphi/dq at a point.",
    "constrain": "phi, Phi = dphi/dq, and the second derivatives of lambda.phi by q.",
    "constraint_values": "phi at a point.",
    "curves": "Phi v' = -v.phi_qq.v, at a state.",
    "pushes": "Right-hand sides of M v' + Phi^T lambda, Phi v' and A v - b at a state.",
    "hold_velocities": "Right-hand sides of Phi v = 0 and A v = b.",
    "rates": "A v - b and its derivatives by q and v at a point.",
    "carried_slopes": "Derivatives of b by q at a point.",
}
_CLEARED = Call("clear", ("W", "CONSTRAINT_QQ", "HELD_SIZE", "lane"))
#: What is evaluated is asked for by its name and indices.
Entry = Callable[..., Expression]
#: The row for two coordinates or constraints: the latter are those behind the former.
EntryRow = Callable[[int, int], Row]


def constraint_functions(
    low: Lowering, held: Held, places: Sequence[int], *, drifting: bool
) -> list[Function]:
    """Write phi, its derivatives and accelerations, each constraint by lines of its own.

    With velocity constraints A v = b these are derived, too. ``places`` has the row of each
    coordinate in matrices. Schemes with a drift, as RATTLE, call for phi alone (``drifting``).
    """
    point = replace(low.node, suffix="c", multipliers=low.multipliers)
    first = dict.fromkeys(("constraint_slopes", "constrain"), (_CLEARED,))
    functions = []
    for name, some in constraint_stores(low, held, places, point, "constraints").items():
        if drifting or name != "constraint_values":
            lines = low.statements(some, (Level.ITERATION,))
            functions.append(Function(name, DOCS[name], (*first.get(name, ()), *lines)))
    return functions


def constraint_stores(
    low: Lowering, held: Held, places: Sequence[int], point: Point, section: str
) -> dict[str, Iterator[Store]]:
    """Return what each function stores at a point."""
    both = (*places, *range(low.n, low.n + held.count))

    def entry(what: str, *index: int) -> Expression:
        return low.held.entry(point, section, what, *index)

    def entry_row(i: int, j: int) -> Row:
        """Return the row of an entry of the saddle-point matrix [[M, Phi^T], [Phi, 0]]."""
        return Row("CONSTRAINT_QQ", held.entry(both[i], both[j]))

    def values() -> Iterator[Store]:
        return (Store(Row("CONSTRAINT", c), entry("phi", c)) for c in count)

    def slopes() -> Iterator[Store]:
        return _first_derivatives(entry, entry_row, low.n, count)

    count, plain = range(held.count), low.equations.plain
    curves = (Store(Row("CURVATURE", c), -entry("curve", c)) for c in count)
    pushes = (Store(Row("RESIDUAL", s), entry("push", a)) for a, s in enumerate(places))
    pulls = _second_derivatives(entry, entry_row, low.n, add=False)
    stores = {
        "constraint_slopes": slopes(),
        "constrain": chain(values(), slopes(), pulls),
        "constraint_values": values(),
        "pushes": chain(pushes, curves),
    }
    rolling = range(len(plain.constraints), held.count)
    if rolling:

        def rates() -> Iterator[Store]:
            return (Store(Row("SLIP", k), entry("rate", c)) for k, c in enumerate(rolling))

        def by_coordinates(block: str, what: str) -> Iterator[Store]:
            return (
                Store(Row(block, k * low.n + a), entry(what, c, a))
                for k, c in enumerate(rolling)
                for a in range(low.n)
            )

        stores["pushes"] = chain(stores["pushes"], rates())
        stores["hold_velocities"] = (
            Store(Row("CURVATURE", c), entry("b", c) if c in rolling else low.graph.of(0))
            for c in count
        )
        slopes_of_rates = by_coordinates("SLIP_Q", "rate_q"), by_coordinates("SLIP_V", "Phi")
        stores["rates"] = chain(rates(), *slopes_of_rates)
        if plain.carried and low.equations.varied is not None:
            stores["carried_slopes"] = by_coordinates("SLIP_Q", "b_q")
    return stores


def constraint_family_functions(
    low: Lowering, families: Sequence[Family], places: Sequence[int], *, drifting: bool
) -> tuple[list[Function], dict[str, Table]]:
    """Write phi, its derivatives and accelerations by loops over families, and their tables.

    There are no velocity constraints among families.
    """
    tables: dict[str, Table] = {}
    functions: list[Function] = []
    calls = {
        "constraint_slopes": [_CLEARED],
        "constrain": [_CLEARED],
        "pushes": [Call("jet"), Call("push_of_jet")],
    } | ({"constraint_values": []} if drifting else {})
    for number, family in enumerate(families, 1):
        writer = FamilyWriter(
            low, family, f"CONSTRAINTS_{number}", derive_constraints(family.plain)
        )
        tables[writer.table] = writer.build_table(places)
        for name, stores, indices in _family_stores(low, writer):
            if name == "constraint_values" and not drifting:
                continue
            function = writer.function(f"{name}_{number}", DOCS[name], stores, indices)
            functions.append(function)
            calls["pushes" if name == "curves" else name].append(Call(function.name))
    functions += [Function(name, DOCS[name], tuple(some)) for name, some in calls.items()]
    return functions, tables


def _family_stores(low: Lowering, writer: FamilyWriter) -> list[tuple[str, list[Store], list[str]]]:
    """Return what a member stores in each function, and which places it looks up before."""
    n, c = len(writer.indices), writer.constraint
    here = [low.names.fresh(f"s{i}") for i in range(n + 1)]
    items = [*writer.indices, f"DIMENSION + {c}"]
    indices = [f"{s} = HELD_PLACE[{item}]" for s, item in zip(here, items, strict=True)]

    def entry(what: str, *index: int) -> Expression:
        return writer.template.entry(writer.point, "constraints", what, *index)

    def entry_row(i: int, j: int) -> Row:
        """Return the row of an entry of the saddle-point matrix, by the looked-up places."""
        return Row("CONSTRAINT_QQ", f"{here[i]}*HELD_STRIDE + {here[j]} + HELD_OFFSET")

    slopes = [*_first_derivatives(entry, entry_row, n, range(1))]
    value = Store(Row("CONSTRAINT", c), entry("phi", 0))
    pulls = [*_second_derivatives(entry, entry_row, n, add=True)]
    curve = Store(Row("CURVATURE", c), -entry("curve", 0))
    return [
        ("constraint_slopes", slopes, indices),
        ("constrain", [value, *slopes, *pulls], indices),
        ("constraint_values", [value], []),
        ("curves", [curve], []),
    ]


def _first_derivatives(
    entry: Entry, entry_row: EntryRow, n: int, constraints: range
) -> Iterator[Store]:
    """Store Phi = dphi/dq in the rows of the constraints, and its transpose."""
    return (
        Store(row, entry("Phi", c, a))
        for c in constraints
        for a in range(n)
        for row in (entry_row(n + c, a), entry_row(a, n + c))
        if entry("Phi", c, a) != 0
    )


def _second_derivatives(entry: Entry, entry_row: EntryRow, n: int, *, add: bool) -> Iterator[Store]:
    """Store the second derivatives of lambda.phi by the coordinates."""
    return (
        Store(entry_row(a, b), entry("pull", a, b), add=add)
        for a in range(n)
        for b in range(n)
        if entry("pull", a, b) != 0
    )
