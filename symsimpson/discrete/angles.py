"""Sines and cosines written by those of other angles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from symsimpson.graph.nodes import ONE, Graph, Value, magnitude, scaled


def halved(graph: Graph, symbols: Iterable[int]) -> dict[int, Value]:
    """Write sine and cosine of symbols by those of half of them.

    1 - cos x is 2 sin(x/2)^2 without a subtraction.
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


def summed(graph: Graph, roots: Sequence[int]) -> dict[int, Value]:
    """Write sine and cosine of a sum by those of a term and of the rest, where both are there.

    Four products in place of some thirty operations. The error is that of numbers of size one, as
    if the angle had been rounded; a sine that something is divided by needs its own digits.
    """
    nodes = graph.reached(roots)
    angles: dict[Value, list[int]] = {}
    for n in nodes:
        kind, parts, _ = graph.nodes[n]
        if kind == "function" and parts[0] in ("sin", "cos"):
            angles.setdefault(parts[1], []).append(n)
    delicate = _delicate(graph, nodes)
    replaced: dict[int, Value] = {}
    for (c, m), users in angles.items():
        if not delicate.isdisjoint(users):
            continue
        terms = _two_terms(graph, (c, m), angles)
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


def _two_terms(
    graph: Graph, angle: Value, angles: Mapping[Value, Any]
) -> tuple[Value, Value] | None:
    """Write an angle as a sum of two others whose sine and cosine are there, too."""
    c, m = angle
    kind, parts, _ = graph.nodes[m]
    if kind != "sum" or len(parts) < 2:
        return None
    terms = [scaled(c, part) for part in parts]
    for k, term in enumerate(terms):
        rest = graph.add(terms[:k] + terms[k + 1 :])
        if all((magnitude(d), n) in angles for d, n in (term, rest)):
            return rest, term
    return None


def _delicate(graph: Graph, nodes: Iterable[int]) -> set[int]:
    """Return the sines and cosines that something is divided by, or a root is taken of."""
    bases = {
        m
        for n in nodes
        if graph.nodes[n].kind == "product"
        for m, e in graph.nodes[n].parts
        if e < 0 or e.denominator != 1
    }
    return {
        n
        for n in graph.reached(bases)
        if graph.nodes[n].kind == "function" and graph.nodes[n].parts[0] in ("sin", "cos")
    }
