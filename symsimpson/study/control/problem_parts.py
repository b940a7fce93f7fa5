"""Reading of arguments: mappings, bounds, durations, steps, and functions of time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.errors import reject
from symsimpson.program.input_values import read_reals, values_at, whole_number
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.names import shortened, spelled


def read_mapping(what: str, given: Any, how: str) -> list[tuple[str, Any, Any]]:
    """Return the name, the key and the value of each entry of a mapping.

    Raises InputError if the argument is not a mapping, or if two keys have the same name.
    """
    if not isinstance(given, Mapping):
        shown = None if given is None else type(given).__name__
        reject(f"{what} is {shown}, not a mapping.", remedy=f"Pass {how}.")
    entries = {}
    for key, value in given.items():
        name = spelled(key)
        if name in entries:  # a symbol and its name are different keys of a dict
            reject(
                f"{what} gives {name} twice.",
                why="One of the two values would have no effect.",
                remedy="Give it once, by symbol or by name.",
            )
        entries[name] = (name, key, value)
    return list(entries.values())


def read_pair(
    what: str, given: Any, how: str = "a number, or a pair (low, high) with None for no bound"
) -> tuple[float, float]:
    """Return bounds (low, high) of a number, or of a pair in which None means no bound.

    Raises InputError for any other value, and if no number lies between the bounds. ``how`` is
    the remedy of the message.
    """
    low, high = given if isinstance(given, (tuple, list)) and len(given) == 2 else (given, given)
    try:
        if isinstance(low, (str, bool, np.bool_)) or isinstance(high, (str, bool, np.bool_)):
            raise TypeError  # float() would accept "3" and True
        pair = (-math.inf if low is None else float(low), math.inf if high is None else float(high))
    except (TypeError, ValueError, OverflowError):
        reject(f"{what} is {shortened(given)}, which is invalid.", remedy=f"Pass {how}.")
    if math.isnan(pair[0]) or math.isnan(pair[1]):
        reject(f"{what} is {given!r}, which contains NaN.", remedy=f"Pass {how}.")
    if pair[0] > pair[1]:
        reject(f"{what} is {given!r}: low is above high.", remedy="Pass a pair (low, high).")
    if pair[0] == math.inf or pair[1] == -math.inf:
        reject(f"{what} is {given!r}, which contains no finite number.", remedy=f"Pass {how}.")
    return pair


def read_duration(given: Any) -> tuple[float, float]:
    """Return bounds (low, high) of the duration; they are equal if it is a number.

    Raises InputError if the duration is missing, not positive or not finite.
    """
    how = "a positive number, duration=2.0, or bounds of it, duration=(0.5, 4.0)"
    if given is None:
        reject("duration is missing: the length of the motion.", remedy=f"Pass {how}.")
    pair = read_pair("duration", given, how)
    for side, wrong, right in (
        ("low", pair[0] <= 0, "above 0"),
        ("high", pair[1] == math.inf, "finite"),
    ):
        if wrong:
            subject = "it" if pair[0] == pair[1] else side
            reject(f"duration is {given!r}: {subject} must be {right}.", remedy=f"Pass {how}.")
    return pair


def read_signals(system: Any, given: Any) -> dict[sp.Symbol, Any]:
    """Return functions of time by their symbols.

    Raises InputError if a key is not a symbol, or if the system already uses its name.
    """
    names = {*map(spelled, (*system.coordinates, *system.parameters, *system.inputs)), "t"}
    signals = {}
    how = "functions of the time by symbol: {s: numpy.sin}"
    for name, key, value in read_mapping("signals", given, how):
        if not isinstance(key, sp.Symbol) or name in names:
            reject(
                f"signals has the key {key!r}, which is "
                f"{'a name of the system' if isinstance(key, sp.Symbol) else 'not a symbol'}.",
                remedy="Use a new symbol: s = sympy.Symbol('s', real=True).",
            )
        signals[key] = value
    return signals


#: More steps exceed the memory, or the 32 bits in which the solver counts matrix entries.
MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class Grid:
    """A time grid of consecutive phases, each divided into equal steps."""

    steps: tuple[int, ...]  #: The number of steps of each phase.

    @property
    def count(self) -> int:
        """Total number of steps, N."""
        return sum(self.steps)

    @cached_property
    def phase(self) -> Ints:
        """Index of the phase of each step, shape (N,)."""
        return np.repeat(np.arange(len(self.steps)), self.steps)

    @property
    def slices(self) -> list[slice]:
        """Range of the steps of each phase."""
        ends = np.cumsum(self.steps).tolist()
        return [slice(end - n, end) for end, n in zip(ends, self.steps, strict=True)]

    @property
    def halved(self) -> Grid:
        """The grid of the same phases with twice as many steps."""
        return Grid(tuple(2 * n for n in self.steps))

    def before(self, k: Ints, place: Floats) -> Floats:
        """Return how many steps of each phase lie before a point, shape (..., phases).

        The point lies in step ``k``, at ``place`` between 0 and 1. The time there is the product
        of these numbers with the step sizes of the phases.
        """
        offset = k[..., None] - [steps.start for steps in self.slices]
        within = (offset >= 0) & (offset < self.steps)
        return np.asarray(np.clip(offset, 0, self.steps) + within * place[..., None])

    def times(self, sizes: Floats) -> Floats:
        """Return the times between steps, shape (N + 1,), for the step sizes of the phases."""
        return np.asarray(self.before(np.arange(self.count + 1), np.zeros(self.count + 1)) @ sizes)


def read_grid(steps: Any, phases: int, most: int = MOST_STEPS) -> Grid:
    """Return the grid for a total number of steps, or for one number for each phase.

    Raises InputError if a number is invalid, or if there are more than ``most`` steps in total.
    """
    several = isinstance(steps, (tuple, list)) or (isinstance(steps, np.ndarray) and steps.ndim > 0)
    given = [whole_number(n) or 0 for n in (steps if several else [steps])]
    if not given or min(given) < 1 or sum(given) > most:
        reject(
            f"steps is {shortened(steps)}, which is out of range.",
            remedy=f"Pass a whole number from 1 to {most}, or one for each phase.",
        )
    if len(given) == 1:
        size, remainder = divmod(given[0], phases)
        given = [size + (k < remainder) for k in range(phases)]
    if len(given) != phases or min(given) < 1:
        reject(
            f"steps is {steps!r}, which does not fit the number of phases, {phases}.",
            remedy="Pass the total number of steps, or one number for each of phases=.",
        )
    return Grid(tuple(given))


#: Times outside of the motion by at most this fraction of the duration count as its ends: sums of
#: step sizes have such round-off errors.
SLACK = 1e-12


def read_function(what: str, given: Any, whole: float) -> Any:
    """Return a function of an array of times; samples of an array span the duration ``whole``.

    Raises InputError, with ``what`` as the name, if the value cannot be such a function.
    """
    if isinstance(given, sp.Expr) and not isinstance(given, sp.Lambda):  # symbols are callable, too
        return _compile_expression(what, given)
    if callable(given):
        return given
    how = "Pass a number, an array of samples, an expression of symsimpson.time, or a function."
    array = read_reals(what, given, how)
    if array.ndim > 1 or not array.size:
        reject(f"{what} is {shortened(given)}, of shape {array.shape}.", remedy=how)
    if array.ndim == 0:
        return lambda t: np.full(np.shape(t), float(array))
    return lambda t: np.interp(t, np.linspace(0, whole, array.size), array)


def finite_values_at(what: str, function: Any, times: Floats) -> Floats:
    """Evaluate a function at times; raise InputError unless all values are finite and real."""
    given = values_at(what, function, times)
    values = read_reals(f"the value of {what}", given, "Return real numbers, as of numpy.real.")
    if not np.isfinite(values).all():
        reject(
            f"{what} is not finite at all times.", remedy="Return a finite number for each time."
        )
    return values


def run_to_functions(run: Any) -> dict[str, Any]:
    """Return coordinates and inputs of a run, by name, as functions of time; and its duration.

    Time counts from the start of the run. Functions are constant after the end of the run. The
    key of the duration is "duration".
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


def _compile_expression(what: str, given: sp.Expr) -> Any:
    """Return a function of an array of times that evaluates an expression of time."""
    others = sorted(map(spelled, (given.free_symbols - {time}) | given.atoms(AppliedUndef)))
    if others:
        twin = "t" in others  # a symbol of the same name with other assumptions
        reject(
            f"{what} is {shortened(given)}, which contains {', '.join(others)}.",
            why="This symbol t is not symsimpson.time." if twin else "",
            remedy="Use symsimpson.time, and replace all other symbols by numbers.",
        )
    return sp.lambdify(time, given, ["scipy", "numpy"])


def read_times(t: ArrayLike, whole: float) -> Floats:
    """Return times as an array.

    Raises InputError if they are not real numbers between 0 and the duration ``whole``.
    """
    times = read_reals("t", t, "Pass a number, or an array of times.")
    outside = times[~((times >= -SLACK * whole) & (times <= (1 + SLACK) * whole))]  # or NaN
    if outside.size:
        reject(
            f"t = {outside.flat[0]:g} lies outside of the motion, 0 <= t <= {whole:g}.",
            remedy="Pass times within this interval.",
        )
    return times
