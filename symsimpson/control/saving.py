"""Solutions of optimal control in files: numbers, for the problem that is written down anew."""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from symsimpson.control.layout import Layout
from symsimpson.control.result import ControlResult
from symsimpson.control.status import ControlStatus
from symsimpson.errors import InputError, StorageError
from symsimpson.schemes.named import read_scheme
from symsimpson.support.files import read_path, written_beside

if TYPE_CHECKING:
    from symsimpson.control.reading import Reading
    from symsimpson.schemes.scheme import Scheme

__all__ = ["open_result", "save_result"]

#: What a file holds beside the two arrays, in JSON.
TOLD = [x.name for x in fields(ControlResult) if x.name not in ("layout", "x", "multipliers")]
#: What a file may raise that is not there, not whole, or not what it should be.
DAMAGE = (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError)
#: The cost of a solution is computed again, and may differ by so much, relatively.
ROUNDED = 1e-9


def save_result(result: ControlResult, path: str | os.PathLike[str]) -> None:
    """Write a solution to a file of NumPy's kind ``.npz``.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    place, layout = read_path("path", path), result.layout
    told: dict[str, Any] = {name: getattr(result, name) for name in TOLD}
    told |= {"status": result.status.name, "scheme": layout.scheme.name, "steps": layout.steps}
    with written_beside(place, "solution") as whole, whole.open("wb") as file:
        text = np.array(json.dumps(told))
        np.savez_compressed(file, told=text, x=result.x, multipliers=result.multipliers)


def open_result(
    read: Reading, path: str | os.PathLike[str], scheme: Scheme | None
) -> ControlResult:
    """Read a solution of a problem from a file.

    Raises
    ------
    StorageError
        If the file is none of these, or is damaged.
    InputError
        If it is the solution of another problem.
    """
    place = read_path("path", path)
    try:
        with place.open("rb") as file, np.load(file, allow_pickle=False) as held:
            told = json.loads(str(held["told"]))
            x, multipliers = (np.array(held[k], np.float64) for k in ("x", "multipliers"))
        steps, status = int(told.pop("steps")), ControlStatus[told.pop("status")]
        name, told = str(told.pop("scheme")), {key: told[key] for key in TOLD if key != "status"}
        cost = float(told["cost"])
    except DAMAGE as error:
        raise StorageError(
            f"{place}: this is no solution that symsimpson saved: {type(error).__name__}.\n"
            "Save one with result.save(path), and open it with the same problem."
        ) from None
    layout = Layout(read, scheme or read_scheme(name), max(1, steps))
    programme, *_ = layout.programme
    same = (len(multipliers), len(x)) == programme.shape and np.isfinite(x).all()
    if not same or abs(programme.values(x)[0] - cost) > ROUNDED * max(1.0, abs(cost)):
        raise InputError(
            f"{place}: the file holds the solution of another problem, of {steps} steps of {name}."
            f"\n{read.system.name} has another cost there. Write down the problem as it was, with "
            "the same parameters."
        )
    return ControlResult(layout, x, multipliers, status=status, **told)
