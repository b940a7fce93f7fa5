"""Does an expression vanish, does it depend on a symbol: proved, refused, or left open.

Algebra alone grants. Samples at 60 digits only refuse, which saves the algebra where it would be
in vain; what neither decides counts as dependent.
"""

from __future__ import annotations

from collections.abc import Iterable

import sympy as sp

from symsimpson.mechanics.terms import Sum

__all__ = ["Simplifier", "vanishes"]

DIGITS = 60
#: Where sums of terms of size one end that vanish identically.
NOTHING = sp.Float(10) ** -45
#: Points of the samples; two, because one may be a zero by chance.
SAMPLES = (sp.Rational(37, 53), sp.Rational(29, 23))
#: Expressions with more operations than this are not simplified at length.
TOO_LONG = 400


def vanishes(expression: sp.Expr) -> bool | None:
    """Tell whether an expression is zero for all values of its symbols; None if undecided."""
    if expression.is_zero or (not expression.free_symbols and sp.expand(expression) == 0):
        return True
    for sample in SAMPLES:
        value = _sample(expression, sample)
        if value is not None and abs(value) > NOTHING:
            return False
    if sp.expand(expression) == 0:
        return True
    if sp.count_ops(expression) > TOO_LONG:
        return None
    return True if sp.simplify(expression) == 0 else None


def _sample(expression: sp.Expr, point: sp.Rational) -> sp.Expr | None:
    """Evaluate at a point, a different number for each symbol; None off the domain."""
    symbols = sorted(expression.free_symbols, key=str)
    values = {
        s: (point + sp.Rational(k, 7 + k)) * (-1 if s.is_negative else 1)
        for k, s in enumerate(symbols)
    }
    value = expression.evalf(DIGITS, subs=values, maxn=4 * DIGITS)
    return value if value.is_number and value.is_finite else None


class Simplifier:
    """Rewrites expressions without the symbols that they do not depend on.

    ``open_questions`` collects what could be neither proved nor refused.
    """

    def __init__(self, symbols: Iterable[sp.Symbol]) -> None:
        self._symbols = set(symbols)
        self.open_questions: list[tuple[str, sp.Symbol]] = []

    def __call__(self, what: str, expression: sp.Expr) -> sp.Expr:
        """Give an equal expression; ``what`` names it in open questions."""
        present = expression.free_symbols & self._symbols
        if not present:
            return sp.S.Zero if vanishes(expression) else expression
        terms = Sum(expression, present)
        for symbol in sorted(present, key=_number):
            slope = terms.diff(symbol)
            if symbol not in slope.free_symbols and slope.is_number and slope != 0:
                continue
            answer = vanishes(slope)
            if answer is None:
                self.open_questions.append((what, symbol))
            elif answer and (fixed := fix(expression, symbol)) is not None:
                expression = fixed
                terms = Sum(expression, present)
        return expression


def fix(expression: sp.Expr, symbol: sp.Symbol) -> sp.Expr | None:
    """Put a number for a symbol that the expression does not depend on."""
    for value in (0, 1, sp.Rational(1, 2)):
        fixed = expression.subs(symbol, value)
        if not fixed.has(sp.nan, sp.zoo, sp.oo, -sp.oo):
            return fixed
    return None


def _number(symbol: sp.Symbol) -> tuple[int, str]:
    return len(symbol.name), symbol.name
