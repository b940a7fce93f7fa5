"""Square roots that depend on each other, with the signs that this rests on."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from symsimpson.graph.field import Angles, Evaluation, PrimeField, raised
from symsimpson.graph.nodes import Graph, Value
from symsimpson.support.array_types import Ints

#: Functions that are positive everywhere, and those with the sign of their argument.
POSITIVE = frozenset(["exp", "cosh", "softplus"])
LIKE_ARGUMENT = frozenset(["sinh", "tanh", "asinh", "atan", "erf"])
#: Functions with a real value only on a part of the real numbers.
PARTIAL = frozenset(["asin", "acos", "acosh", "atanh"])


class Signs:
    """The signs of nodes, as far as they are known.

    A sign is a pair: the sign itself, 1, -1 or 0 for unknown, and whether zero is excluded. The
    signs of symbols are ``known``.
    """

    def __init__(self, graph: Graph, known: Mapping[int, tuple[int, bool]]) -> None:
        self._graph = graph
        self._done = dict(known)

    def __call__(self, value: Value) -> tuple[int, bool]:
        """Return the sign of a value."""
        coefficient, n = value
        if not coefficient:
            return 1, False
        for m in self._graph.reached([n]) if n not in self._done else ():
            if m not in self._done:
                self._done[m] = self._node(m)
        sign, strict = self._done[n]
        return (sign if coefficient > 0 else -sign), strict

    def _node(self, n: int) -> tuple[int, bool]:
        kind, parts, _ = self._graph.nodes[n]
        match kind:
            case "unit" | "constant":
                return 1, True
            case "sum":
                signs = [self((c, m)) for c, m in parts]
                if len({s for s, _ in signs}) == 1:
                    return signs[0][0], any(strict for _, strict in signs)
            case "product":
                return self._product(parts)
            case "function":
                name, *arguments = parts
                if name in POSITIVE:
                    return 1, True
                sign, strict = self(arguments[0])
                if name in LIKE_ARGUMENT:
                    return sign, strict
                if name == "pow" and sign == 1:
                    return 1, strict
                if name == "atan2" and self(arguments[1]) == (1, True):
                    return sign, strict
        return 0, False

    def _product(self, parts: Iterable[tuple[int, object]]) -> tuple[int, bool]:
        sign, strict = 1, True
        for m, e in parts:
            factor_sign, definite = self._done[m]
            if e.denominator != 1 or e.numerator % 2 == 0:  # type: ignore[attr-defined]
                factor_sign = 1
            sign, strict = sign * factor_sign, strict and definite
        return sign, strict

    def real_everywhere(self, roots: Iterable[int]) -> bool:
        """Return whether nodes are real wherever they have a value; True is certain."""
        for n in self._graph.reached(roots):
            kind, parts, _ = self._graph.nodes[n]
            if kind == "product":
                if any(e.denominator != 1 and self((1, m))[0] != 1 for m, e in parts):
                    return False
            elif kind == "function" and (
                parts[0] in PARTIAL or (parts[0] in ("log", "pow") and self(parts[1])[0] != 1)
            ):
                return False
        return True

    def never_real(self, n: int) -> bool:
        """Return whether a node is a root or a logarithm of what is always negative."""
        kind, parts, _ = self._graph.nodes[n]
        if kind == "product":
            return any(e.denominator != 1 and self((1, m)) == (-1, True) for m, e in parts)
        return (
            kind == "function"
            and parts[0] in ("log", "pow")
            and self(parts[1]) == (-1, True)
            and not (parts[0] == "pow" and parts[2][1] == 0)
        )


#: A product of two numbers modulo this fits into 64 bits.
PRIME = 2**31 - 1
#: A dependence that is none survives so many more points than radicands with chance 2^-40.
MORE = 40


def radicands(graph: Graph, nodes: Iterable[int]) -> list[int]:
    """List the nodes of which square roots are taken."""
    bases: dict[int, None] = {}
    for n in nodes:
        kind, parts, _ = graph.nodes[n]
        if kind == "product":
            for m, e in parts:
                if e.denominator == 2:
                    bases[m] = None
    return sorted(bases)


def dependent_radicands(graph: Graph, roots: Iterable[int]) -> frozenset[int]:
    """Return the radicands of which some product is a square, or may be one.

    The nodes that hold the square roots are in ``roots``.
    """
    roots = list(roots)
    order = graph.reached(roots)
    bases, holding = radicands(graph, order), set[int]()  # roots, or what is made of some
    for n in order:
        if radicands(graph, [n]) or not holding.isdisjoint(graph.arguments(n)):
            holding.add(n)
    nested = holding.intersection(bases)
    plain = [m for m in bases if m not in nested]
    dependent = set(nested)
    having: dict[int, list[int]] = {}
    for m in plain:
        for x in graph.nodes[m].symbols:
            having.setdefault(x, []).append(m)
    # all symbols vary, and then each alone: k x^2 is a square but for a constant
    angles = Angles(graph, order)
    if plain:
        dependent |= _dependent(graph, plain, angles, None)
    for x in sorted(having):
        dependent |= _dependent(graph, having[x], angles, x)
    return frozenset(dependent)


def _dependent(graph: Graph, bases: list[int], angles: Angles, varied: int | None) -> set[int]:
    """Return radicands of which a product is a square, as functions of all symbols or of one."""
    name = None if varied is None else graph.nodes[varied].parts[0]
    try:
        at = Evaluation(graph, bases, _Rows(len(bases) + MORE, name), angles=angles)
    except ZeroDivisionError:
        return set(bases)
    count, bits = len(bases) + MORE, []
    for m in bases:  # a bit for each point, 1 where the radicand is no square
        values = np.broadcast_to(at.values[m], count).astype(np.int64)
        character = _power(values, (PRIME - 1) // 2)
        bits.append(int("".join("1" if c == PRIME - 1 else "0" for c in character), 2))
    # a character that never changes is one of a constant, of either kind
    constant = (1 << count) - 1
    places = _kernel(bits if varied is None else [*bits, constant])
    return {bases[k] for k in places if k < len(bases)}


class _Rows(PrimeField):
    """Rows of numbers modulo a prime below 2^31, one for each point."""

    def __init__(self, count: int, varied: str | None = None) -> None:
        super().__init__(0, PRIME)
        self._count, self._varied = count, varied

    def draw(self, *key: object) -> Ints:
        """Return random numbers that are the same for the same key."""
        text = repr([k.tobytes() if isinstance(k, np.ndarray) else k for k in key]).encode()
        seed = int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "big")
        still = self._varied is not None and key[0] == "symbol" and key[1] != self._varied
        drawn = np.random.default_rng(seed).integers(1, PRIME, 1 if still else self._count)
        return np.broadcast_to(drawn, self._count)

    def inverse(self, x: Any) -> Ints:
        """Return 1/x."""
        return _power(np.broadcast_to(np.asarray(x, dtype=np.int64), self._count), PRIME - 2)

    def times(self, x: Any, y: Any) -> Any:
        """Return x y."""
        return x * y % PRIME

    def plus(self, x: Any, y: Any) -> Any:
        """Return x + y."""
        return (x + y) % PRIME


def _power(x: Ints, e: int) -> Ints:
    power: Ints = raised(lambda a, b: a * b % PRIME, np.ones_like(x), x, e)
    return power


def _kernel(bits: list[int]) -> set[int]:
    """Return the places that take part in a dependence modulo two."""
    basis: dict[int, tuple[int, int]] = {}
    places: set[int] = set()
    for place, row in enumerate(bits):
        members = 1 << place
        while row:
            top = row.bit_length()
            if top not in basis:
                basis[top] = (row, members)
                break
            other, more = basis[top]
            row, members = row ^ other, members ^ more
        else:
            places |= {k for k in range(place + 1) if members >> k & 1}
    return places
