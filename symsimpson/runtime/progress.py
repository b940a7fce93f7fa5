"""A bar on what takes longer than two seconds, if tqdm is there."""

from __future__ import annotations

import threading
import warnings
from types import TracebackType
from typing import Any

from symsimpson.errors import InputError

__all__ = ["Progress"]

#: What is done sooner shows no bar.
DELAY = 2.0


class Progress:
    """Counts what is done; a context manager.

    Parameters
    ----------
    total : int
    wanted : bool or None
        None shows a bar after two seconds, if tqdm is installed; True shows one at once.
    """

    def __init__(self, total: int, wanted: bool | None) -> None:
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
        self._bar = tqdm(total=total, unit="member", delay=delay, leave=False)

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
