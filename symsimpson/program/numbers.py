"""Double precision: compiled kernels, and the operations of this arithmetic."""

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
from symsimpson.program.cache import load_or_compile, location
from symsimpson.program.configuration import vector_bits
from symsimpson.program.driver import KernelSets, driver
from symsimpson.support.array_types import Reals
from symsimpson.support.literals import float_literals
from symsimpson.targets.llvm.intrinsics import kernel_intrinsic, stubs, walker_digest
from symsimpson.text.header import Header
from symsimpson.text.syntax import outline, redefined

#: Kernels that the walker rejected in this process, with the reason. Numba compiled them instead.
not_walked: list[str] = []

#: Blocks of several lanes use Newton's method below this number of unknowns: it is up to twice as
#: fast there, and several times slower with more than twelve unknowns.
FEWEST_UNKNOWNS = 8
#: The first kernel of a run. It is compiled with the kernels of a step, which share functions.
_BEGIN = "legendre"
#: The decorator of functions that kernels call. Python never calls them, so they need no wrapper.
_INNER = "compiled = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)"
#: Sine and cosine of the C library, which are defined for any angle.
_ANY_ANGLE = """\
from math import cos, sin


@compiled
def sincos(x):
    return sin(x), cos(x)
"""


class Kernels(KernelSets):
    """Sets of compiled kernels of a module, as addresses, for a number of lanes."""

    def __init__(self, text: str, header: Header, lanes: int = 1) -> None:
        small = lanes > 1 and header.newton_unknowns < FEWEST_UNKNOWNS
        super().__init__(header, by_stages=header.by_stages and not small)
        # the code depends neither on names and values of parameters nor on the banner
        changed = redefined(text, {"FACTS": "", "LANES": f"LANES = {lanes}", "compiled": _INNER})
        self._lanes = lanes
        # the text begins at the docstring, after the comments of the banner
        first = outline(text).body[0].lineno - 1
        self._text = "".join(changed.splitlines(keepends=True)[first:])
        self._single: dict[tuple[str, bool], int] = {}
        self._observers: dict[tuple[str, int], int] = {}
        self.seconds = 0.0  # time spent on compiling and on loading compiled code

    @property
    def location(self) -> str:
        """The state of the step's code as a text: loaded, on disk, or not compiled yet."""
        return location(self._cache_key(self._text), self.fallbacks[0])

    @cached_property
    def _text_with_libm(self) -> str:
        """The text of the module with sine and cosine of the C library, for any angle."""
        if not self.header.fast_sines:
            return self._text
        return redefined(self._text, {"sincos": _ANY_ANGLE.rstrip()})

    def compile_set(self, label: str, names: list[str], *, any_angle: bool) -> list[int]:
        """Compile kernels as one unit and return their addresses; 0 for an empty name."""
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
        """Return the address of a kernel; ``any_angle`` selects the C library's sine and cosine."""
        key = name, any_angle
        if key == (_BEGIN, False):
            self.set(self.fallbacks[0])
        if key not in self._single:  # the search for compiled code needs the digest of the text
            text = self._text_with_libm if any_angle else self._text
            label = f"{name}_any_angle" if any_angle else name
            self._single[key] = self._addresses(text, label, [name])[0]
        return self._single[key]

    def compile_observer(self, text: str, rows: int) -> int:
        """Compile an additional kernel with ``rows`` additional rows, and return its address."""
        if (text, rows) not in self._observers:  # all members of an ensemble use the same kernel
            module = redefined(self._text, {"ROWS": f"ROWS = {self.header.rows + rows}"})
            (address,) = self._addresses(f"{module}\n\n{text}", "observe", ["observe"])
            self._observers[text, rows] = address
        return self._observers[text, rows]

    @staticmethod
    def _cache_key(text: str) -> str:
        """Return the cache key: the digest of the walker, the vector width and the text."""
        return f"{walker_digest()}\n{vector_bits()}\n{text}"

    def _addresses(self, text: str, label: str, names: list[str]) -> list[int]:
        bits = vector_bits()
        some = [name for name in names if name]

        def compile_kernels(module: ModuleType, keep: bool) -> tuple[list[Any], dict[str, int]]:
            for name in some:
                setattr(module, f"walk_{name}", kernel_intrinsic(text, name, self._lanes, bits))
            return _compiled(module, some, keep)

        start = time.perf_counter()
        try:
            pointers = load_or_compile(
                self._cache_key(text), label, compile_kernels, stubs(text, some)
            )[1]
        except (NumbaError, GenerationError) as error:
            not_walked.append(f"{label}: {str(error)[-400:]}")
            pointers = load_or_compile(
                text, label, lambda module, keep: _compiled(module, some, keep)
            )[1]
        self.seconds += time.perf_counter() - start
        return [pointers[name] if name else 0 for name in names]


