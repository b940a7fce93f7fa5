"""Conversion of SymPy expressions to graph values, and of small values to SymPy."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container, Mapping, Sequence
from fractions import Fraction
from typing import Any

import sympy as sp

from symsimpson.errors import GenerationError, reject
from symsimpson.graph.evaluate import without_overflow
from symsimpson.graph.nodes import TINY, Exact, Graph, Value, exact, magnitude, scale

#: Names in the graph of SymPy's functions.
FUNCTIONS: dict[Any, str] = {
    getattr(sp, name): name
    for name in (
        *("sin", "cos", "tan", "cot", "sec", "csc", "asin", "acos", "atan", "atan2"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "log", "erf", "erfc"),
    )
}
#: Functions that are expressed by other functions.
OTHERS: dict[Any, Callable[[Any], sp.Expr]] = {
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
    sp.coth: lambda x: sp.cosh(x) / sp.sinh(x),
}
CONSTANTS: dict[Any, str] = {sp.pi: "pi", sp.EulerGamma: "EulerGamma", sp.Catalan: "Catalan"}
#: Largest index of a root. Powers with larger denominators become functions.
HIGHEST_ROOT = 24
#: A fraction whose denominator is a power of two above this was a float.
FLOAT = 2**10
#: Functions that overflow although their logarithms do not.
GROWING = frozenset(["exp", "cosh", "sinh"])

_BY_NAME = {name: function for function, name in FUNCTIONS.items()}
#: Functions for readable SymPy trees, which this module can read again.
_IN_TREES = _BY_NAME | {
    "softplus": lambda x: sp.log(1 + sp.exp(x)),
    "logcosh": lambda x: sp.log(sp.cosh(x)),
}
_BY_NAME |= without_overflow(sp.exp, sp.log, sp.atanh)
_CONSTANT_OF = {name: constant for constant, name in CONSTANTS.items()} | {"Tiny": sp.Float(TINY)}


class SympyConverter:
    """A converter from SymPy expressions to values of a graph.

    ``known`` maps symbols, coordinates and velocities to values. ``done`` also has all converted
    nodes, so that each node is converted once. ``check`` is called once for each node that is not
    known, before its arguments are converted.
    """

    def __init__(
        self,
        graph: Graph,
        known: Mapping[sp.Basic, Value],
        check: Callable[[sp.Basic], None] = lambda node: None,
    ) -> None:
        self._graph, self._check = graph, check
        self.done: dict[sp.Basic, Value] = dict(known)
        self._positive = {n for user, (_, n) in known.items() if user.is_positive}

    def __call__(self, expression: sp.Basic) -> Value:
        """Convert an expression to a value of the graph."""
        done, work = self.done, [(expression, False)]
        while work:
            node, checked = work.pop()
            if node in done:
                continue
            other = _replacement(node)
            if other is not None:
                if other in done:
                    done[node] = done[other]
                else:
                    work += [(node, False), (other, False)]
            elif not checked:
                self._check(node)
                work.append((node, True))
                work += [(a, False) for a in reversed(node.args) if a not in done]
            else:
                done[node] = self._read(node)
        return done[expression]

    def _read(self, node: Any) -> Value:
        graph = self._graph
        arguments = [self.done[a] for a in node.args]
        if node.is_Rational or node.is_Float:
            return fraction(node), 0
        if node.is_Add:
            return graph.add(arguments)
        if node.is_Mul:
            return graph.multiply(arguments)
        if node in CONSTANTS:
            return graph.constant(CONSTANTS[node])
        if node is sp.E:
            return graph.function("exp", (1, 0))
        if node.is_Pow and type(node) is not sp.exp:
            return self._power(node, *arguments)
        if node.is_Function:
            is_log = node.func is sp.log
            stable = logarithm(graph, arguments[0], self._positive) if is_log else None
            return stable or graph.function(FUNCTIONS[node.func], *arguments)
        wider = node.expand(func=True)  # such as the golden ratio
        if wider == node:
            raise TypeError(f"{type(node).__name__} cannot be read")
        return self(wider)

    def _power(self, node: Any, base: Value, exponent: Value) -> Value:
        if node.base is sp.E:
            return self._graph.function("exp", exponent)
        if node.exp.is_number and exponent[1] == 0:
            e = exact(exponent[0])
            if e.denominator <= HIGHEST_ROOT:
                return self._graph.power(base, e)
        return self._graph.function("pow", base, exponent)


def _replacement(node: Any) -> sp.Expr | None:
    """Return an expression by known functions that equals a node for real arguments, or None.

    Norms of vectors contain squares of moduli, which become plain squares.
    """
    if isinstance(node, sp.Pow) and isinstance(node.base, sp.Abs) and node.exp.is_even:
        return node.base.args[0] ** node.exp
    of = OTHERS.get(type(node))
    return None if of is None else of(node.args[0])


def logarithm(
    graph: Graph, value: Value, positive: Container[int], *, term: bool = False
) -> Value | None:
    """Return log(value) by functions that do not overflow: softplus and logcosh.

    softplus(x) is log(1 + exp(x)) and logcosh(x) is log(cosh(x)). The result is None if no factor
    is or contains an exponential. For a ``term`` of a sum it is None if the term is not known to
    be positive. ``positive`` has the nodes of positive symbols.
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
            logs.append(scale(e, log))
        if log is None or name == "sinh":
            rest.append((1, m, e))
    if term and not all(m in positive or graph.nodes[m].kind == "constant" for _, m, _ in rest):
        return None
    if rest:
        logs.append(graph.function("log", graph.multiply(rest)))
    return graph.add(logs) if term or len(logs) > 1 + bool(rest) else None


