"""Checks of a declaration, each with its own message.

Every function raises :class:`~symsimpson.errors.ModelError` with what is wrong, where, why it
matters and what to do; none of them changes anything.
"""

from __future__ import annotations

import difflib
import math
import numbers
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.logic.boolalg import BooleanFunction
from sympy.physics.mechanics import dynamicsymbols

from symsimpson.errors import ModelError

__all__ = ["fail", "read_coordinates", "read_expression", "read_name", "read_parameters", "spell"]

#: Functions with closed-form first and second derivatives, smooth on their domain.
SMOOTH = (
    sp.sin, sp.cos, sp.tan, sp.cot, sp.sec, sp.csc, sp.asin, sp.acos, sp.atan, sp.atan2,
    sp.sinh, sp.cosh, sp.tanh, sp.asinh, sp.acosh, sp.atanh, sp.exp, sp.log, sp.erf, sp.erfc,
)  # fmt: skip
#: Functions with corners or jumps.
ROUGH = (sp.Abs, sp.sign, sp.floor, sp.ceiling, sp.Heaviside, sp.DiracDelta, sp.frac)
UNEVALUATED = (sp.Derivative, sp.Integral, sp.Sum, sp.Product, sp.Limit, sp.Subs)
NOT_FINITE = (sp.zoo, sp.nan, sp.oo, -sp.oo)


def spell(expression: object, width: int = 60) -> str:
    """Write an expression on one line, velocities as q', for use in a message."""
    text = re.sub(r"Derivative\((\w+)\(t\), t\)", r"\1'", str(expression)).replace("(t)", "")
    text = " ".join(text.split())
    return text if len(text) <= width else text[: width - 3] + "..."


def fail(system: str, what: str, remedy: str) -> ModelError:
    """Build the error for a system: what is wrong and where, then why and what to do."""
    return ModelError(f"system '{system}': {what}\n{remedy}")


