"""How long the stages of a derivation take."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

__all__ = ["collecting", "timed"]

_collected: ContextVar[dict[str, float] | None] = ContextVar("collected", default=None)


@contextmanager
def collecting() -> Iterator[dict[str, float]]:
    """Collect the seconds of all stages that are timed inside, by their names."""
    seconds: dict[str, float] = {}
    token = _collected.set(seconds)
    try:
        yield seconds
    finally:
        _collected.reset(token)


@contextmanager
def timed(stage: str) -> Iterator[None]:
    """Add the seconds that a block takes to a stage, if they are collected."""
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds = _collected.get()
        if seconds is not None:
            seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
