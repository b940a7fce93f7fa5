"""Files of named arrays and a few other values (NumPy's ``.npz`` with a JSON text)."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from symsimpson.errors import StorageError, reject
from symsimpson.support.array_types import Floats
from symsimpson.support.files import atomic_path, read_path

#: Errors that reading a missing, incomplete or wrong file may raise.
FILE_ERRORS = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error),
    *(NotImplementedError, RuntimeError, OverflowError, MemoryError),
)


def write_arrays(
    path: str | os.PathLike[str], what: str, saved: dict[str, Any], arrays: Mapping[str, Any]
) -> None:
    """Write arrays, and the JSON text of ``saved``, to an ``.npz`` file, which has a ``what``.

    Raises StorageError if the file cannot be written, and InputError for another extension.
    """
    place, text = read_path("path", path), np.array(json.dumps(saved))
    if place.suffix != ".npz":
        reject(
            f"path is {str(place)!r}, but a {what} is saved in a .npz file.",
            remedy="Use the extension .npz. The save method of a trajectory has other formats.",
        )
    with atomic_path(place, what) as whole, whole.open("wb") as file:
        np.savez_compressed(file, saved=text, **arrays)


def read_arrays(
    path: str | os.PathLike[str], what: str, kinds: dict[str, Any], sizes: Mapping[str, int]
) -> tuple[Path, dict[str, Any], list[Floats]]:
    """Read a file of :func:`write_arrays`.

    ``kinds`` has the conversion of each JSON entry, and ``sizes`` the dimension of each array.
    Raises StorageError if the file is something else, or is damaged.
    """
    place = read_path("path", path)
    try:
        with place.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            saved = json.loads(str(archive["saved"]))
            arrays = [np.asarray(archive[name]) for name in sizes]
        dimensions: Sequence[int] = tuple(sizes.values())
        for array, dimension in zip(arrays, dimensions, strict=True):
            if array.ndim != dimension or array.dtype != np.float64:
                raise ValueError(f"no array of float64 with {dimension} dimensions")
            if not np.isfinite(array).all():
                raise ValueError("not all numbers are finite")
        return place, {key: kind(saved[key]) for key, kind in kinds.items()}, arrays
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        reject(
            f"the {what} cannot be read: {error.strerror}.",
            where=str(place),
            remedy=f"Save a {what} with its method save(path), and pass the name of that file.",
            error=StorageError,
        )
    except FILE_ERRORS as error:
        reject(
            f"the file is damaged, or not a {what} of symsimpson: {type(error).__name__}.",
            where=str(place),
            remedy=f"Save a {what} with its method save(path), and pass the name of that file.",
            error=StorageError,
        )
