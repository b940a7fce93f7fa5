"""Replacement of integers that are too large for NumPy in SymPy expressions."""

from __future__ import annotations

from typing import Any

#: The largest int64. NumPy stores larger integers in arrays of objects, which Numba rejects.
LARGEST = 2**63 - 1


def float_literals(expression: Any) -> Any:
    """Replace rational numbers whose numerator or denominator exceeds int64 by floats.

    Otherwise ``lambdify`` prints them as Python integers, and NumPy makes arrays of objects.
    ``expression`` is a SymPy expression or matrix, or a nested list or tuple of these.

    Examples
    --------
    >>> import sympy as sp
    >>> x = sp.Symbol("x")
    >>> float_literals([10**20 * x, 3 * x])
    [1.0e+20*x, 3*x]
    """
    import sympy as sp  # slow to import; the caller has imported it

    if isinstance(expression, (list, tuple)):
        return type(expression)(float_literals(part) for part in expression)
    large = {
        x: sp.Float(x, 17) for x in expression.atoms(sp.Rational) if max(abs(x.p), x.q) > LARGEST
    }
    return expression.xreplace(large) if large else expression
