"""Multiprecision: Python executes the same module and the same driver with many digits.

mpmath is the reference, and the balls of python-flint are faster. Both execute the text of the
compiled code. Only the thresholds for round-off differ.
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from fractions import Fraction
from functools import cache, cached_property
from types import SimpleNamespace
from typing import Any, cast

import mpmath
import numpy as np
from mpmath.libmp import from_man_exp, from_pickable, to_pickable
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.driver import KernelSets, driver_text
from symsimpson.program.input_values import whole_number
from symsimpson.program.numbers import Numbers
from symsimpson.support.array_types import Reals
from symsimpson.support.extras import import_library
from symsimpson.targets.binding import bind, bind_arb, bind_mpmath
from symsimpson.text.header import Header
from symsimpson.text.interface import KERNELS
from symsimpson.text.workspace_layout import scratch

FEWEST, MOST = 15, 10_000
#: Steps iterate over stages up to this number of digits, and from this degree of the path on.
#: Otherwise the quadratic convergence of Newton's method is faster.
MOST_BY_STAGES, FEWEST_BY_STAGES = 64, 5
ARITHMETICS = ("mpmath", "arb")


@cache
def _numbers(digits: int, arithmetic: str) -> Digits:
    return Arb(digits) if arithmetic == "arb" else Digits(digits)


def read_precision(precision: Any, arithmetic: Any) -> Digits:
    """Return the arithmetic with ``precision`` decimal digits.

    Raises InputError if the precision or the arithmetic is invalid, or if python-flint is missing.
    """
    if arithmetic not in ARITHMETICS:
        reject(
            f"arithmetic is {arithmetic!r}, which is unknown.",
            remedy="Choose 'mpmath', or 'arb' with python-flint.",
        )
    digits = whole_number(precision) or 0
    if not FEWEST <= digits <= MOST:
        reject(
            f"precision is {precision!r}, not a number of decimal digits from {FEWEST} to {MOST}.",
            remedy="Pass for example precision=64. For double precision, pass neither precision= "
            "nor arithmetic=.",
        )
    if arithmetic == "arb":
        import_library("flint", "arithmetic='arb' (python-flint)", "precise")
    return _numbers(digits, arithmetic)


class _TypeStub:
    """A placeholder for numba's types, which Python does not need."""

    def __getattr__(self, name: str) -> _TypeStub:
        return self

    def __getitem__(self, index: Any) -> _TypeStub:
        return self

    def __call__(self, *arguments: Any, **options: Any) -> _TypeStub:
        return self


class _PythonKernels(KernelSets):
    """Sets of kernels that are Python functions."""

    def __init__(self, module: SimpleNamespace, header: Header, digits: int) -> None:
        many = digits <= MOST_BY_STAGES and header.degree >= FEWEST_BY_STAGES
        super().__init__(header, by_stages=header.by_stages and many)
        self._module = module

    @property
    def location(self) -> str:
        """A text that says that nothing is compiled."""
        return "none: Python, with numbers of many digits"

    def compile_set(self, label: str, names: list[str], *, any_angle: bool) -> list[Any]:
        return [self.address(name) if name else 0 for name in names]

    def pack(self, mode: int, kernels: list[Any]) -> tuple[Any, ...]:
        return mode, *kernels

    def address(self, name: str, *, any_angle: bool = False) -> Any:
        return getattr(self._module, name)


def _revive(digits: int, arithmetic: str, number: Any) -> Any:
    """Restore a pickled number in the context for its digits."""
    return read_precision(digits, arithmetic).context.make_mpf(from_pickable(number))


