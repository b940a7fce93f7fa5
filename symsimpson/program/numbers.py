"""The numbers that a stepper computes with, with the kernels that run in them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numba import cfunc
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from symsimpson.errors import GenerationError
from symsimpson.program.cache import compiled, location
from symsimpson.program.configuration import vector_bits
from symsimpson.program.driver import KernelSets, driver
from symsimpson.support.array_types import Reals
from symsimpson.support.literals import float_literals
from symsimpson.targets.llvm.intrinsics import stubs, walker_digest, walking
from symsimpson.text.header import Header
from symsimpson.text.syntax import outline, redefined

#: Kernels that the walker refused in this process, and why: numba compiled them as they stand.
not_walked: list[str] = []

#: Members side by side are solved by Newton's method where it has fewer unknowns than this: it is
#: up to twice as fast there, and several times slower where it has more than twelve.
FEWEST_UNKNOWNS = 8
#: Runs begin with it: compiled beside the kernels of a step, because they share functions.
_BEGIN = "legendre"
#: What kernels call, where numba compiles it: there is no way in from Python.
_INNER = "compiled = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)"
#: Sine and cosine of the C library, which have a value for any angle.
_ANY_ANGLE = """\
from math import cos, sin


@compiled
def sincos(x):
    return sin(x), cos(x)
"""


class Kernels(KernelSets):
    """Addresses of a module's compiled kernels, for a given number of lanes."""

    def __init__(self, text: str, header: Header, lanes: int = 1) -> None:
        small = lanes > 1 and header.newton_unknowns < FEWEST_UNKNOWNS
        super().__init__(header, by_stages=header.by_stages and not small)
        # names and values of parameters are no part of what is compiled, nor is the banner
        changed = redefined(text, {"FACTS": "", "LANES": f"LANES = {lanes}", "compiled": _INNER})
        self._lanes = lanes
        # the docstring, before which comments stand, and behind it what was changed
        first = outline(text).body[0].lineno - 1
        self._text = "".join(changed.splitlines(keepends=True)[first:])
        self._single: dict[tuple[str, bool], int] = {}
        self._observers: dict[tuple[str, int], int] = {}
        self.seconds = 0.0  # spent on compiling, or on loading what is compiled

    @property
    def location(self) -> str:
        """Whether the compiled step is loaded, on disk or not yet made, in words."""
        return location(self._cache_key(self._text), self.fallbacks[0])

    @cached_property
    def _text_with_libm(self) -> str:
        """The module text with sin and cos of the C library, valid for any angle."""
        if not self.header.fast_sines:
            return self._text
        return redefined(self._text, {"sincos": _ANY_ANGLE.rstrip()})

    def compile_set(self, label: str, names: list[str], *, any_angle: bool) -> list[int]:
        """Compile kernels as one unit, and return their addresses; 0 for an empty name."""
        if any_angle:
            return self._addresses(self._text_with_libm, label, names)
        compiled_names = [*names, _BEGIN]
        addresses = self._addresses(self._text, label, compiled_names)
        for name, address in zip(compiled_names, addresses, strict=True):
            self._single.setdefault((name, False), address)
        return addresses[:-1]

    def pack(self, mode: int, kernels: list[int]) -> NDArray[np.int64]:
        """Pack the mode and the addresses of a set into one array."""
        return np.array([mode, *kernels], dtype=np.int64)

    def address(self, name: str, *, any_angle: bool = False) -> int:
        """Return the address of one kernel; of one that takes any angle, if that is asked for."""
        key = name, any_angle
        if key == (_BEGIN, False):
            self.set(self.fallbacks[0])
        if key not in self._single:  # finding it among what is compiled takes the text's digest
            text = self._text_with_libm if any_angle else self._text
            label = f"{name}_any_angle" if any_angle else name
            self._single[key] = self._addresses(text, label, [name])[0]
        return self._single[key]

    def compile_observer(self, text: str, rows: int) -> int:
        """Compile a further kernel, a text, with so many more rows; return its address."""
        if (text, rows) not in self._observers:  # members of an ensemble ask for the same
            module = redefined(self._text, {"ROWS": f"ROWS = {self.header.rows + rows}"})
            (address,) = self._addresses(f"{module}\n\n{text}", "observe", ["observe"])
            self._observers[text, rows] = address
        return self._observers[text, rows]

    @staticmethod
    def _cache_key(text: str) -> str:
        """Return the cache key: digest of the walker, vector width and module text."""
        return f"{walker_digest()}\n{vector_bits()}\n{text}"

    def _addresses(self, text: str, label: str, names: list[str]) -> list[int]:
        bits = vector_bits()
        some = [name for name in names if name]

        def compile_kernels(module: ModuleType, keep: bool) -> tuple[list[Any], dict[str, int]]:
            for name in some:
                setattr(module, f"walk_{name}", walking(text, name, self._lanes, bits))
            return _compiled(module, some, keep)

        start = time.perf_counter()
        try:
            pointers = compiled(self._cache_key(text), label, compile_kernels, stubs(text, some))[1]
        except (NumbaError, GenerationError) as error:
            not_walked.append(f"{label}: {str(error)[-400:]}")
            pointers = compiled(text, label, lambda module, keep: _compiled(module, some, keep))[1]
        self.seconds += time.perf_counter() - start
        return [pointers[name] if name else 0 for name in names]


def _compiled(module: ModuleType, names: list[str], keep: bool) -> tuple[list[Any], dict[str, int]]:
    """Return kernels of a module, and their addresses."""
    options = {**module.OPTIONS, "cache": keep}
    kernels = [cfunc(module.SIGNATURE, **options)(getattr(module, name)) for name in names]
    return kernels, {
        name: int(kernel.address or 0) for name, kernel in zip(names, kernels, strict=True)
    }


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
#: Inputs of a system without any: by member, step, node and number.
NO_INPUTS = np.zeros((1, 1, 1, 0))


def workspace(header: Header, numbers: Numbers, parameters: Reals, more: int = 0) -> Reals:
    """Make the workspace of one lane, with the parameters in it and so many further rows.

    The last row is the driver's: what the terms of forces add to positions, over h^4.
    """
    W = numbers.zeros((header.rows + more + 1, 1))
    first = header.layout["PARAMETER"]
    W[first : first + parameters.size, 0] = parameters
    return W
