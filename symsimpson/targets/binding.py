"""Execute a generated module with another arithmetic: many digits, or Python numbers.

One text serves every arithmetic. Binding removes the imports of the text and its definitions of
arithmetic names (``real``, ``compiled``, ``sincos``, ...), and supplies other definitions.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np

from symsimpson.text.interface import MATH

#: Functions of a module that check the convergence of an iteration.
_CHECKS = (
    "check_convergence",
    "check_rounding",
    "expect_rounding",
    "check_acceptance",
    "check_stage_convergence",
    "check_stage_acceptance",
    "check_turns",
)


def bind(source: str | ast.Module, arithmetic: Mapping[str, Any]) -> SimpleNamespace:
    """Execute a generated module with another arithmetic.

    Parameters
    ----------
    source : str or ast.Module
        Text or syntax tree of a generated module. The function executes it, so it must be trusted.
    arithmetic : mapping from str to object
        Values of the imported names and of the arithmetic names.

    Returns
    -------
    types.SimpleNamespace
        The functions and constants of the module. Kernels take a workspace of shape (ROWS, LANES).
    """
    tree = ast.parse(source) if isinstance(source, str) else source
    tree.body = [node for node in tree.body if not _is_replaced(node, arithmetic)]
    if "raised" in arithmetic:
        tree = ast.fix_missing_locations(_OperatorReplacer(arithmetic).visit(tree))
    namespace: dict[str, Any] = dict(arithmetic)
    exec(compile(tree, "<generated module>", "exec"), namespace)
    return SimpleNamespace(**{k: v for k, v in namespace.items() if not k.startswith("__")})


def _is_replaced(node: ast.stmt, arithmetic: Mapping[str, Any]) -> bool:
    """Return True if a statement is an import, or defines a name of the arithmetic."""
    match node:
        case ast.ImportFrom() | ast.Import():
            return True
        case ast.FunctionDef(name=name) | ast.Assign(targets=[ast.Name(id=name)]):
            return name in arithmetic
    return False


def plain_arithmetic(
    functions: Mapping[str, Callable[..., Any]] | Callable[..., Any],
    real: Callable[..., Any],
    digits: int | None = None,
) -> dict[str, Any]:
    """Return the arithmetic names of a module and their values.

    ``functions`` has the elementary functions by name, or one function for all of them. With
    ``digits``, the kernels check convergence with thresholds for this number of digits. Without it,
    the checks do nothing.
    """
    named = dict.fromkeys([*MATH, "atan2"], functions) if callable(functions) else functions

    def nothing(W: Any, lane: int) -> None:
        """Replace a check of convergence: the caller decides when to stop."""

    checking: dict[str, Any] = dict.fromkeys(_CHECKS, nothing)
    if digits is not None:
        unit = real(10) ** -digits
        checking = {
            "NEGLIGIBLE": 4 * unit**2,
            "OWN_NEGLIGIBLE": real(10) ** -(3 * digits // 2),
            "OWN_ROUNDED": 1e8 * unit**4,
            "STAGNATION": unit,
            "ROUNDED": 1e4 * unit**2,
            "LOST": unit**2,
            "ROUNDING": unit**2,
            "STALLED": 1e4 * unit**2,
            "NOISE": 40 * unit**2,
        }
    return {
        "pi": math.pi,
        "FRESH": real(2) ** 60,  # always evaluate sine and cosine: rotating them needs doubles
        **checking,
        **named,
        "real": real,
        "array": np.array,
        "carray": lambda workspace, shape: workspace,
        "compiled": lambda function: function,
    }


def bind_mpmath(
    source: str, context: Any = mpmath.mp, *, checking: bool = False
) -> SimpleNamespace:
    """Bind a module to mpmath at the precision of ``context``, which calls of kernels need, too."""
    nan, not_real = context.nan, (context.mpc, complex)

    def real_valued(function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that gives NaN instead of a complex value, like compiled code."""

        def evaluated(*arguments: Any) -> Any:
            try:
                value = function(*arguments)
            except (ZeroDivisionError, ValueError):
                return nan
            return nan if isinstance(value, not_real) else value

        return evaluated

    def divide(a: Any, b: Any) -> Any:
        return a / b if b else (a * context.inf if a == a else nan)

    functions: dict[str, Any] = {
        name: real_valued(getattr(context, name)) for name in (*MATH, "atan2")
    }
    functions["pi"] = +context.pi
    functions |= {"EULER_GAMMA": +context.euler, "CATALAN": +context.catalan}
    functions["TINY"] = context.mpf(2) ** (-4 * context.prec)
    functions["sincos"] = lambda x: context.cos_sin(x)[::-1]
    functions["raised"] = real_valued(lambda a, b: a**b)
    functions["divided"] = divide
    functions |= _table_names(context.mpf, context.dps)
    digits = context.dps if checking else None
    return bind(source, plain_arithmetic(functions, context.mpf, digits))


def bind_arb(source: str) -> SimpleNamespace:
    """Bind a module to the ball arithmetic of python-flint, at the precision of ``flint.ctx``."""
    from flint import arb, ctx

    def method(name: str) -> Callable[[Any], Any]:
        return lambda x: getattr(arb(x), name)()

    functions: dict[str, Any] = {name: method(name) for name in MATH}
    functions["pi"] = arb.pi()
    functions |= {"EULER_GAMMA": arb.const_euler(), "CATALAN": arb.const_catalan()}
    functions["TINY"] = arb(2) ** (-4 * ctx.prec)
    functions["atan2"] = lambda y, x: arb.atan2(arb(y), arb(x))
    functions["sincos"] = method("sin_cos")
    functions["raised"] = _power
    functions |= _table_names(arb, ctx.dps)

    def checked(function: Callable[..., Any]) -> Callable[..., Any]:
        """Replace balls by their midpoints before a check, because balls cannot be compared."""
        if function.__name__ not in (*_CHECKS, "check_drift", "momentum_gap", "correct_velocity"):
            return function

        def middle(value: Any) -> Any:
            return value.mid() if type(value) is arb else value

        def on_midpoints(W: Any, *others: Any) -> Any:
            column = W[:, others[-1]]
            column[:] = [*map(middle, column)]
            return middle(function(W, *map(middle, others)))

        return on_midpoints

    arithmetic = plain_arithmetic(functions, arb, ctx.dps)
    return bind(source, arithmetic | {"compiled": checked})


def _table_names(real: Callable[..., Any], digits: int) -> dict[str, Any]:
    """Return the names by which a module computes its tables, with 20 extra digits."""
    scale = digits + 20

    def number(units: int) -> Any:
        return real(units) / real(10) ** scale

    return {"DIGITS": scale, "ONE": 10**scale, "number": number, "on_grid": number}


def _power(base: Any, exponent: Any) -> Any:
    """Return a power; products avoid the logarithm, which a ball around zero does not have."""
    if not isinstance(exponent, int) or exponent < 1:
        return base**exponent
    result = base
    for _ in range(exponent - 1):
        result = result * base
    return result


class _OperatorReplacer(ast.NodeTransformer):
    """Replaces a**b by raised(a, b) and a/b by divided(a, b), if an arithmetic has these names."""

    def __init__(self, arithmetic: Mapping[str, Any]) -> None:
        named = {ast.Pow: "raised", ast.Div: "divided"}
        self._named = {kind: name for kind, name in named.items() if name in arithmetic}

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        name = self._named.get(type(node.op))
        if name is None:
            return node
        return ast.Call(ast.Name(name, ast.Load()), [node.left, node.right], [])
