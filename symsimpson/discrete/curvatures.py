"""Second derivatives at a node and at a control point, of rows of a step with given weights."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symsimpson.discrete.jet import Jet, Key, written_as_jet
from symsimpson.discrete.node_derivatives import Cost
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import Graph, Value, scaled
from symsimpson.graph.rebuild import rebuilt
from symsimpson.mechanics.plain import Plain

__all__ = ["derive_curvatures"]


def derive_curvatures(plain: Plain, varied: Sequence[sp.Symbol], cost: Cost | None) -> Jet:
    """Derive second derivatives of h alpha.F + beta.P + h gamma g, and of nu.phi - alpha.Phi^T mu.

    They are by q and w = h v at a node, which do not depend on h: the time t does, which ends up c
    h behind the one that is given. The symbols of v and t stand for w and for the start of the
    step, the weights of ``plain`` for alpha, beta and gamma at a node, for alpha and nu at a
    control point; g is the running cost. Outputs are ``("node", i, j)``, j <= i, by (q, w, varied),
    and ``("point", i, j)`` by (q, mu, varied); those that vanish are left out.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    h, place, _ = graph.numbers(symbol.name for symbol in plain.step)
    phi = rebuilt(plain.graph, list(plain.constraints.values()), {}, graph)
    L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
    weights = graph.numbers(symbol.name for symbol in plain.weights)
    of = graph.numbers(symbol.name for symbol in varied)
    slopes = gradient(graph, L, moving)
    forces = [graph.add([slopes[i], f[i]]) for i in range(n)]
    if cost is not None:
        (g,) = rebuilt(cost.graph, [cost.value], {}, graph)
        forces.append(g)
    integrated = graph.add(graph.products(forces, [*weights[:n], *weights[2 * n :]][: len(forces)]))
    momenta = graph.products(slopes[n:], weights[n : 2 * n])
    value = graph.add([graph.multiply([integrated, (1, h)]), *momenta])
    (t,) = graph.numbers([plain.t.name])
    inverse = graph.power((1, h), -1)
    moved = {v: graph.multiply([(1, v), inverse]) for v in moving[n:]}
    if plain.step[0] in varied:
        moved[t] = graph.add([(1, t), graph.multiply([(1, place), (1, h)])])
    (value,) = rebuilt(graph, [value], moved)
    outputs = _second(graph, "node", value, [*moving, *of])
    if phi:
        multipliers = graph.numbers(symbol.name for symbol in plain.multipliers)
        pulls = gradient(graph, graph.add(graph.products(phi, multipliers)), moving[:n])
        pulled = [scaled(-1, pull) for pull in pulls]
        value = graph.add(graph.products([*pulled, *phi], weights[: n + len(phi)]))
        outputs |= _second(graph, "point", value, [*moving[:n], *multipliers, *of])
    return written_as_jet(plain, graph, outputs)


def _second(graph: Graph, what: str, value: Value, symbols: Sequence[int]) -> dict[Key, Value]:
    """Differentiate a value twice; of two equal entries one is kept."""
    entries: dict[Key, Value] = {}
    for i, slope in enumerate(gradient(graph, value, symbols)):
        row = gradient(graph, slope, symbols[: i + 1])
        entries |= {(what, i, j): entry for j, entry in enumerate(row) if entry[0]}
    return entries
