"""Extrapolation of the modified midpoint rule, in any number of digits.

Gragg, Bulirsch and Stoer; Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I,
section II.9. At 30 digits it takes a fiftieth of the time of ``mpmath.odefun``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mpmath

__all__ = ["extrapolate"]

#: Columns of the extrapolation table before the step is halved.
MOST_COLUMNS = 24
#: Length of the first step; where the state changes more slowly, this part of the time in which it
#: moves by itself, but of the way no more than the other one.
FIRST, MOST_PART = mpmath.mpf(1) / 16, mpmath.mpf(1) / 8
#: Steps on trial, before it is told how many the whole way would take.
TRIAL = 12

Vector = list[Any]


def extrapolate(
    f: Callable[[Vector], Vector],
    y: Vector,
    times: Sequence[Any],
    tolerance: Any,
    most: int | None = None,
) -> list[Vector]:
    """Solve y' = f(y) from t = 0, at the working precision of mpmath.

    Parameters
    ----------
    f : callable
        From a list of numbers to a list of numbers.
    y : list of mpf
        The state at 0.
    times : sequence of mpf
        Further and further from 0, all ahead or all behind.
    tolerance : mpf
        Bound of the local error, relative in components larger than 1.
    most : int, optional
        The most steps to take, those that are taken again with half their length included.

    Returns
    -------
    list of lists
        The state at each time.

    Raises
    ------
    ArithmeticError
        If no step is small enough: the solution has a singularity. Also if it takes more than
        ``most`` steps, which is told early on.
    """
    states = []
    t, taken = mpmath.mpf(0), 0
    H = max([FIRST, *(min(FIRST * _scale(f, y), MOST_PART * abs(end)) for end in times[:1])])
    for end in times:
        while t != end:
            if most is not None:
                _check_steps(taken, t, end, H, most)
            taken += 1
            whole = end - t if abs(end - t) <= H else mpmath.sign(end - t) * H
            new, columns = _step(f, y, whole, tolerance)
            if new is None:
                H = abs(whole) / 2
                if abs(end) * mpmath.eps > H:
                    raise ArithmeticError(f"no step is small enough at t = {mpmath.nstr(t, 8)}")
                continue
            t, y = t + whole, new
            if columns < MOST_COLUMNS // 2:
                H = abs(whole) * 2
        states.append(y)
    return states


def _scale(f: Callable[[Vector], Vector], y: Vector) -> Any:
    """Return the time in which a state moves by itself, 0 for one that stands still."""
    rate = max(map(abs, f(y)))
    return max(map(abs, y)) / rate if rate else mpmath.mpf(0)


def _check_steps(taken: int, t: Any, end: Any, H: Any, most: int) -> None:
    """Give up where steps are too many, told by those that are taken and the length of the last.

    Their product is at most (most/2)^2 on a way of ``most`` equal steps.
    """
    left = abs(end - t) / max(H, abs(t) / max(taken, 1))
    if taken >= most or (taken >= TRIAL and 4 * taken * left > most**2):
        raise ArithmeticError(
            f"the exact solution needs more than {most} steps to t = {mpmath.nstr(end, 8)}, of "
            f"which {taken} lead to t = {mpmath.nstr(t, 8)}: choose a smaller h"
        )


def _step(
    f: Callable[[Vector], Vector], y: Vector, H: Any, tolerance: Any
) -> tuple[Vector | None, int]:
    """Take a step; returns the new state, None if it did not converge, and the columns used."""
    slope = f(y)
    previous: list[Vector] = []
    for column in range(1, MOST_COLUMNS + 1):
        row = [_midpoint(f, y, slope, H, 2 * column)]
        for k, old in enumerate(previous):
            ratio = mpmath.mpf(column) / (column - 1 - k)
            weight = ratio**2 - 1
            row.append([a + (a - b) / weight for a, b in zip(row[k], old, strict=True)])
        if column > 2:
            changes = [abs(a - b) / max(1, abs(a)) for a, b in zip(row[-1], row[-2], strict=True)]
            if not all(map(mpmath.isfinite, changes)):
                return None, column
            if max(changes) < tolerance:
                return row[-1], column
        previous = row
    return None, MOST_COLUMNS


def _midpoint(f: Callable[[Vector], Vector], y: Vector, slope: Vector, H: Any, n: int) -> Vector:
    """Take n steps of the modified midpoint rule, n even."""
    h = H / n
    before, now = y, [a + h * b for a, b in zip(y, slope, strict=True)]
    for _ in range(n - 1):
        before, now = now, [a + 2 * h * b for a, b in zip(before, f(now), strict=True)]
    last = f(now)
    return [(a + b + h * c) / 2 for a, b, c in zip(before, now, last, strict=True)]
