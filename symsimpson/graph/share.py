"""Common subexpressions of products and sums.

All powers of a base come from one inverse or root of it. Then the pair of factors that most
products share gets a line. This is repeated until no pair is shared, and then for pairs of terms
[1]_.

References
----------
.. [1] A. Hosangadi, F. Fallah, R. Kastner, Optimizing polynomial expressions by algebraic
   factorization and common subexpression elimination, IEEE Transactions on Computer-Aided Design
   of Integrated Circuits and Systems 25 (2006), 2012-2022.
"""

from __future__ import annotations

import heapq
from fractions import Fraction
from itertools import combinations
from typing import Any

from symsimpson.graph.lines import (
    CoefficientFolding,
    Item,
    StraightLineCode,
    add_factor,
    write_powers,
)
from symsimpson.graph.nodes import exact

#: Longest sum or product in which pairs are searched.
LONGEST = 40
#: Largest number of lines of a program in which pairs are searched.
MOST_LINES = 12000

Pair = tuple[Item, Item]


def share(program: StraightLineCode) -> StraightLineCode:
    """Reduce the operations of a program in place, and return it."""
    _gather_constants(program)
    write_powers(program)
    CoefficientFolding(program).run()
    if len(program.lines) <= MOST_LINES:
        _FactorPairs(program, 1).run()
        _FactorPairs(program, 9).run()
        _TermPairs(program, 9).run()
    program.resolve()
    return program


def _gather_constants(program: StraightLineCode) -> None:
    """Combine the factors of each product, and the terms of each sum, that have level 0."""
    for n in program.order():
        line = program.lines[n]
        if not line.level or line.kind not in ("sum", "product"):
            continue
        place = 1 if line.kind == "sum" else 0
        early = [part for part in line.parts if not program.lines[part[place]].level]
        if len(early) > 1:
            constant = program.line(line.kind, early, 0)
            rest = [part for part in line.parts if program.lines[part[place]].level]
            line.parts = [*rest, (1, constant) if place else (constant, 1)]


class _Pairs:
    """A greedy search for pairs that lines of one kind share. Each pair found gets a line.

    Items with a level above ``level`` are ignored.
    """

    kind = ""
    place = 0  #: Index of the line in an item.

    def __init__(self, program: StraightLineCode, level: int) -> None:
        self._program, self._level = program, level
        self._where: dict[Pair, dict[int, None]] = {}
        self._heap: list[tuple[int, Any, Pair]] = []

    def run(self) -> None:
        """Add lines for the most frequent pairs until no pair is shared."""
        for n in self._program.order():
            if self._program.lines[n].kind == self.kind and self._program.lines[n].level:
                for pair in self._pairs(n):
                    self._where.setdefault(pair, {})[n] = None
        for pair in self._where:
            self._push(pair)
        while self._heap:
            count, _, pair = heapq.heappop(self._heap)
            users = self._where.get(pair, {})
            if len(users) != -count:
                if len(users) > 1:
                    self._push(pair)
                continue
            if len(users) < 2:
                break
            self._extract(pair, list(users))

    def _push(self, pair: Pair) -> None:
        users = len(self._where[pair])
        if users > 1:
            heapq.heappush(self._heap, (-users, self._rank(pair), pair))

    def _extract(self, pair: Pair, users: list[int]) -> None:
        """Replace a pair in all its users by one line."""
        number = self._line(pair)
        touched: dict[Pair, None] = {}
        for n in users:
            if n == number:
                continue
            before = self._pairs(n)
            self._replace(n, pair, number)
            after = self._pairs(n)
            for gone in before:
                if gone not in after:
                    self._where[gone].pop(n, None)
                    touched[gone] = None
            for new in after:
                if new not in before:
                    self._where.setdefault(new, {})[n] = None
                    touched[new] = None
        self._where[pair].pop(number, None)
        if len(self._where[pair]) < 2:
            del self._where[pair]
        for other in touched:
            if other in self._where:
                self._push(other)

    def _pairs(self, n: int) -> dict[Pair, None]:
        raise NotImplementedError

    def _line(self, pair: Pair) -> int:
        raise NotImplementedError

    def _replace(self, n: int, pair: Pair, number: int) -> None:
        raise NotImplementedError

    def _rank(self, pair: Pair) -> Any:
        """Return the order of equally frequent pairs: low levels first."""
        levels = [self._program.lines[item[self.place]].level for item in pair]
        return sum(levels), [float(x) for item in pair for x in item]


class _FactorPairs(_Pairs):
    """A search for pairs of factors. Items are (line, exponent)."""

    kind = "product"

    def _pairs(self, n: int) -> dict[Pair, None]:
        lines = self._program.lines
        operands = sorted(item for item in lines[n].parts if lines[item[0]].level <= self._level)
        return dict.fromkeys(combinations(operands, 2)) if len(operands) <= LONGEST else {}

    def _line(self, pair: Pair) -> int:
        for n in self._where[pair]:
            if sorted(self._program.lines[n].parts) == list(pair):
                return n
        return self._program.line("product", pair, self._program.level([m for m, _ in pair]))

    def _replace(self, n: int, pair: Pair, number: int) -> None:
        line = self._program.lines[n]
        for item in pair:
            line.parts.remove(item)
        add_factor(line.parts, number, 1)


class _TermPairs(_Pairs):
    """A search for pairs of terms with the same ratio of coefficients.

    The items of a pair are (1, line) and (ratio, line).
    """

    kind = "sum"
    place = 1

    def _pairs(self, n: int) -> dict[Pair, None]:
        lines = self._program.lines
        terms = sorted((m, c) for c, m in lines[n].parts if 0 < lines[m].level <= self._level)
        if len(terms) > LONGEST:
            return {}
        return dict.fromkeys(
            ((1, a), (exact(Fraction(d) / c), b)) for (a, c), (b, d) in combinations(terms, 2)
        )

    def _line(self, pair: Pair) -> int:
        (_, a), (ratio, b) = pair
        for n in self._where[pair]:
            parts = self._program.lines[n].parts
            if len(parts) == 2 and sorted((m, c) for c, m in parts) == [(a, 1), (b, ratio)]:
                return n
        return self._program.line("sum", pair, self._program.level([a, b]))

    def _replace(self, n: int, pair: Pair, number: int) -> None:
        (_, a), (ratio, b) = pair
        line = self._program.lines[n]
        coefficient = next(c for c, m in line.parts if m == a)
        line.parts.remove((coefficient, a))
        line.parts.remove((exact(coefficient * ratio), b))
        other = next((c for c, m in line.parts if m == number), None)
        if other is not None:
            line.parts.remove((other, number))
            coefficient = exact(coefficient + other)
        if coefficient or not line.parts:
            line.parts.append((coefficient, number))
