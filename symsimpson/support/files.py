"""Files that a user names: what is no name, and what cannot be written, is told in words."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from symsimpson.errors import StorageError, reject


def read_path(what: str, value: Any) -> Path:
    """Read the name of a file or a folder; ``what`` names it in the message.

    Raises InputError if it is no text and no path, or empty.
    """
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if isinstance(text, str) and text and "\0" not in text:
        return Path(text)
    given = "empty" if isinstance(text, str) and not text else type(value).__name__
    reject(
        f"{what} is {given}, not the name of a file or a folder.",
        remedy="Pass a text as 'folder/name', or a pathlib.Path.",
    )


def check_folder(place: Path, what: str, done: str = "written", trajectory: Any = None) -> None:
    """Refuse to write into a folder that is not there, before anything is computed for it.

    Raises StorageError.
    """
    if not place.absolute().parent.is_dir():
        raise StorageError(
            f"{place}: the {what} cannot be {done}: there is no folder {place.parent}.\n"
            "Make it first, or choose another place.",
            trajectory=trajectory,
        )


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def written_beside(place: Path, what: str, trajectory: Any = None) -> Iterator[Path]:
    """Give a place beside a file; what was written there takes its place once it is whole.

    Raises StorageError if it cannot be written; then what was there before is still there.
    """
    check_folder(place, what, trajectory=trajectory)
    # a name that is nobody's file; writers look at the ending
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
        with contextlib.suppress(OSError):  # its name may be too long for a file
            _remove(whole)


def write_text(path: str | os.PathLike[str], text: str, what: str) -> Path:
    """Write a text to a file; ``what`` names it in the message of a failure.

    Raises InputError if the path is none; StorageError if the file cannot be written.
    """
    place = read_path(f"the file of the {what}", path)
    with written_beside(place, what) as whole:
        whole.write_text(text, encoding="utf-8")
    return place
