"""A bar on what takes longer than one second, if tqdm is there and somebody looks.

A bar is drawn in a terminal or a notebook, one at a time; into a file or a pipe only where it is
asked for. ``progress=False`` keeps a call silent, and tqdm's own TQDM_DISABLE=1 all of them.
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
from symsimpson.support.extras import library

#: What is done sooner shows no bar.
DELAY = 1.0


#: Whether nothing is to be shown; or something is shown already that this is part of.
_silent: ContextVar[bool] = ContextVar("silent", default=False)
#: Held by the bar that is drawn, in whatever thread: two would be drawn over each other.
_drawn = threading.Lock()


def watched() -> bool:
    """Return whether somebody sees what is drawn: in a terminal or a notebook."""
    return "ipykernel" in sys.modules or bool(getattr(sys.stderr, "isatty", bool)())


def read_progress(wanted: Any) -> None:
    """Check whether a bar is wanted; raises InputError."""
    if not (wanted is None or isinstance(wanted, bool)):
        reject(f"progress is {wanted!r}.", remedy="Pass True, False or None.")


@contextlib.contextmanager
def silence(wanted: bool = True) -> Iterator[None]:
    """Show no waiting inside, where that is wanted."""
    token = _silent.set(_silent.get() or wanted)
    try:
        yield
    finally:
        _silent.reset(token)


@contextlib.contextmanager
def waiting(what: str, wanted: bool | None = None) -> Iterator[list[str]]:
    """Tell after a second what is being waited for, and for how long; at once if wanted.

    Texts that are added to the list inside take the place of the first.
    """
    read_progress(wanted)
    texts = [what]
    if _silent.get() or wanted is False or not (wanted or watched()):
        with silence(wanted is False):
            yield texts
        return
    done = threading.Event()
    shown = threading.Thread(target=_tell, args=(texts, done, wanted), daemon=True)
    shown.start()
    try:
        with silence():
            yield texts
    finally:
        done.set()
        shown.join()


def _tell(texts: list[str], done: threading.Event, wanted: bool | None) -> None:
    if done.wait(0.0 if wanted else DELAY):
        return
    with Progress(0, True, look="{desc}: {elapsed}", what=texts[-1]) as bar:
        # a file keeps all that is ever drawn: there, once is enough
        while not done.wait(0.5 if watched() else None):
            bar.say(texts[-1])
            bar.refresh()


class Progress:
    """Counts what is done; a context manager.

    A bar is shown after a second if ``wanted`` is None and tqdm is installed, and at once for True.
    It counts in a ``unit``, looks as ``look`` says in the words of tqdm, and is about ``what``.
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
        if wanted is False or not (wanted or watched()):
            return
        try:
            with warnings.catch_warnings():  # in a notebook without widgets bars are text
                warnings.simplefilter("ignore")
                bars = library("tqdm.auto", "progress=True", "progress")
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
                mininterval=0.1 if watched() else 10.0,
            )

    @property
    def count(self) -> int:
        """How much is done, if a bar is drawn."""
        return 0 if self._bar is None else int(self._bar.n)

    def add(self, count: int) -> None:
        """Count what is done."""
        if self._bar is not None and count:
            with self._lock:
                self._bar.update(min(count, self._bar.total - self._bar.n))

    def say(self, what: str) -> None:
        """Let the bar say what it is about by now, when it is drawn next."""
        if self._bar is not None:
            self._bar.set_description_str(what, refresh=False)

    def refresh(self) -> None:
        """Draw the bar anew."""
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
    """Counts steps of a run, and makes a bar when it has taken long: tqdm is slow to import."""

    def __init__(self, total: int, wanted: bool | None) -> None:
        read_progress(wanted)
        self._total, self._done = total, 0
        self._since = time.monotonic()
        self._bar = Progress(total, True, "step") if wanted else None

    def __call__(self, steps: int) -> None:
        """Count steps."""
        self._done += steps
        if self._bar is not None:
            self._bar.add(steps)
        elif time.monotonic() - self._since > DELAY and watched():
            self._bar = Progress(self._total, None, "step")
            self._bar.add(self._done)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.__exit__()
