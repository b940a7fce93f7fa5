"""A bar on what takes longer than two seconds, if tqdm is there."""

from __future__ import annotations

import threading
import time
import warnings
from types import TracebackType
from typing import Any

from symsimpson.errors import InputError

__all__ = ["Progress", "Watcher"]

#: What is done sooner shows no bar.
DELAY = 2.0


class Progress:
    """Counts what is done; a context manager.

    Parameters
    ----------
    total : int
    wanted : bool or None
        None shows a bar after two seconds, if tqdm is installed; True shows one at once.
    unit : str
        What is counted.
    """

    def __init__(self, total: int, wanted: bool | None, unit: str = "member") -> None:
        self._lock = threading.Lock()
        self._bar: Any = None
        self._at_once = wanted is True
        if wanted is False:
            return
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # no widgets in this notebook: a bar of text
                from tqdm.auto import tqdm
        except ImportError:
            if wanted:
                raise InputError(
                    "progress=True needs tqdm, which is not installed.\n"
                    "Install it with pip install 'symsimpson[progress]', or leave progress out."
                ) from None
            return
        delay = 0.0 if wanted else DELAY
        self._bar = tqdm(total=total, unit=unit, delay=delay, leave=False)

    def add(self, count: int) -> None:
        """Count what is done."""
        if self._bar is not None and count:
            with self._lock:
                self._bar.update(min(count, self._bar.total - self._bar.n))

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            if self._at_once:
                self._bar.refresh()
            self._bar.close()


class Watcher:
    """Counts steps of a run, and makes a bar when it has taken long: tqdm is slow to import."""

    def __init__(self, total: int, wanted: bool | None) -> None:
        self._total, self._done = total, 0
        self._since = time.monotonic()
        self._bar = Progress(total, True, "step") if wanted else None

    def __call__(self, steps: int) -> None:
        """Count steps."""
        self._done += steps
        if self._bar is not None:
            self._bar.add(steps)
        elif time.monotonic() - self._since > DELAY:
            self._bar = Progress(self._total, None, "step")
            self._bar.add(self._done)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.__exit__(None, None, None)
