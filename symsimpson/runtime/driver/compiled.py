"""The driver as one text, compiled function by function or loaded."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from importlib import resources
from types import ModuleType
from typing import Any

from symsimpson.runtime.kernels.cache import compiled

__all__ = ["driver", "driver_text"]

#: The modules that are compiled as one text, in this order.
PARTS = ("steps", "recovery", "explicit", "ensembles", "between")


def driver_text(lanes: int = 1) -> str:
    """Give the text of the driver for a number of lanes."""
    folder = resources.files("symsimpson.runtime.driver")
    files = [folder.joinpath(f"{part}.py").read_text("utf-8") for part in PARTS]
    own = r"^from symsimpson[^\n(]*(\(.*?\)|[^\n(]*)\n"  # names that stand in the same text
    text = "\n\n".join(re.sub(own, "", part, flags=re.DOTALL | re.MULTILINE) for part in files)
    return text.replace("LANES = 1\n", f"LANES = {lanes}\n", 1)


@cache
def driver(name: str, lanes: int = 1) -> Callable[..., Any]:
    """Give a function of the driver for a number of lanes, compiled by itself."""

    def build(module: ModuleType) -> Callable[..., Any]:
        from numba import njit

        function = getattr(module, name).py_func
        made: Callable[..., Any] = njit(
            module.SIGNATURES[name], cache=True, **module.OPTIONS
        )(function)  # fmt: skip
        return made

    return compiled(driver_text(lanes), f"driver-{name}", build)
