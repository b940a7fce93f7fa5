"""Settings of the interpreter: when to compile, collect garbage, and handle Ctrl-C."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType

#: This environment variable with the value "late" postpones each compilation to the first call.
LATE = "SYMSIMPSON_COMPILE"

_late: ContextVar[bool] = ContextVar("late", default=False)


def compiles_late() -> bool:
    """Return whether functions are compiled at their first call, and none in advance."""
    return _late.get() or os.environ.get(LATE) == "late"


@contextlib.contextmanager
def compile_late() -> Iterator[None]:
    """Compile functions at their first call in this context, as for many short-lived steppers."""
    token = _late.set(True)
    try:
        yield
    finally:
        _late.reset(token)


#: New objects between two garbage collections. With Python's default a compilation takes one sixth
#: longer. Without any collection it takes one fifth more memory.
THRESHOLD = 100_000

_lock = threading.Lock()
_inside = 0
_outside = gc.get_threshold()


@contextmanager
def collect_rarely() -> Iterator[None]:
    """Collect garbage less often in this context.

    The user's threshold returns when the last thread leaves the context. A threshold that is larger
    than THRESHOLD, or 0, does not change.
    """
    global _inside, _outside
    with _lock:
        if _inside == 0:
            _outside = gc.get_threshold()
            if 0 < _outside[0] < THRESHOLD:
                gc.set_threshold(THRESHOLD, *_outside[1:])
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                gc.set_threshold(*_outside)


#: Signal lists of the nested contexts in the main thread, the innermost last.
_listening: list[list[int]] = []


@contextmanager
def catch_interrupts() -> Iterator[list[int]]:
    """Collect the signal number of Ctrl-C in a list. The code inside reads the list and stops.

    A second Ctrl-C raises KeyboardInterrupt at once. The next outer context gets the numbers, too.
    """
    signals: list[int] = []
    if not _catches_interrupts():
        yield signals
        return

    def collect(number: int, frame: FrameType | None) -> None:
        if signals:
            raise KeyboardInterrupt
        signals.append(number)

    before = signal.signal(signal.SIGINT, collect)
    _listening.append(signals)
    try:
        yield signals
    finally:
        _listening.pop()
        for outer in _listening[-1:]:
            outer.extend(signals)
        signal.signal(signal.SIGINT, before)


@contextmanager
def defer_interrupts(most: float = math.inf) -> Iterator[None]:
    """Postpone Ctrl-C to the end of code that must not stop half-way, at most ``most`` times."""
    if not _catches_interrupts():
        yield
        return
    signals: list[tuple[int, FrameType | None]] = []
    before = signal.getsignal(signal.SIGINT)

    def collect(number: int, frame: FrameType | None) -> None:
        if len(signals) >= most and callable(before):
            before(number, frame)
        signals.append((number, frame))

    signal.signal(signal.SIGINT, collect)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if signals and callable(before):
        before(*signals[0])


def _catches_interrupts() -> bool:
    """Return whether this code can handle Ctrl-C: in the main thread, with a handler of Python."""
    in_main = threading.current_thread() is threading.main_thread()
    return in_main and signal.getsignal(signal.SIGINT) is not None
