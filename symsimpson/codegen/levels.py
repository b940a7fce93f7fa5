"""Binding times: what depends on the run, on the step, on the iteration.

An expression is cut where it changes level, so that what is known earlier becomes a definition of
its own and is computed only there: products of parameters once a run, the trigonometry of the
left node once a step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import sympy as sp

from symsimpson.codegen.names import NameTable
from symsimpson.codegen.printer import LARGE

__all__ = ["Definition", "Graph", "Level"]


class Level(IntEnum):
    """When a value is known."""

    CONSTANT = 0
    RUN = 1
    STEP = 2
    ITERATION = 3
    LATE = 4  # once the forces at all nodes are known


#: Names of values cut out of an expression, by when they are known.
_PREFIX = {
    Level.CONSTANT: "k",
    Level.RUN: "c",
    Level.STEP: "s",
    Level.ITERATION: "x",
    Level.LATE: "y",
}


@dataclass(frozen=True)
class Definition:
    """A value, or the sine and cosine of a value, with its level and the section it is in."""

    targets: tuple[sp.Symbol, ...]
    value: sp.Expr
    level: Level
    section: str

    @property
    def is_sincos(self) -> bool:
        """Whether the targets are sine and cosine of the value."""
        return len(self.targets) == 2


class Graph:
    """Definitions in an order in which they can be computed, each made once."""

    def __init__(self, names: NameTable) -> None:
        self.names = names
        self.levels: dict[sp.Symbol, Level] = {}
        self.definitions: dict[sp.Symbol, Definition] = {}
        self.constants: dict[sp.Symbol, sp.Expr] = {}
        self._known: dict[sp.Expr, sp.Symbol] = {}
        self._constant_of: dict[sp.Expr, sp.Symbol] = {}

    def declare(self, symbol: sp.Symbol, level: Level) -> sp.Symbol:
        """Take in a symbol whose value comes from outside."""
        self.levels[symbol] = level
        return symbol

    def define(self, hint: str, expression: sp.Expr, section: str) -> sp.Expr:
        """Define an expression under a name; numbers and symbols stand for themselves."""
        value, _ = self.split(expression, section)
        if self._trivial(value):
            return value
        return self._name(value, hint, section)

    def define_sincos(self, hint: str, angle: sp.Expr, section: str) -> tuple[sp.Symbol, sp.Symbol]:
        """Define the sine and the cosine of an angle."""
        value = self.define(hint if hint.startswith("angle") else f"angle_{hint}", angle, section)
        key = sp.sin(value, evaluate=False)
        if key not in self._known:
            sine, cosine = self.names.fresh(f"sin_{hint}"), self.names.fresh(f"cos_{hint}")
            definition = Definition((sine, cosine), value, self.level(value), section)
            for target in (sine, cosine):
                self.definitions[target] = definition
                self.levels[target] = definition.level
            self._known[key] = sine
        return self.definitions[self._known[key]].targets

    def level(self, expression: sp.Expr) -> Level:
        """Return when an expression is known."""
        return max((self.levels[s] for s in expression.free_symbols), default=Level.CONSTANT)

    def split(self, expression: sp.Expr, section: str) -> tuple[sp.Expr, Level]:
        """Replace what is known earlier than the whole by definitions."""
        if expression.is_Symbol:
            return expression, self.levels[expression]
        if expression.is_number:
            return self._number(expression), Level.CONSTANT
        numbers = [argument for argument in expression.args if argument.is_number]
        arguments = list(expression.args)
        if len(numbers) > 1 and (expression.is_Add or expression.is_Mul):
            rest = [argument for argument in arguments if not argument.is_number]
            arguments = [expression.func(*numbers), *rest]
        parts = [self.split(argument, section) for argument in arguments]
        level = max(part[1] for part in parts)
        if not (expression.is_Add or expression.is_Mul):
            return expression.func(*(part[0] for part in parts)), level
        return self._regroup(expression.func, parts, level, section), level

    def _regroup(
        self,
        func: Callable[..., sp.Expr],
        parts: list[tuple[sp.Expr, Level]],
        level: Level,
        section: str,
    ) -> sp.Expr:
        """Gather the arguments of a sum or product that are known before the others."""
        late = [value for value, at in parts if at == level]
        early = [(value, at) for value, at in parts if at < level]
        sign = sp.S.One
        if func is sp.Mul:  # -1 stays outside, so that x and -x share a definition
            sign = sp.S.NegativeOne ** sum(value == -1 for value, _ in early)
            early = [(value, at) for value, at in early if value != -1]
            variable = [value for value, at in early if at > Level.CONSTANT]
            if not variable and len(early) == 1 and early[0][0].is_Number:
                return func(sign, early[0][0], *late)
        if not early:
            return func(sign, *late) if func is sp.Mul else func(*late)
        known = max(at for _, at in early)
        value = self._regroup(func, early, known, section)
        if not self._trivial(value):
            value = self._name(value, _PREFIX[known], section)
        return func(sign, value, *late) if func is sp.Mul else func(value, *late)

    def _name(self, value: sp.Expr, hint: str, section: str) -> sp.Expr:
        """Return the symbol that stands for a value already split; signs are pulled out."""
        if value.could_extract_minus_sign() and -value in self._known:
            return -self._known[-value]
        level = self.level(value)
        if level == Level.CONSTANT:
            return self._number(value.xreplace(self.constants))
        if value not in self._known:
            symbol = self.names.fresh(hint)
            self.definitions[symbol] = Definition((symbol,), value, level, section)
            self.levels[symbol] = level
            self._known[value] = symbol
        return self._known[value]

    def _number(self, number: sp.Expr) -> sp.Expr:
        """Write small integers, their halves and floats in place; name every other constant."""
        if number.is_Float:
            return number
        small = number.is_Rational and abs(number.p) < LARGE and number.q < LARGE
        if small and number.q & (number.q - 1) == 0:
            return number
        if number.could_extract_minus_sign():
            return -self._number(-number)
        if number not in self._constant_of:
            hint = f"C_{number.p}_{number.q}" if number.is_Rational else "C"
            symbol = self.names.fresh(hint)
            self.constants[symbol] = number
            self.levels[symbol] = Level.CONSTANT
            self._constant_of[number] = symbol
        return self._constant_of[number]

    @staticmethod
    def _trivial(value: sp.Expr) -> bool:
        return bool(value.is_Symbol or value.is_Number or (-value).is_Symbol)
