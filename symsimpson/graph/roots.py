"""Signs of nodes, and square roots that depend on each other."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from symsimpson.graph.field import Angles, Evaluation, PrimeField, raise_to_power
from symsimpson.graph.nodes import Graph, Value
from symsimpson.support.array_types import Ints

#: Functions that are positive everywhere, and functions with the sign of their argument.
POSITIVE = frozenset(["exp", "cosh", "softplus"])
LIKE_ARGUMENT = frozenset(["sinh", "tanh", "asinh", "atan", "erf"])
#: Functions that are real only on a part of the real numbers.
PARTIAL = frozenset(["asin", "acos", "acosh", "atanh"])


class Signs:
    """Signs of nodes, derived from the ``known`` signs of symbols.

    A sign is a pair: 1, -1 or 0 for unknown, and whether zero is excluded.
    """

    def __init__(self, graph: Graph, known: Mapping[int, tuple[int, bool]]) -> None:
        self._graph = graph
        self._done = dict(known)

    def __call__(self, value: Value) -> tuple[int, bool]:
        """Return the sign of a value."""
        coefficient, n = value
        if not coefficient:
            return 1, False
        for m in self._graph.descendants([n]) if n not in self._done else ():
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

    def real_everywhere(self, roots: Iterable[int], apart: Iterable[int] = ()) -> bool:
        """Return True if the nodes are certainly real wherever they are defined.

        Roots and functions of values that contain one of the symbols ``apart`` do not count.
        """
        others = set(apart)

        def doubtful(m: int) -> bool:
            return others.isdisjoint(self._graph.nodes[m].symbols)

        for n in self._graph.descendants(roots):
            kind, parts, _ = self._graph.nodes[n]
            if kind == "product":
                if any(
                    e.denominator != 1 and self((1, m))[0] != 1 and doubtful(m) for m, e in parts
                ):
                    return False
            elif (
                kind == "function"
                and (parts[0] in PARTIAL or (parts[0] in ("log", "pow") and self(parts[1])[0] != 1))
                and doubtful(parts[1][1])
            ):
                return False
        return True

    def never_real(self, n: int) -> bool:
        """Return whether a node is a root or a logarithm of a value that is always negative."""
        kind, parts, _ = self._graph.nodes[n]
        if kind == "product":
            return any(e.denominator != 1 and self((1, m)) == (-1, True) for m, e in parts)
        return (
            kind == "function"
            and parts[0] in ("log", "pow")
            and self(parts[1]) == (-1, True)
            and not (parts[0] == "pow" and parts[2][1] == 0)
        )


#: A product of two numbers modulo this prime fits into 64 bits.
PRIME = 2**31 - 1
#: With this number of points more than radicands, a wrong dependence has probability 2^-40.
MORE = 40


def radicands(graph: Graph, nodes: Iterable[int]) -> list[int]:
    """List the nodes under square roots in ascending order."""
    bases: dict[int, None] = {}
    for n in nodes:
        kind, parts, _ = graph.nodes[n]
        if kind == "product":
            for m, e in parts:
                if e.denominator == 2:
                    bases[m] = None
    return sorted(bases)


def dependent_radicands(graph: Graph, roots: Iterable[int]) -> frozenset[int]:
    """Return the radicands that are factors of a product which is, or may be, a square.

    The square roots of these radicands depend on each other. ``roots`` are nodes whose descendants
    include the square roots.
    """
    roots = list(roots)
    order = graph.descendants(roots)
    bases, containing = radicands(graph, order), set[int]()  # nodes that contain square roots
    for n in order:
        if radicands(graph, [n]) or not containing.isdisjoint(graph.arguments(n)):
            containing.add(n)
    nested = containing.intersection(bases)
    plain = [m for m in bases if m not in nested]
    dependent = set(nested)
    by_symbol: dict[int, list[int]] = {}
    for m in plain:
        for x in graph.nodes[m].symbols:
            by_symbol.setdefault(x, []).append(m)
    # first all symbols vary, then each separately: k x^2 is a square up to a constant
    angles = Angles(graph, order)
    if plain:
        dependent |= _find_dependent(graph, plain, angles, None)
    for x in sorted(by_symbol):
        dependent |= _find_dependent(graph, by_symbol[x], angles, x)
    return frozenset(dependent)


def _find_dependent(graph: Graph, bases: list[int], angles: Angles, varied: int | None) -> set[int]:
    """Return the radicands with a square product, as functions of all symbols or of one."""
    name = None if varied is None else graph.nodes[varied].parts[0]
    try:
        at = Evaluation(graph, bases, _PointArrays(len(bases) + MORE, name), angles=angles)
    except ZeroDivisionError:
        return set(bases)
    count, bits = len(bases) + MORE, []
    for m in bases:  # one bit for each point: 1 if the radicand is no square (Euler's criterion)
        values = np.broadcast_to(at.values[m], count).astype(np.int64)
        character = _power(values, (PRIME - 1) // 2)
        bits.append(int("".join("1" if c == PRIME - 1 else "0" for c in character), 2))
    # with one symbol, a product may also be a square times a constant that is no square
    constant = (1 << count) - 1
    places = _dependent_rows(bits if varied is None else [*bits, constant])
    return {bases[k] for k in places if k < len(bases)}


class _PointArrays(PrimeField):
    """Arithmetic modulo a prime on arrays with one number for each point.

    If ``varied`` names a symbol, all other symbols have the same number at all points.
    """

    def __init__(self, count: int, varied: str | None = None) -> None:
        super().__init__(0, PRIME)
        self._count, self._varied = count, varied

    def draw(self, *key: object) -> Ints:
        """Return an array of random numbers. Equal keys give equal arrays."""
        text = repr([k.tobytes() if isinstance(k, np.ndarray) else k for k in key]).encode()
        seed = int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "big")
        fixed = self._varied is not None and key[0] == "symbol" and key[1] != self._varied
        numbers = np.random.default_rng(seed).integers(1, PRIME, 1 if fixed else self._count)
        return np.broadcast_to(numbers, self._count)

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
    power: Ints = raise_to_power(lambda a, b: a * b % PRIME, np.ones_like(x), x, e)
    return power


def _dependent_rows(bits: list[int]) -> set[int]:
    """Return the indices of all rows that occur in a linear dependence modulo two."""
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
