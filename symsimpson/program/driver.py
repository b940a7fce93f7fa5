"""The driver as one text, compiled function by function or loaded."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module, resources
from types import ModuleType
from typing import Any

from numba import njit

from symsimpson.driver.solving import DRIVER_OPTIONS
from symsimpson.driver.steps import SIGNATURES
from symsimpson.module.interface import constants
from symsimpson.module.syntax import outline, redefined
from symsimpson.program.cache import compiled
from symsimpson.program.machine import vector_bits
from symsimpson.support.interpreter import compiles_late
from symsimpson.walk.intrinsics import read_functions, stub, walker_digest, walking_function
from symsimpson.walk.trees import Text

#: The modules that are compiled as one text, in this order.
PARTS = (
    "solving",
    "steps",
    "begin",
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
TOGETHER = (("begin_anew", "begin", "apply", "change_to"), ("take_steps", "run_briefly", "recover"))


@cache
def _files() -> tuple[str, ...]:
    """Return the texts that the driver is made of, what modules and it agree on first."""
    agreed = "\n".join(f"{name} = {value}" for name, value in constants().items())
    folder = resources.files("symsimpson.driver")
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
        import_module(f"symsimpson.driver.{part}")
    return SIGNATURES
