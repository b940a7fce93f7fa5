"""Solutions of optimal control in files: numbers, for a problem that is written down anew."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from symsimpson.errors import InputError, StorageError
from symsimpson.support.array_types import Floats
from symsimpson.support.files import read_path, written_beside

__all__ = ["read_solution", "write_solution"]

#: What a file may raise that is not there, not whole, or not what it should be.
DAMAGE = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error),
    *(NotImplementedError, RuntimeError, OverflowError, MemoryError),
)


def write_solution(
    path: str | os.PathLike[str], saved: dict[str, Any], x: Floats, multipliers: Floats
) -> None:
    """Write a solution to a file of NumPy's kind ``.npz``, and what is saved of it as JSON.

    Raises StorageError if it cannot be written; InputError if the name ends otherwise.
    """
    place, text = read_path("path", path), np.array(json.dumps(saved))
    if place.suffix != ".npz":
        raise InputError(
            f"{str(place)!r} is no name of NumPy's kind, as solutions are written.\nEnd it in "
            ".npz; result.trajectory.save writes the motion to files of other kinds."
        )
    with written_beside(place, "solution") as whole, whole.open("wb") as file:
        np.savez_compressed(file, saved=text, x=x, multipliers=multipliers)


def read_solution(
    path: str | os.PathLike[str], kinds: dict[str, Any]
) -> tuple[Path, dict[str, Any], Floats, Floats]:
    """Read what :func:`write_solution` wrote, each part of what is saved by a function of its kind.

    Raises StorageError if the file is none of these, or is damaged.
    """
    place = read_path("path", path)
    try:
        with place.open("rb") as file, np.load(file, allow_pickle=False) as held:
            saved = json.loads(str(held["saved"]))
            x, multipliers = (np.asarray(held[k]) for k in ("x", "multipliers"))
        if any(vector.ndim != 1 or vector.dtype != np.float64 for vector in (x, multipliers)):
            raise ValueError("these are no vectors of numbers")
        if not (np.isfinite(x).all() and np.isfinite(multipliers).all()):
            raise ValueError("they are not all numbers")
        return place, {key: kind(saved[key]) for key, kind in kinds.items()}, x, multipliers
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise StorageError(
            f"{place}: the solution cannot be read: {error.strerror}.\n"
            "Save one with result.save(path), and name that file."
        ) from None
    except DAMAGE as error:
        raise StorageError(
            f"{place}: this is no solution that symsimpson saved: {type(error).__name__}.\n"
            "Save one with result.save(path), and open it with the same problem."
        ) from None
