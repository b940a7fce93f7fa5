"""Functions of the time as users give them: callables, expressions, numbers, arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike
from sympy.core.function import AppliedUndef

from symsimpson.control.problem_parts import read_reals
from symsimpson.errors import InputError
from symsimpson.mechanics.coordinates import time
from symsimpson.program.input_values import shortened
from symsimpson.support.array_types import Floats
from symsimpson.support.names import spelled

__all__ = ["read_function", "times_within", "values_at"]

#: So far outside of a motion, relatively, times are taken for its ends: it is the rounding of sums.
SLACK = 1e-12


def read_function(what: str, given: Any, whole: float) -> Any:
    """Return a function of an array of times; arrays reach over a whole duration.

    Raises InputError if it is none; ``what`` names it.
    """
    if isinstance(given, sp.Expr) and not isinstance(given, sp.Lambda):  # symbols can be called
        return _of_expression(what, given)
    if callable(given):
        return given
    how = (
        "Pass a number, an array over equal times, an expression of symsimpson.time, or a function."
    )
    array = read_reals(what, given, how)
    if array.ndim > 1 or not array.size:
        raise InputError(f"{what} is {shortened(given)}, of shape {array.shape}.\n{how}")
    if array.ndim == 0:
        return lambda t: np.full(np.shape(t), float(array))
    return lambda t: np.interp(t, np.linspace(0, whole, array.size), array)


def _of_expression(what: str, given: sp.Expr) -> Any:
    """Return a function of an array of times for an expression of the time."""
    others = sorted(map(spelled, (given.free_symbols - {time}) | given.atoms(AppliedUndef)))
    if others:
        twin = "t" in others  # of the same name, with other assumptions
        raise InputError(
            f"{what} is {shortened(given)}, which contains {', '.join(others)}"
            f"{': a symbol t that is not the time' if twin else ''}.\nWrite it as an expression of "
            "symsimpson.time alone, with numbers for all others."
        )
    return sp.lambdify(time, given, ["scipy", "numpy"])


def times_within(t: ArrayLike, whole: float) -> Floats:
    """Read times of a motion from 0 to a duration.

    Raises InputError if they are no real numbers, or one lies outside of the motion.
    """
    times = read_reals("t", t, "Pass a number, or an array of times.")
    outside = times[~((times >= -SLACK * whole) & (times <= (1 + SLACK) * whole))]  # NaN, too
    if outside.size:
        raise InputError(
            f"t = {outside.flat[0]:g} lies outside of the motion, 0 <= t <= {whole:g}.\n"
            "Ask for times within."
        )
    return times


def values_at(what: str, function: Any, times: Floats) -> Floats:
    """Evaluate a function at an array of times of any shape; it gets them in one row.

    Raises InputError if it cannot be, or gives another shape.
    """
    row = times.ravel()
    try:
        given = function(row)
    except Exception as error:  # it is a function of the user's
        raise InputError(
            f"{what} cannot be evaluated at an array of times: {type(error).__name__}: {error}.\n"
            "Write it with functions of numpy."
        ) from None
    values = read_reals(f"what {what} gives", given, "Return real numbers, as of numpy.real.")
    if values.shape not in (row.shape, ()):
        raise InputError(
            f"{what} gives shape {values.shape} for times of shape {row.shape}.\n"
            "It takes an array of times, and gives one of values."
        )
    if not np.isfinite(values).all():
        raise InputError(f"{what} is not finite at all times.\nGive it a value at each.")
    return np.broadcast_to(values, row.shape).reshape(times.shape)
