"""Derivatives at a node of a step: F and P by parameters, and a running cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import sympy as sp

from symsimpson.discrete.jet import Jet, Key, written_as_jet
from symsimpson.graph.derive import Derivatives, gradient
from symsimpson.graph.nodes import ZERO, Graph, Value, scaled
from symsimpson.graph.rebuild import rebuilt
from symsimpson.mechanics.plain import Plain

__all__ = ["Cost", "derive_cost", "derive_slopes"]


@dataclass(frozen=True)
class Cost:
    """A running cost g(t, q, v, u), in a graph whose symbols have the names of the plain ones."""

    graph: Graph
    value: Value

    def depends(self, symbol: sp.Symbol) -> bool:
        """Return whether a plain symbol stands in it."""
        numbers = self.graph.numbers([symbol.name])
        return not self.graph.nodes[self.value[1]].symbols.isdisjoint(numbers)


def derive_slopes(plain: Plain, varied: Mapping[str, sp.Symbol]) -> Jet:
    """Derive F = L_q + f and P = L_v by parameters and inputs: plain symbols, by their names.

    Outputs are ``("F_a", i, name)`` and ``("P_a", i, name)``; of constraints ``("phi_a", c, name)``
    and ``("pull_a", i, name)``, those of phi and of Phi^T lambda + A^T nu; of velocity constraints
    ``("b_a", c, name)`` and ``("rate_a", c, name)``, those of b and A v - b.
    """
    graph, n = Graph(), len(plain.q)
    places = graph.numbers(symbol.name for symbol in plain.symbols)
    moving = places[: 2 * n]
    L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
    held = plain.held_rows(graph)
    m, multipliers = len(held.phi), graph.numbers(symbol.name for symbol in plain.multipliers)
    phi = [*held.phi, *(ZERO for _ in held.rows)]
    pulls = held.pulls(graph, moving[:n], multipliers) if phi else []
    moved = {("b", c): row[-1] for c, row in enumerate(held.rows, m)}
    moved |= {("rate", c): rate for c, rate in enumerate(held.rates(graph, moving[n:]), m)}
    derivatives = Derivatives(graph)
    outputs: dict[Key, Value] = {}
    by_size = _BySize(graph, plain, derivatives)
    for name, x in zip(varied, graph.numbers(s.name for s in varied.values()), strict=True):
        if varied[name] == plain.step[0]:
            L_gradient = gradient(graph, L, moving)
            forces = [graph.add([L_gradient[i], f[i]]) for i in range(n)]
            outputs |= {("F_a", i, name): by_size(F, integrated=True) for i, F in enumerate(forces)}
            outputs |= {("P_a", i, name): by_size(P) for i, P in enumerate(L_gradient[n:])}
            outputs |= {("phi_a", c, name): ZERO for c in range(len(phi))}
            outputs |= {(f"{what}_a", c, name): by_size(x) for (what, c), x in moved.items()}
            for i, pull in enumerate(pulls):
                later = by_size.later(pull) if held.rows else ZERO
                outputs["pull_a", i, name] = graph.add([by_size.over(scaled(-1, pull)), later])
            continue
        slopes = gradient(graph, derivatives(L, x), moving)
        for i in range(n):
            outputs["F_a", i, name] = graph.add([slopes[i], derivatives(f[i], x)])
            outputs["P_a", i, name] = slopes[n + i]
        outputs |= {("phi_a", c, name): derivatives(value, x) for c, value in enumerate(phi)}
        outputs |= {(f"{what}_a", c, name): derivatives(y, x) for (what, c), y in moved.items()}
        outputs |= {("pull_a", i, name): derivatives(y, x) for i, y in enumerate(pulls)}
    return written_as_jet(plain, graph, outputs)


class _BySize:
    """Derivatives of what stands at a node by the size of the step, its path being held.

    There v goes with 1/h and t moves by its place; what is integrated has a factor h before it,
    and is divided by that.
    """

    def __init__(self, graph: Graph, plain: Plain, derivatives: Derivatives) -> None:
        self._graph, self._derivatives = graph, derivatives
        self._v = graph.numbers(s.name for s in plain.v)
        self._h, self._place, self._moving = graph.numbers(s.name for s in plain.step)
        (self._t,) = graph.numbers([plain.t.name])

    def __call__(self, value: Value, *, integrated: bool = False) -> Value:
        """Return the derivative of a value."""
        graph = self._graph
        along = [
            graph.multiply([self._derivatives(value, v), (-1, v)])
            for v in self._v
            if self._derivatives(value, v) != ZERO
        ]
        terms = [self.over(graph.add(along)), self.later(value)]
        if integrated:
            terms.append(graph.multiply([value, graph.power((1, self._h), -1)]))
        return graph.add(terms)

    def later(self, value: Value) -> Value:
        """Return the derivative of a value through the time, which moves by its place."""
        return self._graph.multiply([self._derivatives(value, self._t), (1, self._place)])

    def over(self, value: Value) -> Value:
        """Return a value divided by h, where v goes with 1/h."""
        inverse = self._graph.power((1, self._h), -1)
        return self._graph.multiply([value, inverse, (1, self._moving)])


def derive_cost(plain: Plain, varied: Mapping[str, sp.Symbol], cost: Cost) -> Jet:
    """Derive a running cost g(t, q, v, u) by q, by v, and by parameters and inputs.

    Outputs are ``("g",)``, ``("g_q", i)``, ``("g_v", i)`` and ``("g_a", name)``.
    """
    graph, n = Graph(), len(plain.q)
    (value,) = rebuilt(cost.graph, [cost.value], {}, graph)
    moving = graph.numbers(s.name for s in (*plain.q, *plain.v, *varied.values()))
    slopes = gradient(graph, value, moving)
    outputs: dict[Key, Value] = {("g",): value}
    outputs |= {("g_q", i): slopes[i] for i in range(n)}
    outputs |= {("g_v", i): slopes[n + i] for i in range(n)}
    outputs |= {("g_a", name): slopes[2 * n + j] for j, name in enumerate(varied)}
    by_size = _BySize(graph, plain, Derivatives(graph))
    outputs |= {
        ("g_a", name): by_size(value, integrated=True)
        for name, symbol in varied.items()
        if symbol == plain.step[0]
    }
    return written_as_jet(plain, graph, outputs)
