"""The observed order of a scheme: how its errors fall with the step size."""

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
    """Return the observed order between each error and the next error.

    Parameters
    ----------
    errors : array_like, shape (k,)
        The errors for step sizes that fall by a constant ratio.
    ratio : float, default 2.0
        The ratio of a step size to the next step size.

    Returns
    -------
    ndarray, shape (k - 1,)
        The orders. An order is infinite if the next error is 0, and NaN between two errors of 0.

    Examples
    --------
    >>> observed_orders([1.6e-3, 1e-4, 6.25e-6]).tolist()
    [4.0, 4.0]
    """
    values = np.asarray(errors, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(values[:-1] / values[1:]) / np.log(ratio))


#: Schemes of higher order are measured with steps from h to h/4, others with h to h/16.
HIGH_ORDER = 8
#: Least error that the error of the reference solution does not affect.
RESOLVED = 1e-28


def measure_order(s: Subject) -> Iterator[Check]:
    """Measure the order of the scheme against the exact motion of its own energy H."""
    steps, context = STEPS, s.flow.context
    # published coefficients have a limited number of decimals, which limits the accuracy
    decimals = re.findall(r'real\("-?[0-9]*\.([0-9]+)"\)', s.stepper.source)
    digits = max(map(len, decimals), default=None)
    resolved = RESOLVED if digits is None else max(RESOLVED, 10.0 ** -(digits + 2))

    def end(level: int) -> Any:
        """Return the final state with steps of h / 2**level."""
        return s.flow.advance(s.z, context.ldexp(s.h, -level), int(steps * 2.0**level))

    levels = list(_levels(s))
    ends = [end(level) for level in levels]
    exact = _solve_exactly(s, steps, ends)
    errors = [s.distance(state, exact) for state in ends]
    if max(errors) < resolved and (s.doublings > 0 or s.distance(exact, s.z) == 0):
        reason = "Pass a larger h, or a state from which the system moves."
        failure = "nothing was tested: the motion hardly moves"
        yield Check.without_value("order", "", reason, failure)
        return
    order, _, least = _observed_order(s, errors, resolved)
    if order < least:  # an error that changes its sign between two step sizes hides the order
        levels.append(levels[-1] + 1)
        ends.append(end(levels[-1]))
        exact = _solve_exactly(s, steps, ends)
        errors = [s.distance(state, exact) for state in ends]
    # coefficients of few digits add an error of lower order, which larger steps exceed
    while digits is not None and sum(e > resolved for e in errors) < 3 and levels[0] > -3:
        levels.insert(0, levels[0] - 1)
        errors.insert(0, s.distance(end(levels[0]), exact))
    what = (
        f"errors {errors[0]:.1e} to {errors[-1]:.1e} after 8 h, for {_step_size(levels[0])} to "
        f"{_step_size(levels[-1])}, in {DIGITS} digits"
    )
    reason = f"The scheme has order {s.stepper.order}; the last pairs of errors are asymptotic."
    if s.stepper.order > HIGH_ORDER:
        reason += " A tolerance of 1 suffices, because a symmetric scheme has an even order."
    yield Check("order", *_observed_order(s, errors, resolved), what, reason)


def _solve_exactly(s: Subject, steps: int, ends: Sequence[Any]) -> Any:
    """Return the exact state after ``steps`` steps of h, accurate enough to measure ``ends``."""
    with mpmath.workdps(DIGITS):
        error = _expected_error(s, s.distance(ends[-2], ends[-1]))
        return s.solve_exactly(steps * mpmath.mpf(s.h), error=error)


def _levels(s: Subject) -> range:
    """Return the numbers of halvings of h."""
    return range(3 if s.stepper.order > HIGH_ORDER else 5)


def _expected_error(s: Subject, difference: float) -> float:
    """Return the error with the smallest step, from its difference from twice this step."""
    return difference / 2.0**s.stepper.order


def _observed_order(
    s: Subject, errors: Sequence[float], resolved: float
) -> tuple[float, Literal["at least"], float]:
    """Return the order that errors with halved steps show, and the least order that passes."""
    order, high = s.stepper.order, s.stepper.order > HIGH_ORDER
    orders = observed_orders(errors)[np.array(errors[1:]) > resolved]
    last = float(orders[-1 if high else -2 :].min()) if orders.size else float(order)  # exact
    return last, "at least", order - (1.0 if high else 0.15)


def measure_time_order(s: Subject) -> Iterator[Check]:
    """Measure the order of the time t of a time-transformed system."""
    if s.clock is None:
        return
    steps, clock, context = STEPS, s.clock, s.flow.context

    def end(parts: int) -> Any:
        run = clock.run(s.z, s.h / context.mpf(parts), parts * steps, every=None)
        return context.convert(run.t[-1])

    ends = [end(2**level) for level in _levels(s)]
    with mpmath.workdps(DIGITS):
        error = _expected_error(s, float(abs(ends[-2] - ends[-1])))
        exact = s.solve_exactly(steps * mpmath.mpf(s.h), with_time=True, error=error)[-1]
    errors = [float(abs(time - exact)) for time in ends]
    yield Check(
        "time",
        *_observed_order(s, errors, RESOLVED),
        f"errors of t from {errors[0]:.1e} to {errors[-1]:.1e} after 8 steps, for h to "
        f"{_step_size(len(errors) - 1)}",
        "The time is the momentum of E0, and has the order of the scheme.",
    )


def _step_size(level: int) -> str:
    """Return the text of the step size h / 2**level, for example "h/4" or "2 h"."""
    return f"h/{2**level}" if level > 0 else f"{2**-level} h".removeprefix("1 ")
