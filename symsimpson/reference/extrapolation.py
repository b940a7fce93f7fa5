"""Extrapolation of the modified midpoint rule, in any number of digits.

Gragg, Bulirsch and Stoer; Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I,
section II.9. At 30 digits it takes a fiftieth of the time of ``mpmath.odefun``.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath

from symsimpson.reference.first_order import FirstOrder

#: Columns of the extrapolation table before the step is halved.
MOST_COLUMNS = 24
#: The first step is this part of the time in which the state changes, and at most the other part of
#: the way.
FIRST, MOST_PART = mpmath.mpf(1) / 16, mpmath.mpf(1) / 8
#: A component counts as at least this part of the largest one of its kind: smaller ones may be
#: round-off.
LEAST = mpmath.mpf("1e-9")
#: Steps on trial, before it is told how many the whole way would take.
TRIAL = 12

Vector = list[Any]


def extrapolate(
    f: Callable[[Vector], Vector],
    y: Vector,
    times: Sequence[Any],
    tolerance: Any,
    most: int | None = None,
    least: int = 1,
) -> list[Vector]:
    """Solve y' = f(y) from t = 0, at the working precision of mpmath.

    Parameters
    ----------
    f : callable
        From a list of numbers to a list of numbers.
    y : list of mpf
        The state at 0.
    times : sequence of mpf
        Further and further from 0, all positive or all negative.
    tolerance : mpf
        Bound of the local error of each component, relative to its largest value so far.
    most : int, optional
        The most steps to take, those that are taken again with half their length included.
    least : int
        The least size of a component. With 0 the tolerance does not depend on units: positions
        (the first half) and momenta or velocities have sizes of their own.

    Returns
    -------
    list of lists
        The state at each time.

    Raises
    ------
    ArithmeticError
        If no step is small enough: the solution has a singularity. Also if it takes more than
        ``most`` steps, which is detected early.
    """
    states = []
    t, taken = mpmath.mpf(0), 0
    sizes = [max(least, abs(x)) for x in y]
    scales = [FIRST * scale for scale in _scales(f, y)]
    H = min([*scales, *(MOST_PART * abs(end) for end in times[:1])], default=FIRST)
    for end in times:
        while t != end:
            if most is not None:
                _check_steps(taken, t, end, H, most)
            taken += 1
            whole = end - t if abs(end - t) <= H else mpmath.sign(end - t) * H
            new, columns = _step(f, y, whole, tolerance, sizes)
            if new is None:
                H = abs(whole) / 2
                if abs(end) * mpmath.eps > H:
                    raise ArithmeticError(f"no step is small enough at t = {mpmath.nstr(t, 8)}")
                continue
            t, y = t + whole, new
            sizes = [max(size, abs(x)) for size, x in zip(sizes, y, strict=True)]
            if columns < MOST_COLUMNS // 2:
                H = abs(whole) * 2
        states.append(y)
    return states


def _kinds(y: Vector) -> list[Vector]:
    """Part a state into positions, momenta or velocities, and the time if it has one."""
    n = len(y) // 2
    return [kind for kind in (y[:n], y[n : 2 * n], y[2 * n :]) if kind]


def _scales(f: Callable[[Vector], Vector], y: Vector) -> list[Any]:
    """Return the times in which positions and momenta change; from rest, by the acceleration."""
    slope = f(y)
    moved = f([a + b for a, b in zip(y, slope, strict=True)])
    largest = [[max(map(abs, kind)) for kind in _kinds(x)] for x in (y, slope, moved)]
    times = [size / rate for size, rate, _ in zip(*largest, strict=True) if size and rate]
    (size, *_), _, (speed, *_) = largest
    return times or ([mpmath.sqrt(size / speed)] if size and speed else [])


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
    f: Callable[[Vector], Vector], y: Vector, H: Any, tolerance: Any, sizes: Vector
) -> tuple[Vector | None, int]:
    """Take a step; returns the new state, None if it did not converge, and the columns used.

    ``sizes`` has the largest values of the components so far.
    """
    slope = f(y)
    previous: list[Vector] = []
    for column in range(1, MOST_COLUMNS + 1):
        row = [_midpoint(f, y, slope, H, 2 * column)]
        for k, old in enumerate(previous):
            ratio = mpmath.mpf(column) / (column - 1 - k)
            weight = ratio**2 - 1
            row.append([a + (a - b) / weight for a, b in zip(row[k], old, strict=True)])
        if column > 2:
            changes = [abs(a - b) for a, b in zip(row[-1], row[-2], strict=True)]
            if not all(map(mpmath.isfinite, changes)):
                return None, column
            reached = [max(size, abs(a)) for size, a in zip(sizes, row[-1], strict=True)]
            bounds = [
                tolerance * max(size, LEAST * max(kind))
                for kind in _kinds(reached)
                for size in kind
            ]
            if all(map(operator.le, changes, bounds)):
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


#: Digits computed with beyond those asked for.
GUARD = 12


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
