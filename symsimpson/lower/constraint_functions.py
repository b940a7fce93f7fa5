"""Functions that evaluate constraints: lines for each one, or loops over families."""

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
from symsimpson.lower.storage import Border
from symsimpson.lower.template import Point
from symsimpson.lower.terms_of_l import FamilyWriter, Table

DOCS = {
    "constraint_slopes": "Phi = dphi/dq at a point.",
    "constrain": "phi, Phi = dphi/dq, and the second derivatives of lambda.phi by q.",
    "constraint_values": "phi at a point.",
    "curves": "Phi v' = -v.phi_qq.v, at a state.",
    "pushes": "Right-hand sides of M v' + Phi^T lambda, Phi v' and A v - b at a state.",
    "hold_velocities": "Right-hand sides of Phi v = -phi_t and A v = b.",
    "rates": "A v - b and its derivatives by q and v at a point.",
    "carried_slopes": "Derivatives of b by q at a point.",
}
_CLEARED = Call("clear", ("W", "CONSTRAINT_QQ", "HELD_SIZE", "lane"))


def constraint_functions(
    low: Lowering, held: Border, places: Sequence[int], *, drifting: bool
) -> list[Function]:
    """Write the functions of phi, its derivatives and accelerations, constraint by constraint.

    Velocity constraints A v = b are included. ``places`` has the matrix row of each coordinate.
    Schemes with drifts, such as RATTLE, also need phi alone (``drifting``).
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
    low: Lowering, held: Border, places: Sequence[int], point: Point, section: str
) -> dict[str, Iterator[Store]]:
    """Return the stores of each function at a point."""
    both = (*places, *range(low.n, low.n + held.count))

    def entry(what: str, *index: int) -> Expression:
        return low.constraint_jet.entry(point, section, what, *index)

    def entry_row(i: int, j: int) -> Row:
        """Return the row of an entry of the saddle-point matrix [[M, Phi^T], [Phi, 0]]."""
        return Row("CONSTRAINT_QQ", held.entry(both[i], both[j]))

    count, plain = range(held.count), low.equations.plain
    stores = _stores_of_phi(entry, entry_row, low.n, count)
    pushes = (Store(Row("RESIDUAL", s), entry("push", a)) for a, s in enumerate(places))
    stores["pushes"] = chain(pushes, stores.pop("curves"))
    first, rolling = plain.first_side, range(len(plain.constraints), held.count)

    def rates() -> Iterator[Store]:
        return (Store(Row("SLIP", k), entry("rate", c)) for k, c in enumerate(rolling))

    def by_coordinates(block: str, what: str, some: Sequence[int]) -> Iterator[Store]:
        return (
            Store(Row(block, (c - first) * low.n + a), entry(what, c, a))
            for c in some
            for a in range(low.n)
        )

    if rolling or plain.moving:
        stores["hold_velocities"] = (
            Store(Row("CURVATURE", c), entry("b", c) if c >= first else low.graph.of(0))
            for c in count
        )
    if rolling:
        stores["pushes"] = chain(stores["pushes"], rates())
        stores["rates"] = chain(
            rates(),
            by_coordinates("SLIP_Q", "rate_q", rolling),
            by_coordinates("SLIP_V", "Phi", rolling),
        )
    if plain.carried and low.equations.varied is not None:
        stores["carried_slopes"] = by_coordinates("SLIP_Q", "b_q", range(first, held.count))
    return stores


def constraint_family_functions(
    low: Lowering, families: Sequence[Family], places: Sequence[int], *, drifting: bool
) -> tuple[list[Function], dict[str, Table]]:
    """Write the functions of phi, its derivatives and accelerations as loops over families.

    The second result has the tables of the loops. Families have no velocity constraints.
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
        lookups, family_stores = _family_stores(low, writer)
        for name, stores in family_stores.items():
            if name == "constraint_values" and not drifting:
                continue
            more = lookups if name in ("constraint_slopes", "constrain") else []
            function = writer.function(f"{name}_{number}", DOCS[name], stores, more)
            functions.append(function)
            calls["pushes" if name == "curves" else name].append(Call(function.name))
    functions += [Function(name, DOCS[name], tuple(some)) for name, some in calls.items()]
    return functions, tables


def _family_stores(
    low: Lowering, writer: FamilyWriter
) -> tuple[list[str], dict[str, Iterator[Store]]]:
    """Return the lines that look up places, and the stores of a member in each function."""
    n = len(writer.indices)
    here = [low.names.fresh(f"s{i}") for i in range(n + 1)]
    items = [*writer.indices, f"DIMENSION + {writer.constraint}"]

    def entry(what: str, *index: int) -> Expression:
        return writer.template.entry(writer.point, "constraints", what, *index)

    def entry_row(i: int, j: int) -> Row:
        """Return the row of an entry of the saddle-point matrix, by the looked-up places."""
        return Row("CONSTRAINT_QQ", f"{here[i]}*HELD_STRIDE + {here[j]} + HELD_OFFSET")

    lookups = [f"{s} = HELD_PLACE[{item}]" for s, item in zip(here, items, strict=True)]
    return lookups, _stores_of_phi(entry, entry_row, n, [writer.constraint], add=True)


def _stores_of_phi(
    entry: Callable[..., Expression],
    entry_row: Callable[[int, int], Row],
    n: int,
    constraints: Sequence[int | str],
    *,
    add: bool = False,
) -> dict[str, Iterator[Store]]:
    """Return the stores of phi and its derivatives by n coordinates, for each function.

    ``entry`` gives an entry of the jet, and ``entry_row`` the row of a matrix entry. The iterators
    define an entry when they reach its store. Second derivatives are added with ``add``.
    """

    def values() -> Iterator[Store]:
        return (Store(Row("CONSTRAINT", c), entry("phi", k)) for k, c in enumerate(constraints))

    def slopes() -> Iterator[Store]:
        """Store Phi = dphi/dq in the rows of the constraints, and its transpose."""
        return (
            Store(row, entry("Phi", k, a))
            for k in range(len(constraints))
            for a in range(n)
            for row in (entry_row(n + k, a), entry_row(a, n + k))
            if entry("Phi", k, a) != 0
        )

    pulls = (
        Store(entry_row(a, b), entry("pull", a, b), add=add)
        for a in range(n)
        for b in range(n)
        if entry("pull", a, b) != 0
    )
    return {
        "constraint_slopes": slopes(),
        "constrain": chain(values(), slopes(), pulls),
        "constraint_values": values(),
        "curves": (
            Store(Row("CURVATURE", c), -entry("curve", k)) for k, c in enumerate(constraints)
        ),
    }
