"""The driver as one text, compiled function by function or loaded."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache
from importlib import resources
from types import ModuleType
from typing import Any

from symsimpson.ahead import compiles_late
from symsimpson.definitions import redefined, syntax
from symsimpson.runtime.kernels.cache import compiled
from symsimpson.runtime.kernels.vectors import vector_bits
from symsimpson.walk.functions import function_stub, walking_function
from symsimpson.walk.kernels import walker_digest

__all__ = ["driver", "driver_text"]

#: The modules that are compiled as one text, in this order.
PARTS = (
    "solving", "steps", "begin", "recovery", "explicit", "brief", "ensembles", "between", "work",
    "backward", "arriving",
)  # fmt: skip
#: Functions that are compiled in one go, because they share others, and a run that has called one
#: may call all of them: those of any run, and those of steps that are solved by iteration.
TOGETHER = (
    ("begin_anew", "begin", "apply", "switch", "steady"),
    ("take_steps", "run_briefly", "recover"),
)


@cache
def driver_text(lanes: int = 1, *, renewing: bool = False, iterated: bool = True) -> str:
    """Return the text of the driver for a number of lanes, behind the agreement with modules.

    One that is ``renewing`` makes variations orthonormal on the way; short runs of one that is
    ``iterated`` solve their steps by iteration.
    """
    folder = resources.files("symsimpson.runtime.driver")
    files = [resources.files("symsimpson").joinpath("interface.py")]
    files += [folder.joinpath(f"{part}.py") for part in PARTS]
    text = "\n\n".join(_without_own_imports(file.read_text("utf-8")) for file in files)
    constants = {
        "LANES": lanes, "RENEWING": renewing, "ITERATED": iterated, "VECTOR_BITS": vector_bits(),
    }  # fmt: skip
    return redefined(text, {name: f"{name} = {value}" for name, value in constants.items()})


def _without_own_imports(text: str) -> str:
    """Leave out imports of names that stand in the same text."""
    lines = text.splitlines(keepends=True)
    for node in reversed(syntax(text).body):
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

    def build(module: ModuleType, keep: bool) -> dict[str, Callable[..., Any]]:
        from numba import njit

        options = {**module.DRIVER_OPTIONS, "cache": keep, "no_cpython_wrapper": False}
        functions = {
            x.name: x for x in syntax(text).body
            if isinstance(x, ast.FunctionDef) and ast.unparse(x.decorator_list[0]) != "intrinsic"
        }  # fmt: skip
        made = {}
        for one in names:
            signature = module.SIGNATURES[one]
            walk = walking_function(functions, vars(module), one, signature, vector_bits())
            setattr(module, f"walk_{one}", walk)
            made[one] = njit(signature, **options)(getattr(module, f"walked_{one}"))
        return made

    text = driver_text(lanes, renewing=renewing, iterated=iterated)
    file = text + "".join(function_stub(text, one) for one in names)
    key = f"{walker_digest()}\n{file}"
    return compiled(key, "-".join(["driver", *names]), build, file)[name]