def read_name(name: Any) -> str:
    """Check that the name can be that of a file and of a module."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,63}", name):
        raise ModelError(
            f"the system's name {name!r} cannot be the name of a file and a Python module.\n"
            "Generated modules are called <name>__<scheme>.py. Use up to 64 ASCII letters, digits "
            "and underscores, the first a letter: 'cart_pole'."
        )
    return name


def read_coordinates(system: str, coordinates: Any) -> tuple[AppliedUndef, ...]:
    """Check that the coordinates are distinct functions of time."""
    if isinstance(coordinates, (AppliedUndef, sp.Symbol)):
        coordinates = (coordinates,)
    if isinstance(coordinates, sp.MatrixBase):
        coordinates = tuple(coordinates)
    if isinstance(coordinates, (set, frozenset, Mapping)):
        raise fail(
            system,
            f"the coordinates are a {type(coordinates).__name__}, which has no order of its own.",
            "Numbers of a state come in the order of the coordinates. Write a tuple: (x, y).",
        )
    if isinstance(coordinates, str) or not isinstance(coordinates, Iterable):
        raise fail(
            system,
            f"the coordinates are {coordinates!r}, not a tuple of functions of time.",
            "Make them first: q1, q2 = symsimpson.coordinates('q1 q2').",
        )
    coordinates = tuple(coordinates)
    if not coordinates:
        raise fail(system, "there are no coordinates.", "Give at least one function of time.")
    for q in coordinates:
        if not isinstance(q, AppliedUndef) or q.args != (dynamicsymbols._t,):
            raise fail(
                system,
                f"the coordinate {spell(q)} is not a function of time, sympy's dynamicsymbols._t.",
                "Its velocity q.diff() would be zero. Make it with "
                f"symsimpson.coordinates('{str(q).partition('(')[0]}') or sympy's dynamicsymbols.",
            )
        for assumed in ("positive", "negative", "nonnegative", "nonpositive", "nonzero", "integer"):
            if getattr(q, f"is_{assumed}"):
                raise fail(
                    system,
                    f"the coordinate {spell(q)} is declared {assumed}.",
                    "SymPy simplified T and V with that assumption, and a motion need not keep to "
                    f"it. Make it with symsimpson.coordinates('{spell(q)}').",
                )
    names = [q.func.__name__ for q in coordinates]
    for name in names:
        if names.count(name) > 1:
            raise fail(
                system,
                f"the coordinate {name} is declared {names.count(name)} times.",
                "Each coordinate has one equation of motion. List it once.",
            )
    check_names(system, names)
    return coordinates


def check_names(system: str, coordinates: Sequence[str], invariants: Iterable[str] = ()) -> None:
    """Refuse two quantities of one name: columns of a table, ``run["energy"]``."""
    taken = {"t": "the time", "energy": "the energy"}
    for name in coordinates:
        taken |= {f"p_{name}": f"the momentum of {name}", f"v_{name}": f"the velocity of {name}"}
    for name in coordinates:
        if name in taken:
            raise fail(
                system,
                f"the coordinate {name} has the name of {taken[name]}.",
                f"run['{name}'] could be either. Give the coordinate another name.",
            )
    taken |= {name: f"the coordinate {name}" for name in coordinates}
    for name in invariants:
        if name in taken:
            raise fail(
                system,
                f"the invariant {name!r} has the name of {taken[name]}.",
                f"run[{name!r}] could be either. Give the invariant another name.",
            )


def read_parameters(
    system: str, parameters: Any, coordinates: Sequence[AppliedUndef]
) -> dict[sp.Symbol, float]:
    """Check that parameters are distinct symbols with finite real values that fit them."""
    if not isinstance(parameters, Mapping):
        raise fail(
            system,
            f"the parameters are {spell(parameters)!r}, not a mapping from symbols to values.",
            "Write parameters={m: 1.0, g: 9.81}.",
        )
    values: dict[sp.Symbol, float] = {}
    names = {q.func.__name__: "a coordinate" for q in coordinates}
    for symbol, value in parameters.items():
        if not isinstance(symbol, sp.Symbol) or symbol == dynamicsymbols._t:
            raise fail(
                system,
                f"the parameter {spell(symbol)!r} is not a SymPy symbol.",
                "Make it with sympy.symbols('m', positive=True) and use that symbol in T and V.",
            )
        if symbol.name in names:
            raise fail(
                system,
                f"two symbols of one name, '{symbol.name}': a parameter and {names[symbol.name]}.",
                "SymPy holds them apart by their assumptions, a reader cannot. "
                "Make the symbol once and use it everywhere, or rename one of them.",
            )
        if symbol.is_real is False:
            raise fail(
                system,
                f"the parameter {symbol.name} is declared as a symbol that is not real.",
                "Energies are real. Make it with sympy.Symbol(name, real=True).",
            )
        if symbol.is_integer:
            raise fail(
                system,
                f"the parameter {symbol.name} is declared an integer.",
                "SymPy simplified T and V with that assumption, and a run may be given any real "
                "value. Make it with sympy.Symbol(name, real=True), or write the number.",
            )
        names[symbol.name] = "another parameter"
        values[symbol] = read_value(system, symbol, value)
    return values


def read_value(system: str, symbol: sp.Symbol, value: Any) -> float:
    """Check one parameter's value."""
    if value is None:
        raise fail(
            system,
            f"the parameter {symbol.name} has no value.",
            f"Every parameter needs a default; it can be changed at each run. "
            f"Write parameters={{..., {symbol.name}: 1.0}}.",
        )
    real = isinstance(value, (numbers.Real, sp.Expr)) and not isinstance(value, bool)
    try:
        number = float(value) if real else math.nan
    except (TypeError, OverflowError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise fail(
            system,
            f"the parameter {symbol.name} has the value {spell(value)}, "
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
            raise fail(
                system,
                f"the parameter {symbol.name} is declared {sign} and has the value {number:g}.",
                "SymPy simplifies with that assumption, so the equations would be wrong. "
                "Change the value or the assumption.",
            )
    return number


def read_expression(
    system: str,
    what: str,
    expression: Any,
    replace: Mapping[sp.Basic, sp.Basic],
    allowed: Iterable[sp.Symbol],
) -> sp.Expr:
    """Check one expression and write it in the system's own plain symbols.

    ``what`` names it in messages ("kinetic energy"); ``replace`` maps the user's coordinates,
    velocities and parameters to plain symbols, of which those in ``allowed`` may appear.
    """
    if isinstance(expression, str):
        raise fail(
            system,
            f"the {what} is the string {spell(expression)!r}, not an expression.",
            "Text is never evaluated here. Write it with the SymPy symbols themselves, unquoted.",
        )
    try:
        user = sp.sympify(expression, strict=True)
    except (sp.SympifyError, AttributeError, TypeError):
        user = None
    if not isinstance(user, sp.Expr) or user.is_Matrix:
        raise fail(
            system,
            f"the {what} is {spell(expression)!r}, not a scalar expression.",
            "Write it with SymPy symbols, functions and numbers; of a 1 by 1 matrix take [0, 0].",
        )
    plain = user.xreplace(dict(replace))
    check_content(system, what, plain, {own: users for users, own in replace.items()})
    check_symbols(system, what, plain, replace, set(allowed))
    return plain


def check_content(
    system: str, what: str, plain: sp.Expr, back: Mapping[sp.Basic, sp.Basic]
) -> None:
    """Refuse what has no value, no derivative or no real value."""

    def show(node: sp.Basic) -> str:
        return spell(node.xreplace(dict(back)))

    parameters = {own for own, user in back.items() if user.is_Symbol}
    moving = plain.free_symbols - parameters
    for node in sp.preorder_traversal(plain):
        if isinstance(node, UNEVALUATED):
            if isinstance(node, sp.Derivative) and (
                isinstance(node.expr, AppliedUndef) or node.expr in back
            ):
                order = node.derivative_count
                raise fail(
                    system,
                    f"the {what} contains {show(node)}, "
                    + (f"a derivative of order {order}." if order > 1 else "an unknown velocity."),
                    "A Lagrangian depends on the declared coordinates and their first derivatives. "
                    "Declare the coordinate, or drop the term.",
                )
            raise fail(
                system,
                f"the {what} contains the unevaluated {type(node).__name__} {show(node)}.",
                "It must be differentiated and compiled. Evaluate it first with .doit().",
            )
        if isinstance(node, AppliedUndef):
            raise fail(
                system,
                f"the {what} contains {show(node)}, which is neither a declared coordinate nor a "
                "function with a known form.",
                "Add it to the coordinates, or replace it by an expression.",
            )
        if node in NOT_FINITE:
            raise fail(
                system,
                f"the {what} contains {node}, which is no finite number.",
                "Look for a division by zero or an overflow where the expression is built.",
            )
        if _not_real(node):
            raise fail(
                system,
                f"the {what} contains {show(node)}, which is not real.",
                "Energies are real. Look for the root, power or logarithm of a negative number.",
            )
        known = _differentiable(node)
        if known and getattr(node, "is_number", False) and not _fits(node):
            raise fail(
                system,
                f"the {what} contains the number {show(node)} = {sp.N(node, 3)}, larger than "
                "doubles can be.",
                "Choose other units.",
            )
        if known:
            continue
        if node.free_symbols.isdisjoint(moving):
            of = "parameters" if node.free_symbols else "numbers"
            raise fail(
                system,
                f"the {what} contains {show(node)}, which is made of {of} alone, by a function "
                "that compiled code does not have.",
                "Evaluate it first: replace it by its value, "
                + (
                    "in a parameter of its own."
                    if node.free_symbols
                    else f"{spell(sp.N(node, 17))}."
                ),
            )
        if isinstance(node, (sp.Piecewise, sp.Max, sp.Min, Relational, BooleanFunction)):
            raise fail(
                system,
                f"the {what} contains {show(node)}, which is defined by cases.",
                "Newton's method needs two continuous derivatives. Use a smooth expression.",
            )
        name = node.func.__name__
        raise fail(
            system,
            f"the {what} contains {show(node)}: "
            + (
                f"the function {name} has no two continuous derivatives."
                if isinstance(node, ROUGH)
                else f"{name}, or its derivatives, are not among the functions of C's mathematics "
                "library, which compiled code calls."
            ),
            "Use a smooth form, such as sqrt(x**2 + eps**2) for |x|, or one of "
            + ", ".join(sorted(f.__name__ for f in SMOOTH))
            + ".",
        )


def _differentiable(node: sp.Basic) -> bool:
    """Tell whether a node can be differentiated twice and compiled, if its arguments can."""
    if isinstance(node, (sp.Piecewise, sp.Max, sp.Min, Relational, BooleanFunction)):
        return False
    return not isinstance(node, sp.Function) or isinstance(node, SMOOTH)


def _not_real(node: sp.Basic) -> bool:
    """Tell whether a node is not real, or is not for all exponents that come up."""
    if node is sp.I or getattr(node, "is_extended_real", None) is False:
        return True
    return bool(isinstance(node, sp.Pow) and node.base.is_negative and not node.exp.is_integer)


def _fits(number: sp.Basic) -> bool:
    """Tell whether a number is one of doubles."""
    value = number if number.is_Number else sp.N(number, 15)
    return bool(abs(value) <= sys.float_info.max)


def check_symbols(
    system: str,
    what: str,
    plain: sp.Expr,
    replace: Mapping[sp.Basic, sp.Basic],
    allowed: set[sp.Symbol],
) -> None:
    """Refuse symbols that were not declared, or not for this place."""
    declared = {str(s): s for s in replace if isinstance(s, sp.Symbol)}
    originals = {plain: user for user, plain in replace.items()}
    for symbol in sorted(plain.free_symbols - allowed, key=str):
        if symbol in originals:
            user = spell(originals[symbol])
            velocity = isinstance(originals[symbol], sp.Derivative)
            raise fail(
                system,
                f"the {what} depends on the {'velocity' if velocity else 'symbol'} {user}.",
                "A potential depends on positions alone. Move terms that are linear in the "
                "velocities to a Lagrangian: MechanicalSystem.from_lagrangian(name, L, ...)."
                if velocity
                else f"Leave {user} out of it.",
            )
        if symbol == dynamicsymbols._t:
            raise fail(
                system,
                f"the {what} depends explicitly on the time t.",
                "Only autonomous systems are integrated. Make the driven quantity a coordinate "
                "or a parameter.",
            )
        if symbol.name in declared:
            raise fail(
                system,
                f"two symbols of one name, '{symbol.name}': the {what} contains one, the "
                "parameters another, with different assumptions.",
                "SymPy holds them apart, so the value would not arrive. "
                "Make the symbol once and use it everywhere.",
            )
        close = difflib.get_close_matches(symbol.name, declared, n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise fail(
            system,
            f"the {what} contains the unknown symbol {symbol.name}: it is neither a coordinate "
            f"nor a parameter with a value.{hint}",
            f"Give it a value: parameters={{..., {symbol.name}: 1.0}}, "
            "or make it a coordinate with symsimpson.coordinates.",
        )
