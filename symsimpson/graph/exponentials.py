"""Logarithms of sums of exponentials, which do not overflow where their exponentials do."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import Any

from symsimpson.graph.nodes import Graph, Value, scaled

__all__ = ["logarithm", "without_overflow"]

#: Functions that overflow though their logarithms are small.
GROWING = frozenset(["exp", "cosh", "sinh"])


def without_overflow(exp: Any, log: Any, atanh: Any) -> dict[str, Callable[[Any], Any]]:
    """Return log(1 + exp(x)) and log(cosh(x)), made of the functions of an arithmetic."""

    def softplus(x: Any) -> Any:
        small = exp(-abs(x))
        return (x + abs(x)) / 2 + 2 * atanh(small / (2 + small))

    return {"softplus": softplus, "logcosh": lambda x: abs(x) + log((1 + exp(-2 * abs(x))) / 2)}


def logarithm(graph: Graph, value: Value, positive: Container[int]) -> Value | None:
    """Return log(value) by softplus(x) = log(1 + exp(x)) and logcosh(x) = log(cosh(x)).

    None if no exponential is in it, or a term is not known to be positive; the nodes of symbols
    that are so are ``positive``.
    """
    parts = [graph.nodes[m].parts for m in graph.reached([value[1]])]
    return _log(graph, value, positive) if any(p[:1] and p[0] in GROWING for p in parts) else None


def _log(
    graph: Graph, value: Value, positive: Container[int], *, term: bool = False
) -> Value | None:
    coefficient, n = value
    kind, parts, _ = graph.nodes[n]
    logs: list[Value | None] = []
    if coefficient <= 0:
        return None
    if kind == "product":
        for m, e in parts:
            log = _log(graph, (1, m), positive, term=term)
            logs.append(log and scaled(e, log))
    elif kind == "sum":
        first, *others = (_log(graph, part, positive, term=True) for part in parts)
        for other in others:
            if first is None or other is None:
                return None
            first = graph.add(
                [first, graph.function("softplus", graph.add([other, scaled(-1, first)]))]
            )
        logs = [first]
    elif kind == "function" and parts[0] in GROWING:
        name, x = parts
        logs = [x if name == "exp" else graph.function("logcosh", x)]
        if name == "sinh":  # which is positive on one side, where a sum with it may be on both
            logs.append(None if term else graph.function("log", graph.function("tanh", x)))
    elif n:
        logs = [graph.function("log", (1, n)) if n in positive or kind == "constant" else None]
    if None in logs:
        return None
    return graph.add([graph.function("log", (coefficient, 0)), *(x for x in logs if x is not None)])
