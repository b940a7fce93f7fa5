"""Identities for sines and cosines: half angles, and sums of angles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from symsimpson.graph.nodes import ONE, Graph, Value, magnitude, scale


def halve_angles(graph: Graph, symbols: Iterable[int]) -> dict[int, Value]:
    """Map the sine and cosine of symbols to expressions in the half angles.

    For example, 1 - cos x becomes 2 sin(x/2)^2, without a subtraction.
    """
    replacements: dict[int, Value] = {}
    for x in symbols:
        sine = graph.function("sin", (Fraction(1, 2), x))
        cosine = graph.function("cos", (Fraction(1, 2), x))
        replacements[graph.function("sin", (1, x))[1]] = graph.multiply([(2, 0), sine, cosine])
        replacements[graph.function("cos", (1, x))[1]] = graph.add(
            [ONE, graph.multiply([(-2, 0), sine, sine])]
        )
    return replacements


def split_sums(graph: Graph, roots: Sequence[int]) -> dict[int, Value]:
    """Map the sine and cosine of a sum to expressions in two partial sums, by addition theorems.

    This needs four products in place of about 30 operations, if the sines and cosines of both
    partial sums exist already. The absolute error is the round-off of a number of size one. Sines
    and cosines in divisors or under roots need all digits, and are not replaced.
    """
    nodes = graph.descendants(roots)
    angles: dict[Value, list[int]] = {}
    for n in nodes:
        kind, parts, _ = graph.nodes[n]
        if kind == "function" and parts[0] in ("sin", "cos"):
            angles.setdefault(parts[1], []).append(n)
    sensitive = _find_sensitive(graph, nodes)
    replaced: dict[int, Value] = {}
    for (c, m), users in angles.items():
        if not sensitive.isdisjoint(users):
            continue
        terms = _split_angle(graph, (c, m), angles)
        if terms is None:
            continue
        (s_a, c_a), (s_b, c_b) = (
            (graph.function("sin", term), graph.function("cos", term)) for term in terms
        )
        for n in users:
            if graph.nodes[n].parts[0] == "sin":
                pairs = [graph.multiply([s_a, c_b]), graph.multiply([c_a, s_b])]
            else:
                minus = graph.multiply([(-1, 0), s_a, s_b])
                pairs = [graph.multiply([c_a, c_b]), minus]
            replaced[n] = graph.add(pairs)
    return replaced


def _split_angle(
    graph: Graph, angle: Value, angles: Mapping[Value, Any]
) -> tuple[Value, Value] | None:
    """Split an angle into a sum of two other ``angles``; None if this is not possible."""
    c, m = angle
    kind, parts, _ = graph.nodes[m]
    if kind != "sum" or len(parts) < 2:
        return None
    terms = [scale(c, part) for part in parts]
    for k, term in enumerate(terms):
        rest = graph.add(terms[:k] + terms[k + 1 :])
        if all((magnitude(d), n) in angles for d, n in (term, rest)):
            return rest, term
    return None


def _find_sensitive(graph: Graph, nodes: Iterable[int]) -> set[int]:
    """Return the sines and cosines in divisors and under roots, which need all digits."""
    bases = {
        m
        for n in nodes
        if graph.nodes[n].kind == "product"
        for m, e in graph.nodes[n].parts
        if e < 0 or e.denominator != 1
    }
    return {
        n
        for n in graph.descendants(bases)
        if graph.nodes[n].kind == "function" and graph.nodes[n].parts[0] in ("sin", "cos")
    }
