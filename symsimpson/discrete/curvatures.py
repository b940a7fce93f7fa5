"""Second derivatives at a node and at a control point, of rows of a step with given weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import sympy as sp

from symsimpson.discrete.jet import Jet, Key, written_as_jet
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import Graph, Value, scaled
from symsimpson.graph.rebuild import rebuilt

if TYPE_CHECKING:
    from symsimpson.discrete.slopes import Cost
    from symsimpson.mechanics.plain import Plain

__all__ = ["derive_curvatures"]


def derive_curvatures(plain: Plain, varied: Sequence[sp.Symbol], cost: Cost | None) -> Jet:
    """Derive second derivatives of alpha.F + beta.P + gamma g, and of nu.phi - alpha.Phi^T lambda.

    Parameters
    ----------
    plain : Plain
        Its weights stand for alpha, beta and gamma at a node, for alpha and nu at a control point.
    varied : sequence of sympy.Symbol
        Plain symbols of parameters and inputs.
    cost : Cost, optional
        The running cost g.

    Returns
    -------
    Jet
        Outputs ``("node", i, j)``, j <= i, by (q, v, varied), and ``("point", i, j)`` by
        (q, lambda, varied); those that vanish are left out.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    given = [plain.L, *plain.f, *plain.constraints.values()]
    L, *values = rebuilt(plain.graph, given, {}, graph)
    f, phi = values[:n], values[n:]
    weights = graph.numbers(symbol.name for symbol in plain.weights)
    of = graph.numbers(symbol.name for symbol in varied)
    slopes = gradient(graph, L, moving)
    forces = [graph.add([slopes[i], f[i]]) for i in range(n)]
    terms = graph.products([*forces, *slopes[n:]], weights[: 2 * n])
    if cost is not None:
        (g,) = rebuilt(cost.graph, [cost.value], {}, graph)
        terms = [*terms, *graph.products([g], weights[2 * n :])]
    outputs = _second(graph, "node", graph.add(terms), [*moving, *of])
    if phi:
        multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
        pulls = gradient(graph, graph.add(graph.products(phi, multipliers)), moving[:n])
        pulled = [scaled(-1, pull) for pull in pulls]
        value = graph.add(graph.products([*pulled, *phi], weights[: n + len(phi)]))
        outputs |= _second(graph, "point", value, [*moving[:n], *multipliers, *of])
    return written_as_jet(plain, graph, outputs)


def _second(graph: Graph, what: str, value: Value, symbols: Sequence[int]) -> dict[Key, Value]:
    """Differentiate a value twice; of two equal entries one is kept."""
    found: dict[Key, Value] = {}
    for i, slope in enumerate(gradient(graph, value, symbols)):
        row = gradient(graph, slope, symbols[: i + 1])
        found |= {(what, i, j): entry for j, entry in enumerate(row) if entry[0]}
    return found
