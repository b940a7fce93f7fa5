"""Where an expression has a real value."""

from __future__ import annotations

from collections.abc import Iterable

import sympy as sp

from symsimpson.mechanics.plain import Plain

__all__ = ["has_real_energy", "real_everywhere"]

#: Functions with a real value for every real argument; poles have none, but a step meets no point.
REAL = (
    sp.sin, sp.cos, sp.tan, sp.cot, sp.sec, sp.csc, sp.atan, sp.atan2, sp.sinh, sp.cosh, sp.tanh,
    sp.asinh, sp.exp, sp.Abs, sp.erf, sp.erfc,
)  # fmt: skip


def has_real_energy(plain: Plain) -> bool:
    """Tell whether the energy is real at all states, so that nobody need look."""
    entries = plain.mass.todok().values()
    return real_everywhere([*entries, *plain.gyroscopic, plain.potential])


def real_everywhere(expressions: Iterable[sp.Expr]) -> bool:
    """Tell whether expressions of real symbols are real wherever they have a value.

    True is certain; where SymPy cannot tell the sign of what a root or logarithm is taken of,
    the answer is False.

    Examples
    --------
    >>> import sympy as sp
    >>> x = sp.Symbol("x", real=True)
    >>> real_everywhere([sp.sqrt(1 + x**2) / x]), real_everywhere([sp.log(x)])
    (True, False)
    """
    return all(_real(node) for one in expressions for node in sp.preorder_traversal(one))


def _real(node: sp.Basic) -> bool:
    if isinstance(node, sp.exp):
        return True
    if isinstance(node, sp.Pow):
        return bool(node.exp.is_integer or node.base.is_nonnegative)
    if isinstance(node, sp.log):
        return bool(node.args[0].is_nonnegative)
    return not isinstance(node, sp.Function) or isinstance(node, REAL)
