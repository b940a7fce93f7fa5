"""Values that become instructions of LLVM: numbers, and vectors of them.

A number that is known while a text is walked stays a number of Python. It becomes a constant only
where it meets one that is not known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

DOUBLE, INT, BIT = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
#: What is left of fast arithmetic: tests for NaN and compensated sums stay what they are. A product
#: is fused with a sum by the walker, where the text has one in the other, and LLVM fuses no more:
#: then vectors and single numbers have the same bits.
FLAGS = ("nsz",)
KNOWN = (bool, int, float, np.integer, np.floating)


class Refused(Exception):
    """A construct that no kernel of a generated module has, or that no vector can do.

    ``function`` is the one in which it is.
    """

    function = ""


@dataclass(frozen=True)
class LaneNumber:
    """The number of a lane in each lane of a vector, from ``first`` on."""

    first: Any


@dataclass(frozen=True)
class PrivateRow:
    """A row of which each lane has its own: vector number ``place`` of ``rows`` in ``memory``."""

    memory: Any
    rows: int
    place: Any


def known(value: Any) -> bool:
    """Return whether a value is a number of Python or NumPy."""
    return isinstance(value, KNOWN)


class Values:
    """Makes instructions of a builder of llvmlite; known numbers are computed with at once."""

    def __init__(self, builder: ir.IRBuilder, flags: tuple[str, ...] = FLAGS) -> None:
        self.builder, self._flags = builder, flags

    # -- kinds of values

    def real(self, value: Any) -> Any:
        """Return a value as a double, or a vector of doubles."""
        if known(value):
            return ir.Constant(DOUBLE, float(value))
        if isinstance(value, LaneNumber):
            raise Refused("the number of a lane as a real number")
        if value.type == INT:
            return self.builder.sitofp(value, DOUBLE)
        if value.type == BIT:
            return self.builder.uitofp(value, DOUBLE)
        return value

    def whole(self, value: Any) -> Any:
        """Return a value as a whole number of 64 bits; a known one is cut towards zero."""
        if known(value):
            return ir.Constant(INT, int(value))
        if not isinstance(value, LaneNumber) and value.type == BIT:
            return self.builder.zext(value, INT)
        if isinstance(value, LaneNumber) or value.type != INT:
            raise Refused("a real number as a row or a count")
        return value

    def bit(self, value: Any) -> Any:
        """Return a known number as true or false, and any other value as it is."""
        return ir.Constant(BIT, int(bool(value))) if known(value) else value

    def typed(self, a: Any, beside: Any) -> Any:
        """Return a known number as a value of the common type of both numbers."""
        if isinstance(a, bool) and isinstance(beside, bool):
            return self.bit(a)
        both = isinstance(a, int) and isinstance(beside, int)
        return self.whole(a) if both else self.real(a)

    def alike(self, *values: Any) -> list[Any]:
        """Return values of one type: vectors if one is a vector, doubles if one is a double."""
        if any(isinstance(value, (LaneNumber, PrivateRow)) for value in values):
            raise Refused("a row as a number")
        kinds = {value.type for value in values if not known(value)}
        width = next((kind.count for kind in kinds if isinstance(kind, ir.VectorType)), 0)
        elements = {kind.element if isinstance(kind, ir.VectorType) else kind for kind in kinds}
        if elements == {BIT} and all(isinstance(x, bool) for x in values if known(x)):
            operands = [self.bit(value) for value in values]
        elif elements <= {INT, BIT} and not any(isinstance(value, float) for value in values):
            operands = [self.whole(value) for value in values]
        else:
            operands = [self.real(value) for value in values]
        return [self.spread(value, width) for value in operands] if width else operands

    def spread(self, value: Any, width: int) -> Any:
        """Return a vector that has a number in all lanes."""
        if isinstance(value.type, ir.VectorType):
            return value
        kind = ir.VectorType(value.type, width)
        if isinstance(value, ir.Constant):
            return ir.Constant(kind, [value] * width)
        nothing, number = ir.Constant(kind, ir.Undefined), ir.IntType(32)
        first = self.builder.insert_element(nothing, value, number(0))
        zeros = ir.Constant(ir.VectorType(number, width), [number(0)] * width)
        return self.builder.shuffle_vector(first, nothing, zeros)

    # -- arithmetic

    def add(self, a: Any, b: Any) -> Any:
        """Return a + b."""
        if isinstance(a, PrivateRow) or isinstance(b, PrivateRow):
            row, more = (a, b) if isinstance(a, PrivateRow) else (b, a)
            return PrivateRow(row.memory, row.rows, self.add(row.place, more))
        if isinstance(a, LaneNumber) or isinstance(b, LaneNumber):
            return self._along(a, b, self.add)
        if known(a) and known(b):
            return a + b
        for operand, other in ((a, b), (b, a)):
            if known(operand) and operand == 0 and not self._would_promote(operand, other):
                return self._number(other)
        return self._two("add", "fadd", a, b)

    def subtract(self, a: Any, b: Any) -> Any:
        """Return a - b."""
        if known(a) and known(b):
            return a - b
        if isinstance(a, LaneNumber) and not isinstance(b, LaneNumber):
            return LaneNumber(self.subtract(a.first, b))
        if known(b) and b == 0 and not self._would_promote(b, a):
            return self._number(a)
        if known(a) and a == 0 and not self._would_promote(a, b):
            return self.negative(b)
        return self._two("sub", "fsub", a, b)

    def multiply(self, a: Any, b: Any) -> Any:
        """Return a b; a known factor 1 vanishes.

        A known factor 0 gives 0, whatever the other is: zeros of tables are no products. Where an
        instruction must tell what is not finite, there are no flags, and the product stays.
        """
        if known(a) and known(b):
            return a * b
        for factor, other in ((a, b), (b, a)):
            if known(factor) and not self._would_promote(factor, other):
                if factor == 1:
                    return self._number(other)
                if factor == -1 and self._is_real(other):
                    return self.negative(other)
                if factor == 0 and self._flags:
                    return factor
        return self._two("mul", "fmul", a, b)

    def fused(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once where the machine can.

        With two known numbers, a known 0, 1 or -1, or without flags it is a product and a sum.
        """
        values = (a, b, c)
        plain = not self._flags or any(isinstance(x, (LaneNumber, PrivateRow)) for x in values)
        if plain or sum(map(known, values)) > 1 or not any(map(self._is_real, values)):
            return self.add(self.multiply(a, b), c)
        if any(known(x) and x in (0, 1, -1) for x in values):
            return self.add(self.multiply(a, b), c)
        a, b, c = self.alike(*map(self.real, values))
        return self._intrinsic("fmuladd", a, b, c)

    def divide(self, a: Any, b: Any) -> Any:
        """a/b."""
        if known(a) and known(b):
            return a / b
        if known(b) and b == 1 and self._is_real(a):
            return a
        a, b = self.alike(self.real(a), self.real(b))
        return self.builder.fdiv(a, b, flags=self._flags)

    def quotient(self, a: Any, b: Any) -> Any:
        """The whole number below a/b, of whole numbers."""
        if known(a) and known(b):
            return a // b
        a, b = self.whole(a), self.whole(b)
        quotient = self.builder.sdiv(a, b)
        return self.subtract(quotient, self._below(a, b))

    def remainder(self, a: Any, b: Any) -> Any:
        """The remainder of a number divided by another, of the sign of the divisor."""
        if known(a) and known(b):
            return a % b
        if self._is_real(a) or self._is_real(b):
            a, b = self.alike(a, b)
            left = self.builder.frem(a, b, flags=self._flags)
            other = self.builder.xor(self.compare("<", left, 0.0), self.compare("<", b, 0.0))
            wrong = self.builder.and_(other, self.compare("!=", left, 0.0))
            return self.choose(wrong, self.add(left, b), left)
        a, b = self.whole(a), self.whole(b)
        remainder = self.builder.srem(a, b)
        return self.add(remainder, self.choose(self._below(a, b), b, 0))

    def _below(self, a: Any, b: Any) -> Any:
        """Return whether a division that cuts gives more than one that goes down."""
        left = self.builder.srem(a, b)
        apart = self.builder.icmp_signed("<", self.builder.xor(left, b), INT(0))
        return self.builder.and_(apart, self.builder.icmp_signed("!=", left, INT(0)))

    def power(self, a: Any, b: Any) -> Any:
        """a^b for a known whole b, by squares."""
        if known(a) and known(b):
            return a**b
        if b < 0:
            return self.divide(1.0, self.power(a, -b))
        result, square, rest = None, a, int(b)
        while rest:
            if rest & 1:
                result = square if result is None else self.multiply(result, square)
            rest >>= 1
            if rest:
                square = self.multiply(square, square)
        return 1.0 if result is None else result

    def negative(self, a: Any) -> Any:
        """-a."""
        if known(a):
            return -a
        if not self._is_real(a):
            return self.builder.neg(a)
        return self.builder.fneg(a, flags=self._flags)

    def compare(self, sign: str, a: Any, b: Any) -> Any:
        """Return a < b and the like; of NaN all but != are false."""
        if known(a) and known(b):
            return {"<": a < b, "<=": a <= b, ">": a > b, ">=": a >= b, "==": a == b, "!=": a != b}[
                sign
            ]
        a, b = self.alike(a, b)
        if not self._is_real(a):
            return self.builder.icmp_signed(sign, a, b)
        comparison = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
        return comparison(sign, a, b, flags=self._flags)

    def both(self, a: Any, b: Any) -> Any:
        """Both of two truths."""
        return self._logic(a, b, settles=False)

    def either(self, a: Any, b: Any) -> Any:
        """One of two truths, or both."""
        return self._logic(a, b, settles=True)

    def no(self, a: Any) -> Any:
        """The opposite of a truth."""
        return (not a) if known(a) else self.builder.not_(a)

    def any(self, a: Any) -> Any:
        """Whether a truth holds in one lane of a vector at least."""
        bits = ir.IntType(a.type.count)
        return self.builder.icmp_unsigned("!=", self.builder.bitcast(a, bits), bits(0))

    def choose(self, truth: Any, a: Any, b: Any) -> Any:
        """Return a where something is true, else b."""
        if known(truth):
            return a if truth else b
        if known(a) and known(b) and a == b and str(a) == str(b):
            return a
        if known(a) and known(b):  # numbers of Python have no type yet
            a = self.typed(a, b)
        a, b = self.alike(a, b)
        if isinstance(truth.type, ir.VectorType):
            a, b = (self.spread(x, truth.type.count) for x in (a, b))
        return self.builder.select(truth, a, b)

    def absolute(self, a: Any) -> Any:
        """|a|."""
        if known(a):
            return abs(a)
        if a.type == INT:
            return self.choose(self.compare("<", a, 0), self.negative(a), a)
        return self._intrinsic("fabs", a)

    def root(self, a: Any) -> Any:
        """The square root of a."""
        return self._intrinsic("sqrt", self.real(a))

    def truncate(self, a: Any) -> Any:
        """A real number cut towards zero."""
        if known(a):
            return int(a)
        if isinstance(a.type, ir.VectorType):
            raise Refused("counts that differ from lane to lane")
        return a if a.type == INT else self.builder.fptosi(a, INT)

    def element(self, a: Any, lane: Any) -> Any:
        """The number in a lane."""
        return self.builder.extract_element(a, ir.IntType(32)(lane) if known(lane) else lane)

    def joined(self, numbers: list[Any]) -> Any:
        """Numbers as a vector."""
        vector = ir.Constant(ir.VectorType(numbers[0].type, len(numbers)), ir.Undefined)
        for lane, number in enumerate(numbers):
            vector = self.builder.insert_element(vector, number, ir.IntType(32)(lane))
        return vector

    # -- shared by the operations above

    def _along(self, a: Any, b: Any, operation: Any) -> LaneNumber:
        if isinstance(b, LaneNumber):
            a, b = b, a
        if isinstance(b, LaneNumber):
            raise Refused("a row of twice the number of a lane")
        return LaneNumber(operation(a.first, b))

    def _number(self, value: Any) -> Any:
        """Return a value, a truth as 0 or 1."""
        return self.whole(value) if getattr(value, "type", None) == BIT else value

    def _would_promote(self, number: Any, other: Any) -> bool:
        """Return whether a known number would make a whole number a real one."""
        return (
            isinstance(number, float)
            and not isinstance(other, LaneNumber)
            and not self._is_real(other)
        )

    @staticmethod
    def _is_real(value: Any) -> bool:
        if known(value):
            return isinstance(value, float)
        if isinstance(value, (LaneNumber, PrivateRow)):
            raise Refused("a row as a number")
        kind = value.type
        return (kind.element if isinstance(kind, ir.VectorType) else kind) == DOUBLE

    def _two(self, of_whole: str, of_real: str, a: Any, b: Any) -> Any:
        a, b = self.alike(a, b)
        if a.type == BIT:
            a, b = self.whole(a), self.whole(b)
        if self._is_real(a):
            return getattr(self.builder, of_real)(a, b, flags=self._flags)
        return getattr(self.builder, of_whole)(a, b, flags=("nsw",))

    def _logic(self, a: Any, b: Any, *, settles: bool) -> Any:
        for operand, other in ((a, b), (b, a)):
            if known(operand):
                return operand if bool(operand) is settles else other
        a, b = self.alike(a, b)
        return (self.builder.or_ if settles else self.builder.and_)(a, b)

    def _intrinsic(self, name: str, *given: Any) -> Any:
        a = given[0]
        vector = isinstance(a.type, ir.VectorType)
        full = f"llvm.{name}.{f'v{a.type.count}' if vector else ''}f64"
        intrinsic = self._external(full, a.type, [x.type for x in given])
        return self.builder.call(intrinsic, given, fastmath=self._flags)

    def _external(self, name: str, result: Any, kinds: list[Any]) -> Any:
        """Return a function that others define."""
        module = self.builder.module
        declared = module.globals.get(name)
        return declared or ir.Function(module, ir.FunctionType(result, kinds), name)
