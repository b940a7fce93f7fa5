"""Paths and files of the user: checks, and atomic writes."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from symsimpson.errors import StorageError, reject


def read_path(what: str, value: Any) -> Path:
    """Read the name of a file or a folder. ``what`` names it in the message.

    Raises InputError if the value is empty, or neither a text nor a path.
    """
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if isinstance(text, str) and text and "\0" not in text:
        return Path(text)
    kind = "empty" if isinstance(text, str) and not text else type(value).__name__
    reject(
        f"{what} is {kind}, not the name of a file or a folder.",
        remedy="Pass a text such as 'folder/name', or a pathlib.Path.",
    )


def check_folder(place: Path, what: str, done: str = "written", trajectory: Any = None) -> None:
    """Raise StorageError before a computation if the folder of its output does not exist."""
    if not place.absolute().parent.is_dir():
        raise StorageError(
            f"{place}: the {what} cannot be {done}, because there is no folder {place.parent}.\n"
            "Make the folder first, or choose another place.",
            trajectory=trajectory,
        )


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_path(place: Path, what: str, trajectory: Any = None) -> Iterator[Path]:
    """Yield a temporary path, and move the finished file or folder to ``place`` at the end.

    Raises StorageError if the file cannot be written. An old file at ``place`` then still exists.
    """
    check_folder(place, what, trajectory=trajectory)
    # no file of the user has this name; writers choose the format by the extension
    whole = place.with_name(f".{place.stem}.new{place.suffix}")
    try:
        _remove(whole)
        yield whole
        if whole.is_dir():
            _remove(place)
        os.replace(whole, place)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise StorageError(
            f"{place}: the {what} cannot be written: {reason}.\nChoose another place.",
            trajectory=trajectory,
        ) from error
    finally:
        with contextlib.suppress(OSError):  # the name may be too long for a file
            _remove(whole)


def write_text(path: str | os.PathLike[str], text: str, what: str) -> Path:
    """Write a text to a file. ``what`` names the file in the message of a failure.

    Raises InputError for an invalid path, and StorageError if the file cannot be written.
    """
    place = read_path(f"the file of the {what}", path)
    with atomic_path(place, what) as whole:
        whole.write_text(text, encoding="utf-8")
    return place
