"""The numbers that a stepper computes with, and what runs kernels and driver in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.module.header import Header
from symsimpson.program.compiled import Kernels
from symsimpson.program.driver import driver
from symsimpson.program.sets import KernelSets
from symsimpson.support.array_types import Reals
from symsimpson.support.literals import float_literals

#: A context that does nothing can be entered many times.
NOTHING: AbstractContextManager[None] = nullcontext()
#: Python is quicker than NumPy with so many numbers.
FEW = 16


class Numbers:
    """Double precision, by compiled code; other numbers are subclasses."""

    compiled = True  #: Whether code is: ensembles and short runs take no others.
    stretch = 4096  #: Steps after which a run first looks whether it was interrupted.
    epsilon = 2.0**-52  #: Twice the relative size of a rounding.

    def __reduce__(self) -> str | tuple[Any, ...]:
        return "FLOAT64"  # there is one, by its name in this module

    def is_one(self, value: Any) -> bool:
        """Return whether a value needs no conversion."""
        return type(value) is float and math.isfinite(value)

    def read(self, value: Any) -> Reals:
        """Convert numbers of any shape; raises TypeError, ValueError or OverflowError."""
        array = np.array(value)
        if array.dtype == np.float64:
            return array
        # None would be NaN
        missing = array.dtype.kind == "O" and any(x is None for x in array.flat)
        if array.dtype.kind not in "fiuO" or missing:
            raise TypeError(array.dtype)
        return array.astype(np.float64)

    def zeros(self, shape: int | tuple[int, ...]) -> Reals:
        """Return an array of zeros."""
        return np.zeros(shape)

    def finite(self, array: Reals) -> NDArray[np.bool_]:
        """Return which numbers are finite."""
        return np.isfinite(array)

    def all_finite(self, array: Reals) -> bool:
        """Return whether all numbers are finite; quick where there are few."""
        few = array.dtype.char == "d" and array.ndim == 1 and len(array) <= FEW
        if few and math.isfinite(sum(array.tolist())):
            return True  # a sum of finite ones may be infinite
        return bool(self.finite(array).all())

    def counted(self, first: int, stop: int, stride: int) -> Reals:
        """Return whole numbers to multiply with."""
        return np.arange(first, stop, stride, dtype=np.float64)

    def single(self, number: Any) -> Any:
        """Return one number as a user gets it."""
        return number

    def result(self, array: Reals) -> Reals:
        """Return an array as a user gets it."""
        return array

    def solve(self, matrix: Reals, right: Reals) -> Reals:
        """Solve a system of linear equations."""
        return np.linalg.solve(matrix, right)

    def lambdified(self, symbols: Sequence[Any], expressions: Sequence[Any]) -> Any:
        """Return a function of arrays that evaluates expressions of SymPy, a list of arrays."""
        import sympy as sp

        return sp.lambdify(symbols, float_literals(list(expressions)), "numpy", cse=True)

    def kernels(self, text: str, header: Header, lanes: int = 1) -> KernelSets:
        """Return the kernels of a module, for so many trajectories at a time."""
        return Kernels(text, header, lanes)

    def driver(
        self, name: str, lanes: int = 1, *, renewing: bool = False, iterated: bool = True
    ) -> Callable[..., Any]:
        """Return a function of the driver, or of that which makes variations orthonormal."""
        return driver(name, lanes, renewing=renewing, iterated=iterated)

    def make_ready(self, kernels: KernelSets) -> None:
        """Compile all that a run may need, so that no later one waits for it.

        What takes any angle and any pivot is left: few runs need it, and it may take long.
        """
        for name in kernels.fallbacks:
            if name != "robust":
                kernels.set(name)
        kernels.address("energy")
        steps = "take_steps" if kernels.header.newton_unknowns else "take_explicit_steps"
        for function in ("begin_anew", steps):
            self.driver(function)

    def working(self) -> AbstractContextManager[Any]:
        """Return the context in which these numbers are computed with."""
        return NOTHING


FLOAT64 = Numbers()
