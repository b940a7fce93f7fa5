"""Parts of a problem as users give them: mappings, bounds, durations, steps, functions of time."""

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
    """Read a mapping: the name of each key, the key, and its value.

    Raises InputError if it is none, or if two keys have one name.
    """
    if not isinstance(given, Mapping):
        shown = None if given is None else type(given).__name__
        reject(f"{what} is {shown}, not a mapping.", remedy=f"Pass {how}.")
    entries = {}
    for key, value in given.items():
        name = spelled(key)
        if name in entries:  # a symbol and its name are two keys to Python
            reject(
                f"{what} gives {name} twice: one of the two would have no effect.",
                remedy="Give it once, by symbol or by name.",
            )
        entries[name] = (name, key, value)
    return list(entries.values())


def read_pair(
    what: str, given: Any, how: str = "a number, or a pair (low, high) with None for no bound"
) -> tuple[float, float]:
    """Read a number, or bounds (low, high) with None for no bound.

    Raises InputError if it is neither, or if no number lies between the bounds; ``how`` says what
    to pass.
    """
    low, high = given if isinstance(given, (tuple, list)) and len(given) == 2 else (given, given)
    try:
        if isinstance(low, (str, bool, np.bool_)) or isinstance(high, (str, bool, np.bool_)):
            raise TypeError  # float() takes "3", and True
        pair = (-math.inf if low is None else float(low), math.inf if high is None else float(high))
    except (TypeError, ValueError, OverflowError):
        reject(f"{what} is {shortened(given)}.", remedy=f"Pass {how}.")
    if math.isnan(pair[0]) or math.isnan(pair[1]):
        reject(f"{what} is {given!r}, and NaN is no number.", remedy=f"Pass {how}.")
    if pair[0] > pair[1]:
        reject(f"{what} is {given!r}: low is not below high.", remedy="Pass a pair (low, high).")
    if pair[0] == math.inf or pair[1] == -math.inf:
        reject(f"{what} is {given!r}: no finite number lies there.", remedy=f"Pass {how}.")
    return pair


def read_duration(given: Any) -> tuple[float, float]:
    """Read a duration, or bounds between which it is found.

    Raises InputError if it is missing, not positive or not finite.
    """
    how = "a positive number, duration=2.0, or bounds of it, duration=(0.5, 4.0)"
    if given is None:
        reject("duration is missing: how long the motion is.", remedy=f"Pass {how}.")
    pair = read_pair("duration", given, how)
    for side, wrong, right in (
        ("low", pair[0] <= 0, "above 0, as steps have a size"),
        ("high", pair[1] == math.inf, "finite"),
    ):
        if wrong:
            subject = "it" if pair[0] == pair[1] else side
            reject(f"duration is {given!r}: {subject} must be {right}.", remedy=f"Pass {how}.")
    return pair


def read_signals(system: Any, given: Any) -> dict[sp.Symbol, Any]:
    """Read functions of the time by symbols that the system does not have.

    Raises InputError if a key is something else.
    """
    taken = {*map(spelled, (*system.coordinates, *system.parameters, *system.inputs)), "t"}
    signals = {}
    how = "functions of the time by symbol: {s: numpy.sin}"
    for name, key, value in read_mapping("signals", given, how):
        if not isinstance(key, sp.Symbol) or name in taken:
            reject(
                f"signals names {key!r}, which is "
                f"{'a name of the system' if isinstance(key, sp.Symbol) else 'no symbol'}.",
                remedy="Take a symbol of its own: s = sympy.Symbol('s', real=True).",
            )
        signals[key] = value
    return signals


#: With more the solver, which counts entries in 32 bits, or the memory comes to its end.
MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class Grid:
    """Phases one after the other, each in equal steps."""

    steps: tuple[int, ...]  #: The number of steps of each phase.

    @property
    def count(self) -> int:
        """Number of steps."""
        return sum(self.steps)

    @cached_property
    def phase(self) -> Ints:
        """The phase of each step, shape (N,)."""
        return np.repeat(np.arange(len(self.steps)), self.steps)

    @property
    def slices(self) -> list[slice]:
        """The steps of each phase."""
        ends = np.cumsum(self.steps).tolist()
        return [slice(end - n, end) for end, n in zip(ends, self.steps, strict=True)]

    @property
    def halved(self) -> Grid:
        """The same phases in steps of half the size."""
        return Grid(tuple(2 * n for n in self.steps))

    def before(self, k: Ints, place: Floats) -> Floats:
        """Return how many steps of each phase lie before places in steps, shape (..., phases).

        The time at a place is that times the sizes of steps.
        """
        offset = k[..., None] - [steps.start for steps in self.slices]
        within = (offset >= 0) & (offset < self.steps)
        return np.asarray(np.clip(offset, 0, self.steps) + within * place[..., None])

    def times(self, sizes: Floats) -> Floats:
        """Return the times of the ends of steps, shape (N + 1,), for the size of each phase's."""
        return np.asarray(self.before(np.arange(self.count + 1), np.zeros(self.count + 1)) @ sizes)


def read_grid(steps: Any, phases: int, most: int = MOST_STEPS) -> Grid:
    """Read a number of steps, ``most`` in all, or one for each phase.

    Raises InputError if it is neither.
    """
    several = isinstance(steps, (tuple, list)) or (isinstance(steps, np.ndarray) and steps.ndim > 0)
    given = [whole_number(n) or 0 for n in (steps if several else [steps])]
    if not given or min(given) < 1 or sum(given) > most:
        reject(
            f"steps is {shortened(steps)}.",
            remedy="Pass a whole number of steps, at least 1 and at most "
            f"{most}; or one for each phase.",
        )
    if len(given) == 1:
        size, more = divmod(given[0], phases)
        given = [size + (k < more) for k in range(phases)]
    if len(given) != phases or min(given) < 1:
        reject(
            f"steps is {steps!r}, and the number of phases is {phases}.",
            remedy="Pass one number of steps for all of it, or one for each of phases=.",
        )
    return Grid(tuple(given))


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
        reject(f"{what} is {shortened(given)}, of shape {array.shape}.", remedy=f"{how}")
    if array.ndim == 0:
        return lambda t: np.full(np.shape(t), float(array))
    return lambda t: np.interp(t, np.linspace(0, whole, array.size), array)


def finite_values_at(what: str, function: Any, times: Floats) -> Floats:
    """Evaluate a function at times; raises InputError if it gives no finite real numbers."""
    given = values_at(what, function, times)
    values = read_reals(f"what {what} gives", given, "Return real numbers, as of numpy.real.")
    if not np.isfinite(values).all():
        reject(f"{what} is not finite at all times.", remedy="Give it a value at each.")
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
        reject(
            f"{what} is {shortened(given)}, which contains {', '.join(others)}"
            f"{': a symbol t that is not the time' if twin else ''}.",
            remedy="Write it as an expression of "
            "symsimpson.time alone, with numbers for all others.",
        )
    return sp.lambdify(time, given, ["scipy", "numpy"])


def times_within(t: ArrayLike, whole: float) -> Floats:
    """Read times of a motion from 0 to a duration.

    Raises InputError if they are no real numbers, or one lies outside of the motion.
    """
    times = read_reals("t", t, "Pass a number, or an array of times.")
    outside = times[~((times >= -SLACK * whole) & (times <= (1 + SLACK) * whole))]  # NaN, too
    if outside.size:
        reject(
            f"t = {outside.flat[0]:g} lies outside of the motion, 0 <= t <= {whole:g}.",
            remedy="Ask for times within.",
        )
    return times
