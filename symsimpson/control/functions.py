"""Functions of the time as users give them: callables, numbers, arrays over equal times."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError

__all__ = ["read_function", "values_at"]

Floats = NDArray[np.float64]


def read_function(what: str, given: Any, whole: float) -> Any:
    """Return a function of an array of times; arrays reach over a whole duration.

    Raises
    ------
    InputError
        If it is none; ``what`` names it.
    """
    if callable(given):
        return given
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros((0, 0))
    if array.ndim > 1 or not array.size:
        raise InputError(
            f"{what} is {given!r}, of shape {array.shape}.\nPass a number, an array over equal "
            "times, or a function of the time."
        )
    if array.ndim == 0:
        return lambda t: np.full(np.shape(t), float(array))
    return lambda t: np.interp(t, np.linspace(0, whole, array.size), array)


def values_at(what: str, function: Any, times: Floats) -> Floats:
    """Evaluate a function at an array of times.

    Raises
    ------
    InputError
        If it cannot be, or gives another shape.
    """
    try:
        found = np.asarray(function(times), dtype=np.float64)
    except Exception as error:  # it is a function of the user's
        raise InputError(
            f"{what} cannot be evaluated at an array of times: {type(error).__name__}: {error}.\n"
            "Write it with functions of numpy."
        ) from None
    if found.shape not in (times.shape, ()):
        raise InputError(
            f"{what} gives shape {found.shape} for times of shape {times.shape}.\n"
            "It takes an array of times, and gives one of values."
        )
    if not np.isfinite(found).all():
        raise InputError(f"{what} is not finite at all times.\nGive it a value at each.")
    return np.broadcast_to(found, times.shape)
