"""Long sums, differentiated term by term: a chain of 512 springs has terms of two coordinates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import sympy as sp

__all__ = ["Sum", "connected"]

#: Factors with ``variables`` in front of sums of more terms than this are multiplied out.
LONG = 8


class Sum:
    """The terms of an expression, found by the symbols that they contain.

    Derivatives equal those of the expression; they only cost less. A factor in front of a sum
    that contains ``variables`` is multiplied out if it is free of them or the sum is long.
    """

    def __init__(self, expression: sp.Expr, variables: Iterable[sp.Symbol] = ()) -> None:
        self.terms = tuple(_split(sp.sympify(expression), set(variables)))
        self._with: dict[sp.Basic, list[int]] = {}
        for number, term in enumerate(self.terms):
            for symbol in term.free_symbols:
                self._with.setdefault(symbol, []).append(number)

    def diff(self, first: sp.Symbol, second: sp.Symbol | None = None) -> sp.Expr:
        """Differentiate by one symbol or by two."""
        if second is None:
            return sp.Add(*(term.diff(first) for term in self.having(first)))
        shared = [term for term in self.having(first) if second in term.free_symbols]
        return sp.Add(*(term.diff(first).diff(second) for term in shared))

    def having(self, symbol: sp.Symbol) -> Iterator[sp.Expr]:
        """Give the terms that contain a symbol."""
        return (self.terms[number] for number in self._with.get(symbol, ()))

    def pairs(self, symbols: Iterable[sp.Symbol]) -> list[tuple[int, int]]:
        """List the pairs i >= j of symbols that meet in a term, by their places."""
        place = {symbol: i for i, symbol in enumerate(symbols)}
        met: set[tuple[int, int]] = set()
        for term in self.terms:
            here = sorted(place[s] for s in term.free_symbols if s in place)
            met.update((i, j) for number, i in enumerate(here) for j in here[: number + 1])
        return sorted(met)


def _split(expression: sp.Expr, variables: set[sp.Symbol]) -> Iterator[sp.Expr]:
    for term in sp.Add.make_args(expression):
        factors = term.args if term.is_Mul else ()
        moving = [factor for factor in factors if factor.free_symbols & variables]
        sums = [f for f in moving if f.is_Add and (len(moving) == 1 or len(f.args) > LONG)]
        if len(sums) == 1:
            rest = term.func(*(factor for factor in factors if factor is not sums[0]))
            for part in sums[0].args:
                yield rest * part
        else:
            yield term


def connected(size: int, pairs: Iterable[tuple[int, int]]) -> list[list[int]]:
    """Group 0..size-1 by the pairs that join them, in the order of their least members."""
    group = list(range(size))

    def root(i: int) -> int:
        while group[i] != i:
            group[i] = group[group[i]]
            i = group[i]
        return i

    for i, j in pairs:
        low, high = sorted((root(i), root(j)))
        group[high] = low
    found: dict[int, list[int]] = {}
    for i in range(size):
        found.setdefault(root(i), []).append(i)
    return list(found.values())
