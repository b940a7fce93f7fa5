"""Parts of a problem as users give them: mappings by symbol or by name, bounds, the duration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.errors import InputError
from symsimpson.program.input_values import shortened
from symsimpson.support.names import spelled

__all__ = ["read_duration", "read_mapping", "read_pair", "read_signals"]


def read_mapping(what: str, given: Any, how: str) -> list[tuple[str, Any, Any]]:
    """Read a mapping: the name of each key, the key, and its value.

    Raises InputError if it is none, or if two keys have one name.
    """
    if not isinstance(given, Mapping):
        shown = None if given is None else type(given).__name__
        raise InputError(f"{what} is {shown}, not a mapping.\nPass {how}.")
    entries = {}
    for key, value in given.items():
        name = spelled(key)
        if name in entries:  # a symbol and its name are two keys to Python
            raise InputError(
                f"{what} gives {name} twice: one of the two would have no effect.\n"
                "Give it once, by symbol or by name."
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
        raise InputError(f"{what} is {shortened(given)}.\nPass {how}.") from None
    if math.isnan(pair[0]) or math.isnan(pair[1]):
        raise InputError(f"{what} is {given!r}, and NaN is no number.\nPass {how}.")
    if pair[0] > pair[1]:
        raise InputError(f"{what} is {given!r}: low is not below high.\nPass a pair (low, high).")
    if pair[0] == math.inf or pair[1] == -math.inf:
        raise InputError(f"{what} is {given!r}: no finite number lies there.\nPass {how}.")
    return pair


def read_duration(given: Any) -> tuple[float, float]:
    """Read a duration, or bounds between which it is found.

    Raises InputError if it is missing, not positive or not finite.
    """
    how = "a positive number, duration=2.0, or bounds of it, duration=(0.5, 4.0)"
    if given is None:
        raise InputError(f"duration is missing: how long the motion is.\nPass {how}.")
    pair = read_pair("duration", given, how)
    for side, wrong, right in (
        ("low", pair[0] <= 0, "above 0, as steps have a size"),
        ("high", pair[1] == math.inf, "finite"),
    ):
        if wrong:
            subject = "it" if pair[0] == pair[1] else side
            raise InputError(f"duration is {given!r}: {subject} must be {right}.\nPass {how}.")
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
            raise InputError(
                f"signals names {key!r}, which is "
                f"{'a name of the system' if isinstance(key, sp.Symbol) else 'no symbol'}.\n"
                "Take a symbol of its own: s = sympy.Symbol('s', real=True)."
            )
        signals[key] = value
    return signals
