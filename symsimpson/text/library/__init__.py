"""Functions that emitted modules carry along, written once as ordinary Python.

The emitter copies the text of each function that is called. A function that is marked ``@kernel``
is what a kernel does on one lane. The names that a file declares are constants of the emitted
module: the blocks of the workspace and the scheme's tables. Nothing here but this reader runs in
the package itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType

from symsimpson.text.syntax import definitions

__all__ = ["kernel_sources", "library_sources"]

#: The files, in the order of their functions in a module.
FILES = """
    elementary moving path assemble solve cyclic mass legendre canonical close explicit_steps
    acceptance constrained_step step_kernels stage_loops collocation step_derivatives tangent
    adjoint curvature clock
"""


def library_sources() -> Mapping[str, str]:
    """Return the text of each function that kernels call, by name."""
    return _sources(kernels=False)


def kernel_sources() -> Mapping[str, str]:
    """Return the text of each kernel, by name."""
    return _sources(kernels=True)


@cache
def _sources(*, kernels: bool) -> Mapping[str, str]:
    """Return the text of each function that is a kernel, or of each that is none."""
    sources: dict[str, str] = {}
    for file in FILES.split():
        text = resources.files(__name__).joinpath(f"{file}.py").read_text("utf-8")
        lines = text.splitlines()
        for name, (first, end) in definitions(text).items():
            if (lines[first] == "@kernel") is kernels:
                sources[name] = "\n".join(lines[first:end])
    return MappingProxyType(sources)
