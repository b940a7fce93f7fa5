"""The order at which errors fall with the step, of states as of the time of a retimed system."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import mpmath
import numpy as np
from numpy.typing import ArrayLike

from symsimpson.study.analysis.certificate import Check
from symsimpson.study.analysis.subject import DIGITS, STEPS, Subject
from symsimpson.support.array_types import Floats


def observed_orders(errors: ArrayLike, ratio: float = 2.0) -> Floats:
    """Return the observed order between each error and the next.

    Parameters
    ----------
    errors : array_like, shape (k,)
        Errors at steps that fall by a constant ratio.
    ratio : float
        The ratio of a step to the next.

    Returns
    -------
    ndarray, shape (k - 1,)
        Infinite where the next error is 0, NaN between two errors of 0.

    Examples
    --------
    >>> observed_orders([1.6e-3, 1e-4, 6.25e-6]).tolist()
    [4.0, 4.0]
    """
    values = np.asarray(errors, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(values[:-1] / values[1:]) / np.log(ratio))


#: Orders above this are seen with steps down to h/4, others down to h/16.
HIGH = 8
#: Errors above this are not those of the solution that they are measured by.
RESOLVED = 1e-28


def order_of_errors(s: Subject) -> Iterator[Check]:
    """order: errors against Hamilton's equations of the module's own energy."""
    steps, context = STEPS, s.precise.context
    # coefficients that the module states as they were published
    decimals = re.findall(r'real\("-?[0-9]*\.([0-9]+)"\)', s.stepper.source)
    digits = max(map(len, decimals), default=None)
    resolved = RESOLVED if digits is None else max(RESOLVED, 10.0 ** -(digits + 2))

    def end(level: int) -> Any:
        """Return the end with steps of h / 2**level."""
        return s.precise.flow(s.z, context.ldexp(s.h, -level), int(steps * 2.0**level))

    levels = list(_levels(s))
    ends = [end(level) for level in levels]
    exact = _exact(s, steps, ends)
    errors = [s.distance(state, exact) for state in ends]
    if max(errors) < resolved and (s.doublings > 0 or s.distance(exact, s.z) == 0):
        reason = "Pass a larger h, or a state from which the system moves."
        yield Check.not_asked("order", "", reason, "nothing was tested: the motion hardly moves")
        return
    seen, _, least = _seen(s, errors, resolved)
    if seen < least:  # errors that change sign between two steps have no order yet
        levels.append(levels[-1] + 1)
        ends.append(end(levels[-1]))
        exact = _exact(s, steps, ends)
        errors = [s.distance(state, exact) for state in ends]
    # coefficients of few digits leave an error of lower order: larger steps are above it
    while digits is not None and sum(e > resolved for e in errors) < 3 and levels[0] > -3:
        levels.insert(0, levels[0] - 1)
        errors.insert(0, s.distance(end(levels[0]), exact))
    what = (
        f"errors {errors[0]:.1e} to {errors[-1]:.1e} after 8 h, for {_parts(levels[0])} to "
        f"{_parts(levels[-1])}, in {DIGITS} digits"
    )
    nearly = ", nearly: a symmetric scheme has an even order." if s.stepper.order > HIGH else "."
    yield Check(
        "order",
        *_seen(s, errors, resolved),
        what,
        f"The scheme has order {s.stepper.order}; the last pairs are asymptotic{nearly}",
    )


def _exact(s: Subject, steps: int, ends: Sequence[Any]) -> Any:
    """Return where the exact motion is after some steps, by which these ends are measured."""
    with mpmath.workdps(DIGITS):
        return s.exact(steps * mpmath.mpf(s.h), error=_least(s, s.distance(ends[-2], ends[-1])))


def _levels(s: Subject) -> range:
    """Return how often steps are halved."""
    return range(3 if s.stepper.order > HIGH else 5)


def _least(s: Subject, difference: float) -> float:
    """Return the error of the last of two ends that differ by so much, if the order is right."""
    return difference / 2.0**s.stepper.order


def _seen(
    s: Subject, errors: Sequence[float], resolved: float
) -> tuple[float, Literal["at least"], float]:
    """Return the order that errors with halved steps show, and the least that it should be."""
    order, high = s.stepper.order, s.stepper.order > HIGH
    seen = observed_orders(errors)[np.array(errors[1:]) > resolved]
    least = float(seen[-1 if high else -2 :].min()) if seen.size else float(order)  # exact
    return least, "at least", order - (1.0 if high else 0.15)


def order_of_time(s: Subject) -> Iterator[Check]:
    """time: that of a retimed system, against the rate along the exact motion."""
    if s.timed is None:
        return
    steps, timed, context = STEPS, s.timed, s.precise.context

    def end(parts: int) -> Any:
        run = timed.run(s.z, s.h / context.mpf(parts), parts * steps, every=None)
        return context.convert(run.t[-1])

    ends = [end(2**level) for level in _levels(s)]
    with mpmath.workdps(DIGITS):
        least = _least(s, float(abs(ends[-2] - ends[-1])))
        exact = s.exact(steps * mpmath.mpf(s.h), timed=True, error=least)[-1]
    errors = [float(abs(time - exact)) for time in ends]
    yield Check(
        "time",
        *_seen(s, errors, RESOLVED),
        f"errors of t from {errors[0]:.1e} to {errors[-1]:.1e} after 8 steps, for h to "
        f"{_parts(len(errors) - 1)}",
        "The time is the momentum of E0, and has the order of the scheme.",
    )


def _parts(level: int) -> str:
    return f"h/{2**level}" if level > 0 else f"{2**-level} h".removeprefix("1 ")
