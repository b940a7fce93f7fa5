"""The expression graph: values are pairs of an exact coefficient and a node.

Equal nodes exist once. Arguments have smaller numbers than the nodes that use them, so nodes can be
evaluated in ascending order. The graph does not expand products of sums, because an expanded
expression shares no subexpressions. Floats become dyadic rationals, so no arithmetic rounds.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from fractions import Fraction
from math import gcd, lcm
from typing import Any, NamedTuple, TypeAlias

from sympy import integer_nthroot

#: An int, or a Fraction that is not a whole number.
Exact: TypeAlias = int | Fraction
#: A coefficient and the number of a node.
Value: TypeAlias = tuple[Exact, int]

#: The node of the number one: the first node of every graph.
UNIT = 0
ZERO: Value = (0, UNIT)
ONE: Value = (1, UNIT)

#: The constant "Tiny" in double precision. It makes a square root smooth at 0, and is negligible
#: in a sum with other squares.
TINY = 2.0**-600
#: A common factor of the coefficients of a sum is extracted only below this size.
LARGE = 2**40
#: Largest number of bits of a whole number whose root is computed.
LONGEST_ROOT = 10**4
#: Odd functions, f(-x) = -f(x). EVEN has even functions, and AT_ZERO values at zero.
ODD = frozenset(["sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh", "erf"])
#: Kinds of nodes that are extracted from a sum if all terms contain them as factors.
COMMON = frozenset(["symbol", "function", "sum"])
EVEN = frozenset(["cos", "cosh", "logcosh"])
AT_ZERO = {**dict.fromkeys(ODD, 0), **dict.fromkeys(EVEN, 1), "exp": 1, "erfc": 1, "logcosh": 0}


class Node(NamedTuple):
    """A node of the graph. ``symbols`` has the node numbers of the symbols in it.

    The ``parts`` depend on the ``kind``: a symbol or a constant has its name, a sum has pairs
    (coefficient, node), and a product has pairs (node, exponent). A function has its name and the
    values of its arguments.
    """

    kind: str
    parts: tuple[Any, ...]
    symbols: frozenset[int]


class Graph:
    """A directed acyclic graph of expressions, without duplicate nodes.

    A ``factored`` graph extracts common factors from all terms of a sum.
    """

    def __init__(self, *, factored: bool = False) -> None:
        self.nodes: list[Node] = []
        self.factored = factored
        self._numbers: dict[tuple[str, tuple[Any, ...]], int] = {}
        self._sets: dict[frozenset[int], frozenset[int]] = {}
        self._make("unit", (), frozenset())

    def _make(self, kind: str, parts: tuple[Any, ...], symbols: frozenset[int]) -> int:
        number = self._numbers.get((kind, parts))
        if number is None:
            number = self._numbers[kind, parts] = len(self.nodes)
            symbols = self._sets.setdefault(symbols, symbols)
            self.nodes.append(Node(kind, parts, symbols))
        return number

    def _united(self, numbers: Iterable[int]) -> frozenset[int]:
        sets = {self.nodes[n].symbols for n in numbers}
        return next(iter(sets)) if len(sets) == 1 else frozenset().union(*sets)

    def symbol(self, name: str) -> Value:
        """Return the value of a symbol."""
        known = self._numbers.get(("symbol", (name,)))
        number = len(self.nodes) if known is None else known
        return 1, self._make("symbol", (name,), frozenset([number]))

    def numbers(self, names: Iterable[str]) -> tuple[int, ...]:
        """Return the node numbers of the symbols with these names."""
        return tuple(self.symbol(name)[1] for name in names)

    def constant(self, name: str) -> Value:
        """Return the value of an irrational constant, such as "pi"."""
        return 1, self._make("constant", (name,), frozenset())

    def add(self, values: Iterable[Value]) -> Value:
        """Add values, and collect the coefficients of equal nodes."""
        terms: dict[int, Exact] = {}
        for coefficient, n in values:
            if coefficient:
                terms[n] = terms.get(n, 0) + coefficient
        items = [(n, exact(c)) for n, c in sorted(terms.items()) if c]
        if not items:
            return ZERO
        if len(items) == 1:
            return items[0][1], items[0][0]
        if self.factored and (common := self._common([n for n, _ in items])):
            rest = [self.multiply([(c, n), *((1, b, -e) for b, e in common)]) for n, c in items]
            return self.multiply([self.add(rest), *((1, b, e) for b, e in common)])
        content = _content([c for _, c in items])
        if content != 1:
            items = [(n, exact(c / Fraction(content))) for n, c in items]
        parts = tuple((c, n) for n, c in items)
        return content, self._make("sum", parts, self._united(n for n, _ in items))

    def multiply(self, values: Iterable[tuple[Exact, int] | tuple[Exact, int, Exact]]) -> Value:
        """Multiply values. An optional third entry is the exponent of the node."""
        coefficient: Exact = 1
        factors: dict[int, Exact] = {}
        open_: list[tuple[int, Exact]] = []
        for value in values:
            coefficient *= value[0]
            open_.append((value[1], value[2] if len(value) == 3 else 1))
        if not coefficient:
            return ZERO
        while open_:
            for n, e in open_:
                if n != UNIT:
                    factors[n] = factors.get(n, 0) + e
            open_ = []
            for n, e in list(factors.items()):
                kind, parts, _ = self.nodes[n]
                if not e:
                    del factors[n]
                elif kind == "product" and e.denominator == 1:
                    del factors[n]
                    open_ += [(base, exact(f * e)) for base, f in parts]
                elif kind == "sum" and len(parts) == 1 and e.denominator == 1:
                    del factors[n]
                    coefficient *= Fraction(parts[0][0]) ** int(e)
                    open_.append((parts[0][1], e))
                elif kind == "function" and parts[0] == "cosh":  # sinh/cosh = tanh cannot overflow
                    sinh = self._numbers.get(("function", ("sinh", parts[1])), UNIT)
                    common = min(e, -factors.get(sinh, 0), key=magnitude)
                    if max(e, common) < 0:  # only sinh/cosh: cosh/sinh would need 1/tanh
                        tanh = self.function("tanh", parts[1])[1]
                        open_ += [(n, -common), (sinh, common), (tanh, -common)]
        coefficient = exact(coefficient)
        parts = tuple((n, exact(e)) for n, e in sorted(factors.items()))
        if not parts:
            return coefficient, UNIT
        if len(parts) == 1 and parts[0][1] == 1:
            return coefficient, parts[0][0]
        return coefficient, self._make("product", parts, self._united(n for n, _ in parts))

    def products(self, values: Iterable[Value], nodes: Iterable[int]) -> list[Value]:
        """Multiply each value by the node at the same place."""
        return [self.multiply([x, (1, n)]) for x, n in zip(values, nodes, strict=True)]

    def power(self, value: Value, exponent: Exact) -> Value:
        """Raise a value to a rational power.

        Raises ZeroDivisionError for a negative power of zero.
        """
        coefficient, n = value
        exponent = exact(exponent)
        if not coefficient:
            if exponent < 0:
                raise ZeroDivisionError
            return ZERO if exponent else ONE
        if exponent.denominator == 1:
            outside = 1 if coefficient == 1 else exact(Fraction(coefficient) ** int(exponent))
            return self.multiply([(outside, n, exponent)])
        root = _root(magnitude(coefficient), Fraction(exponent))
        if root is not None:
            return self.multiply(
                [(root, self.absorb_coefficient((1 if coefficient > 0 else -1, n)), exponent)]
            )
        return self.multiply([(1, self.absorb_coefficient(value), exponent)])

    def absorb_coefficient(self, value: Value) -> int:
        """Return a node that equals a value, including its coefficient."""
        coefficient, n = value
        if coefficient == 1:
            return n
        return self._make("sum", ((coefficient, n),), self.nodes[n].symbols)

    def function(self, name: str, *arguments: Value) -> Value:
        """Apply a function. It expresses tan, cot, sec and csc by sine and cosine."""
        coefficient, n = arguments[0]
        quotients = {"tan": (1, -1), "cot": (-1, 1), "sec": (0, -1), "csc": (-1, 0)}
        if name in quotients:
            sine, cosine = self.function("sin", *arguments), self.function("cos", *arguments)
            e, f = quotients[name]
            return self.multiply([self.power(sine, e), self.power(cosine, f)])
        if not coefficient and name in AT_ZERO:
            return AT_ZERO[name], UNIT
        if name == "log" and arguments[0] == ONE:
            return ZERO
        sign = 1
        if coefficient < 0 and (name in ODD or name in EVEN):
            arguments = ((-coefficient, n),)
            sign = -1 if name in ODD else 1
        symbols = self._united(a[1] for a in arguments)
        return sign, self._make("function", (name, *arguments), symbols)

    def _common(self, numbers: list[int]) -> list[tuple[int, Exact]]:
        """List the common factors of all nodes with their powers: symbols, functions and sums."""
        shared: dict[int, Exact] | None = None
        for n in numbers:
            powers = {
                base: e for base, e in self.factors(n) if self.nodes[base].kind in COMMON and e > 0
            }
            if shared is None:
                shared = powers
            else:
                shared = {
                    base: min(e, powers[base]) for base, e in shared.items() if base in powers
                }
            if not shared:
                return []
        return list((shared or {}).items())

    def factors(self, n: int) -> tuple[tuple[int, Exact], ...]:
        """Return the factors of a node and their exponents."""
        node = self.nodes[n]
        return node.parts if node.kind == "product" else ((n, 1),)

    def arguments(self, n: int) -> list[int]:
        """List the nodes of the arguments of a node."""
        kind, parts, _ = self.nodes[n]
        return arguments(kind, parts)

    def descendants(self, roots: Iterable[int], known: Container[int] = ()) -> list[int]:
        """List the roots and all their descendants in ascending order.

        The search does not enter ``known`` nodes.
        """
        seen: set[int] = set()
        work = list(roots)
        while work:
            n = work.pop()
            if n not in seen and n not in known:
                seen.add(n)
                work += self.arguments(n)
        return sorted(seen)


def arguments(kind: str, parts: Sequence[Any]) -> list[int]:
    """List the arguments of a node, or of a line of straight-line code."""
    match kind:
        case "sum":
            return [m for _, m in parts]
        case "product":
            return [m for m, _ in parts]
        case "function":
            return [value[1] for value in parts[1:]]
    return []


def scale(factor: Exact, value: Value) -> Value:
    """Multiply a value by a number."""
    return exact(factor * value[0]), value[1]


def exact(number: Exact) -> Exact:
    """Return a fraction with denominator 1 as an int, and any other number unchanged."""
    return number if type(number) is int or number.denominator != 1 else number.numerator


def magnitude(number: Exact) -> Exact:
    """Return the modulus of a number."""
    return number if number >= 0 else -number


def _content(coefficients: list[Exact]) -> Exact:
    """Return the common factor of coefficients with the sign of the first coefficient.

    Large numerators and denominators come from floats. The factor is then only the sign.
    """
    sign = 1 if coefficients[0] > 0 else -1
    top = gcd(*(c.numerator for c in coefficients))
    bottom = lcm(*(c.denominator for c in coefficients))
    if any(max(abs(c.numerator), c.denominator) >= LARGE for c in coefficients):
        return sign
    return exact(Fraction(sign * top, bottom)) if max(top, bottom) < LARGE else sign


def _root(number: Exact, exponent: Fraction) -> Exact | None:
    """Return a rational power of a positive number; None if it is irrational or too long."""
    parts = []
    for whole in (number.numerator, number.denominator):
        if whole.bit_length() > LONGEST_ROOT:
            return None
        root, is_exact = integer_nthroot(whole, exponent.denominator)
        if not is_exact:
            return None
        parts.append(root)
    return exact(Fraction(*parts) ** exponent.numerator)
