"""Logarithms of sums of exponentials, which do not overflow where their exponentials do."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import Any

from symsimpson.graph.nodes import Exact, Graph, Value, scaled

#: Functions that overflow though their logarithms are small.
GROWING = frozenset(["exp", "cosh", "sinh"])


def without_overflow(exp: Any, log: Any, atanh: Any) -> dict[str, Callable[[Any], Any]]:
    """Return log(1 + exp(x)) and log(cosh(x)) by the functions of an arithmetic."""

    def softplus(x: Any) -> Any:
        small = exp(-abs(x))
        return (x + abs(x)) / 2 + 2 * atanh(small / (2 + small))

    return {"softplus": softplus, "logcosh": lambda x: abs(x) + log((1 + exp(-2 * abs(x))) / 2)}


def logarithm(
    graph: Graph, value: Value, positive: Container[int], *, term: bool = False
) -> Value | None:
    """Return log(value) by softplus(x) = log(1 + exp(x)) and logcosh(x) = log(cosh(x)).

    None if no exponential is a factor, or in one; of a ``term`` of a sum if it is not known to be
    positive. The nodes of symbols that are so are ``positive``.
    """
    coefficient, n = value
    if coefficient <= 0:
        return None
    logs = [graph.function("log", (coefficient, 0))]
    rest: list[tuple[Exact, int, Exact]] = []
    for m, e in graph.factors(n) if n else ():
        kind, (name, *parts), _ = graph.nodes[m]
        log = _of_sum(graph, m, positive, term) if kind == "sum" else None
        if name == "exp":
            log = parts[0]
        elif name in GROWING:
            log = graph.function("logcosh", parts[0])
        if name == "sinh":
            m = graph.function("tanh", parts[0])[1]
        if log is not None:
            logs.append(scaled(e, log))
        if log is None or name == "sinh":
            rest.append((1, m, e))
    if term and not all(m in positive or graph.nodes[m].kind == "constant" for _, m, _ in rest):
        return None
    if rest:
        logs.append(graph.function("log", graph.multiply(rest)))
    return graph.add(logs) if term or len(logs) > 1 + bool(rest) else None


def _of_sum(graph: Graph, n: int, positive: Container[int], term: bool) -> Value | None:
    """Return the logarithm of a sum of positive terms."""
    nodes = map(graph.nodes.__getitem__, graph.reached([n]))
    if not term and not any(
        GROWING.intersection(x.parts[:1]) for x in nodes if x.kind == "function"
    ):
        return None
    total, *others = (logarithm(graph, x, positive, term=True) for x in graph.nodes[n].parts)
    for other in others:
        if total is None or other is None:
            return None
        apart = graph.add([other, scaled(-1, total)])
        total = graph.add([total, graph.function("softplus", apart)])
    return total
