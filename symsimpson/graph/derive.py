"""Exact derivatives on the graph: forward mode for one symbol, reverse mode for many."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction

from symsimpson.graph.nodes import ONE, ZERO, Graph, Value, scale


class Derivatives:
    """Forward-mode derivatives of nodes with respect to symbols, with a cache."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._known: dict[tuple[int, int], Value] = {}

    def __call__(self, value: Value, x: int) -> Value:
        """Differentiate a value with respect to the symbol x."""
        graph, known = self._graph, self._known
        coefficient, root = value
        if not coefficient or x not in graph.nodes[root].symbols:
            return ZERO
        work = [root]
        while work:  # a stack in place of recursion, because chains of sums may be long
            n = work[-1]
            if (n, x) in known:
                work.pop()
                continue
            moving = [m for m in graph.arguments(n) if x in graph.nodes[m].symbols]
            missing = [m for m in moving if (m, x) not in known]
            if missing:
                work += missing
                continue
            known[n, x] = self._node(n, x)
            work.pop()
        return scale(coefficient, known[root, x])

    def _node(self, n: int, x: int) -> Value:
        graph, known = self._graph, self._known
        if n == x:
            return ONE
        terms = []
        for m, outer in slopes(graph, n):
            if x in graph.nodes[m].symbols:
                terms.append(graph.multiply([outer, known[m, x]]))
        return graph.add(terms)


def gradient(graph: Graph, value: Value, symbols: Sequence[int]) -> list[Value]:
    """Differentiate a value with respect to many symbols, in reverse mode."""
    coefficient, root = value
    wanted = set(symbols)
    collected: dict[int, list[Value]] = {root: [(coefficient, 0)]}
    adjoints: dict[int, Value] = {}
    for n in reversed(graph.descendants([root])):
        if n not in collected or graph.nodes[n].symbols.isdisjoint(wanted):
            continue
        adjoint = graph.add(collected.pop(n))
        if n in wanted:
            adjoints[n] = adjoint
            continue
        for m, outer in slopes(graph, n):
            if not graph.nodes[m].symbols.isdisjoint(wanted):
                collected.setdefault(m, []).append(graph.multiply([adjoint, outer]))
    return [adjoints.get(x, ZERO) for x in symbols]


def slopes(graph: Graph, n: int) -> Iterable[tuple[int, Value]]:
    """Return pairs of an argument and the partial derivative of a node with respect to it."""
    kind, parts, _ = graph.nodes[n]
    if kind == "sum":
        return [(m, (c, 0)) for c, m in parts]
    if kind == "product":
        derivatives = []
        for k, (m, e) in enumerate(parts):
            others = [(1, base, f) for base, f in (*parts[:k], *parts[k + 1 :])]
            derivatives.append((m, graph.multiply([(e, m, e - 1), *others])))
        return derivatives
    if kind == "function":
        name, *arguments = parts
        outer = _outer(graph, n, name, arguments)
        pairs = zip(arguments, outer, strict=True)
        return [(m, graph.multiply([(c, 0), slope])) for (c, m), slope in pairs]
    return []


def _outer(graph: Graph, n: int, name: str, arguments: Sequence[Value]) -> list[Value]:
    """Return the partial derivatives of a function with respect to its arguments."""
    x = arguments[0]
    square = graph.power(x, 2)
    value = (1, n)
    half = Fraction(1, 2)

    def with_one(sign: int, of_square: int) -> Value:
        return graph.add([(sign, 0), graph.multiply([(of_square, 0), square])])

    def logistic() -> Value:
        """Return exp(x)/(1 + exp(x)) as exp(-softplus(-x)), which does not overflow."""
        return graph.function("exp", scale(-1, graph.function("softplus", scale(-1, x))))

    slopes_of: dict[str, Callable[[], Value]] = {
        "sin": lambda: graph.function("cos", x),
        "cos": lambda: scale(-1, graph.function("sin", x)),
        "asin": lambda: graph.power(with_one(1, -1), -half),
        "acos": lambda: scale(-1, graph.power(with_one(1, -1), -half)),
        "atan": lambda: graph.power(with_one(1, 1), -1),
        "sinh": lambda: graph.function("cosh", x),
        "cosh": lambda: graph.function("sinh", x),
        "tanh": lambda: graph.add([ONE, scale(-1, graph.power(value, 2))]),
        "asinh": lambda: graph.power(with_one(1, 1), -half),
        "acosh": lambda: graph.power(with_one(-1, 1), -half),
        "atanh": lambda: graph.power(with_one(1, -1), -1),
        "exp": lambda: value,
        "logcosh": lambda: graph.function("tanh", x),
        "softplus": logistic,
        "log": lambda: graph.power(x, -1),
    }
    if name in slopes_of:
        return [slopes_of[name]()]
    match name:
        case "erf" | "erfc":
            bell = graph.function("exp", scale(-1, square))
            factor = graph.power(graph.constant("pi"), -half)
            return [graph.multiply([(2 if name == "erf" else -2, 0), factor, bell])]
        case "pow":
            slope = graph.multiply([arguments[1], value, graph.power(x, -1)])
            return [slope, graph.multiply([value, graph.function("log", x)])]
        case "atan2":
            y, x = arguments
            over = graph.power(graph.add([graph.power(x, 2), graph.power(y, 2)]), -1)
            return [graph.multiply([x, over]), scale(-1, graph.multiply([y, over]))]
    raise AssertionError(name)