class Digits(Numbers):
    """Numbers of mpmath, in a separate context with a fixed number of digits."""

    compiled, stretch, arithmetic = False, 1, "mpmath"

    def __init__(self, digits: int) -> None:
        self.digits = digits
        self.context = mpmath.mp.clone()
        self.context.dps = digits
        self.epsilon = 10.0 ** (1 - min(digits, 300))
        # pickle cannot find the number class of a cloned context by its name
        copyreg.pickle(self.context.mpf, self._reduced)

    def __reduce__(self) -> tuple[Any, ...]:
        return read_precision, (self.digits, self.arithmetic)

    def _reduced(self, number: Any) -> tuple[Any, ...]:
        return _revive, (self.digits, self.arithmetic, to_pickable(number._mpf_))

    def is_one(self, value: Any) -> bool:
        """Return False, because every value is converted."""
        return False

    def make_ready(self, kernels: KernelSets) -> None:
        """Do nothing, because Python executes the kernels."""

    def read(self, value: Any) -> Reals:
        """Convert numbers, decimal strings and SymPy numbers, each to the full precision."""
        given = np.array(value, dtype=object)
        array = self.zeros(given.shape)
        for index, number in np.ndenumerate(given):
            array[index] = self._to_kernel(self._number(number))
        return array

    def _number(self, value: Any) -> Any:
        context = self.context
        if type(value) is context.mpf:
            return +value
        if isinstance(value, Fraction):
            return context.mpf(value.numerator) / value.denominator
        if isinstance(value, np.integer):
            return context.mpf(int(value))
        if hasattr(value, "evalf") and hasattr(value, "free_symbols"):  # SymPy, if it is loaded
            return context.mpf(str(value.evalf(self.digits + 10)))
        number = context.convert(value if not hasattr(value, "as_tuple") else str(value))
        if not isinstance(number, context.mpf):
            raise TypeError(value)
        return +number  # rounds to the digits of this context

    def _to_kernel(self, number: Any) -> Any:
        """Convert an mpmath number to the type that kernels compute with."""
        return number

    def zeros(self, shape: int | tuple[int, ...]) -> Reals:
        """Return an array of zeros."""
        return np.full(shape, self._to_kernel(self.context.zero), dtype=object)

    def finite(self, array: Reals) -> NDArray[np.bool_]:
        """Return a mask of the finite numbers."""
        finite = np.frompyfunc(lambda x: bool(self.context.isfinite(self._to_user(x))), 1, 1)
        return cast(NDArray[np.bool_], np.asarray(finite(array), dtype=bool))

    def _to_user(self, number: Any) -> Any:
        """Convert a number of the kernels to an mpmath number."""
        return number

    def counted(self, first: int, stop: int, stride: int) -> Reals:
        """Return the whole numbers of a range as an array."""
        return np.array(range(first, stop, stride), dtype=object)

    def solve(self, matrix: Reals, right: Reals) -> Reals:
        """Solve a system of linear equations."""
        context = self.context
        solved = context.lu_solve(context.matrix(matrix.tolist()), context.matrix(right.tolist()))
        return np.array(list(solved), dtype=object)

    def lambdified(self, symbols: Sequence[Any], expressions: Sequence[Any]) -> Any:
        """Return a function of arrays that evaluates SymPy expressions element by element."""
        import sympy as sp

        functions = {name: getattr(self.context, name) for name in dir(self.context)}
        single = sp.lambdify(symbols, expressions, [functions, "mpmath"], cse=True)
        outer, inner = np.frompyfunc(self._to_user, 1, 1), np.frompyfunc(self._to_kernel, 1, 1)

        def every(*arguments: Any) -> list[Reals]:
            given = np.broadcast_arrays(*map(outer, arguments))
            rows = [single(*row) for row in zip(*(x.ravel() for x in given), strict=True)]
            columns = zip(*rows, strict=True)
            converted = ([self.context.convert(x) for x in column] for column in columns)
            return [inner(np.array(column, dtype=object)) for column in converted]

        return every

    def kernels(self, text: str, header: Header, lanes: int = 1) -> _PythonKernels:
        """Return the kernels of a module as Python functions of mpmath numbers."""
        return _PythonKernels(bind_mpmath(text, self.context, checking=True), header, self.digits)

    def driver(
        self, name: str, lanes: int = 1, *, renewing: bool = False, iterated: bool = True
    ) -> Callable[..., Any]:
        """Return a function of the driver in this arithmetic."""
        return cast(Callable[..., Any], getattr(self._driver, name))

    @cached_property
    def _driver(self) -> SimpleNamespace:
        replaced = {
            "njit": lambda **options: lambda function: function,
            "types": _TypeStub(),
            "call": self._call,
            "AT_ONCE": 1,  # radii of python-flint's balls grow within a call
            "MOST_ITERATIONS": max(40, 5 * self.digits // 2),
            "FEW_ITERATIONS": max(16, self.digits),
            "ROUND_OFF": self._to_kernel(self.context.mpf(10) ** (4 - 2 * self.digits)),
            "np": SimpleNamespace(
                inf=self._to_kernel(self.context.inf),
                int64=int,
                empty=self._allocate,
                zeros=self._allocate,
            ),
        }
        return bind(driver_text(), replaced)

    def _allocate(self, shape: int | tuple[int, ...], dtype: type | None = None) -> Reals:
        """Return zeros of this arithmetic, or of ``dtype`` for counters of the driver."""
        return self.zeros(shape) if dtype is None else np.zeros(shape, dtype)

    def _call(self, kernel: Callable[..., None], h: Any, t: Any, W: Reals) -> None:
        kernel(h, t, W)


class Arb(Digits):
    """Midpoints of the balls of python-flint."""

    arithmetic = "arb"

    def __init__(self, digits: int) -> None:
        super().__init__(digits)
        from flint import arb

        self._arb = arb

    def _to_kernel(self, number: Any) -> Any:
        sign, mantissa, exponent, _ = number._mpf_
        if not mantissa:  # zero, or not finite
            return self._arb(str(number))
        whole = int(mantissa)  # it may be an integer of gmpy2
        return self._arb((-whole if sign else whole, exponent))

    def _to_user(self, number: Any) -> Any:
        if not isinstance(number, self._arb):
            return self.context.convert(number)
        if not number.is_finite():
            return self.context.nan
        mantissa, exponent = number.mid().man_exp()
        return self.context.make_mpf(from_man_exp(int(mantissa), int(exponent)))

    def single(self, number: Any) -> Any:
        """Return the midpoint of a ball as an mpmath number."""
        return self._to_user(number)

    def result(self, array: Reals) -> Reals:
        """Return the midpoints of balls as mpmath numbers."""
        return cast(Reals, np.frompyfunc(self._to_user, 1, 1)(array))

    def kernels(self, text: str, header: Header, lanes: int = 1) -> _PythonKernels:
        """Return the kernels of a module as Python functions of balls."""
        with self.working():
            module = bind_arb(text)
        passing = {row for rows in scratch(header.layout).values() for row in rows}
        lasting = np.array([row for row in range(header.rows) if row not in passing])
        for name in KERNELS:
            if hasattr(module, name):
                vars(getattr(module, name))["lasting"] = lasting, slice(header.rows, None)
        return _PythonKernels(module, header, self.digits)

    def working(self) -> AbstractContextManager[Any]:
        """Return a context that sets the global precision of python-flint."""
        import flint

        return cast(AbstractContextManager[Any], flint.ctx.workprec(self.context.prec))

    def _call(self, kernel: Callable[..., None], h: Any, t: Any, W: Reals) -> None:
        """Call a kernel, and set the radii of the balls to zero.

        Radii bound round-off, which Newton's method corrects. Rows that no other kernel reads may
        retain their radii.
        """
        kernel(h, t, W)
        ball = self._arb
        for lane in W.T:
            for rows in getattr(kernel, "lasting", (slice(None),)):
                lane[rows] = [x.mid() if type(x) is ball else x for x in lane[rows]]
