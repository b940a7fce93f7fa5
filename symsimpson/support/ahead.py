"""When functions are compiled: ahead, with others that a run may need, or late."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextvars import ContextVar

__all__ = ["LATE", "compiles_late", "late"]

#: The environment variable by which "late" puts off what no run has called for yet.
LATE = "SYMSIMPSON_COMPILE"

_late: ContextVar[bool] = ContextVar("late", default=False)


def compiles_late() -> bool:
    """Tell whether each function is compiled when it is first called, and none ahead."""
    return _late.get() or os.environ.get(LATE) == "late"


@contextlib.contextmanager
def late() -> Iterator[None]:
    """Compile nothing ahead inside: of many steppers most are used once."""
    token = _late.set(True)
    try:
        yield
    finally:
        _late.reset(token)
