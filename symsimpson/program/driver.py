"""The driver as one text, compiled function by function, with the kernels that it takes."""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cache, cached_property
from importlib import import_module, resources
from types import ModuleType
from typing import Any

from numba import njit

from symsimpson.errors import reject
from symsimpson.program.cache import compiled
from symsimpson.program.configuration import vector_bits
from symsimpson.program.recorders import Recorder
from symsimpson.support.interpreter import compiles_late
from symsimpson.targets.llvm.intrinsics import read_functions, stub, walker_digest, walking_function
from symsimpson.targets.llvm.trees import Text
from symsimpson.text.driver.steps import DRIVER_OPTIONS, SIGNATURES
from symsimpson.text.header import Header
from symsimpson.text.interface import (
    EXPLICIT,
    KERNEL_SETS,
    NEWTON,
    NEWTON_AFTER_STAGES,
    PIVOTED,
    STAGES,
    WITH_PIVOTS,
    constants,
)
from symsimpson.text.syntax import outline, redefined

#: The modules that are compiled as one text, in this order.
PARTS = (
    "steps",
    "recovery",
    "explicit",
    "ensemble_loop",
    "between",
    "short_run",
    "adjoint_loops",
    "impacts",
)
#: Functions that are compiled in one go, because they share others, and a run that has called one
#: may call all of them: those of any run, and those of steps that are solved by iteration.
TOGETHER = (
    ("begin_anew", "begin", "apply", "change_to", "evaluate"),
    ("take_steps", "run_briefly", "recover"),
)


@cache
def _files() -> tuple[str, ...]:
    """Return the texts that the driver is made of, what modules and it agree on first."""
    agreed = "\n".join(f"{name} = {value}" for name, value in constants().items())
    folder = resources.files("symsimpson.text.driver")
    return agreed, *(folder.joinpath(f"{part}.py").read_text("utf-8") for part in PARTS)


def _constants(lanes: int, renewing: bool, iterated: bool) -> dict[str, object]:
    return {"LANES": lanes, "RENEWING": renewing, "ITERATED": iterated}


@cache
def driver_text(lanes: int = 1, *, renewing: bool = False, iterated: bool = True) -> str:
    """Return the text of the driver for a number of lanes, behind the agreement with modules.

    One that is ``renewing`` makes variations orthonormal on the way; short runs of one that is
    ``iterated`` solve their steps by iteration.
    """
    text = "\n\n".join(map(_without_own_imports, _files()))
    values = _constants(lanes, renewing, iterated)
    return redefined(text, {name: f"{name} = {value}" for name, value in values.items()})


def _without_own_imports(text: str) -> str:
    """Leave out imports of names that stand in the same text."""
    lines = text.splitlines(keepends=True)
    for node in reversed(outline(text).body):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("symsimpson"):
            del lines[node.lineno - 1 : node.end_lineno]
    return "".join(lines)


@cache
def driver(
    name: str, lanes: int = 1, *, renewing: bool = False, iterated: bool = True
) -> Callable[..., Any]:
    """Return a function of the driver for a number of lanes, compiled with what belongs to it."""
    plain = lanes == 1 and iterated and not renewing and not compiles_late()
    names = next((group for group in TOGETHER if plain and name in group), (name,))
    bits, known = vector_bits(), signatures()

    def text() -> Text:
        return read_functions(driver_text(lanes, renewing=renewing, iterated=iterated))

    def build(module: ModuleType, keep: bool) -> dict[str, Callable[..., Any]]:
        functions = {}
        for function_name in names:
            walk = walking_function(text, function_name, known[function_name], bits)
            setattr(module, f"walk_{function_name}", walk)
            options: dict[str, Any] = {**DRIVER_OPTIONS, "cache": keep, "no_cpython_wrapper": False}
            functions[function_name] = njit(known[function_name], **options)(
                getattr(module, function_name)
            )
        return functions

    of = (walker_digest(), bits, _constants(lanes, renewing, iterated), names, *_files())
    file = "\n\n".join(
        stub(function_name, len(known[function_name].args)) for function_name in names
    )
    return compiled("\n".join(map(str, of)), "-".join(["driver", *names]), build, file)[name]


