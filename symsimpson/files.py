"""Files that a user names: what is no name, and what cannot be written, is told in words."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symsimpson.errors import InputError, StorageError

if TYPE_CHECKING:
    from symsimpson.runtime.results.trajectory import Trajectory

__all__ = ["check_folder", "read_path", "write_text"]


def read_path(what: str, value: Any) -> Path:
    """Read the name of a file or a folder; ``what`` names it in the message.

    Raises
    ------
    InputError
        If it is no text and no path, or empty.
    """
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if isinstance(text, str) and text and "\0" not in text:
        return Path(text)
    given = "empty" if isinstance(text, str) and not text else type(value).__name__
    raise InputError(
        f"{what} is {given}, not the name of a file or a folder.\n"
        "Pass a text as 'folder/name', or a pathlib.Path."
    )


def check_folder(
    place: Path, what: str, done: str = "written", trajectory: Trajectory | None = None
) -> None:
    """Refuse to write into a folder that is not there, before anything is computed for it.

    Raises
    ------
    StorageError
    """
    if not place.absolute().parent.is_dir():
        raise StorageError(
            f"{place}: the {what} cannot be {done}: there is no folder {place.parent}.\n"
            "Make it first, or choose another place.",
            trajectory=trajectory,
        )


def write_text(path: str | os.PathLike[str], text: str, what: str) -> Path:
    """Write a text to a file; ``what`` names it in the message of a failure.

    Raises
    ------
    InputError
        If the path is none.
    StorageError
        If the file cannot be written.
    """
    place = read_path(f"the file of the {what}", path)
    check_folder(place, what)
    try:
        place.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StorageError(
            f"{place}: the {what} cannot be written: {error.strerror}.\nChoose another place."
        ) from error
    return place
