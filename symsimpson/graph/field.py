"""Polynomial identity tests: values of nodes at random points of a finite field.

A random point assigns numbers modulo a prime to symbols, points of the unit circle to the terms of
angles, and units to exponentials. Every other function gets a random number, the same for equal
arguments. Take an expression that is rational in symbols, sines, cosines, exponentials and
independent square roots. If one of its values is nonzero, it is certainly not identically zero. If
two values are zero, the probability of a nonzero expression is below (degree/2^61)^2 [1]_, [2]_.
Other functions are never mistaken for zero, because their values are random.

References
----------
.. [1] J. T. Schwartz, Fast probabilistic algorithms for verification of polynomial identities,
   Journal of the ACM 27 (1980), 701-717.
.. [2] G. H. Gonnet, Determining equivalence of expressions in random polynomial time,
   Proc. 16th ACM Symposium on Theory of Computing (1984), 334-341.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable
from fractions import Fraction
from math import lcm
from typing import Any

from symsimpson.graph.nodes import Exact, Graph, Value

#: A Mersenne prime. It is 3 modulo 4, so -1 has no square root, and i extends the field.
PRIME = 2**61 - 1
#: A second Mersenne prime, for coefficients that PRIME divides.
LARGER = 2**89 - 1
#: An int, or a pair (a, b) for a + b i.
Element = Any


class PrimeField:
    """Arithmetic modulo a prime, extended by i where a square root needs it."""

    def __init__(self, seed: int, prime: int = PRIME) -> None:
        self._seed, self.prime = seed, prime

    def draw(self, *key: object) -> Element:
        """Return a random number. Equal keys give equal numbers."""
        text = repr((self._seed, *key)).encode()
        return int.from_bytes(hashlib.blake2b(text, digest_size=16).digest(), "big") % self.prime

    def inverse(self, x: Element) -> Element:
        """Return 1/x."""
        if isinstance(x, int):
            if not x:
                raise ZeroDivisionError
            return pow(x, -1, self.prime)
        a, b = x
        norm = pow(a * a + b * b, -1, self.prime)
        return a * norm % self.prime, -b * norm % self.prime

    def root(self, x: Element) -> Element:
        """Return a square root: r or r i for a number, a random number for a pair a + b i."""
        if not isinstance(x, int):
            return self.draw("root", x)
        prime = self.prime
        root = pow(x, (prime + 1) // 4, prime)
        if root * root % prime == x:
            return root
        return 0, pow(-x, (prime + 1) // 4, prime)

    def times(self, x: Element, y: Element) -> Element:
        """Return x y."""
        if isinstance(x, int) and isinstance(y, int):
            return x * y % self.prime
        (a, b), (c, d) = _pair(x), _pair(y)
        return self._reduced(a * c - b * d, a * d + b * c)

    def plus(self, x: Element, y: Element) -> Element:
        """Return x + y."""
        if isinstance(x, int) and isinstance(y, int):
            return (x + y) % self.prime
        (a, b), (c, d) = _pair(x), _pair(y)
        return self._reduced(a + c, b + d)

    def _reduced(self, a: int, b: int) -> Element:
        b %= self.prime
        return (a % self.prime, b) if b else a % self.prime


def _pair(x: Element) -> tuple[int, int]:
    return (x, 0) if isinstance(x, int) else x


class Angles:
    """Arguments of sin, cos, exp, sinh, cosh and tanh as rational combinations of nodes.

    The nodes are no sums. ``divisors`` has the common denominator of the coefficients of each node.
    Random points belong to the node divided by its divisor, so all angles are integer combinations.
    """

    def __init__(self, graph: Graph, nodes: Iterable[int]) -> None:
        self._graph = graph
        self._known: dict[int, dict[int, Exact]] = {}
        self.divisors: dict[int, int] = {}
        for n in nodes:
            kind, parts, _ = graph.nodes[n]
            if kind == "function" and parts[0] in ("sin", "cos", "exp", "sinh", "cosh", "tanh"):
                for m, c in self(parts[1]).items():
                    self.divisors[m] = lcm(self.divisors.get(m, 1), c.denominator)

    def __call__(self, value: Value) -> dict[int, Exact]:
        """Return an angle as a map from nodes, which are no sums, to rational coefficients."""
        coefficient, n = value
        if n not in self._known:
            kind, parts, _ = self._graph.nodes[n]
            if kind == "sum":
                combination: dict[int, Exact] = {}
                for c, m in parts:
                    for base, f in self((c, m)).items():
                        combination[base] = combination.get(base, 0) + f
                self._known[n] = {m: c for m, c in combination.items() if c}
            else:
                self._known[n] = {n: 1}
        return {m: Fraction(coefficient) * c for m, c in self._known[n].items()}


class Evaluation:
    """The values of nodes and of all their descendants at one random point.

    Square roots of ``opaque`` nodes get random numbers, like unknown functions. ``angles`` may
    include angles of further nodes. The constructor raises ZeroDivisionError if a division by zero
    occurs at this point. The caller then chooses another point.
    """

    def __init__(
        self,
        graph: Graph,
        roots: Iterable[int],
        arithmetic: PrimeField,
        opaque: Collection[int] = (),
        angles: Angles | None = None,
    ) -> None:
        self._graph, self.arithmetic, self._opaque = graph, arithmetic, opaque
        roots = list(roots)
        nodes = graph.descendants(roots)
        self._angles = Angles(graph, nodes) if angles is None else angles
        self.values: dict[int, Element] = {}
        self._symbols: dict[int, Element] = {}
        self._evaluate(nodes, self.values)
        self._containing: dict[int, list[int]] = {}  # nodes by the symbols in them
        self._dependent: dict[int, set[int]] = {}

    def __getitem__(self, value: Value) -> Element:
        """Return the number of a value, a pair of a coefficient and a node."""
        coefficient, n = value
        return self.arithmetic.times(self._number(coefficient), self.values[n])

    def depending_on(self, x: int) -> set[int]:
        """Return the nodes whose values change when the symbol x gets another random number."""
        if x in self._dependent:
            return self._dependent[x]
        if not self._containing:
            for n in self.values:
                for s in self._graph.nodes[n].symbols:
                    self._containing.setdefault(s, []).append(n)
        nodes = self._containing.get(x, [])
        before = {n: self.values[n] for n in nodes}
        self._symbols[x] = self.arithmetic.draw("moved", self._graph.nodes[x].parts[0])
        try:
            self._evaluate(nodes, self.values)
            self._dependent[x] = {n for n in nodes if self.values[n] != before[n]}
        finally:
            del self._symbols[x]
            self.values |= before
        return self._dependent[x]

    def at(self, symbols: dict[int, Element]) -> Evaluation:
        """Return an evaluation at the same point, but with given numbers for some symbols."""
        other = object.__new__(Evaluation)
        fresh = {"_symbols": symbols, "values": {}, "_containing": {}, "_dependent": {}}
        other.__dict__.update(self.__dict__ | fresh)
        other._evaluate(sorted(self.values), other.values)
        return other

    def _number(self, x: Exact) -> int:
        p = self.arithmetic.prime
        top, bottom = x.numerator % p, x.denominator % p
        if (x and not top) or not bottom:
            raise ZeroDivisionError  # the prime divides a coefficient
        return top if bottom == 1 else top * pow(bottom, -1, p) % p

    def _evaluate(self, nodes: Iterable[int], values: dict[int, Element]) -> None:
        times, plus, prime = self.arithmetic.times, self.arithmetic.plus, self.arithmetic.prime
        for n in nodes:
            kind, parts, _ = self._graph.nodes[n]
            if kind == "sum":
                terms = [(self._number(c), values[m]) for c, m in parts]
                if all(type(x) is int for _, x in terms):
                    values[n] = sum(c * x for c, x in terms) % prime
                    continue
                total: Element = 0
                for c, x in terms:
                    total = plus(total, times(c, x))
                values[n] = total
            elif kind == "product":
                product: Element = 1
                for m, e in parts:
                    x = values[m] if e == 1 else self._power(m, values[m], e)
                    product = times(product, x)
                values[n] = product
            elif kind == "function":
                values[n] = self._function(parts, values)
            elif kind == "symbol":
                element = self._symbols.get(n)
                values[n] = self.arithmetic.draw("symbol", parts[0]) if element is None else element
            else:
                values[n] = 1 if n == 0 else self.arithmetic.draw("constant", *parts)

    def _power(self, n: int, x: Element, e: Exact) -> Element:
        if e.denominator == 2 and n not in self._opaque:
            x = self.arithmetic.root(x)
        elif e.denominator != 1:
            x = self.arithmetic.draw("power", x, e.denominator)
        return self._whole_power(x, e.numerator)

    def _whole_power(self, x: Element, e: int) -> Element:
        if e < 0:
            x, e = self.arithmetic.inverse(x), -e
        return raise_to_power(self.arithmetic.times, 1, x, e)

    def _function(self, parts: tuple[Any, ...], values: dict[int, Element]) -> Element:
        name, *arguments = parts
        a = self.arithmetic
        times, plus = a.times, a.plus
        if name in ("sin", "cos"):
            turn: tuple[Element, Element] = (1, 0)
            for m, factor in self._angles(arguments[0]).items():
                turn = self._add_angles(turn, self._multiple_angle(m, values[m], factor))
            return turn[name == "sin"]
        if name in ("exp", "sinh", "cosh", "tanh"):
            unit: Element = 1
            for m, factor in self._angles(arguments[0]).items():
                exponential = a.draw("exp", self._quotient(m, values[m]))
                unit = times(
                    unit, self._whole_power(exponential, int(factor * self._angles.divisors[m]))
                )
            if name == "exp":
                return unit
            back = times(a.prime - 1, a.inverse(unit))
            half = (a.prime + 1) // 2
            sinh = times(half, plus(unit, back))
            cosh = times(half, plus(unit, times(a.prime - 1, back)))
            if name == "tanh":
                return times(sinh, a.inverse(cosh))
            return sinh if name == "sinh" else cosh
        return a.draw(name, *(times(self._number(c), values[m]) for c, m in arguments))

    def _quotient(self, n: int, value: Element) -> Element:
        """Return the value of a node over its divisor; angles are integer multiples of it."""
        return self.arithmetic.times(self._number(Fraction(1, self._angles.divisors[n])), value)

    def _multiple_angle(self, n: int, value: Element, factor: Exact) -> tuple[Element, Element]:
        """Return the cosine and the sine of a multiple of a node."""
        a = self.arithmetic
        times, plus = a.times, a.plus
        t = a.draw("circle", self._quotient(n, value))
        square = times(t, t)
        over = a.inverse(plus(1, square))
        c, s = times(plus(1, times(a.prime - 1, square)), over), times(times(2, t), over)
        whole = int(factor * self._angles.divisors[n])
        if whole < 0:
            s, whole = times(a.prime - 1, s), -whole
        return raise_to_power(self._add_angles, (1, 0), (c, s), whole)

    def _add_angles(
        self, first: tuple[Element, Element], second: tuple[Element, Element]
    ) -> tuple[Element, Element]:
        """Return the cosine and the sine of the sum of two angles."""
        times, plus = self.arithmetic.times, self.arithmetic.plus
        (c, s), (d, r) = first, second
        minus = times(self.arithmetic.prime - 1, times(s, r))
        return plus(times(c, d), minus), plus(times(s, d), times(c, r))


def raise_to_power(times: Callable[[Any, Any], Any], unit: Any, x: Any, count: int) -> Any:
    """Return unit times x to the power count, by repeated squaring. ``times`` is the product."""
    while count:
        if count & 1:
            unit = times(unit, x)
        x, count = times(x, x), count >> 1
    return unit
