"""Coefficients of the terms of L: products of parameters, computed once a run.

Pair sums have as many products m_i m_k as pairs: those that differ by their parameters alone are
computed in a loop over a table.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Index, Loop, Row, Section, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.lower import Lowering
from symsimpson.graph.nodes import Exact

__all__ = ["coefficient_loops"]

#: Fewer products of one kind are written out.
FEWEST = 8


def coefficient_loops(
    low: Lowering, values: Sequence[Expression]
) -> tuple[list[Statement], list[Store], dict[str, object]]:
    """Generate the loops, single stores and tables that compute the coefficients of L.

    ``values`` are the coefficients, in the order of their rows, made of the parameters of ``low``.
    Loops are for products of one form, of which there are at least FEWEST; stores are for what is
    left. A table has for each turn of a loop the row of a coefficient, then those of its
    parameters.
    """
    kinds: dict[tuple[Exact, int], list[tuple[int, ...]]] = defaultdict(list)
    stores = []
    for row, value in enumerate(values):
        places = _places(low, value)
        number = value.coefficient
        if places:
            kinds[number, len(places)].append((row, *places))
        else:
            stores.append(_store(low, row, value))
    loops: list[Statement] = []
    tables: dict[str, object] = {}
    for (number, _), members in kinds.items():
        if len(members) < FEWEST:
            stores += [_store(low, row, values[row]) for row, *_ in members]
            continue
        name = f"PRODUCTS_{len(tables) + 1}"
        tables[name] = tuple(members)
        loops.append(_loop(low, name, number, members))
    return loops, sorted(stores, key=lambda store: int(store.row.index)), tables


def _places(low: Lowering, product: Expression) -> tuple[int, ...]:
    """Return the rows of the parameters in a pure product; () for any other expression."""
    factors = [Expression(low.graph, (e, n)) for n, e in low.graph.factors(product.node)]
    rows = [low.rows[factor] for factor in factors if factor in low.rows]
    return tuple(sorted(int(row.index) for row in rows)) if len(rows) == len(factors) else ()


def _store(low: Lowering, row: int, value: Expression) -> Store:
    return Store(Row("COEFFICIENT", row), low.graph.split(value, "constants")[0])


def _loop(
    low: Lowering, table: str, number: Exact, members: Sequence[tuple[int, ...]]
) -> Statement:
    """Write the loop over products of one kind."""
    target, *indices = [low.names.fresh("row") for _ in members[0]]
    factors = []
    for index in indices:
        factors.append(low.graph.fresh("factor", Level.RUN))
        low.rows[factors[-1]] = Row("PARAMETER", index)
    value = low.graph.split(low.graph.product([number, *factors]), "constants")[0]
    read = [Index(name, f"{table}[term, {k}]") for k, name in enumerate((target, *indices))]
    body = low.statements([Store(Row("COEFFICIENT", target), value)], (Level.RUN,))
    inside = [part for section in body if isinstance(section, Section) for part in section.body]
    return Loop("term", f"range({len(members)})", (*read, *inside))
