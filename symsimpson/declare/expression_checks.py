"""Checks of an expression: a smooth real scalar that contains declared symbols only.

Every function raises :class:`~symsimpson.errors.ModelError` for an invalid expression, and
changes nothing.
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

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.coordinates import time
from symsimpson.declare.plain import Symbols
from symsimpson.graph.nodes import Value
from symsimpson.graph.read import FUNCTIONS, SympyConverter
from symsimpson.support.names import did_you_mean, shortened

#: Functions with closed-form first and second derivatives, smooth on their domain.
SMOOTH = tuple(FUNCTIONS)
#: Functions with corners or jumps.
ROUGH = (sp.Abs, sp.sign, sp.floor, sp.ceiling, sp.Heaviside, sp.DiracDelta, sp.frac, sp.Mod)
#: Piecewise definitions and conditions.
CASES = (sp.Piecewise, sp.Max, sp.Min, Relational, BooleanFunction)
UNEVALUATED = (
    *(sp.Derivative, sp.Integral, sp.Sum, sp.Product, sp.Limit, sp.Subs),
    sp.UnevaluatedExpr,
)
#: Nodes that an expression may contain besides functions.
PLAIN = (sp.Symbol, sp.Number, sp.NumberSymbol, sp.Add, sp.Mul, sp.Pow)
NOT_FINITE = (sp.zoo, sp.nan, sp.oo, -sp.oo)
#: Remedies for two errors that several checks find.
NOT_REAL = "Energies are real. Look for the root, power or logarithm of a negative number."
DIVISION = "Look for a division by zero or an overflow in the code that builds the expression."


def read_expression(
    system: str,
    what: str,
    expression: Any,
    symbols: Symbols,
    known: Mapping[sp.Basic, Value],
    allowed: Iterable[sp.Symbol],
) -> Value:
    """Check one expression and read it into the graph.

    Messages name the system and the expression, for example "kinetic energy". The mapping
    ``known`` has the nodes of the user's coordinates, velocities, parameters and inputs. The
    expression may contain only the plain symbols in ``allowed``.
    """
    reject_here = partial(reject_model, system)
    if isinstance(expression, str):
        reject_here(
            f"the {what} is the string {spell(expression)!r}, not an expression. "
            "The package never evaluates text.",
            "Write the SymPy symbols themselves, without quotes.",
        )
    try:
        user = sp.sympify(expression, strict=True)
    except (sp.SympifyError, AttributeError, TypeError):
        user = None
    if not isinstance(user, sp.Expr) or user.is_Matrix:
        reject_here(
            f"the {what} is {spell(expression)!r}, not a scalar expression.",
            "Write it with SymPy symbols, functions and numbers. For a 1 by 1 matrix, pass its "
            "entry [0, 0].",
        )

    def check(node: sp.Basic) -> None:
        _check_coordinate(system, what, node, known)
        check_content(system, what, node)
        if isinstance(node, sp.Symbol):
            check_declared(system, what, node, known)

    reader = SympyConverter(symbols.graph, known, check)
    try:
        value = reader(user)
    except ZeroDivisionError:
        reject_here(f"the {what} contains a division by zero.", DIVISION)
    for n in symbols.graph.descendants([value[1]]):
        if symbols.signs.never_real(n):
            node = next((x for x, (_, m) in reader.done.items() if m == n), what)
            reject_here(f"the {what} contains {spell(node)}, which is not real.", NOT_REAL)
    _check_place(system, what, value, known, set(symbols.numbers(allowed)), symbols)
    return value


def _check_place(
    system: str,
    what: str,
    value: Value,
    known: Mapping[sp.Basic, Value],
    allowed: set[int],
    symbols: Symbols,
) -> None:
    """Reject declared symbols that this expression may not contain, such as v in a potential."""
    wrong = symbols.graph.nodes[value[1]].symbols - allowed
    for symbol, (_, n) in known.items():
        if n not in wrong:
            continue
        if n in symbols.numbers(symbols.u):
            reject_model(
                system,
                f"the {what} depends on the input {spell(symbol)}. Only forces may contain inputs.",
                "Write its effect as a force, forces={q: ...}. The force of a potential V is "
                "-dV/dq.",
            )
        velocity = isinstance(symbol, sp.Derivative)
        reject_model(
            system,
            f"the {what} depends on the {'velocity' if velocity else 'symbol'} {spell(symbol)}.",
            "A potential depends on positions only. Move terms that are linear in the velocities "
            "to a Lagrangian: MechanicalSystem.from_lagrangian(name, L, ...)."
            if velocity and what == "potential"
            else f"It may depend on positions only. Remove {spell(symbol)}.",
        )


def _check_form(system: str, what: str, node: sp.Expr) -> None:
    """Reject an undefined function of coordinates."""
    if any(argument.atoms(AppliedUndef) for argument in node.args):
        reject_model(
            system,
            f"the {what} contains {spell(node)}, an undefined function of coordinates. "
            "Its values and derivatives are unknown.",
            f"Substitute its expression: .subs({spell(node)}, ...).doit().",
        )


def _check_coordinate(
    system: str, what: str, node: sp.Basic, known: Mapping[sp.Basic, Value]
) -> None:
    """Reject a function with the name of a coordinate whose argument is not the time."""
    user = node.expr if isinstance(node, sp.Derivative) else node
    if user in known or not isinstance(user, AppliedUndef) or len(user.args) != 1:
        return
    for x in known:
        if isinstance(x, AppliedUndef) and x.func.__name__ == user.func.__name__:
            why = "Its argument is not the time."
            if str(user) == str(x):
                why = "Its time is a symbol with other assumptions."
            reject_model(
                system,
                f"the {what} contains {shortened(user)}, which is not the coordinate {x}. {why}",
                "Write the coordinate that symsimpson.coordinates returned. The time is "
                "symsimpson.time.",
            )


def check_content(system: str, what: str, node: sp.Basic) -> None:
    """Reject a node that has no value, is not real, or cannot be differentiated twice."""
    reject_here = partial(reject_model, system)
    if isinstance(node, UNEVALUATED):
        if isinstance(node, sp.Derivative) and isinstance(node.expr, AppliedUndef):
            _check_form(system, what, node.expr)
            order, user = node.derivative_count, spell(node.expr)
            reject_here(
                f"the {what} contains {spell(node)}, "
                + (f"a derivative of order {order}." if order > 1 else "an unknown velocity.")
                + " Energies and forces depend on declared coordinates and their first derivatives "
                "only.",
                f"Declare the coordinate, or remove the term. If {user} is a given function of "
                f"time, substitute its expression: L.subs({user}, ...).doit().",
            )
        reject_here(
            f"the {what} contains the unevaluated {type(node).__name__} {spell(node)}. "
            "It cannot be differentiated and compiled.",
            "Evaluate it first with .doit().",
        )
    if isinstance(node, AppliedUndef):
        _check_form(system, what, node)
        reject_here(
            f"the {what} contains {spell(node)}, which is neither a declared coordinate nor a "
            "function with a known form.",
            f"Add it to the coordinates. If each run provides its values, as for a motor, declare "
            f"an input of forces: inputs=({spell(node)},). If it is a given function of time, "
            f"substitute its expression: .subs({spell(node)}, ...).doit().",
        )
    if node in NOT_FINITE:
        reject_here(f"the {what} contains {node}, which is not a finite number.", DIVISION)
    called = isinstance(node, sp.Function)
    known = isinstance(node, SMOOTH) if called else not isinstance(node, CASES)
    number = _number(node) if known else None
    if _is_not_real(node, number):
        reject_here(f"the {what} contains {spell(node)}, which is not real.", NOT_REAL)
    if number is not None and not number.is_zero:
        large = not abs(number) <= sys.float_info.max
        if large or float(number) == 0:
            size, other = ("larger", "smaller") if large else ("smaller", "larger")
            reject_here(
                f"the {what} contains the number {spell(node)} = {sp.N(number, 3)}, {size} than "
                "doubles can be.",
                f"Choose other units, or a {other} factor.",
            )
    if known and not isinstance(node, (*PLAIN, sp.Function)):
        reject_here(
            f"the {what} contains {spell(node)}, a {type(node).__name__}.",
            "Write it with symbols, numbers, sums, products, powers and functions.",
        )
    if known:
        return
    contains, name = f"the {what} contains {spell(node)}", type(node).__name__
    if _depends_on_time_only(node):
        jumps = isinstance(node, (*CASES, *ROUGH))
        reject_here(
            f"{contains}, a function of time "
            + ("with jumps or corners." if jumps else f"that compiled code does not have: {name}.")
            + " The equations are differentiated, and a step across a jump loses the order of the "
            "scheme.",
            "Replace it by an input of a force: forces={q: u}, inputs=(u,). Each run provides the "
            "values: integrate(..., inputs={'u': symsimpson.samples(values, period=...)}). "
            "Or integrate from jump to jump, and begin each run at the end of the previous one. "
            "Or write a smooth step: (1 + tanh((t - t1)/eps))/2.",
        )
    if not node.atoms(AppliedUndef):
        of = "parameters" if node.free_symbols else "numbers"
        value = "a new parameter" if node.free_symbols else spell(sp.N(node, 17))
        reject_here(
            f"{contains}, a function of {of} only that compiled code does not have.",
            f"Evaluate it first, and replace it by {value}.",
        )
    if isinstance(node, CASES):
        reject_here(
            f"{contains}, which is defined by cases. Newton's method needs two continuous "
            "derivatives.",
            "Use a smooth expression: (x + sqrt(x**2 + eps**2))/2 for Max(x, 0). Or declare a "
            "system for each case: end a run with symsimpson.Event(x, terminal=True), and begin "
            "the next one there.",
        )
    smooth = ", ".join(sorted(f.__name__ for f in SMOOTH))
    if isinstance(node, sp.sign):
        reject_here(
            f"{contains}: the function sign jumps.",
            "For dry friction, declare friction={'pad': symsimpson.Friction(velocity, limit=...)}, "
            "which also sticks. For another force, write tanh(x/eps); a step must resolve eps.",
        )
    if isinstance(node, ROUGH):
        reject_here(
            f"{contains}: the function {name} cannot be differentiated twice.",
            "Use a smooth form: sqrt(x**2 + eps**2) for |x|. A step "
            f"must then resolve eps. Or use one of {smooth}.",
        )
    reject_here(
        f"{contains}. Compiled code calls C's mathematics library, which lacks {name} or its "
        "derivatives.",
        "Approximate it on the range of the motion, for example by a polynomial. Or write it with "
        f"powers and {smooth}.",
    )


def _depends_on_time_only(node: sp.Basic) -> bool:
    """Return whether a function, or the conditions of its cases, contain t but no coordinate."""
    deciding = [case for _, case in node.args] if isinstance(node, sp.Piecewise) else [node]
    return any(time in part.free_symbols for part in deciding) and not any(
        part.atoms(AppliedUndef) for part in deciding
    )


def _is_not_real(node: sp.Basic, number: sp.Expr | None) -> bool:
    """Return whether a node is not real, or is a power of a negative number that may not be."""
    if node is sp.I or (number is not None and number.is_extended_real is False):
        return True
    return bool(
        isinstance(node, sp.Pow)
        and node.base.is_number
        and node.base.is_negative
        and not node.exp.is_integer
    )


def _number(node: sp.Basic) -> sp.Expr | None:
    """Return the value of a node without symbols, and None for other nodes."""
    if not getattr(node, "is_number", False):
        return None
    return node if node.is_Number else sp.N(node, 15)


def check_declared(
    system: str, what: str, symbol: sp.Symbol, known: Mapping[sp.Basic, Value]
) -> None:
    """Reject a symbol that was not declared."""
    reject_here = partial(reject_model, system)
    name, contains = symbol.name, f"the {what} contains a symbol {symbol.name}"
    declared = {str(s): s for s in known if isinstance(s, sp.Symbol)}
    if declared.get(name) == time:
        reject_here(
            f"{contains} that is not the time. Its assumptions differ, so SymPy takes it for "
            "another symbol.",
            "Use symsimpson.time.",
        )
    functions = {x.func.__name__: x for x in known if isinstance(x, AppliedUndef)}
    momentum_of = {f"p_{q}": x for q, x in functions.items()}.get(name)
    if name in declared and momentum_of is not None:
        reject_here(
            f"{contains}, which is not the momentum of that name. Its assumptions differ, so "
            "SymPy takes it for another symbol.",
            f"Write (p,) = symsimpson.momenta({momentum_of.func.__name__}), and use p instead.",
        )
    if name in declared:
        reject_here(
            f"two symbols have the name '{name}': the {what} contains one, the parameters another. "
            "Their assumptions differ, so the value would not reach the expression.",
            "Create the symbol once and use it everywhere.",
        )
    if name in functions:
        reject_here(
            f"{contains}, which is not the coordinate of that name. The coordinate is a function "
            f"of time, {functions[name]}.",
            "Write the coordinate that symsimpson.coordinates returned.",
        )
    hint = did_you_mean(name, declared)
    if what == "kinetic energy":
        hint += " A velocity is the derivative of a coordinate, q.diff()."
    reject_here(
        f"the {what} contains the unknown symbol {name}. It is neither a coordinate nor a "
        f"parameter with a value.{hint}",
        f"Add a value: parameters={{..., {name}: 1.0}}. Or make it a coordinate with "
        f"symsimpson.coordinates, or an input of forces: inputs=({name},).",
    )
