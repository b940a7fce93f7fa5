"""When functions are compiled: ahead, with others that a run may need, or late."""

from __future__ import annotations

import os

__all__ = ["LATE", "compiles_late"]

#: The environment variable by which "late" puts off what no run has called for yet.
LATE = "SYMSIMPSON_COMPILE"


def compiles_late() -> bool:
    """Tell whether each function is compiled when it is first called, and none ahead."""
    return os.environ.get(LATE) == "late"