@cache
def signatures() -> Mapping[str, Any]:
    """Return what is called from Python, and with what."""
    for part in PARTS:  # each adds its own
        import_module(f"symsimpson.text.driver.{part}")
    return SIGNATURES


class KernelSets(ABC):
    """Kernels in some arithmetic: addresses of compiled ones, or functions.

    They are ``by_stages`` if steps are iterated over stages first.
    """

    def __init__(self, header: Header, *, by_stages: bool) -> None:
        self.header, self.by_stages = header, by_stages
        self._sets: dict[tuple[str, tuple[Recorder, ...], bool], Any] = {}

    @cached_property
    def fallbacks(self) -> tuple[str, ...]:
        """Names of the sets to take steps with, each where the one before fails."""
        first = ("stages",) if self.by_stages else ()
        return (*first, "newton", *(("robust",) if self.header.newton_unknowns else ()))

    def set(self, name: str, recorders: tuple[Recorder, ...] = (), *, again: bool = False) -> Any:
        """Return a set: its mode, then its kernels, and those of recorders.

        "robust" is Newton's method with row pivoting and sine and cosine of the C library. It takes
        any angle and meets no singular pivot, at several times the cost. Steps that are taken
        ``again`` were accepted once: how the energy changes is not looked at.
        """
        key = name, recorders, again
        if key not in self._sets:  # finding compiled code takes the digest of the text
            self._sets[key] = self._made(*key)
        return self._sets[key]

    def _made(self, name: str, recorders: tuple[Recorder, ...], again: bool) -> Any:
        if name == "stages":
            mode = STAGES
        elif not self.header.newton_unknowns:
            mode = EXPLICIT
        else:
            # forces may change the energy as they like
            watched = self.by_stages and self.header.conservative and not again
            mode = NEWTON_AFTER_STAGES if watched else NEWTON
        robust = name == "robust"
        *names, energy = KERNEL_SETS[mode]
        if robust and self.header.unrolled:
            names[names.index("newton")] = PIVOTED
        kernels = self.compile_set(name, names, any_angle=robust)
        # the energy is a kernel of its own, for whoever asks for it
        measure = self.address(energy, any_angle=robust) if energy else 0
        behind = [self._recording(recorder, robust) for recorder in recorders]
        return self.pack(mode, [*kernels, measure, *behind])

    def _recording(self, recorder: Recorder, robust: bool) -> Any:
        """Return the kernel of a recorder."""
        if recorder.text:
            return self.compile_observer(recorder.text, recorder.room)
        pivoted = f"{recorder.kernel}{WITH_PIVOTS}"
        name = pivoted if robust and pivoted in self.header.functions else recorder.kernel
        return self.address(name, any_angle=robust)

    @property
    @abstractmethod
    def location(self) -> str:
        """Where the code of a step is, in words."""

    @abstractmethod
    def compile_set(self, label: str, names: list[str], *, any_angle: bool) -> list[Any]:
        """Return kernels that are compiled together; 0 for an empty name."""

    @abstractmethod
    def pack(self, mode: int, kernels: list[Any]) -> Any:
        """Return a set as the driver of this arithmetic takes it."""

    @abstractmethod
    def address(self, name: str, *, any_angle: bool = False) -> Any:
        """Return one kernel; of one that takes any angle, if that is asked for."""

    def compile_observer(self, text: str, rows: int) -> Any:
        """Compile a further kernel, whose text stands behind the module's.

        The workspace has so many more rows, from what was ROWS on. Raises InputError if nothing is
        compiled here.
        """
        reject(
            "expressions are evaluated in double precision, and this stepper has many digits.",
            remedy="Compile without precision.",
        )
