"""Ctrl-C at a moment when it does no harm."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["listening", "undisturbed"]


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