def _compiled(module: ModuleType, names: list[str], keep: bool) -> tuple[list[Any], dict[str, int]]:
    """Compile kernels of a module; return them and their addresses by name."""
    options = {**module.OPTIONS, "cache": keep}
    kernels = [cfunc(module.SIGNATURE, **options)(getattr(module, name)) for name in names]
    return kernels, {
        name: int(kernel.address or 0) for name, kernel in zip(names, kernels, strict=True)
    }


#: A context without effect. It can be entered many times.
NOTHING: AbstractContextManager[None] = nullcontext()
#: Python is faster than NumPy up to this length of an array.
FEW = 16


class Numbers:
    """Double precision with compiled code. Multiprecision arithmetics are subclasses."""

    compiled = True  #: Whether kernels are compiled. Ensembles and short runs need this.
    stretch = 4096  #: Steps before a run first checks for an interruption.
    epsilon = 2.0**-52  #: Twice the largest relative round-off error.

    def __reduce__(self) -> str | tuple[Any, ...]:
        return "FLOAT64"  # the name of the only instance in this module

    def is_one(self, value: Any) -> bool:
        """Return whether a value needs no conversion."""
        return type(value) is float and math.isfinite(value)

    def read(self, value: Any) -> Reals:
        """Convert numbers of any shape. Raises TypeError, ValueError or OverflowError."""
        array = np.array(value)
        if array.dtype == np.float64:
            return array
        # NumPy would convert None to NaN
        missing = array.dtype.kind == "O" and any(x is None for x in array.flat)
        if array.dtype.kind not in "fiuO" or missing:
            raise TypeError(array.dtype)
        return array.astype(np.float64)

    def zeros(self, shape: int | tuple[int, ...]) -> Reals:
        """Return an array of zeros."""
        return np.zeros(shape)

    def finite(self, array: Reals) -> NDArray[np.bool_]:
        """Return a mask of the finite numbers."""
        return np.isfinite(array)

    def all_finite(self, array: Reals) -> bool:
        """Return whether all numbers are finite, with a fast path for short arrays."""
        few = array.dtype.char == "d" and array.ndim == 1 and len(array) <= FEW
        if few and math.isfinite(sum(array.tolist())):
            return True  # otherwise the sum of finite numbers may have overflowed
        return bool(self.finite(array).all())

    def counted(self, first: int, stop: int, stride: int) -> Reals:
        """Return the whole numbers of a range as an array."""
        return np.arange(first, stop, stride, dtype=np.float64)

    def single(self, number: Any) -> Any:
        """Return a number of this arithmetic as the type for results."""
        return number

    def result(self, array: Reals) -> Reals:
        """Return an array of this arithmetic as the type for results."""
        return array

    def solve(self, matrix: Reals, right: Reals) -> Reals:
        """Solve a system of linear equations."""
        return np.linalg.solve(matrix, right)

    def lambdified(self, symbols: Sequence[Any], expressions: Sequence[Any]) -> Any:
        """Return a function of arrays that evaluates SymPy expressions as a list of arrays."""
        import sympy as sp

        return sp.lambdify(symbols, float_literals(list(expressions)), "numpy", cse=True)

    def kernels(self, text: str, header: Header, lanes: int = 1) -> KernelSets:
        """Return the kernels of a module for a number of lanes."""
        return Kernels(text, header, lanes)

    def driver(
        self, name: str, lanes: int = 1, *, renewing: bool = False, iterated: bool = True
    ) -> Callable[..., Any]:
        """Return a function of the driver; a ``renewing`` driver orthonormalises variations."""
        return driver(name, lanes, renewing=renewing, iterated=iterated)

    def make_ready(self, kernels: KernelSets) -> None:
        """Compile the functions of a run in advance.

        The set "robust" is not compiled, because few runs need it and it may take long.
        """
        for name in kernels.fallbacks:
            if name != "robust":
                kernels.set(name)
        kernels.address("energy")
        steps = "take_steps" if kernels.header.newton_unknowns else "take_explicit_steps"
        for function in ("begin_anew", steps):
            self.driver(function)

    def working(self) -> AbstractContextManager[Any]:
        """Return the context for computations, which sets a global precision if necessary."""
        return NOTHING


FLOAT64 = Numbers()
#: Inputs of a system without inputs, with the axes member, step, node and input.
NO_INPUTS = np.zeros((1, 1, 1, 0))


def workspace(header: Header, numbers: Numbers, parameters: Reals, more: int = 0) -> Reals:
    """Return the workspace of one lane with the parameters, and ``more`` additional rows.

    The driver uses the last row for the contribution of force terms to positions, over h^4.
    """
    W = numbers.zeros((header.rows + more + 1, 1))
    first = header.layout["PARAMETER"]
    W[first : first + parameters.size, 0] = parameters
    return W