def _of_sum(graph: Graph, n: int, positive: Container[int], term: bool) -> Value | None:
    """Return the logarithm of a sum of positive terms, or None."""
    nodes = map(graph.nodes.__getitem__, graph.descendants([n]))
    if not term and not any(
        GROWING.intersection(x.parts[:1]) for x in nodes if x.kind == "function"
    ):
        return None
    total, *others = (logarithm(graph, x, positive, term=True) for x in graph.nodes[n].parts)
    for other in others:
        if total is None or other is None:
            return None
        difference = graph.add([other, scale(-1, total)])
        total = graph.add([total, graph.function("softplus", difference)])
    return total


def fraction(number: Any) -> int | Fraction:
    """Convert a SymPy number to an exact fraction."""
    if number.is_Rational:
        return exact(Fraction(int(number.p), int(number.q)))
    sign, mantissa, exponent, _ = number._mpf_
    whole = -int(mantissa) if sign else int(mantissa)
    return exact(whole * Fraction(2) ** int(exponent))


def was_float(value: int | Fraction) -> bool:
    """Return whether the denominator of a number is a large power of two, as only of a float."""
    q = value.denominator
    return q > FLOAT and q & (q - 1) == 0


def is_float(value: int | Fraction) -> bool:
    """Return whether a number was a float, and is exactly representable as one."""
    return was_float(value) and Fraction(float(value)) == value


def fit_to_double(value: int | Fraction) -> int | Fraction:
    """Return a number, rounded to a double if its numerator or denominator has over 1000 bits.

    Raises GenerationError if the number exceeds the range of double precision.
    """
    if magnitude(value) > sys.float_info.max:
        reject(
            "a number in the equations exceeds the range of double precision (about 1.8e308).",
            remedy="Choose other units, or avoid high powers of large numbers.",
            error=GenerationError,
        )
    huge = max(abs(value.numerator), value.denominator).bit_length() > 1000
    return exact(Fraction(float(value))) if huge else value


def number(value: int | Fraction) -> sp.Number:
    """Convert a fraction to a SymPy Rational, or to a Float if it was a float."""
    value = fit_to_double(value)
    if is_float(value):
        return sp.Float(float(value))
    return sp.Rational(value.numerator, value.denominator)


def to_sympy(graph: Graph, value: Value, names: Mapping[int, sp.Expr]) -> sp.Expr:
    """Convert a short value to a SymPy expression. A tree repeats shared subexpressions.

    ``names`` maps nodes of symbols to SymPy expressions.
    """
    done: dict[int, sp.Expr] = {0: sp.S.One, **names}
    for n in graph.descendants([value[1]]):
        if n not in done:
            kind, parts, _ = graph.nodes[n]
            done[n] = line_to_sympy(kind, parts, done, _IN_TREES)
    return number(value[0]) * done[value[1]]


def to_lines(
    graph: Graph, values: Sequence[Value], names: Mapping[int, sp.Expr]
) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[sp.Expr]]:
    """Convert values to definitions, one for each shared node, and expressions of these."""
    done, lines = {0: sp.S.One, **names}, list[tuple[sp.Symbol, sp.Expr]]()
    for n in graph.descendants([n for _, n in values]):
        if n not in done:
            kind, parts, _ = graph.nodes[n]
            line = line_to_sympy(kind, parts, done, _IN_TREES)
            done[n] = sp.Symbol(f"node_{n}")
            lines.append((done[n], line))
    return lines, [number(c) * done[n] for c, n in values]


def tree_size(graph: Graph, value: Value) -> int:
    """Count the nodes of a value as a tree, which repeats shared subexpressions."""
    size: dict[int, int] = {}
    for n in graph.descendants([value[1]]):
        size[n] = 1 + sum(size[m] for m in graph.arguments(n))
    return size[value[1]]


def line_to_sympy(
    kind: str,
    parts: Sequence[Any],
    done: Mapping[int, sp.Expr],
    functions: Mapping[str, Any] = _BY_NAME,
) -> sp.Expr:
    """Convert a node, or a line of straight-line code, from its converted arguments ``done``."""
    match kind:
        case "sum":
            return sp.Add(*(number(c) * done[m] for c, m in parts))
        case "product":
            return sp.Mul(*(sp.Pow(done[m], number(e)) for m, e in parts))
        case "function":
            name, *values = parts
            arguments = [number(c) * done[m] for c, m in values]
            return sp.Pow(*arguments) if name == "pow" else functions[name](*arguments)
        case "constant":
            return _CONSTANT_OF[parts[0]]
    raise AssertionError(kind)
