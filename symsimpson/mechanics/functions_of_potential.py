"""Functions of positions that are functions of the potential alone."""

from __future__ import annotations

import random
from fractions import Fraction

import mpmath
import sympy as sp

from symsimpson.mechanics.declared import Declared

__all__ = ["function_of_level", "level"]

#: Stands for V in functions of it.
level = sp.Symbol("level", real=True)
#: Where a power of V is looked for, and with how many digits.
POINTS, DIGITS = 4, 40
#: Powers have denominators up to this.
LARGEST = 12


def function_of_level(system: Declared, value: sp.Expr) -> sp.Expr | None:
    """Return a function of positions as one of V, with :data:`level` in its place.

    None if V does not stand in it as a whole, and it is no constant times a power of -V: that is
    returned without the constant.
    """
    V, coordinates = system.potential, system.coordinates
    for sign in (1, -1):
        expression = value.subs(sign * V, sign * level)
        if not expression.has(*coordinates) and expression.has(level):
            return expression
    power = _power(system, value)
    return None if power is None else (-level) ** power


def _power(system: Declared, value: sp.Expr) -> sp.Rational | None:
    """Return the power s of a constant times (-V)^s, from slopes at some points; None if none."""
    plain = {q: sp.Dummy() for q in system.coordinates}
    others = sorted(
        (system.potential.free_symbols | value.free_symbols) - {*system.coordinates}, key=str
    )
    V, g = (x.xreplace(plain) for x in (system.potential, value))
    slopes = [x.diff(q) for x in (V, g) for q in plain.values()]
    arguments = [*plain.values(), *(a for a in others if a.is_Symbol)]
    evaluate = sp.lambdify(arguments, [V, g, *slopes], "mpmath")
    numbers, powers = random.Random(1), []
    with mpmath.workdps(DIGITS):
        small = mpmath.mpf(10) ** (DIGITS // -2)
        for _ in range(POINTS):
            try:
                v, u, *d = evaluate(*(mpmath.mpf(numbers.uniform(0.3, 1.7)) for _ in arguments))
            except (ZeroDivisionError, ValueError, TypeError, NameError):
                return None
            if any(isinstance(x, mpmath.mpc) for x in (v, u, *d)) or not v < 0 or u == 0:
                return None
            for dv, du in zip(d[: len(plain)], d[len(plain) :], strict=True):
                if abs(dv) > small:
                    powers.append(du * v / (dv * u))
                elif abs(du) > small:
                    return None
        if not powers or max(powers) - min(powers) > small:
            return None
        power = Fraction(float(powers[0])).limit_denominator(LARGEST)
        exact = abs(powers[0] - mpmath.mpf(power.numerator) / power.denominator) < small
    return sp.Rational(power.numerator, power.denominator) if exact and power else None
