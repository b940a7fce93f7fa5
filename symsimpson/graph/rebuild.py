"""Substitution of values for nodes, in the same graph or in another graph."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction

import mpmath

from symsimpson.graph.evaluate import evaluate_nodes
from symsimpson.graph.nodes import Exact, Graph, Value, scale

#: Numbers to substitute for a symbol on which a value does not depend. The first valid one is used.
NUMBERS = (0, 1, 2, Fraction(7, 3))
#: Digits of a comparison of values, and the relative difference of equal values.
DIGITS = 40
NOTHING = mpmath.mpf("1e-25")
#: Patterns of signs for the coordinates of the points of a comparison.
SIGNS = ((1,), (-1,), (1, -1), (1, 1, -1), (-1, 1, 1))


def rebuild(
    graph: Graph, values: Iterable[Value], replaced: Mapping[int, Value], into: Graph | None = None
) -> list[Value]:
    """Return values with some nodes replaced, in the graph ``into`` (by default the same graph).

    ``replaced`` maps nodes of ``graph`` to values of ``into``. Raises ZeroDivisionError if the
    substitution leads to a division by zero.
    """
    values = list(values)
    target = graph if into is None else into
    touched = frozenset().union(*(graph.nodes[n].symbols for n in replaced))
    done: dict[int, Value] = dict(replaced)
    for n in graph.descendants(n for _, n in values):
        if n in done:
            continue
        unchanged = target is graph and graph.nodes[n].symbols.isdisjoint(touched)
        done[n] = (1, n) if unchanged else rebuild_node(graph, n, done, target)
    return [scale(c, done[n]) for c, n in values]


def rebuild_node(graph: Graph, n: int, done: Mapping[int, Value], target: Graph) -> Value:
    """Build a node in the graph ``target`` from the new values ``done`` of its arguments."""
    kind, parts, _ = graph.nodes[n]
    match kind:
        case "sum":
            return target.add(scale(c, done[m]) for c, m in parts)
        case "product":
            return target.multiply([target.power(done[m], e) for m, e in parts])
        case "function":
            name, *arguments = parts
            return target.function(name, *(scale(c, done[m]) for c, m in arguments))
        case "symbol":
            return target.symbol(*parts)
        case "constant":
            return target.constant(*parts)
    return 1, n


def fix_symbols(graph: Graph, value: Value, symbols: Iterable[int]) -> Value | None:
    """Substitute numbers for symbols on which a value does not depend; None if this fails."""
    left = sorted(symbols)
    # usually all symbols can be 0 at once
    attempts: list[tuple[list[int], Exact]] = [(left, NUMBERS[0])] if len(left) > 1 else []
    attempts += [([x], number) for x in left for number in NUMBERS]
    for some, number in attempts:
        if not set(some) <= set(left):
            continue
        try:
            (candidate,) = rebuild(graph, [value], dict.fromkeys(some, (number, 0)))
        except ZeroDivisionError:
            continue
        if agree_at_points(graph, value, candidate):
            value, left = candidate, [x for x in left if x not in some]
    return None if left else value


def agree_at_points(graph: Graph, old: Value, new: Value) -> bool:
    """Return whether two values agree at several points, and the old one is finite at one."""
    symbols = sorted(graph.nodes[old[1]].symbols | graph.nodes[new[1]].symbols)
    compared = False
    with mpmath.workdps(DIGITS):
        for signs in SIGNS:
            point = {
                x: mpmath.mpf(3 + 2 * k) / (7 + k) * signs[k % len(signs)]
                for k, x in enumerate(symbols)
            }
            values = evaluate_nodes(graph, [old[1], new[1]], point, mpmath.mp)
            first, second = (values[n] * c.numerator / c.denominator for c, n in (old, new))
            if mpmath.isfinite(first):
                compared = True
                if not abs(first - second) <= NOTHING * (1 + abs(first)):
                    return False
    return compared
