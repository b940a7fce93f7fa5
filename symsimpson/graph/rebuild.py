"""A graph written anew: with other values in place of some nodes, or in another graph."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction

import mpmath

from symsimpson.graph.evaluate import evaluated
from symsimpson.graph.nodes import Exact, Graph, Value, scaled

#: What is put for symbols that a value does not depend on, the first that will do.
NUMBERS = (0, 1, 2, Fraction(7, 3))
#: Values that are the same agree to most of so many digits,
DIGITS = 40
NOTHING = mpmath.mpf("1e-25")
#: at points whose coordinates have these signs in turn.
SIGNS = ((1,), (-1,), (1, -1), (1, 1, -1), (-1, 1, 1))


def rebuilt(
    graph: Graph, values: Iterable[Value], replaced: Mapping[int, Value], into: Graph | None = None
) -> list[Value]:
    """Write values with others in place of some nodes.

    Those that are ``replaced`` and what is written belong to the graph ``into``, the same one if it
    is not given. Nodes without a symbol are written there, too. Raises ZeroDivisionError if
    something is divided by zero then.
    """
    values = list(values)
    same = into is None or into is graph
    target = graph if into is None else into
    touched = frozenset().union(*(graph.nodes[n].symbols for n in replaced)) if same else None
    done: dict[int, Value] = dict(replaced)
    reached = graph.reached(n for _, n in values)
    for n in reached:
        if n in done:
            continue
        if touched is not None and graph.nodes[n].symbols.isdisjoint(touched):
            done[n] = (1, n)
            continue
        done[n] = again(graph, n, done, target)
    return [scaled(c, done[n]) for c, n in values]


def again(graph: Graph, n: int, done: Mapping[int, Value], target: Graph) -> Value:
    """Write one node in a graph, of arguments that are done."""
    kind, parts, _ = graph.nodes[n]
    match kind:
        case "sum":
            return target.add(scaled(c, done[m]) for c, m in parts)
        case "product":
            return target.multiply([target.power(done[m], e) for m, e in parts])
        case "function":
            name, *arguments = parts
            return target.function(name, *(scaled(c, done[m]) for c, m in arguments))
        case "symbol":
            return target.symbol(*parts)
        case "constant":
            return target.constant(*parts)
    return 1, n


def fixed(graph: Graph, value: Value, symbols: Iterable[int]) -> Value | None:
    """Put numbers for symbols that a value does not depend on; None if none of them will do."""
    left = sorted(symbols)
    # all at a time, as a rule
    attempts: list[tuple[list[int], Exact]] = [(left, NUMBERS[0])] if len(left) > 1 else []
    attempts += [([x], number) for x in left for number in NUMBERS]
    for some, number in attempts:
        if not set(some) <= set(left):
            continue
        try:
            (candidate,) = rebuilt(graph, [value], dict.fromkeys(some, (number, 0)))
        except ZeroDivisionError:
            continue
        if same(graph, value, candidate):
            value, left = candidate, [x for x in left if x not in some]
    return None if left else value


def same(graph: Graph, old: Value, new: Value) -> bool:
    """Return whether a value agrees with an old one at points of several signs."""
    symbols = sorted(graph.nodes[old[1]].symbols | graph.nodes[new[1]].symbols)
    seen = False
    with mpmath.workdps(DIGITS):
        for signs in SIGNS:
            point = {
                x: mpmath.mpf(3 + 2 * k) / (7 + k) * signs[k % len(signs)]
                for k, x in enumerate(symbols)
            }
            values = evaluated(graph, [old[1], new[1]], point, mpmath.mp)
            first, second = (values[n] * c.numerator / c.denominator for c, n in (old, new))
            if mpmath.isfinite(first):
                seen = True
                if not abs(first - second) <= NOTHING * (1 + abs(first)):
                    return False
    return seen
