"""Progress bars (tqdm) for calls that take longer than one second.

By default a bar appears only in a terminal or a notebook, and one bar at a time. ``progress=True``
shows it in a file or a pipe, too. ``progress=False`` turns the bar of a call off, and tqdm's
variable TQDM_DISABLE=1 turns all bars off.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Any

from symsimpson.errors import InputError, reject
from symsimpson.support.extras import import_library

#: Seconds before a bar appears.
DELAY = 1.0


#: True if bars are turned off, or an outer call already shows a bar.
_silent: ContextVar[bool] = ContextVar("silent", default=False)
#: The visible bar owns this lock. Bars of two threads would overwrite each other.
_drawn = threading.Lock()


def is_watched() -> bool:
    """Return whether the output is a terminal or a notebook."""
    return "ipykernel" in sys.modules or bool(getattr(sys.stderr, "isatty", bool)())


def read_progress(wanted: Any) -> None:
    """Check the argument ``progress``: True, False or None. Raises InputError."""
    if not (wanted is None or isinstance(wanted, bool)):
        reject(
            f"progress is {wanted!r}, which is neither a truth value nor None.",
            remedy="Pass True, False or None.",
        )


@contextlib.contextmanager
def silence(wanted: bool = True) -> Iterator[None]:
    """Show no bars in this context, if ``wanted``."""
    token = _silent.set(_silent.get() or wanted)
    try:
        yield
    finally:
        _silent.reset(token)


@contextlib.contextmanager
def announce(what: str, wanted: bool | None = None) -> Iterator[list[str]]:
    """Show after one second what the caller waits for, and since when.

    The text appears at once if ``wanted`` is True, and never if it is False. The last text in the
    list that this context yields replaces ``what``.
    """
    read_progress(wanted)
    texts = [what]
    if _silent.get() or wanted is False or not (wanted or is_watched()):
        with silence(wanted is False):
            yield texts
        return
    done = threading.Event()
    shown = threading.Thread(target=_show_texts, args=(texts, done, wanted), daemon=True)
    shown.start()
    try:
        with silence():
            yield texts
    finally:
        done.set()
        shown.join()


def _show_texts(texts: list[str], done: threading.Event, wanted: bool | None) -> None:
    if done.wait(0.0 if wanted else DELAY):
        return
    with Progress(0, True, look="{desc}: {elapsed}", what=texts[-1]) as bar:
        # in a file each update is a new line, so one is enough
        while not done.wait(0.5 if is_watched() else None):
            bar.say(texts[-1])
            bar.refresh()


class Progress:
    """A progress bar that counts up to ``total``. It is a context manager.

    The bar appears after one second if ``wanted`` is None and tqdm is installed, and at once if it
    is True. ``unit`` names what it counts, ``look`` is the format string of tqdm, and ``what`` is
    the description.
    """

    def __init__(
        self,
        total: int,
        wanted: bool | None,
        unit: str = "member",
        *,
        look: str | None = None,
        what: str | None = None,
    ) -> None:
        self._lock = threading.Lock()
        self._bar: Any = None
        self._at_once = wanted is True
        if wanted is False or not (wanted or is_watched()):
            return
        try:
            with warnings.catch_warnings():  # tqdm warns in a notebook without widgets
                warnings.simplefilter("ignore")
                bars = import_library("tqdm.auto", "progress=True", "progress")
        except InputError:
            if wanted:
                raise
            return
        if _drawn.acquire(blocking=False):
            self._bar = bars.tqdm(
                total=total,
                unit=unit,
                delay=0.0 if wanted else DELAY,
                leave=False,
                bar_format=look,
                desc=what,
                mininterval=0.1 if is_watched() else 10.0,
            )

    @property
    def count(self) -> int:
        """The present count; 0 without a bar."""
        return 0 if self._bar is None else int(self._bar.n)

    def add(self, count: int) -> None:
        """Increase the count, at most to the total."""
        if self._bar is not None and count:
            with self._lock:
                self._bar.update(min(count, self._bar.total - self._bar.n))

    def say(self, what: str) -> None:
        """Set the description that the next redraw shows."""
        if self._bar is not None:
            self._bar.set_description_str(what, refresh=False)

    def refresh(self) -> None:
        """Redraw the bar."""
        if self._bar is not None:
            self._bar.refresh()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *problem: object) -> None:
        if self._bar is not None:
            if self._at_once:
                self._bar.refresh()
            self._bar.close()
            self._bar = None
            _drawn.release()


class Watcher:
    """A counter of the steps of a run. It imports tqdm, which is slow, only for long runs."""

    def __init__(self, total: int, wanted: bool | None) -> None:
        read_progress(wanted)
        self._total, self._done = total, 0
        self._since = time.monotonic()
        self._bar = Progress(total, True, "step") if wanted else None

    def __call__(self, steps: int) -> None:
        """Add ``steps`` to the count."""
        self._done += steps
        if self._bar is not None:
            self._bar.add(steps)
        elif time.monotonic() - self._since > DELAY and is_watched():
            self._bar = Progress(self._total, None, "step")
            self._bar.add(self._done)

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.__exit__()
