"""Numbers in expressions as functions of floats can take them."""

from __future__ import annotations

from typing import Any

#: NumPy and Numba take no larger whole numbers: arrays of them are of objects.
LARGEST = 2**63 - 1


def float_literals(expression: Any) -> Any:
    """Write whole numbers and parts of fractions that no int64 holds as floats.

    Printed as they are, they would be integers of Python, of which NumPy makes arrays of objects.
    Expressions and matrices of SymPy are taken, and lists or tuples of such, of any depth.

    Examples
    --------
    >>> import sympy as sp
    >>> x = sp.Symbol("x")
    >>> float_literals([10**20 * x, 3 * x])
    [1.0e+20*x, 3*x]
    """
    import sympy as sp  # slow to import, and there by now

    if isinstance(expression, (list, tuple)):
        return type(expression)(float_literals(part) for part in expression)
    large = {
        x: sp.Float(x, 17) for x in expression.atoms(sp.Rational) if max(abs(x.p), x.q) > LARGEST
    }
    return expression.xreplace(large) if large else expression
