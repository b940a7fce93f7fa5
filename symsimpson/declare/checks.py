"""Checks of a declaration, each with its own message.

Every function raises :class:`~symsimpson.errors.ModelError` with what is wrong, where, why it
matters and what to do; none of them changes anything.
"""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from functools import partial
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.errors import ModelError, reject
from symsimpson.support.names import is_masked
from symsimpson.text.quantity import SCALARS


def spell(expression: object, width: int = 60) -> str:
    """Write an expression on one line, velocities as q', for use in a message."""
    text = re.sub(r"Derivative\(([^()]+)\(t\), t\)", r"\1'", str(expression)).replace("(t)", "")
    text = " ".join(text.split())
    return text if len(text) <= width else text[: width - 3] + "..."


def fail(system: str, what: str, remedy: str) -> ModelError:
    """Build the error for a system: what is wrong and where, then why and what to do."""
    return ModelError(f"system '{system}': {what}\n{remedy}")


def read_name(name: Any) -> str:
    """Check that the name can be that of a file and of a module."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,63}", name):
        reject(
            f"the system's name {name!r} cannot be the name of a file and a Python module.",
            remedy="Generated modules are called <name>__<scheme>.py. Use up to 64 ASCII "
            "letters, digits "
            "and underscores, the first a letter: 'cart_pole'.",
            error=ModelError,
        )
    return name


def read_coordinates(system: str, coordinates: Any) -> tuple[AppliedUndef, ...]:
    """Check that the coordinates are distinct functions of time."""
    refuse = partial(fail, system)
    if isinstance(coordinates, (AppliedUndef, sp.Symbol)):
        coordinates = (coordinates,)
    if isinstance(coordinates, sp.MatrixBase):
        coordinates = tuple(coordinates)
    if isinstance(coordinates, (set, frozenset, Mapping)):
        raise refuse(
            f"the coordinates are a {type(coordinates).__name__}, not a sequence.",
            "Numbers of a state come in the order of the coordinates. Write a tuple: (x, y).",
        )
    if isinstance(coordinates, str) or not isinstance(coordinates, Iterable):
        raise refuse(
            f"the coordinates are {coordinates!r}, not a tuple of functions of time.",
            "Make them first: q1, q2 = symsimpson.coordinates('q1 q2').",
        )
    coordinates = tuple(coordinates)
    if not coordinates:
        raise refuse("there are no coordinates.", "Give at least one function of time.")
    for q in coordinates:
        if isinstance(q, AppliedUndef) and [str(t) for t in q.args] == [str(time)]:
            _check_time(system, q)
        if not isinstance(q, AppliedUndef) or q.args != (time,):
            raise refuse(
                f"the coordinate {spell(q)} is not a function of time, sympy's dynamicsymbols._t.",
                "Its velocity q.diff() would be zero. Make it with "
                f"symsimpson.coordinates('{str(q).partition('(')[0]}') or sympy's dynamicsymbols.",
            )
        for assumed in ("positive", "negative", "nonnegative", "nonpositive", "nonzero", "integer"):
            if getattr(q, f"is_{assumed}"):
                raise refuse(
                    f"the coordinate {spell(q)} is declared {assumed}.",
                    "SymPy simplified T and V with that assumption, and a motion need not keep to "
                    f"it. Make it with symsimpson.coordinates('{spell(q)}').",
                )
    names = [q.func.__name__ for q in coordinates]
    for name in names:
        if names.count(name) > 1:
            raise refuse(
                f"the coordinate {name} is declared {names.count(name)} times.",
                "Each coordinate has one equation of motion. List it once.",
            )
    check_names(system, names)
    return coordinates


def _check_time(system: str, q: AppliedUndef) -> None:
    """Refuse a function of a time of one's own, which SymPy holds apart by its assumptions."""
    (t,) = q.args
    if t != time:
        assumed = ", ".join(sorted(key for key, is_so in t.assumptions0.items() if is_so))
        raise fail(
            system,
            f"the coordinate {q.func.__name__} is a function of a symbol {t} with assumptions "
            f"({assumed}), which SymPy holds apart from the time.",
            f"The time has no assumptions: write t = symsimpson.time, or t = sympy.Symbol('{t}'), "
            "and make coordinates, forces and energies with that.",
        )


