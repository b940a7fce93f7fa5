"""The kernels of one module, compiled or loaded from the cache when first asked for."""

from __future__ import annotations

import time
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numba import cfunc
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from symsimpson.errors import GenerationError
from symsimpson.module.header import Header
from symsimpson.module.syntax import outline, redefined
from symsimpson.program.cache import compiled, location
from symsimpson.program.machine import vector_bits
from symsimpson.program.sets import KernelSets
from symsimpson.walk.intrinsics import stubs, walker_digest, walking

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
        *kernels, begin = self._addresses(self._text, label, [*names, _BEGIN])
        self._single.setdefault((_BEGIN, False), begin)
        return kernels

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
