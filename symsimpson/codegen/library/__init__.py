"""Functions that emitted modules carry along, written once as ordinary Python.

The emitter copies their text. The names that a file declares are constants of the emitted module:
the blocks of the workspace and the scheme's tables. Nothing here but this reader runs in the
package itself.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

from symsimpson.module.definitions import definitions

__all__ = ["library_sources"]

#: The files, in the order in which their functions stand in a module.
FILES = (
    "sincos",
    "softplus",
    "path",
    "clear",
    "assemble",
    "solve",
    "mass",
    "close",
    "explicit_steps",
    "acceptance",
    "constrained_step",
    "rattle",
    "velocity_constraints",
    "stage_iteration",
    "stage_loops",
    "collocation",
    "step_derivatives",
    "tangent",
    "constrained_tangent",
    "adjoint",
    "constrained_adjoint",
    "curvature",
    "clock",
)


@cache
def library_sources() -> dict[str, str]:
    """Return the text of each function, by name."""
    sources: dict[str, str] = {}
    for file in FILES:
        text = resources.files(__name__).joinpath(f"{file}.py").read_text("utf-8")
        lines = text.splitlines()
        for name, (first, end) in definitions(text).items():
            sources[name] = "\n".join(lines[first:end])
    return sources
