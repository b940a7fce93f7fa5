"""Checks of an expression: that it is one, real, smooth, and made of what was declared.

Every function raises :class:`~symsimpson.errors.ModelError` with what is wrong, where, why it
matters and what to do; none of them changes anything.
"""

from __future__ import annotations

import difflib
import random
import sys
from collections.abc import Iterable, Mapping
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.logic.boolalg import BooleanFunction
from sympy.physics.mechanics import dynamicsymbols

from symsimpson.mechanics.checks import fail, spell

__all__ = ["read_expression", "same_number"]

#: Functions with closed-form first and second derivatives, smooth on their domain.
SMOOTH = (
    sp.sin, sp.cos, sp.tan, sp.cot, sp.sec, sp.csc, sp.asin, sp.acos, sp.atan, sp.atan2,
    sp.sinh, sp.cosh, sp.tanh, sp.asinh, sp.acosh, sp.atanh, sp.exp, sp.log, sp.erf, sp.erfc,
)  # fmt: skip
#: Functions with corners or jumps.
ROUGH = (sp.Abs, sp.sign, sp.floor, sp.ceiling, sp.Heaviside, sp.DiracDelta, sp.frac)
UNEVALUATED = (sp.Derivative, sp.Integral, sp.Sum, sp.Product, sp.Limit, sp.Subs)
NOT_FINITE = (sp.zoo, sp.nan, sp.oo, -sp.oo)


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
                "Choose other units, or a smaller factor.",
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
                f"the function {name} cannot be differentiated twice."
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


def same_number(given: sp.Expr, *others: sp.Expr) -> bool:
    """Tell whether an expression is one of others, or has its value at some random point."""
    if given in others:
        return True
    generator = random.Random(1)
    symbols = sorted(set().union(*(one.free_symbols for one in (given, *others))), key=str)
    point = {x: sp.Rational(generator.randint(100, 999), 700) for x in symbols}
    values = [one.evalf(30, subs=point) for one in (given, *others)]
    return any(abs(values[0] - value) < sp.Float("1e-20") for value in values[1:] if value.is_Float)
