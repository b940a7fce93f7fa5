"""Run a module's text in another arithmetic: plain floats, complex numbers, many digits.

One text serves every arithmetic. Binding it means to leave out its imports and the definitions
that name an arithmetic (``real``, ``compiled``, ``sincos``, ...) and to supply those from here.
"""

from __future__ import annotations

import ast
import cmath
import math
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np

__all__ = ["bind", "bind_complex", "bind_float", "bind_mpmath", "plain_arithmetic"]

_MATH = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh",
    "exp", "log", "sqrt",
)  # fmt: skip


def bind(source: str, arithmetic: Mapping[str, Any]) -> SimpleNamespace:
    """Execute a generated module with another arithmetic.

    Parameters
    ----------
    source : str
        Text of a module that symsimpson emitted; it is executed, so it must be trusted.
    arithmetic : mapping from str to object
        Values for the names that it imports or that stand for its arithmetic.

    Returns
    -------
    types.SimpleNamespace
        The module's functions and constants; kernels take a workspace of shape (ROWS, LANES).
    """
    tree = ast.parse(source)
    tree.body = [node for node in tree.body if not _replaced(node, arithmetic)]
    namespace: dict[str, Any] = dict(arithmetic)
    exec(compile(tree, "<generated module>", "exec"), namespace)
    return SimpleNamespace(**{k: v for k, v in namespace.items() if not k.startswith("__")})


def _replaced(node: ast.stmt, arithmetic: Mapping[str, Any]) -> bool:
    match node:
        case ast.ImportFrom() | ast.Import():
            return True
        case ast.FunctionDef(name=name) | ast.Assign(targets=[ast.Name(id=name)]):
            return name in arithmetic
    return False


def plain_arithmetic(
    functions: Mapping[str, Callable[..., Any]] | Callable[..., Any], real: Callable[..., Any]
) -> dict[str, Any]:
    """Give the names that a module takes from its arithmetic; one function may stand for all."""
    named = dict.fromkeys([*_MATH, "atan2"], functions) if callable(functions) else functions
    return {
        "pi": math.pi,
        **named,
        "real": real,
        "array": np.array,
        "carray": lambda workspace, shape: workspace,
        "compiled": lambda function: function,
    }


def bind_float(source: str) -> SimpleNamespace:
    """Bind to Python floats: the same operations as compiled, without a compiler."""
    functions = {name: getattr(math, name) for name in [*_MATH, "atan2"]}
    return bind(source, plain_arithmetic(functions, float))


def bind_complex(source: str) -> SimpleNamespace:
    """Bind to complex numbers, for derivatives by a complex step."""
    functions: dict[str, Any] = {name: getattr(cmath, name) for name in _MATH}
    functions["sincos"] = lambda x: (cmath.sin(x), cmath.cos(x))
    return bind(source, plain_arithmetic(functions, float))


def bind_mpmath(source: str) -> SimpleNamespace:
    """Bind to mpmath at its present working precision, in which the kernels must be called too."""
    names = [*_MATH, "atan2", "pi"]
    functions: dict[str, Any] = {name: getattr(mpmath.mp, name) for name in names}
    functions["sincos"] = lambda x: mpmath.mp.cos_sin(x)[::-1]
    return bind(source, plain_arithmetic(functions, mpmath.mpf))
