"""Texts that are written where a user asks for them."""

from __future__ import annotations

import os
from pathlib import Path

from symsimpson.errors import StorageError

__all__ = ["write_text"]


def write_text(path: str | os.PathLike[str], text: str, what: str) -> Path:
    """Write a text to a file; ``what`` names it in the message of a failure.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    place = Path(path)
    try:
        place.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StorageError(
            f"{place}: the {what} cannot be written: {error.strerror}.\nChoose another place."
        ) from error
    return place
