"""The driver (the compiled loop over steps): its text and functions, and its sets of kernels."""

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
from symsimpson.program.cache import load_or_compile
from symsimpson.program.configuration import vector_bits
from symsimpson.program.recorders import Recorder
from symsimpson.support.interpreter import compiles_late
from symsimpson.targets.llvm.intrinsics import (
    function_intrinsic,
    read_functions,
    stub,
    walker_digest,
)
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

#: The files of the driver, in the order of its text.
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
#: Groups of functions that are compiled at once, because they share other functions and a run may
#: call all of them: the functions of every run, and the functions of implicit steps.
TOGETHER = (
    ("begin_anew", "begin", "apply", "change_to", "evaluate"),
    ("take_steps", "run_briefly", "recover"),
)


@cache
def _files() -> tuple[str, ...]:
    """Return the parts of the driver's text: first the constants that modules share with it."""
    agreed = "\n".join(f"{name} = {value}" for name, value in constants().items())
    folder = resources.files("symsimpson.text.driver")
    return agreed, *(folder.joinpath(f"{part}.py").read_text("utf-8") for part in PARTS)


def _constants(lanes: int, renewing: bool, iterated: bool) -> dict[str, object]:
    return {"LANES": lanes, "RENEWING": renewing, "ITERATED": iterated}


@cache
def driver_text(lanes: int = 1, *, renewing: bool = False, iterated: bool = True) -> str:
    """Return the text of the driver for a number of lanes.

    A ``renewing`` driver orthonormalises variations during the run. An ``iterated`` driver solves
    the steps of short runs by iteration; otherwise the scheme is explicit.
    """
    text = "\n\n".join(map(_without_own_imports, _files()))
    values = _constants(lanes, renewing, iterated)
    return redefined(text, {name: f"{name} = {value}" for name, value in values.items()})


def _without_own_imports(text: str) -> str:
    """Remove imports from the package, because the text of the driver defines these names."""
    lines = text.splitlines(keepends=True)
    for node in reversed(outline(text).body):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("symsimpson"):
            del lines[node.lineno - 1 : node.end_lineno]
    return "".join(lines)


@cache
def driver(
    name: str, lanes: int = 1, *, renewing: bool = False, iterated: bool = True
) -> Callable[..., Any]:
    """Return a compiled function of the driver for a number of lanes."""
    plain = lanes == 1 and iterated and not renewing and not compiles_late()
    names = next((group for group in TOGETHER if plain and name in group), (name,))
    bits, known = vector_bits(), signatures()

    def text() -> Text:
        return read_functions(driver_text(lanes, renewing=renewing, iterated=iterated))

    def build(module: ModuleType, keep: bool) -> dict[str, Callable[..., Any]]:
        functions = {}
        for function_name in names:
            walk = function_intrinsic(text, function_name, known[function_name], bits)
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
    return load_or_compile("\n".join(map(str, of)), "-".join(["driver", *names]), build, file)[name]


@cache
def signatures() -> Mapping[str, Any]:
    """Return the signatures of the functions that Python calls, by name."""
    for part in PARTS:  # each file adds its signatures
        import_module(f"symsimpson.text.driver.{part}")
    return SIGNATURES


class KernelSets(ABC):
    """Sets of kernels of a module in one arithmetic, as addresses or as Python functions.

    With ``by_stages``, steps first iterate over the velocities and forces at the nodes (stages).
    """

    def __init__(self, header: Header, *, by_stages: bool) -> None:
        self.header, self.by_stages = header, by_stages
        self._sets: dict[tuple[str, tuple[Recorder, ...], bool], Any] = {}

    @cached_property
    def fallbacks(self) -> tuple[str, ...]:
        """Names of the sets for steps. Each set is used where the previous one fails."""
        first = ("stages",) if self.by_stages else ()
        return (*first, "newton", *(("robust",) if self.header.newton_unknowns else ()))

    def set(self, name: str, recorders: tuple[Recorder, ...] = (), *, again: bool = False) -> Any:
        """Return a set: its mode, its kernels, and the kernels of the recorders.

        "robust" is Newton's method with row pivoting, and with the sine and cosine of the C
        library. It accepts any angle and avoids singular pivots, at several times the cost. With
        ``again``, steps that were accepted before are repeated without a check of the energy.
        """
        key = name, recorders, again
        if key not in self._sets:  # the search for compiled code needs the digest of the text
            self._sets[key] = self._build_set(*key)
        return self._sets[key]

    def _build_set(self, name: str, recorders: tuple[Recorder, ...], again: bool) -> Any:
        if name == "stages":
            mode = STAGES
        elif not self.header.newton_unknowns:
            mode = EXPLICIT
        else:
            # only a conservative system has an energy to check
            watched = self.by_stages and self.header.conservative and not again
            mode = NEWTON_AFTER_STAGES if watched else NEWTON
        robust = name == "robust"
        *names, energy = KERNEL_SETS[mode]
        if robust and self.header.unrolled:
            names[names.index("newton")] = PIVOTED
        kernels = self.compile_set(name, names, any_angle=robust)
        # results use the energy kernel, too, so it is compiled separately
        measure = self.address(energy, any_angle=robust) if energy else 0
        recorder_kernels = [self._recorder_kernel(recorder, robust) for recorder in recorders]
        return self.pack(mode, [*kernels, measure, *recorder_kernels])

    def _recorder_kernel(self, recorder: Recorder, robust: bool) -> Any:
        """Return the kernel of a recorder; with row pivoting if ``robust`` and available."""
        if recorder.text:
            return self.compile_observer(recorder.text, recorder.room)
        pivoted = f"{recorder.kernel}{WITH_PIVOTS}"
        name = pivoted if robust and pivoted in self.header.functions else recorder.kernel
        return self.address(name, any_angle=robust)

    @property
    @abstractmethod
    def location(self) -> str:
        """The state of the step's code as a text: loaded, on disk, or not compiled yet."""

    @abstractmethod
    def compile_set(self, label: str, names: list[str], *, any_angle: bool) -> list[Any]:
        """Return kernels that are compiled as one unit; 0 for an empty name."""

    @abstractmethod
    def pack(self, mode: int, kernels: list[Any]) -> Any:
        """Return a set in the form that the driver of this arithmetic accepts."""

    @abstractmethod
    def address(self, name: str, *, any_angle: bool = False) -> Any:
        """Return a kernel; with ``any_angle``, the variant with the C library's sine and cosine."""

    def compile_observer(self, text: str, rows: int) -> Any:
        """Compile an additional kernel from its text, with ``rows`` additional rows of workspace.

        Raises InputError for a multiprecision stepper.
        """
        reject(
            "expressions are evaluated in double precision, and this stepper has many digits.",
            remedy="Compile it without precision=.",
        )
