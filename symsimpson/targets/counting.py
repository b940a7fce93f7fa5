"""Count the operations of a kernel by executing its text with counting numbers."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.targets.binding import bind, plain_arithmetic


@dataclass(frozen=True)
class Cost:
    """The number of operations of a step.

    The sine and cosine of an angle count as one operation together. Signs, absolute values and
    comparisons do not count.

    Attributes
    ----------
    unknowns : int
        Number of Newton unknowns; 0 if steps need no iteration.
    iteration : int
        Operations of one Newton iteration.
    closing : int
        Operations that complete a step and predict the next. If steps need no iteration, these are
        all operations of a step.
    """

    unknowns: int
    iteration: int
    closing: int


#: Operations that do not count if one operand is a literal 0, or a 0 of a table.
FOLDED = (operator.add, operator.sub, operator.mul)


class _CountingNumber:
    """A number that counts its operations in the class attribute ``count``."""

    count = 0
    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value: float = float(value)

    def __float__(self) -> float:
        return self.value

    def __int__(self) -> int:
        return int(self.value)

    def __bool__(self) -> bool:
        return self.value != 0

    def __abs__(self) -> _CountingNumber:
        return _CountingNumber(abs(self.value))

    def __neg__(self) -> _CountingNumber:
        return _CountingNumber(-self.value)

    def __eq__(self, other: object) -> bool:
        return self.value == (other.value if isinstance(other, _CountingNumber) else other)

    def __hash__(self) -> int:
        return hash(self.value)


def _products(exponent: Any) -> int:
    """Return the number of products of an integer power by squaring; 1 for other powers."""
    n = abs(exponent) if isinstance(exponent, int) else 1
    return n.bit_length() - 1 + n.bit_count() - 1 if n > 1 else 1


def _count_binary(
    operate: Callable[[Any, Any], Any],
) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """Return a counting operation, and the same operation with exchanged operands."""

    def counted(a: Any, b: Any) -> Any:
        if operate in FOLDED and not (
            isinstance(a, _CountingNumber) and isinstance(b, _CountingNumber)
        ):
            number, other = (b, a) if isinstance(a, _CountingNumber) else (a, b)
            if number == 0:
                return 0.0 if operate is operator.mul else other
        _CountingNumber.count += _products(b) if operate is operator.pow else 1
        try:
            return _CountingNumber(operate(float(a), float(b)))
        except (ArithmeticError, ValueError):
            return _CountingNumber(float("nan"))

    return counted, lambda a, b: counted(b, a)


def _comparison(compare: Callable[[Any, Any], bool]) -> Callable[[Any, Any], bool]:
    return lambda a, b: compare(float(a), float(b))


for _name in ("add", "sub", "mul", "truediv", "pow"):
    for _sign, _operation in zip(("", "r"), _count_binary(getattr(operator, _name)), strict=True):
        setattr(_CountingNumber, f"__{_sign}{_name}__", _operation)
for _name in ("lt", "le", "gt", "ge"):
    setattr(_CountingNumber, f"__{_name}__", _comparison(getattr(operator, _name)))


def cost(source: str) -> Cost:
    """Count the operations of the kernels of a generated module."""

    def any_function(*arguments: Any) -> _CountingNumber:
        """Replace every elementary function: count one operation, and return any value."""
        _CountingNumber.count += 1
        return _CountingNumber(0.5)

    def sincos(x: Any) -> tuple[_CountingNumber, _CountingNumber]:
        """Replace sine and cosine: count one operation, and return any values."""
        _CountingNumber.count += 1
        return _CountingNumber(0.6), _CountingNumber(0.8)

    arithmetic = plain_arithmetic(any_function, float) | {"sincos": sincos}
    module = bind(source, arithmetic)
    W = np.empty((module.ROWS, module.LANES), dtype=object)
    # the numbers are arbitrary, because no branch depends on them
    W[:, :] = [[_CountingNumber(0.3 + 0.001 * (row % 97))] for row in range(module.ROWS)]
    W[[module.ACTIVE, module.COUNT], :] = _CountingNumber(1)

    def run(kernel: Callable[..., None]) -> int:
        before = _CountingNumber.count
        kernel(_CountingNumber(0.01), 0.0, W)
        return _CountingNumber.count - before

    run(module.prepare)
    run(module.start)
    unknowns = module.NEWTON_UNKNOWNS
    return Cost(unknowns, run(module.newton) if unknowns else 0, run(module.advance))
