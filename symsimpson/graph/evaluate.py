"""Numerical values of nodes, in double precision or with many digits of mpmath."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import mpmath

from symsimpson.graph.nodes import TINY, Exact, Graph, Value


def evaluate_nodes(
    graph: Graph, roots: Iterable[int], symbols: Mapping[int, Any], context: Any
) -> dict[int, Any]:
    """Evaluate nodes and all their descendants. Values that are not real become NaN.

    ``symbols`` has numbers for symbols, and may have numbers for other nodes. ``context`` is
    ``mpmath.mp`` with its present precision, or ``mpmath.fp`` for double precision.
    """
    values = dict(symbols)
    for n in graph.descendants(roots, values):
        kind, parts, _ = graph.nodes[n]
        values[n] = evaluate_line(kind, parts, values, context)
    return values


def evaluate_doubles(
    graph: Graph, values: Sequence[Value], symbols: Mapping[int, Any]
) -> list[float]:
    """Evaluate values in double precision. Values that are not real become NaN."""
    numbers = evaluate_nodes(graph, [n for c, n in values if c], symbols, mpmath.fp)
    return [_double(c) * float(numbers[n]) if c else 0.0 for c, n in values]


def _double(number: Exact) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf


def evaluate_values(
    graph: Graph, values: Sequence[Value], symbols: Mapping[int, Any], context: Any
) -> list[Any]:
    """Evaluate values with the numbers of a context. Values that are not real become NaN."""
    numbers = evaluate_nodes(graph, [n for c, n in values if c], symbols, context)
    return [_number(context, c) * numbers[n] if c else context.mpf(0) for c, n in values]


def moduli(graph: Graph, roots: Iterable[int], values: Mapping[int, float]) -> dict[int, float]:
    """Return upper bounds of nodes: sums of the moduli of their terms, without cancellation.

    The round-off error of a node is about 2^-53 times its bound. ``values`` has the values of the
    roots and of all their descendants, from :func:`evaluate_nodes`.
    """
    sizes: dict[int, float] = {}
    for n in graph.descendants(roots):
        kind, parts, _ = graph.nodes[n]
        if kind == "sum":
            sizes[n] = sum(abs(float(c)) * sizes[m] for c, m in parts)
        elif kind == "product":  # factors have their bounds, divisors their values
            try:
                sizes[n] = math.prod(
                    sizes[m] ** float(e) if e > 0 else abs(values[m]) ** float(e) for m, e in parts
                )
            except (ZeroDivisionError, OverflowError):
                sizes[n] = math.nan
        else:
            sizes[n] = abs(values[n])
    return sizes


def evaluate_line(kind: str, parts: Sequence[Any], values: Mapping[int, Any], context: Any) -> Any:
    """Evaluate a node, or a line of straight-line code, from the values of its arguments."""
    try:
        match kind:
            case "sum":
                value = context.fsum(_number(context, c) * values[m] for c, m in parts)
            case "product":
                value = context.fprod(values[m] ** _number(context, e) for m, e in parts)
            case "function":
                arguments = [_number(context, c) * values[m] for c, m in parts[1:]]
                value = _function(context, parts[0])(*arguments)
            case _:
                value = _constant(context, parts)
    except (ZeroDivisionError, ValueError, OverflowError):
        return context.nan
    return context.nan if isinstance(value, (complex, context.mpc)) else value


def _number(context: Any, x: Exact) -> Any:
    return context.mpf(x.numerator) / x.denominator if x.denominator != 1 else int(x)


def _constant(context: Any, parts: Sequence[str]) -> Any:
    if not parts:
        return context.mpf(1)
    known = {"pi": context.pi, "EulerGamma": context.euler, "Catalan": context.catalan}
    return known.get(parts[0], TINY)


def _function(context: Any, name: str) -> Callable[..., Any]:
    if name == "pow":
        return lambda x, y: x**y
    if name == "abs":
        return abs
    if name in ("softplus", "logcosh"):
        return without_overflow(*(_function(context, x) for x in ("exp", "log", "atanh")))[name]
    function: Callable[..., Any] = getattr(context, name, None) or getattr(math, name)
    return function


def without_overflow(exp: Any, log: Any, atanh: Any) -> dict[str, Callable[[Any], Any]]:
    """Return functions for log(1 + exp(x)) and log(cosh(x)) that do not overflow.

    ``exp``, ``log`` and ``atanh`` are the functions of an arithmetic.
    """

    def softplus(x: Any) -> Any:
        small = exp(-abs(x))
        return (x + abs(x)) / 2 + 2 * atanh(small / (2 + small))

    return {"softplus": softplus, "logcosh": lambda x: abs(x) + log((1 + exp(-2 * abs(x))) / 2)}
