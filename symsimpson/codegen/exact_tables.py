"""Exact numbers of a scheme, as texts of the library compute with them when they are traced."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeAlias

import sympy as sp

from symsimpson.codegen.expression import Expression
from symsimpson.discrete.combined_rows import simplified
from symsimpson.graph.nodes import exact

__all__ = ["ExactNumber", "ExactTable", "Irrational", "exact_number"]


class Irrational:
    """An irrational number, exact: roots that cancel do so, and no denominator has a root."""

    __slots__ = ("value",)

    def __init__(self, value: sp.Expr) -> None:
        self.value = value

    def _with(self, other: Any, operate: Callable[[Any, Any], Any]) -> Any:
        if isinstance(other, Expression):
            return operate(other.graph.of(self.value), other)
        if not isinstance(other, (int, Fraction, Irrational)):
            return NotImplemented
        return _combined(operate, self.value, _written(other))

    def __neg__(self) -> ExactNumber:
        return Irrational(-self.value)

    def __add__(self, other: Any) -> Any:
        return self._with(other, operator.add)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        return self._with(other, operator.mul)

    __rmul__ = __mul__

    def __eq__(self, other: object) -> bool:
        """Return whether another number is the same; no whole number is."""
        return isinstance(other, Irrational) and self.value == other.value

    def __hash__(self) -> int:
        return hash(self.value)

    def __gt__(self, other: Any) -> bool:
        return bool(self.value > _written(other))

    def __lt__(self, other: Any) -> bool:
        return bool(self.value < _written(other))


#: A number of a table.
ExactNumber: TypeAlias = int | Fraction | Irrational


class ExactTable:
    """A table of the scheme, or a number of it, with all digits."""

    def __init__(self, entries: tuple[Any, ...]) -> None:
        self._entries = entries

    def __getitem__(self, place: int | tuple[int, ...]) -> Any:
        entry: Any = self._entries
        for k in place if isinstance(place, tuple) else (place,):
            if k < 0:
                raise IndexError(f"a text reads entry {place} of a table")
            entry = entry[k]
        return ExactTable(entry) if isinstance(entry, tuple) else exact_number(entry)

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self._entries)))

    def __len__(self) -> int:
        return len(self._entries)


def exact_number(number: Any) -> ExactNumber:
    """Return a number of SymPy as a whole number, a fraction, or an irrational number."""
    if isinstance(number, (int, Fraction, Irrational)):
        return number
    value = sp.sympify(number)
    return exact(Fraction(int(value.p), int(value.q))) if value.is_Rational else Irrational(value)


def _written(number: ExactNumber) -> sp.Expr:
    if isinstance(number, Irrational):
        return number.value
    return sp.Rational(number.numerator, number.denominator)


@lru_cache(maxsize=10_000)  # the same products of entries for all pairs of coordinates
def _combined(operate: Callable[[Any, Any], Any], x: sp.Expr, y: sp.Expr) -> ExactNumber:
    return exact_number(simplified(operate(x, y)))
