"""How steps are solved: by which kernels, with what Jacobian, and in how many iterations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mpmath
import numpy as np

from symsimpson.analysis.certificate import Check
from symsimpson.analysis.subject import DIGITS, Subject
from symsimpson.derivatives.step_equations import At, evaluate_equations

__all__ = [
    "EXACT",
    "equations",
    "fallbacks",
    "iterations",
    "jacobian",
    "newton",
    "order_of_corrections",
    "starts",
]

#: What is exact comes out as zero to so many digits; differences have two thirds of DIGITS.
EXACT = 1e-25
#: So many steps, each half as long as the one before, are tried by kernels that are compared.
HALVINGS = 8
#: The first Newton correction makes at most so much of its square, as a logarithm.
FIRST = 7.0


def equations(s: Subject) -> Iterator[Check]:
    """equations: derivatives of the residual against differences."""
    if "equations" not in s.stepper.program.header.functions:
        return
    precise, n, d = s.precise, s.n, s.stepper.program.header.degree
    q, p = s.path.q, s.path.p
    share = np.arange(1, d + 1)[:, None] / precise.context.mpf(d)
    # forces may have one derivative at rest: moving nodes, each coordinate at another speed
    moving = np.arange(1, n + 1) / precise.context.mpf(2**30 * n) * precise.sizes[:n]
    nodes = q[0] + share * (q[1] - q[0] + moving)

    def evaluate(points: Any) -> tuple[Any, Any]:
        at = At(q[0], points, s.h, precise.parameters, 0)
        return evaluate_equations(precise.program, at, p[0])

    exact = evaluate(nodes)[1]
    columns = []
    for k in range(d * n):
        move = np.zeros((d, n), dtype=object)
        size = precise.small * precise.sizes[k % n]
        move[k // n, k % n] = size
        up, down = (evaluate(nodes + x)[0] for x in (move, -move))
        columns.append((up - down) / (2 * size))
    difference = max(map(abs, (exact - np.array(columns, dtype=object).T).ravel()))
    yield Check.at_most(
        "equations",
        float(difference / max(map(abs, exact.ravel()))),
        EXACT,
        "exact derivatives of the residual against differences",
        f"Equal, but for the differences, in {DIGITS} digits.",
    )


def starts(s: Subject) -> Iterator[Check]:
    """starts: check p0 = L_v(q0, v0), and tell of it only where it is not so."""
    if s.timed is not None:
        return
    q, p, v = s.z[: s.n], s.z[s.n :], s.precise.gradient(s.z)[s.n :]
    parameters = s.precise.parameters
    begun = s.precise.stepper.integrate(q, v0=v, h=s.h, steps=0, parameters=parameters)
    off = float(max(abs((begun.p[0] - p) / s.precise.sizes[s.n :])))
    if not off <= EXACT:
        reason = "A run that begins with velocities has other momenta, and another energy."
        yield Check.at_most("starts", off, EXACT, "p0 of the velocities at p, less p", reason)


def fallbacks(s: Subject) -> Iterator[Check]:
    """fallbacks: kernels that take steps where others fail solve the same equations."""
    names = s.stepper.program.kernels.fallbacks
    if len(names) < 2 or s.timed is not None:
        return
    for halvings in range(HALVINGS):
        h = s.precise.context.ldexp(s.h, -halvings)
        ends = [s.precise.step_by(name, s.z, h) for name in names]
        taken = [end for end in ends if end is not None]
        if len(taken) == len(names):
            break
    else:
        without = ", ".join(name for name, end in zip(names, ends, strict=True) if end is None)
        raise ArithmeticError(f"no step down to h/{2**halvings} was taken by {without}")
    part = f" of h/{2**halvings}" if halvings else ""
    apart = max(abs(x) for end in taken[1:] for x in (end - taken[0]) / s.precise.sizes)
    yield Check.at_most(
        "fallbacks",
        float(apart),
        EXACT,
        f"a step{part} by {', '.join(names[1:])}, relative to that by {names[0]}",
        "Where one does not converge another one goes on, with the same equations.",
    )


def jacobian(s: Subject) -> Iterator[Check]:
    """Jacobian: the one of the iteration, which may be reduced, at the solution of a step."""
    if s.stepper.program.header.newton_unknowns == 0:
        return
    yield Check.at_most(
        "Jacobian",
        s.precise.jacobian_defect(s.z, s.h),
        EXACT**0.5,
        "what an iteration leaves of a small displacement from the solution",
        f"With the exact Jacobian, a number of second order: {float(s.precise.small):.0e}.",
    )


def newton(s: Subject) -> Iterator[Check]:
    """Newton: corrections shrink quadratically."""
    if s.stepper.program.header.newton_unknowns == 0:
        return
    sizes = s.precise.corrections(s.z, s.h, 8)
    usable = [x for x in sizes if x > 10.0 ** (5 - DIGITS)]
    reason = "With the exact Jacobian each correction is about the square of the one before."
    shown = ", ".join(f"{float(x):.0e}" for x in sizes[:5])
    order = order_of_corrections(usable) if len(usable) > 2 else 2.0  # solved at once
    yield Check.at_least("Newton", order, 1.7, f"corrections {shown}", reason)


def order_of_corrections(sizes: Sequence[Any]) -> float:
    """Return the power of the one before that the last of three or more corrections is.

    The last ratios tell, or the last size in units of what the first one makes of its square: a
    correction that is better than quadratic by chance spoils the ratios.
    """
    logs = [float(mpmath.log(x)) for x in sizes]
    a, b, c = logs[-3:]
    if not c < b < a:
        return 0.0
    first = min(max(logs[1] - 2 * logs[0], 0.0), FIRST)
    return max((c - b) / (b - a), (c - first) / b if b < 0 else 0.0)


def iterations(s: Subject) -> Iterator[Check]:
    """iterations: for each step, of Newton's method or over stages."""
    most = 16.0 if s.stepper.program.header.by_stages else 6.0
    run = s.compiled(1000, every=None)
    yield Check.at_most(
        "iterations",
        float(run.newton_iterations.sum()) / 1000,
        most,
        "iterations a step",
        "The predictor leaves few at a reasonable step.",
    )
