"""Settings of the running interpreter: when it compiles, frees memory, hears Ctrl-C."""

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


#: New objects between two searches. With Python's own number a compilation takes a sixth longer;
#: without any search it takes a fifth more memory.
THRESHOLD = 100_000

_lock = threading.Lock()
_inside = 0
_outside = gc.get_threshold()


@contextmanager
def rarely_collected() -> Iterator[None]:
    """Have Python look for unreachable objects less often, and as before when the last one left.

    Settings of the user's that are as rare, or none, stay.
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


#: What Ctrl-C is put into, the innermost last; in the main thread alone.
_listening: list[list[int]] = []


@contextmanager
def listening() -> Iterator[list[int]]:
    """Let Ctrl-C put its number into a list, for code that reads the list and stops.

    A second Ctrl-C stops the code at once. Listeners around this one get the number, too.
    """
    heard: list[int] = []
    if not _disturbed():
        yield heard
        return

    def hear(number: int, frame: FrameType | None) -> None:
        if heard:
            raise KeyboardInterrupt
        heard.append(number)

    before = signal.signal(signal.SIGINT, hear)
    _listening.append(heard)
    try:
        yield heard
    finally:
        _listening.pop()
        for outer in _listening[-1:]:
            outer.extend(heard)
        signal.signal(signal.SIGINT, before)


@contextmanager
def undisturbed(most: float = math.inf) -> Iterator[None]:
    """Put off Ctrl-C to the end of what must not be left half done, ``most`` times at most."""
    if not _disturbed():
        yield
        return
    heard: list[tuple[int, FrameType | None]] = []
    before = signal.getsignal(signal.SIGINT)

    def hear(number: int, frame: FrameType | None) -> None:
        if len(heard) >= most and callable(before):
            before(number, frame)
        heard.append((number, frame))

    signal.signal(signal.SIGINT, hear)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if heard and callable(before):
        before(*heard[0])


def _disturbed() -> bool:
    """Return whether Ctrl-C is heard here: in the main thread, unless another program hears it."""
    alone = threading.current_thread() is threading.main_thread()
    return alone and signal.getsignal(signal.SIGINT) is not None
