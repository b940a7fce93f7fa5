"""Numbers and vectors of numbers, whose operations become LLVM instructions.

A known number stays a Python number. It becomes an LLVM constant only if an operation combines it
with an unknown number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir

DOUBLE, INT, BIT = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
#: The only fast-math flag, so that tests for NaN and compensated sums stay correct. The walker
#: fuses a product with a sum if the text has one in the other. LLVM fuses no others, so vectors and
#: single numbers are bitwise identical.
FLAGS = ("nsz",)
KNOWN = (bool, int, float, np.integer, np.floating)


class UnsupportedConstruct(Exception):
    """The walker cannot emit a construct, or cannot emit it for vectors.

    ``function`` is the name of the function that contains the construct.
    """

    function = ""


@dataclass(frozen=True)
class LaneNumber:
    """A vector of consecutive numbers, one for each lane, that begins with ``first``."""

    first: Any


@dataclass(frozen=True)
class PrivateRow:
    """A row with a private number for each lane: vector ``place`` of ``rows`` in ``memory``."""

    memory: Any
    rows: int
    place: Any


def is_known(value: Any) -> bool:
    """Return True if a value is a Python or NumPy number."""
    return isinstance(value, KNOWN)


class Values:
    """Emits instructions with an llvmlite builder; evaluates operations of known numbers."""

    def __init__(self, builder: ir.IRBuilder, flags: tuple[str, ...] = FLAGS) -> None:
        self.builder, self._flags = builder, flags

    # -- kinds of values

    def real(self, value: Any) -> Any:
        """Return a value as a double, or a vector of doubles."""
        if is_known(value):
            return ir.Constant(DOUBLE, float(value))
        if isinstance(value, LaneNumber):
            raise UnsupportedConstruct("the number of a lane as a real number")
        if value.type == INT:
            return self.builder.sitofp(value, DOUBLE)
        if value.type == BIT:
            return self.builder.uitofp(value, DOUBLE)
        return value

    def whole(self, value: Any) -> Any:
        """Return a value as a 64-bit integer; known numbers are truncated towards zero."""
        if is_known(value):
            return ir.Constant(INT, int(value))
        if not isinstance(value, LaneNumber) and value.type == BIT:
            return self.builder.zext(value, INT)
        if isinstance(value, LaneNumber) or value.type != INT:
            raise UnsupportedConstruct("a real number as a row or a count")
        return value

    def bit(self, value: Any) -> Any:
        """Return a known number as a truth value, and any other value unchanged."""
        return ir.Constant(BIT, int(bool(value))) if is_known(value) else value

    def as_typed(self, a: Any, beside: Any) -> Any:
        """Return a known number as an LLVM constant of the common type of both numbers."""
        if isinstance(a, bool) and isinstance(beside, bool):
            return self.bit(a)
        both = isinstance(a, int) and isinstance(beside, int)
        return self.whole(a) if both else self.real(a)

    def unify_types(self, *values: Any) -> list[Any]:
        """Convert values to their common type: vectors if one is a vector, doubles if one is."""
        if any(isinstance(value, (LaneNumber, PrivateRow)) for value in values):
            raise UnsupportedConstruct("a row as a number")
        kinds = {value.type for value in values if not is_known(value)}
        width = next((kind.count for kind in kinds if isinstance(kind, ir.VectorType)), 0)
        elements = {kind.element if isinstance(kind, ir.VectorType) else kind for kind in kinds}
        if elements == {BIT} and all(isinstance(x, bool) for x in values if is_known(x)):
            operands = [self.bit(value) for value in values]
        elif elements <= {INT, BIT} and not any(isinstance(value, float) for value in values):
            operands = [self.whole(value) for value in values]
        else:
            operands = [self.real(value) for value in values]
        return [self.broadcast(value, width) for value in operands] if width else operands

    def broadcast(self, value: Any, width: int) -> Any:
        """Return a vector with the same number in all lanes."""
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
            return self._shift_lane_number(a, b, self.add)
        if is_known(a) and is_known(b):
            return a + b
        for operand, other in ((a, b), (b, a)):
            if is_known(operand) and operand == 0 and not self._would_promote(operand, other):
                return self._number(other)
        return self._binary_instruction("add", "fadd", a, b)

    def subtract(self, a: Any, b: Any) -> Any:
        """Return a - b."""
        if is_known(a) and is_known(b):
            return a - b
        if isinstance(a, LaneNumber) and not isinstance(b, LaneNumber):
            return LaneNumber(self.subtract(a.first, b))
        if is_known(b) and b == 0 and not self._would_promote(b, a):
            return self._number(a)
        if is_known(a) and a == 0 and not self._would_promote(a, b):
            return self.negative(b)
        return self._binary_instruction("sub", "fsub", a, b)

    def multiply(self, a: Any, b: Any) -> Any:
        """Return a b without an instruction if a factor is a known 1, -1 or 0.

        A known factor 0 gives 0, even if the other factor is not finite. Without fast-math flags,
        such a product keeps its instruction, so that it propagates NaN.
        """
        if is_known(a) and is_known(b):
            return a * b
        for factor, other in ((a, b), (b, a)):
            if is_known(factor) and not self._would_promote(factor, other):
                if factor == 1:
                    return self._number(other)
                if factor == -1 and self._is_real(other):
                    return self.negative(other)
                if factor == 0 and self._flags:
                    return factor
        return self._binary_instruction("mul", "fmul", a, b)

    def multiply_add(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once if the machine has such an instruction.

        The result is a product and a sum if both factors are known, one of them is a known 0, 1 or
        -1, the summand is a known 0, or there are no fast-math flags.
        """
        values = (a, b, c)
        plain = not self._flags or any(isinstance(x, (LaneNumber, PrivateRow)) for x in values)
        plain = plain or (is_known(a) and is_known(b)) or (is_known(c) and c == 0)
        trivial = any(is_known(x) and x in (0, 1, -1) for x in (a, b))
        if plain or trivial or not any(map(self._is_real, values)):
            return self.add(self.multiply(a, b), c)
        a, b, c = self.unify_types(*map(self.real, values))
        return self._intrinsic("fmuladd", a, b, c)

    def divide(self, a: Any, b: Any) -> Any:
        """Return a / b."""
        if is_known(a) and is_known(b):
            return a / b
        if is_known(b) and b == 1 and self._is_real(a):
            return a
        a, b = self.unify_types(self.real(a), self.real(b))
        return self.builder.fdiv(a, b, flags=self._flags)

    def quotient(self, a: Any, b: Any) -> Any:
        """Return the floor of a / b for integers."""
        if is_known(a) and is_known(b):
            return a // b
        a, b = self.whole(a), self.whole(b)
        quotient = self.builder.sdiv(a, b)
        return self.subtract(quotient, self._rounds_up(a, b))

    def remainder(self, a: Any, b: Any) -> Any:
        """Return a % b, with the sign of b."""
        if is_known(a) and is_known(b):
            return a % b
        if self._is_real(a) or self._is_real(b):
            a, b = self.unify_types(a, b)
            left = self.builder.frem(a, b, flags=self._flags)
            other = self.builder.xor(self.compare("<", left, 0.0), self.compare("<", b, 0.0))
            wrong = self.builder.and_(other, self.compare("!=", left, 0.0))
            return self.choose(wrong, self.add(left, b), left)
        a, b = self.whole(a), self.whole(b)
        remainder = self.builder.srem(a, b)
        return self.add(remainder, self.choose(self._rounds_up(a, b), b, 0))

    def _rounds_up(self, a: Any, b: Any) -> Any:
        """Return True if truncated integer division exceeds floor division: a / b < 0, inexact."""
        left = self.builder.srem(a, b)
        apart = self.builder.icmp_signed("<", self.builder.xor(left, b), INT(0))
        return self.builder.and_(apart, self.builder.icmp_signed("!=", left, INT(0)))

    def power(self, a: Any, b: Any) -> Any:
        """Return a**b for a known integer b, by repeated squaring."""
        if is_known(a) and is_known(b):
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
        """Return -a."""
        if is_known(a):
            return -a
        if not self._is_real(a):
            return self.builder.neg(a)
        return self.builder.fneg(a, flags=self._flags)

    def compare(self, sign: str, a: Any, b: Any) -> Any:
        """Return a comparison, such as a < b; with NaN, only != is true."""
        if is_known(a) and is_known(b):
            return {"<": a < b, "<=": a <= b, ">": a > b, ">=": a >= b, "==": a == b, "!=": a != b}[
                sign
            ]
        a, b = self.unify_types(a, b)
        if not self._is_real(a):
            return self.builder.icmp_signed(sign, a, b)
        comparison = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
        return comparison(sign, a, b, flags=self._flags)

    def logical_and(self, a: Any, b: Any) -> Any:
        """Return the conjunction of two truth values."""
        return self._logic(a, b, settles=False)

    def logical_or(self, a: Any, b: Any) -> Any:
        """Return the disjunction of two truth values."""
        return self._logic(a, b, settles=True)

    def logical_not(self, a: Any) -> Any:
        """Return the negation of a truth value."""
        return (not a) if is_known(a) else self.builder.not_(a)

    def any(self, a: Any) -> Any:
        """Return True if a vector of truth values is true in at least one lane."""
        bits = ir.IntType(a.type.count)
        return self.builder.icmp_unsigned("!=", self.builder.bitcast(a, bits), bits(0))

    def choose(self, truth: Any, a: Any, b: Any) -> Any:
        """Return a if ``truth``, else b; both values are computed."""
        if is_known(truth):
            return a if truth else b
        if is_known(a) and is_known(b) and a == b and str(a) == str(b):
            return a
        if is_known(a) and is_known(b):  # numbers of Python have no type yet
            a = self.as_typed(a, b)
        a, b = self.unify_types(a, b)
        if isinstance(truth.type, ir.VectorType):
            a, b = (self.broadcast(x, truth.type.count) for x in (a, b))
        return self.builder.select(truth, a, b)

    def absolute(self, a: Any) -> Any:
        """Return the absolute value of a."""
        if is_known(a):
            return abs(a)
        if a.type == INT:
            return self.choose(self.compare("<", a, 0), self.negative(a), a)
        return self._intrinsic("fabs", a)

    def root(self, a: Any) -> Any:
        """Return the square root of a."""
        return self._intrinsic("sqrt", self.real(a))

    def truncate(self, a: Any) -> Any:
        """Return a real number truncated towards zero, as an integer."""
        if is_known(a):
            return int(a)
        if isinstance(a.type, ir.VectorType):
            raise UnsupportedConstruct("counts that differ from lane to lane")
        return a if a.type == INT else self.builder.fptosi(a, INT)

    def element(self, a: Any, lane: Any) -> Any:
        """Return the number of a vector in a lane."""
        return self.builder.extract_element(a, ir.IntType(32)(lane) if is_known(lane) else lane)

    def build_vector(self, numbers: list[Any]) -> Any:
        """Return a vector of the numbers, one for each lane."""
        vector = ir.Constant(ir.VectorType(numbers[0].type, len(numbers)), ir.Undefined)
        for lane, number in enumerate(numbers):
            vector = self.builder.insert_element(vector, number, ir.IntType(32)(lane))
        return vector

    # -- shared by the operations above

    def _shift_lane_number(self, a: Any, b: Any, operation: Any) -> LaneNumber:
        if isinstance(b, LaneNumber):
            a, b = b, a
        if isinstance(b, LaneNumber):
            raise UnsupportedConstruct("a row of twice the number of a lane")
        return LaneNumber(operation(a.first, b))

    def _number(self, value: Any) -> Any:
        """Return a value; a truth value becomes 0 or 1."""
        return self.whole(value) if getattr(value, "type", None) == BIT else value

    def _would_promote(self, number: Any, other: Any) -> bool:
        """Return True if a known float would convert the other operand from integer to real."""
        return (
            isinstance(number, float)
            and not isinstance(other, LaneNumber)
            and not self._is_real(other)
        )

    @staticmethod
    def _is_real(value: Any) -> bool:
        if is_known(value):
            return isinstance(value, float)
        if isinstance(value, (LaneNumber, PrivateRow)):
            raise UnsupportedConstruct("a row as a number")
        kind = value.type
        return (kind.element if isinstance(kind, ir.VectorType) else kind) == DOUBLE

    def _binary_instruction(self, of_whole: str, of_real: str, a: Any, b: Any) -> Any:
        a, b = self.unify_types(a, b)
        if a.type == BIT:
            a, b = self.whole(a), self.whole(b)
        if self._is_real(a):
            return getattr(self.builder, of_real)(a, b, flags=self._flags)
        return getattr(self.builder, of_whole)(a, b, flags=("nsw",))

    def _logic(self, a: Any, b: Any, *, settles: bool) -> Any:
        for operand, other in ((a, b), (b, a)):
            if is_known(operand):
                return operand if bool(operand) is settles else other
        a, b = self.unify_types(a, b)
        return (self.builder.or_ if settles else self.builder.and_)(a, b)

    def _intrinsic(self, name: str, *given: Any) -> Any:
        a = given[0]
        vector = isinstance(a.type, ir.VectorType)
        full = f"llvm.{name}.{f'v{a.type.count}' if vector else ''}f64"
        intrinsic = self._external(full, a.type, [x.type for x in given])
        return self.builder.call(intrinsic, given, fastmath=self._flags)

    def _external(self, name: str, result: Any, kinds: list[Any]) -> Any:
        """Return the declaration of an external function."""
        module = self.builder.module
        declared = module.globals.get(name)
        return declared or ir.Function(module, ir.FunctionType(result, kinds), name)
