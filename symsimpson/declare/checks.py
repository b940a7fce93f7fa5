"""Checks of the name, coordinates and parameters of a system.

Every function raises :class:`~symsimpson.errors.ModelError` for an invalid declaration, and
changes nothing.
"""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from functools import partial
from typing import Any, NoReturn

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.errors import ModelError, reject
from symsimpson.support.names import is_masked
from symsimpson.text.quantity import SCALARS


def spell(expression: object, width: int = 60) -> str:
    """Write an expression for a message: on one line, with velocities as q'."""
    text = re.sub(r"Derivative\(([^()]+)\(t\), t\)", r"\1'", str(expression)).replace("(t)", "")
    text = " ".join(text.split())
    return text if len(text) <= width else text[: width - 3] + "..."


def reject_model(system: str, problem: str, remedy: str) -> NoReturn:
    """Raise a ModelError that names the system; the ``problem`` says what is wrong and why."""
    reject(problem, f"system '{system}'", remedy=remedy, error=ModelError)


def read_name(name: Any) -> str:
    """Check that a name is valid for a file and a Python module."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,63}", name):
        reject(
            f"the system's name {name!r} cannot be the name of a file and a Python module.",
            why="Generated modules are called <name>__<scheme>.py.",
            remedy="Use up to 64 ASCII letters, digits and underscores. Begin with a letter: "
            "'cart_pole'.",
            error=ModelError,
        )
    return name


def read_coordinates(system: str, coordinates: Any) -> tuple[AppliedUndef, ...]:
    """Check that the coordinates are distinct functions of time."""
    reject_here = partial(reject_model, system)
    if isinstance(coordinates, (AppliedUndef, sp.Symbol)):
        coordinates = (coordinates,)
    if isinstance(coordinates, sp.MatrixBase):
        coordinates = tuple(coordinates)
    if isinstance(coordinates, (set, frozenset, Mapping)):
        reject_here(
            f"the coordinates are a {type(coordinates).__name__}, not a sequence. "
            "The numbers of a state follow the order of the coordinates.",
            "Write a tuple: (x, y).",
        )
    if isinstance(coordinates, str) or not isinstance(coordinates, Iterable):
        reject_here(
            f"the coordinates are {coordinates!r}, not a tuple of functions of time.",
            "Make them first: q1, q2 = symsimpson.coordinates('q1 q2').",
        )
    coordinates = tuple(coordinates)
    if not coordinates:
        reject_here("there are no coordinates.", "Pass at least one function of time.")
    for q in coordinates:
        if isinstance(q, AppliedUndef) and [str(t) for t in q.args] == [str(time)]:
            _check_time(system, q)
        if not isinstance(q, AppliedUndef) or q.args != (time,):
            reject_here(
                f"the coordinate {spell(q)} is not a function of time, sympy's dynamicsymbols._t. "
                "Its velocity q.diff() would be zero.",
                f"Make it with symsimpson.coordinates('{str(q).partition('(')[0]}') or sympy's "
                "dynamicsymbols.",
            )
        for assumed in ("positive", "negative", "nonnegative", "nonpositive", "nonzero", "integer"):
            if getattr(q, f"is_{assumed}"):
                reject_here(
                    f"the coordinate {spell(q)} is declared {assumed}. "
                    "SymPy simplified T and V with that assumption, but the motion may violate it.",
                    f"Make the coordinate with symsimpson.coordinates('{spell(q)}').",
                )
    names = [q.func.__name__ for q in coordinates]
    for name in names:
        if names.count(name) > 1:
            reject_here(
                f"the coordinate {name} is declared {names.count(name)} times. "
                "Each coordinate has one equation of motion.",
                "List each coordinate once.",
            )
    check_names(system, names)
    return coordinates


def _check_time(system: str, q: AppliedUndef) -> None:
    """Reject a coordinate whose argument is called t but has assumptions that the time lacks."""
    (t,) = q.args
    if t != time:
        assumed = ", ".join(sorted(key for key, is_so in t.assumptions0.items() if is_so))
        reject_model(
            system,
            f"the coordinate {q.func.__name__} is a function of a symbol {t} with assumptions "
            f"({assumed}). "
            "The time has no assumptions, so SymPy takes the two for different symbols.",
            f"Write t = symsimpson.time, or t = sympy.Symbol('{t}'). Make coordinates, forces and "
            "energies with that symbol.",
        )


def check_names(system: str, coordinates: Sequence[str], invariants: Iterable[str] = ()) -> None:
    """Reject two quantities with the same name, because ``run[name]`` would be ambiguous."""
    reject_here = partial(reject_model, system)
    taken = {"t": "the time", **{scalar.name: f"the {scalar.doc}" for scalar in SCALARS}}
    for name in coordinates:
        taken |= {f"p_{name}": f"the momentum of {name}", f"v_{name}": f"the velocity of {name}"}
    for name in coordinates:
        if name.endswith("(t)"):
            reject_here(
                f"the name of the coordinate {name} contains the time. "
                "The time is the argument of the function, not a part of its name.",
                f"Write sympy.Function('{name.removesuffix('(t)')}')(t).",
            )
        if name in taken:
            reject_here(
                f"the coordinate {name} has the name of {taken[name]}. "
                f"run['{name}'] would be ambiguous.",
                "Give the coordinate another name.",
            )
    taken |= {name: f"the coordinate {name}" for name in coordinates}
    for name in invariants:
        if name in taken:
            reject_here(
                f"the invariant {name!r} has the name of {taken[name]}. "
                f"run[{name!r}] would be ambiguous.",
                "Give the invariant another name.",
            )


def read_parameters(
    system: str, parameters: Any, coordinates: Sequence[AppliedUndef]
) -> dict[sp.Symbol, float]:
    """Check that parameters are distinct symbols with finite values that fit their assumptions."""
    reject_here = partial(reject_model, system)
    if not isinstance(parameters, Mapping):
        reject_here(
            f"the parameters are {spell(parameters)!r}, not a mapping from symbols to values.",
            "Write parameters={m: 1.0, g: 9.81}.",
        )
    values: dict[sp.Symbol, float] = {}
    names = {q.func.__name__: "a coordinate" for q in coordinates}
    for symbol, value in parameters.items():
        if symbol == time:
            reject_here(
                f"the parameter {spell(symbol)!r} is the time, on which coordinates depend. "
                "The time needs no value: energies and forces may contain symsimpson.time.",
                "Give the parameter another name.",
            )
        if symbol in coordinates:
            reject_here(
                f"the parameter {spell(symbol)!r} is a coordinate, whose value changes in a run.",
                "Remove it from the parameters. Pass its initial value to each run: "
                "integrate(q0, v0, ...).",
            )
        if not isinstance(symbol, sp.Symbol):
            reject_here(
                f"the parameter {spell(symbol)!r} is not a SymPy symbol.",
                "Write the symbol that T and V contain, without quotes: {m: 1.0}, after "
                "m = sympy.Symbol('m', positive=True). Runs accept its name, too.",
            )
        if symbol.name in names:
            reject_here(
                f"two symbols have the name '{symbol.name}': a parameter and {names[symbol.name]}. "
                "Only their assumptions differ, so a reader cannot distinguish them.",
                "Create the symbol once and use it everywhere, or rename one of them.",
            )
        if symbol.is_real is False:
            reject_here(
                f"the parameter {symbol.name} is declared as a symbol that is not real. "
                "Energies are real.",
                "Make it with sympy.Symbol(name, real=True).",
            )
        if symbol.is_integer:
            reject_here(
                f"the parameter {symbol.name} is declared an integer. "
                "SymPy simplified T and V with that assumption, but a run accepts any real value.",
                "Make it with sympy.Symbol(name, real=True), or write the number.",
            )
        names[symbol.name] = "another parameter"
        values[symbol] = read_value(system, symbol, value)
    return values


def read_value(system: str, symbol: sp.Symbol, value: Any) -> float:
    """Check that a parameter's value is a finite real number that fits the symbol's assumptions."""
    reject_here = partial(reject_model, system)
    if value is None:
        reject_here(
            f"the parameter {symbol.name} has no value. "
            "Every parameter needs a default value, which each run may change.",
            f"Write parameters={{..., {symbol.name}: 1.0}}.",
        )
    real = isinstance(value, (numbers.Real, Decimal, sp.Expr)) and not isinstance(value, bool)
    # xarray and NumPy store single numbers as arrays without a dimension
    if getattr(value, "shape", None) == () and not is_masked(value):
        real = getattr(getattr(value, "dtype", None), "kind", None) in ("f", "i", "u")
    try:
        number = float(value) if real else math.nan
    except (TypeError, OverflowError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        shown = repr(value) if isinstance(value, str) else spell(value)
        reject_here(
            f"the parameter {symbol.name} has the value {shown}, which is not a finite real "
            "number.",
            f"Write a number: {{{symbol.name}: 1.0}}.",
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
            reject_here(
                f"the parameter {symbol.name} is declared {sign} and has the value {number:g}. "
                "SymPy simplifies with that assumption, so the equations would be wrong.",
                "Change the value or the assumption.",
            )
    return number
