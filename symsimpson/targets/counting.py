"""Operations of a kernel, counted by running its text with numbers that count."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.targets.binding import bind, plain_arithmetic


@dataclass(frozen=True)
class Cost:
    """The cost of a step, in operations on numbers.

    Sine and cosine of an angle count as one; signs, absolute values and comparisons as none.

    Attributes
    ----------
    unknowns : int
        Newton unknowns; 0 where a step needs no iteration.
    iteration : int
        Operations of one Newton iteration.
    closing : int
        Operations that close a step and predict the next, or of a whole step without iterations.
    """

    unknowns: int
    iteration: int
    closing: int


#: Operations that vanish where one of the numbers is a 0 of the text, or of its tables.
FOLDED = (operator.add, operator.sub, operator.mul)


class _Counted:
    """A number whose operations are counted."""

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

    def __abs__(self) -> _Counted:
        return _Counted(abs(self.value))

    def __neg__(self) -> _Counted:
        return _Counted(-self.value)

    def __eq__(self, other: object) -> bool:
        return self.value == (other.value if isinstance(other, _Counted) else other)

    def __hash__(self) -> int:
        return hash(self.value)


def _products(exponent: Any) -> int:
    """Count the products of a whole power, as a compiler makes them; other powers count as one."""
    n = abs(exponent) if isinstance(exponent, int) else 1
    return n.bit_length() - 1 + n.bit_count() - 1 if n > 1 else 1


def _binary(
    operate: Callable[[Any, Any], Any],
) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """Return an operation that is counted, and the same with operands exchanged."""

    def counted(a: Any, b: Any) -> Any:
        if operate in FOLDED and not (isinstance(a, _Counted) and isinstance(b, _Counted)):
            number, other = (b, a) if isinstance(a, _Counted) else (a, b)
            if number == 0:
                return 0.0 if operate is operator.mul else other
        _Counted.count += _products(b) if operate is operator.pow else 1
        try:
            return _Counted(operate(float(a), float(b)))
        except (ArithmeticError, ValueError):
            return _Counted(float("nan"))

    return counted, lambda a, b: counted(b, a)


def _comparison(compare: Callable[[Any, Any], bool]) -> Callable[[Any, Any], bool]:
    return lambda a, b: compare(float(a), float(b))


for _name in ("add", "sub", "mul", "truediv", "pow"):
    for _sign, _operation in zip(("", "r"), _binary(getattr(operator, _name)), strict=True):
        setattr(_Counted, f"__{_sign}{_name}__", _operation)
for _name in ("lt", "le", "gt", "ge"):
    setattr(_Counted, f"__{_name}__", _comparison(getattr(operator, _name)))


def cost(source: str) -> Cost:
    """Count the operations of a module's kernels, from the text that symsimpson emitted."""

    def any_function(*arguments: Any) -> _Counted:
        """Stand for every elementary function: one operation, and some value."""
        _Counted.count += 1
        return _Counted(0.5)

    def sincos(x: Any) -> tuple[_Counted, _Counted]:
        """Stand for a sine and a cosine: one operation, and some values."""
        _Counted.count += 1
        return _Counted(0.6), _Counted(0.8)

    arithmetic = plain_arithmetic(any_function, float) | {"sincos": sincos}
    module = bind(source, arithmetic)
    W = np.empty((module.ROWS, module.LANES), dtype=object)
    # any numbers will do, because no branch depends on them
    W[:, :] = [[_Counted(0.3 + 0.001 * (row % 97))] for row in range(module.ROWS)]
    W[[module.ACTIVE, module.COUNT], :] = _Counted(1)

    def run(kernel: Callable[..., None]) -> int:
        before = _Counted.count
        kernel(_Counted(0.01), 0.0, W)
        return _Counted.count - before

    run(module.prepare)
    run(module.start)
    unknowns = module.NEWTON_UNKNOWNS
    return Cost(unknowns, run(module.newton) if unknowns else 0, run(module.advance))
