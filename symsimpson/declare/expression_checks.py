"""Checks of an expression: that it is one, real, smooth, and made of what was declared.

Every function raises :class:`~symsimpson.errors.ModelError` with what is wrong, where, why it
matters and what to do; none of them changes anything.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.logic.boolalg import BooleanFunction

from symsimpson.declare.checks import fail, spell
from symsimpson.declare.coordinates import time
from symsimpson.declare.plain import Symbols
from symsimpson.graph.nodes import Value
from symsimpson.graph.read import FUNCTIONS, Reader
from symsimpson.support.names import did_you_mean, shortened

#: Functions with closed-form first and second derivatives, smooth on their domain.
SMOOTH = tuple(FUNCTIONS)
#: Functions with corners or jumps.
ROUGH = (sp.Abs, sp.sign, sp.floor, sp.ceiling, sp.Heaviside, sp.DiracDelta, sp.frac, sp.Mod)
#: What is defined by cases.
CASES = (sp.Piecewise, sp.Max, sp.Min, Relational, BooleanFunction)
UNEVALUATED = (
    *(sp.Derivative, sp.Integral, sp.Sum, sp.Product, sp.Limit, sp.Subs),
    sp.UnevaluatedExpr,
)
#: What expressions are made of, besides functions.
PLAIN = (sp.Symbol, sp.Number, sp.NumberSymbol, sp.Add, sp.Mul, sp.Pow)
NOT_FINITE = (sp.zoo, sp.nan, sp.oo, -sp.oo)


def read_expression(
    system: str,
    what: str,
    expression: Any,
    symbols: Symbols,
    known: Mapping[sp.Basic, Value],
    allowed: Iterable[sp.Symbol],
) -> Value:
    """Check one expression and read it into the graph.

    ``what`` names it in messages ("kinetic energy"); ``known`` maps the user's coordinates,
    velocities and parameters to symbols of the graph, of which those in ``allowed`` may appear.
    """
    refuse = partial(fail, system)
    if isinstance(expression, str):
        raise refuse(
            f"the {what} is the string {spell(expression)!r}, not an expression.",
            "Text is never evaluated here. Write it with the SymPy symbols themselves, unquoted.",
        )
    try:
        user = sp.sympify(expression, strict=True)
    except (sp.SympifyError, AttributeError, TypeError):
        user = None
    if not isinstance(user, sp.Expr) or user.is_Matrix:
        raise refuse(
            f"the {what} is {spell(expression)!r}, not a scalar expression.",
            "Write it with SymPy symbols, functions and numbers; of a 1 by 1 matrix take [0, 0].",
        )

    def check(node: sp.Basic) -> None:
        _check_coordinate(system, what, node, known)
        check_content(system, what, node)
        if isinstance(node, sp.Symbol):
            check_declared(system, what, node, known)

    reader = Reader(symbols.graph, known, check)
    try:
        value = reader(user)
    except ZeroDivisionError:
        raise refuse(
            f"the {what} contains a division by zero.",
            "Look for a division by zero or an overflow where the expression is built.",
        ) from None
    _check_real(system, what, reader, value, symbols)
    _check_place(system, what, value, known, set(symbols.numbers(allowed)), symbols)
    return value


def _check_real(system: str, what: str, reader: Reader, value: Value, symbols: Symbols) -> None:
    """Refuse roots and logarithms of what is negative everywhere."""
    signs = symbols.signs
    for n in symbols.graph.reached([value[1]]):
        if signs.never_real(n):
            node = next((user for user, (_, m) in reader.done.items() if m == n), what)
            raise fail(
                system,
                f"the {what} contains {spell(node)}, which is not real.",
                "Energies are real. Look for the root, power or logarithm of a negative number.",
            )


def _check_place(
    system: str,
    what: str,
    value: Value,
    known: Mapping[sp.Basic, Value],
    allowed: set[int],
    symbols: Symbols,
) -> None:
    """Refuse symbols that were declared, but not for this place."""
    wrong = symbols.graph.nodes[value[1]].symbols - allowed
    for symbol, (_, n) in known.items():
        if n in wrong:
            velocity = isinstance(symbol, sp.Derivative)
            if n in symbols.numbers(symbols.u):
                raise fail(
                    system,
                    f"the {what} depends on the input {spell(symbol)}.",
                    "Inputs stand in forces: write what it does as one, forces={q: ...}; the force "
                    "of a potential V is -dV/dq.",
                )
            raise fail(
                system,
                f"the {what} depends on the {'velocity' if velocity else 'symbol'} "
                f"{spell(symbol)}.",
                "A potential depends on positions alone. Move terms that are linear in the "
                "velocities to a Lagrangian: MechanicalSystem.from_lagrangian(name, L, ...)."
                if velocity and what == "potential"
                else f"It follows from the positions alone: leave {spell(symbol)} out of it.",
            )


def _check_form(system: str, what: str, node: sp.Expr) -> None:
    """Refuse an unknown function of coordinates, which cannot be one itself."""
    if any(argument.atoms(AppliedUndef) for argument in node.args):
        raise fail(
            system,
            f"the {what} contains {spell(node)}, a function of coordinates without a form.",
            "Its values and derivatives must be known. Put in its expression: "
            f".subs({spell(node)}, ...).doit().",
        )


def _check_coordinate(
    system: str, what: str, node: sp.Basic, known: Mapping[sp.Basic, Value]
) -> None:
    """Refuse a coordinate, or its velocity, that is a function of another time."""
    user = node.expr if isinstance(node, sp.Derivative) else node
    if user in known or not isinstance(user, AppliedUndef) or len(user.args) != 1:
        return
    for x in known:
        if isinstance(x, AppliedUndef) and x.func.__name__ == user.func.__name__:
            same = str(user) == str(x)
            raise fail(
                system,
                f"the {what} contains {shortened(user)}, which is not the coordinate {x}: "
                + (
                    "its time is a symbol with other assumptions."
                    if same
                    else "its argument is not the time."
                ),
                "Write the coordinate in its place, as symsimpson.coordinates made it; the time is "
                "symsimpson.time.",
            )


def check_content(system: str, what: str, node: sp.Basic) -> None:
    """Refuse what has no value, no derivative or no real value."""
    refuse = partial(fail, system)
    if isinstance(node, UNEVALUATED):
        if isinstance(node, sp.Derivative) and isinstance(node.expr, AppliedUndef):
            _check_form(system, what, node.expr)
            order = node.derivative_count
            raise refuse(
                f"the {what} contains {spell(node)}, "
                + (f"a derivative of order {order}." if order > 1 else "an unknown velocity."),
                "Energies and forces depend on the declared coordinates and their first "
                f"derivatives. Declare the coordinate, or drop the term; if {spell(node.expr)} is "
                f"a given function of time, put in its expression: L.subs({spell(node.expr)}, "
                "...).doit().",
            )
        raise refuse(
            f"the {what} contains the unevaluated {type(node).__name__} {spell(node)}.",
            "It must be differentiated and compiled. Evaluate it first with .doit().",
        )
    if isinstance(node, AppliedUndef):
        _check_form(system, what, node)
        raise refuse(
            f"the {what} contains {spell(node)}, which is neither a declared coordinate nor a "
            "function with a known form.",
            f"Add it to the coordinates. If its values are given to each run, as those of a motor, "
            f"it is an input of forces: inputs=({spell(node)},). If it is a given function of "
            f"time, put in its expression: .subs({spell(node)}, ...).doit().",
        )
    if node in NOT_FINITE:
        raise refuse(
            f"the {what} contains {node}, which is no finite number.",
            "Look for a division by zero or an overflow where the expression is built.",
        )
    called = isinstance(node, sp.Function)
    known = isinstance(node, SMOOTH) if called else not isinstance(node, CASES)
    number = _number(node) if known else None
    if _not_real(node, number):
        raise refuse(
            f"the {what} contains {spell(node)}, which is not real.",
            "Energies are real. Look for the root, power or logarithm of a negative number.",
        )
    if number is not None and not number.is_zero:
        large = not abs(number) <= sys.float_info.max
        if large or float(number) == 0:
            size, other = ("larger", "smaller") if large else ("smaller", "larger")
            raise refuse(
                f"the {what} contains the number {spell(node)} = {sp.N(number, 3)}, {size} than "
                "doubles can be.",
                f"Choose other units, or a {other} factor.",
            )
    if known and not isinstance(node, (*PLAIN, sp.Function)):
        raise refuse(
            f"the {what} contains {spell(node)}, a {type(node).__name__}.",
            "Write it with symbols, numbers, sums, products, powers and functions.",
        )
    if known:
        return
    if _of_time_alone(node):
        name = type(node).__name__
        jumps = isinstance(node, (*CASES, *ROUGH))
        raise refuse(
            f"the {what} contains {spell(node)}, a function of time "
            + ("with jumps or corners." if jumps else f"that compiled code does not have: {name}."),
            "A step across a jump loses the order of the scheme, and the equations are "
            "differentiated. Let a force have an input in its place, forces={q: u}, inputs=(u,): "
            "its values are given to each run, integrate(..., inputs={'u': "
            "symsimpson.samples(values, period=...)}). Or run from jump to jump, each run from "
            "the end of the one before; or write a smooth step, (1 + tanh((t - t1)/eps))/2.",
        )
    if not node.atoms(AppliedUndef):
        of = "parameters" if node.free_symbols else "numbers"
        raise refuse(
            f"the {what} contains {spell(node)}, which is made of {of} alone, by a function "
            "that compiled code does not have.",
            "Evaluate it first: replace it by its value, "
            + ("in a parameter of its own." if node.free_symbols else f"{spell(sp.N(node, 17))}."),
        )
    if isinstance(node, CASES):
        raise refuse(
            f"the {what} contains {spell(node)}, which is defined by cases.",
            "Newton's method needs two continuous derivatives. Use a smooth expression, as "
            "(x + sqrt(x**2 + eps**2))/2 for Max(x, 0); or a system for each case: a run that "
            "symsimpson.Event(x, terminal=True) ends tells where the other goes on.",
        )
    name = node.func.__name__
    raise refuse(
        f"the {what} contains {spell(node)}: "
        + (
            f"the function {name} cannot be differentiated twice."
            if isinstance(node, ROUGH)
            else f"{name}, or its derivatives, are not among the functions of C's mathematics "
            "library, which compiled code calls."
        ),
        (
            "Use a smooth form, such as sqrt(x**2 + eps**2) for |x| or tanh(x/eps) for its sign (a "
            "step must then resolve eps), or one of "
            if isinstance(node, ROUGH)
            else "Approximate it on the range of the motion, by a polynomial, say; or write it by "
            "powers and "
        )
        + ", ".join(sorted(f.__name__ for f in SMOOTH))
        + ".",
    )


def _of_time_alone(node: sp.Basic) -> bool:
    """Return whether the time decides what a function is, and no coordinate does."""
    deciding = [case for _, case in node.args] if isinstance(node, sp.Piecewise) else [node]
    return any(time in part.free_symbols for part in deciding) and not any(
        part.atoms(AppliedUndef) for part in deciding
    )


def _not_real(node: sp.Basic, number: sp.Expr | None) -> bool:
    """Return whether a node is not real, or is not for all exponents that come up."""
    if node is sp.I or (number is not None and number.is_extended_real is False):
        return True
    return bool(
        isinstance(node, sp.Pow)
        and node.base.is_number
        and node.base.is_negative
        and not node.exp.is_integer
    )


def _number(node: sp.Basic) -> sp.Expr | None:
    """Return the value of a node that contains no symbols, None of others."""
    if not getattr(node, "is_number", False):
        return None
    return node if node.is_Number else sp.N(node, 15)


def check_declared(
    system: str, what: str, symbol: sp.Symbol, known: Mapping[sp.Basic, Value]
) -> None:
    """Refuse a symbol that was not declared."""
    refuse = partial(fail, system)
    declared = {str(s): s for s in known if isinstance(s, sp.Symbol)}
    if declared.get(symbol.name) == time:
        raise refuse(
            f"the {what} contains a symbol {symbol.name} that is not the time: it has other "
            "assumptions.",
            "SymPy holds them apart. The time is symsimpson.time.",
        )
    functions = {x.func.__name__: x for x in known if isinstance(x, AppliedUndef)}
    momentum_of = {f"p_{name}": x for name, x in functions.items()}.get(symbol.name)
    if symbol.name in declared and momentum_of is not None:
        raise refuse(
            f"the {what} contains a symbol {symbol.name}, which is not the momentum of that name: "
            "it has other assumptions.",
            f"SymPy holds them apart. Write (p,) = symsimpson.momenta({momentum_of.func.__name__})"
            " and p in its place.",
        )
    if symbol.name in declared:
        raise refuse(
            f"two symbols of one name, '{symbol.name}': the {what} contains one, the "
            "parameters another, with different assumptions.",
            "SymPy holds them apart, so the value would not arrive. "
            "Make the symbol once and use it everywhere.",
        )
    if symbol.name in functions:
        raise refuse(
            f"the {what} contains a symbol {symbol.name}, which is not the coordinate of that "
            f"name: that is a function of time, {functions[symbol.name]}.",
            "Write the coordinate in its place, as symsimpson.coordinates made it.",
        )
    hint = did_you_mean(symbol.name, declared)
    if what == "kinetic energy":
        hint += " A velocity is the derivative of a coordinate, q.diff()."
    raise refuse(
        f"the {what} contains the unknown symbol {symbol.name}: it is neither a coordinate "
        f"nor a parameter with a value.{hint}",
        f"Give it a value: parameters={{..., {symbol.name}: 1.0}}, "
        "or make it a coordinate with symsimpson.coordinates, or an input of forces: "
        f"inputs=({symbol.name},).",
    )
