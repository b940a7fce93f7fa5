"""An accurate solution of y' = f(y) in many digits, with an estimate of its error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath

from symsimpson.reference.extrapolation import extrapolate
from symsimpson.reference.first_order import FirstOrder

__all__ = ["Truth", "truth"]

#: Digits computed with beyond those asked for.
GUARD = 12

Vector = list[Any]


@dataclass(frozen=True)
class Truth:
    """States at some times, as numbers of mpmath.

    Attributes
    ----------
    t : tuple
    y : tuple of tuples
        The state at each time.
    errors : tuple
        Each component's largest difference to a solution with a tolerance 1000 times as large.
    """

    t: tuple[Any, ...]
    y: tuple[tuple[Any, ...], ...]
    errors: tuple[Any, ...]

    @property
    def error(self) -> Any:
        """The largest error of any component."""
        return max(self.errors)


def truth(
    equations: FirstOrder,
    y0: Sequence[Any],
    times: Sequence[Any],
    *,
    digits: int = 30,
    parameters: Mapping[Any, Any] | None = None,
) -> Truth:
    """Solve from t = 0 with a local error of 10^-digits, and once more to estimate the error.

    Local errors are relative to the largest value of each component so far. A component counts as
    at least 1e-9 of the largest position, or of the largest momentum or velocity.

    Parameters
    ----------
    equations : FirstOrder
    y0 : sequence of numbers or decimal strings
    times : sequence of numbers or decimal strings
        Increasing.
    digits : int
    parameters : mapping, optional
        Values by name, in place of the defaults.

    Returns
    -------
    Truth

    Raises
    ------
    ArithmeticError
        If no step is small enough: the solution has a singularity.

    Examples
    --------
    >>> import symsimpson as ss
    >>> from symsimpson.reference import canonical, truth
    >>> found = truth(canonical(ss.systems.harmonic_oscillator()), [1, 0], [1], digits=20)
    >>> print(f"{float(found.y[0][0]):.12f}")
    0.540302305868
    >>> bool(found.error < 1e-15)
    True
    """
    rates = equations.function("mpmath")
    with mpmath.workdps(digits + GUARD):
        values = [mpmath.mpf(x) for x in equations.values(parameters)]

        def f(y: Vector) -> Vector:
            slopes: Vector = rates(*y, *values)
            return slopes

        start = [mpmath.mpf(x) for x in y0]
        points = [mpmath.mpf(x) for x in times]
        fine, coarse = (
            extrapolate(f, start, points, mpmath.mpf(10) ** (loss - digits), least=0)
            for loss in (0, 3)
        )
        components = zip(zip(*fine, strict=True), zip(*coarse, strict=True), strict=True)
        errors = tuple(max(abs(a - b) for a, b in zip(*pair, strict=True)) for pair in components)
    return Truth(tuple(points), tuple(map(tuple, fine)), errors)