def check_names(system: str, coordinates: Sequence[str], invariants: Iterable[str] = ()) -> None:
    """Refuse two quantities of one name: columns of a table, ``run["energy"]``."""
    refuse = partial(fail, system)
    taken = {"t": "the time", **{scalar.name: f"the {scalar.doc}" for scalar in SCALARS}}
    for name in coordinates:
        taken |= {f"p_{name}": f"the momentum of {name}", f"v_{name}": f"the velocity of {name}"}
    for name in coordinates:
        if name.endswith("(t)"):
            raise refuse(
                f"the name of the coordinate {name} has the time in it.",
                f"The time is its argument: write sympy.Function('{name.removesuffix('(t)')}')(t).",
            )
        if name in taken:
            raise refuse(
                f"the coordinate {name} has the name of {taken[name]}.",
                f"run['{name}'] could be either. Give the coordinate another name.",
            )
    taken |= {name: f"the coordinate {name}" for name in coordinates}
    for name in invariants:
        if name in taken:
            raise refuse(
                f"the invariant {name!r} has the name of {taken[name]}.",
                f"run[{name!r}] could be either. Give the invariant another name.",
            )


def read_parameters(
    system: str, parameters: Any, coordinates: Sequence[AppliedUndef]
) -> dict[sp.Symbol, float]:
    """Check that parameters are distinct symbols with finite real values that fit them."""
    refuse = partial(fail, system)
    if not isinstance(parameters, Mapping):
        raise refuse(
            f"the parameters are {spell(parameters)!r}, not a mapping from symbols to values.",
            "Write parameters={m: 1.0, g: 9.81}.",
        )
    values: dict[sp.Symbol, float] = {}
    names = {q.func.__name__: "a coordinate" for q in coordinates}
    for symbol, value in parameters.items():
        if symbol == time:
            raise refuse(
                f"the parameter {spell(symbol)!r} is the time, on which coordinates depend.",
                "Give the parameter another name. The time needs no value: symsimpson.time may "
                "stand in energies and forces as it is.",
            )
        if symbol in coordinates:
            raise refuse(
                f"the parameter {spell(symbol)!r} is a coordinate, whose value changes in a run.",
                "Leave it out of the parameters. Its start is given to each run: integrate(q0, "
                "v0, ...).",
            )
        if not isinstance(symbol, sp.Symbol):
            raise refuse(
                f"the parameter {spell(symbol)!r} is not a SymPy symbol.",
                "Write the symbol that stands in T and V, without quotes: {m: 1.0}, after "
                "m = sympy.Symbol('m', positive=True). Runs find it by its name, too.",
            )
        if symbol.name in names:
            raise refuse(
                f"two symbols of one name, '{symbol.name}': a parameter and {names[symbol.name]}.",
                "SymPy holds them apart by their assumptions, a reader cannot. "
                "Make the symbol once and use it everywhere, or rename one of them.",
            )
        if symbol.is_real is False:
            raise refuse(
                f"the parameter {symbol.name} is declared as a symbol that is not real.",
                "Energies are real. Make it with sympy.Symbol(name, real=True).",
            )
        if symbol.is_integer:
            raise refuse(
                f"the parameter {symbol.name} is declared an integer.",
                "SymPy simplified T and V with that assumption, and a run may be given any real "
                "value. Make it with sympy.Symbol(name, real=True), or write the number.",
            )
        names[symbol.name] = "another parameter"
        values[symbol] = read_value(system, symbol, value)
    return values


def read_value(system: str, symbol: sp.Symbol, value: Any) -> float:
    """Check one parameter's value."""
    refuse = partial(fail, system)
    if value is None:
        raise refuse(
            f"the parameter {symbol.name} has no value.",
            f"Every parameter needs a default; it can be changed at each run. "
            f"Write parameters={{..., {symbol.name}: 1.0}}.",
        )
    real = isinstance(value, (numbers.Real, Decimal, sp.Expr)) and not isinstance(value, bool)
    # as arrays of xarray and NumPy hold single numbers
    if getattr(value, "shape", None) == () and not is_masked(value):
        real = getattr(getattr(value, "dtype", None), "kind", None) in ("f", "i", "u")
    try:
        number = float(value) if real else math.nan
    except (TypeError, OverflowError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise refuse(
            f"the parameter {symbol.name} has the value "
            f"{repr(value) if isinstance(value, str) else spell(value)}, "
            "which is not a finite real number.",
            f"Give it a number: {{{symbol.name}: 1.0}}.",
        )
    signs = {
        "positive": number > 0,
        "negative": number < 0,
        "nonnegative": number >= 0,
        "nonpositive": number <= 0,
        "nonzero": number != 0,
    }
    for sign, holds in signs.items():
        if getattr(symbol, f"is_{sign}") and not holds:
            raise refuse(
                f"the parameter {symbol.name} is declared {sign} and has the value {number:g}.",
                "SymPy simplifies with that assumption, so the equations would be wrong. "
                "Change the value or the assumption.",
            )
    return number
