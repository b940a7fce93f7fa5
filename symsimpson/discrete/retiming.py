"""Quantities of a retimed system in the user's time, and the rate of that."""

from __future__ import annotations

from symsimpson.declare.plain import Plain
from symsimpson.declare.retimed import Retiming
from symsimpson.discrete.jet import Jet, Key, written_as_jet
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import Graph, Value
from symsimpson.graph.rebuild import rebuilt


def derive_original_terms(retiming: Retiming) -> Jet:
    """Derive M, a, V and P = dL/dv of the original system, with v = dq/dt.

    Outputs are ``("M", i, j)``, ``("a", i)``, ``("V",)`` and ``("P", i)``.
    """
    plain, graph = retiming.plain, Graph()
    n = len(plain.q)
    every = [(i, j) for i in range(n) for j in range(n)]
    given = [plain.L, plain.V, *plain.a, *(plain.entry(i, j) for i, j in every)]
    L, V, *values = rebuilt(plain.graph, given, {}, graph)
    momenta = gradient(graph, L, graph.numbers(s.name for s in plain.v))
    outputs: dict[Key, Value] = {("V",): V}
    outputs |= {("a", i): values[i] for i in range(n)}
    outputs |= {("M", i, j): value for (i, j), value in zip(every, values[n:], strict=True)}
    outputs |= {("P", i): momentum for i, momentum in enumerate(momenta)}
    return written_as_jet(plain, graph, outputs)


def derive_rate(plain: Plain, retiming: Retiming) -> Jet:
    """Return g = dt/dtau before its division by the value at the start; ``plain`` is in tau.

    The output is ``("rate",)``.
    """
    graph = Graph()
    (rate,) = rebuilt(retiming.graph, [retiming.rate], {}, graph)
    return written_as_jet(plain, graph, {("rate",): rate})
