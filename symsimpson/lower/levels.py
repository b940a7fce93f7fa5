"""Binding times: values that depend on the run, the step or the iteration."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import mpmath

from symsimpson.graph.evaluate import evaluate_nodes
from symsimpson.graph.nodes import UNIT, Exact
from symsimpson.graph.read import fit_to_double, is_float
from symsimpson.lower.emitted_names import NameTable
from symsimpson.lower.expression import Expression, Expressions
from symsimpson.lower.printer import LARGE, count_operations

#: Constants are equal if they agree in DIGITS digits, computed with GUARD more.
DIGITS, GUARD = 50, 15


class Level(IntEnum):
    """The time from which a value is known."""

    CONSTANT = 0
    RUN = 1
    STEP = 2
    ITERATION = 3
    LATE = 4  # once the forces at all nodes are known


#: Names of values cut out of an expression, by when they are known.
_PREFIX = "kcsxy"
#: Operations of functions of values; sines and cosines are counted by themselves.
_OPERATIONS = {"exact_sum": 6}


@dataclass(frozen=True)
class Definition:
    """A value, or the results of a ``function`` of some values, with a level and a section."""

    targets: tuple[Expression, ...]
    values: tuple[Expression, ...]
    level: Level
    section: str
    function: str = ""

    @property
    def symbols(self) -> list[Expression]:
        """The symbols in its values, in the order of the lines."""
        return [symbol for value in self.values for symbol in value.symbols]

    @property
    def operations(self) -> int:
        """The number of its operations, without sines and cosines."""
        return sum(map(count_operations, self.values)) + _OPERATIONS.get(self.function, 0)


#: A value that is split, and when it is known.
Part = tuple[Expression, Level]


class Definitions(Expressions):
    """Definitions in an order in which they can be computed; equal values share a definition.

    An expression is cut where its level changes: products of parameters are computed once a run,
    the trigonometry of the left node once a step.
    """

    def __init__(self, names: NameTable) -> None:
        super().__init__()
        self.names = names
        #: By the node of a symbol.
        self.levels: dict[int, Level] = {}
        self.definitions: dict[Expression, Definition] = {}
        self.constants: dict[Expression, Expression] = {}
        self._symbol_of: dict[Expression, Expression] = {}
        self._constant_of: dict[Expression | str, Expression] = {}
        self._pairs: dict[tuple[Any, ...], tuple[Expression, Expression]] = {}
        #: Symbols whose definitions may be substituted if they are used once.
        self.removable: set[Expression] = set()
        #: Values that a text asks for which computes all of them, in that order, with its sections.
        self.requests: dict[Expression, str] = {}

    def declare(self, name: str, level: Level) -> Expression:
        """Return the symbol of a value that comes from outside."""
        symbol = self.make_symbol(name)
        self.levels[symbol.node] = level
        return symbol

    def fresh(self, hint: str, level: Level) -> Expression:
        """Return a symbol of a new name for a value that comes from outside."""
        return self.declare(self.names.fresh(hint), level)

    def define(self, hint: str, expression: Expression, section: str) -> Expression:
        """Define an expression under a name; return numbers and symbols unchanged."""
        value, _ = self.split(expression, section)
        if self._trivial(value):
            return value
        return self._name(value, hint, section)

    def define_removable(self, hint: str, expression: Expression, section: str) -> Expression:
        """Define an expression whose line may be left out where it is used once."""
        before = len(self.definitions)
        value = self.define(hint, expression, section)
        if len(self.definitions) > before:
            self.removable.update(value.symbols)
        return value

    def define_sincos(
        self, hint: str, angle: Expression, section: str
    ) -> tuple[Expression, Expression]:
        """Define the sine and the cosine of an angle."""
        value = self.define(hint if hint.startswith("angle") else f"angle_{hint}", angle, section)
        return self.define_pair("sincos", (value,), (f"sin_{hint}", f"cos_{hint}"), section)

    def define_pair(
        self, function: str, values: tuple[Expression, ...], hints: tuple[str, str], section: str
    ) -> tuple[Expression, Expression]:
        """Define the two values that a function gives."""
        if (function, *values) not in self._pairs:
            level = max(map(self.level, values))
            first, second = (self.fresh(hint, level) for hint in hints)
            definition = Definition((first, second), values, level, section, function)
            self.definitions |= {first: definition, second: definition}
            self._pairs[function, *values] = first, second
        for symbol in self._pairs[function, *values]:
            self.requests.setdefault(symbol, section)
        return self._pairs[function, *values]

    def level(self, expression: Expression) -> Level:
        """Return the level at which an expression is known."""
        return Level(self.known_at(expression.node))

    def known_at(self, node: int) -> int:
        """Return the level of a node; sums begin with terms of low levels."""
        return max((self.levels[n] for n in self.nodes[node].symbols), default=0)

    def split(self, expression: Expression, section: str) -> Part:
        """Define the parts of an expression that are known earlier than the whole."""
        if expression.is_number:
            return self._number(expression), Level.CONSTANT
        kind, parts, _ = self.nodes[expression.node]
        level, c = self.level(expression), expression.coefficient
        if kind == "symbol":
            return self._multiple(c, Expression(self, (1, expression.node))), level
        if kind == "sum":
            if c not in (1, -1):  # a number before parentheses
                inner, _ = self.split(Expression(self, (1, expression.node)), section)
                return self._multiple(c, inner), level
            terms = self._join_numbers(self.total, [(c * d, n) for d, n in parts])
            return self._regroup(self.total, self._parts(terms, section), level, section), level
        if kind == "product":
            factors = [self.multiply([(1, n, e)]) for n, e in parts]
            joined = self._join_numbers(self.product, [*([(c, UNIT)] if c != 1 else []), *factors])
            pieces = [
                self.split(factor, section) if factor.is_number else self._power(factor, section)
                for factor in joined
            ]
            return self._regroup(self.product, pieces, level, section), level
        name, *arguments = parts
        pieces = self._parts([Expression(self, value) for value in arguments], section)
        return self._multiple(c, self.apply(name, *(value for value, _ in pieces))), level

    def _parts(self, values: Iterable[Expression], section: str) -> list[Part]:
        return [self.split(value, section) for value in values]

    def _power(self, power: Expression, section: str) -> Part:
        """Split the base of a power; exponents other than roots become constants."""
        ((base, exponent),) = self.factors(power.node)
        value, level = self.split(Expression(self, (1, base)), section)
        if exponent.denominator in (1, 2, 4):
            return value**exponent, level
        return self.apply("pow", value, self._number(self.of(exponent))), level

    def _multiple(self, c: Exact, value: Expression) -> Expression:
        """Return a value times a number, which has a name if it is not exact."""
        c *= value.coefficient
        unscaled = Expression(self, (1, value.node))
        return unscaled if c == 1 else self._number(self.of(c)) * unscaled

    def _join_numbers(
        self, join: Callable[[list[Expression]], Expression], values: list[tuple[Exact, int]]
    ) -> list[Expression]:
        """Return the parts of a sum or product, with all numbers joined."""
        parts = [Expression(self, value) for value in values]
        numbers = [part for part in parts if part.is_number]
        if len(numbers) < 2:
            return parts
        return [join(numbers), *(part for part in parts if not part.is_number)]

    def _regroup(
        self,
        join: Callable[[list[Expression]], Expression],
        parts: list[Part],
        level: Level,
        section: str,
    ) -> Expression:
        """Define together the parts of a sum or product that are known before the others."""
        late = [value for value, at in parts if at == level]
        early = [(value, at) for value, at in parts if at < level]
        if join == self.product:  # signs stay outside, so that x and -x share a definition
            minus = sum(value.coefficient < 0 for value, _ in early) % 2
            early = [
                (-value if value.coefficient < 0 else value, at)
                for value, at in early
                if value not in (1, -1)
            ]
            late = [self.of(-1 if minus else 1), *late]
            if len(early) == 1 and early[0][0].node == UNIT:
                return join([early[0][0], *late])
        if not early:
            return join(late)
        known = max(at for _, at in early)
        value = self._regroup(join, early, known, section)
        if not self._trivial(value):
            value = self._name(value, _PREFIX[known], section)
        return join([value, *late])

    def _name(self, value: Expression, hint: str, section: str) -> Expression:
        """Return the symbol of a split value, or the negative symbol of its opposite."""
        if -value in self._symbol_of:
            self.requests.setdefault(self._symbol_of[-value], section)
            return -self._symbol_of[-value]
        level = self.level(value)
        if level == Level.CONSTANT:
            return self._number(self.substitute(value, self.constants))
        if value not in self._symbol_of:
            symbol = self.fresh(hint, level)
            self.definitions[symbol] = Definition((symbol,), (value,), level, section)
            self._symbol_of[value] = symbol
        self.requests.setdefault(self._symbol_of[value], section)
        return self._symbol_of[value]

    def _number(self, number: Expression) -> Expression:
        """Write small integers, their halves and floats in place; name every other constant."""
        if number.node == UNIT:
            number = self.of(fit_to_double(number.coefficient))
        c = number.coefficient
        if number.node == UNIT:
            small = abs(c.numerator) < LARGE and c.denominator < LARGE
            if is_float(c) or (small and c.denominator & (c.denominator - 1) == 0):
                return number
        if c < 0:
            return -self._number(-number)
        rational = number.node == UNIT
        if number not in self._constant_of:
            key = number if rational else self._digits(number)
            if key in self._constant_of:  # the same number, written in another way
                self._constant_of[number] = self._constant_of[key]
                return self._constant_of[number]
            short = rational and max(c.numerator, c.denominator) < LARGE
            hint = f"C_{c.numerator}_{c.denominator}" if short else "C"
            symbol = self.fresh(hint, Level.CONSTANT)
            self.constants[symbol] = number
            self._constant_of[number] = self._constant_of[key] = symbol
        return self._constant_of[number]

    def is_positive(self, expression: Expression) -> bool:
        """Return whether an expression is a number above zero."""
        value = self.substitute(expression, self.constants)
        return value.is_number and mpmath.mpf(self._digits(value)) > 0

    def _digits(self, number: Expression) -> str:
        """Return a number in digits."""
        with mpmath.workdps(DIGITS + GUARD):
            value = evaluate_nodes(self, [number.node], {}, mpmath.mp)[number.node]
            c = number.coefficient
            return str(mpmath.nstr(value * c.numerator / c.denominator, DIGITS))

    @staticmethod
    def _trivial(value: Expression) -> bool:
        return value.node == UNIT or (value.coefficient in (1, -1) and value.kind == "symbol")
