"""Functions of the time as users give them: callables, expressions, numbers, arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike
from sympy.core.function import AppliedUndef

from symsimpson.errors import InputError
from symsimpson.mechanics.coordinates import time
from symsimpson.program.input_values import read_reals, shortened, values_at
from symsimpson.support.array_types import Floats
from symsimpson.support.names import spelled

__all__ = ["finite_values_at", "functions_of", "read_function", "times_within"]

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


def finite_values_at(what: str, function: Any, times: Floats) -> Floats:
    """Evaluate a function at times; raises InputError if it gives no finite real numbers."""
    given = values_at(what, function, times)
    values = read_reals(f"what {what} gives", given, "Return real numbers, as of numpy.real.")
    if not np.isfinite(values).all():
        raise InputError(f"{what} is not finite at all times.\nGive it a value at each.")
    return values


def functions_of(run: Any) -> dict[str, Any]:
    """Return coordinates and inputs of a run as functions of the time since it began, and how long.

    The keys are names, and "duration". After the end of the run they stay what they are there.
    """
    program, begin, end = run.program, float(run.t[0]), float(run.t[-1])

    def times(t: Floats) -> Floats:
        return np.clip(begin + np.asarray(t), min(begin, end), max(begin, end))

    functions: dict[str, Any] = {
        name: lambda t, a=a: run.at(times(t)).q[:, a] for a, name in enumerate(program.coordinates)
    }
    for j, name in enumerate(program.inputs if run.driven else ()):
        functions[name] = lambda t, j=j: run.driven.at(program, times(t))[0, :, 0, j]
    return functions | {"duration": end - begin}


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
