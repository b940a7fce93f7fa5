"""Checks of a certificate, each of which yields rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import mpmath
import numpy as np
import sympy as sp

from symsimpson.api.stepper import Stepper
from symsimpson.declare.system import MechanicalSystem
from symsimpson.reference.first_order import Lines
from symsimpson.run.step_equations import At, evaluate_equations
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.analysis.certificate import Check
from symsimpson.study.analysis.subject import DIGITS, Subject
from symsimpson.study.analysis.symmetries import Symmetry, linear_symmetries
from symsimpson.support.array_types import Reals

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


LONG = 100_000
#: Up to this order the energy swings by much more than the shadow energy that a scheme keeps.
HIGHEST_ORDER = 4
#: Steps of the run whose shadow energy is looked at, and the number that h is divided by there.
FEW, FINER = 100, 4
#: Rounding error of the shadow energy, relative to the energy.
SHADOW_ROUNDING = 1e-12


def shadow_is_testable(stepper: Stepper) -> bool:
    """Return whether runs can have a shadow energy that swings much less than the energy."""
    header = stepper.program.header
    family = "equations" in header.functions and not header.constraints
    differentiable = stepper.program.differentiate is not None
    return family and header.conservative and differentiable and header.order <= HIGHEST_ORDER


def shadow(s: Subject) -> Iterator[Check]:
    """shadow: check that the modified energy varies by less than half of what H does.

    Over few steps of h/4, from peak to peak; or less than half of its largest distance from H,
    where that is more.
    """
    if not shadow_is_testable(s.stepper):
        return
    run = s.compiled(FEW, every=1, parts=FINER)
    scale = float(run.energy_scale)
    kept = run.shadow_energy
    # H of the linear oscillator is constant with midpoint, and so is its distance from the other
    swing = max(np.ptp(run.energy), np.abs(kept - run.energy).max()) / scale
    yield Check.at_most(
        "shadow",
        float(np.ptp(kept)) / scale,
        0.5 * float(swing) + SHADOW_ROUNDING,
        f"swing of the energy that the scheme keeps, in {FEW} steps of h/{FINER}; H: {swing:.1e}",
        "H less the error of the action swings less than H; a drift would show at once.",
    )


def drift(s: Subject) -> Iterator[Check]:
    """drift: check that energy and momenta have no trend over many steps.

    What fails with h is measured again with h/2, up to h/16. Trends of a user's invariants, and of
    the energy of what rolls, are measured and not judged. Of systems that are not conservative the
    balance of energy and work is checked.
    """
    if not s.stepper.program.header.conservative:
        yield from _balance(s)
        return
    for parts in (1, 2, 4, 8, 16):  # coarse steps of chaotic motions jump between levels of H
        rows = list(_trends(s, parts))
        if all(row.passed for row in rows):
            break
    yield from rows


def _trends(s: Subject, parts: int) -> Iterator[Check]:
    """Measure trends over many steps with a part of h."""
    run = s.compiled(LONG, every=20, parts=parts)
    energy = {"energy": run.energy}
    momenta = {x.name: x.momentum(run.q, run.p) for x in s.symmetries}
    # what rolls makes no symplectic map, and its energy may wander
    kept, watched = (momenta, energy) if s.rolling else (energy | momenta, {})
    # rounding grows with the terms of a momentum: those of a free centre of mass grow with its path
    sizes = {x.name: x.size(run.q, run.p) for x in s.symmetries}
    if s.timed is not None:  # K is zero, but for errors
        sizes["energy"] = float(run.energy_scale)
    steps = f"{LONG} steps" + (f" of h/{parts}" if parts > 1 else "")
    for k, (name, values) in enumerate((kept | watched | run.invariants).items()):
        size = sizes.get(name, float(np.abs(values).max())) or 1.0
        blocks = (values[1:] / size).reshape(20, -1)
        trend = abs(float(np.polyfit(np.arange(20), blocks.mean(axis=1), 1)[0])) * 20
        swing = float(np.ptp(blocks))
        what = f"{name}: trend over {steps}; it swings by {swing:.1e}"
        if k < len(kept):
            yield Check.at_most(
                "drift",
                trend,
                max(1e-12, 0.2 * swing),
                what,
                "A symplectic map has no trend; a fifth of the swing is what chance may show.",
            )
        else:
            yield Check.at_most("watched", trend, float("inf"), what, "Nothing is promised.")


def _balance(s: Subject) -> Iterator[Check]:
    """balance: measure the order of energy less work from runs with h, h/2 and finer ones."""
    if "work" not in s.stepper.program.header.functions:
        return
    largest: list[float] = []
    for parts in (1, 2, 4, 8):  # until steps are fine enough to show the order
        run = s.compiled(200 * parts, every=1, parts=parts)
        largest.append(float(np.abs(run.energy_balance).max() / run.energy_scale))
        if parts == 1:
            continue
        lost = largest[-1] < 1e-12
        order = float(s.stepper.order) if lost else math.log2(largest[-2] / largest[-1])
        if order >= s.stepper.order - 1.0:
            break
    coarse, fine = ("h" if n == 1 else f"h/{n}" for n in (parts // 2, parts))
    yield Check.at_least(
        "balance",
        order,
        s.stepper.order - 1.0,
        f"energy less work: {largest[-2]:.1e} and {largest[-1]:.1e} of the energy "
        f"with {coarse} and {fine}",
        "What the energy differs by from the work done has the order of the scheme.",
    )


#: So many steps are looked at, and so often Newton's method corrects each.
STEPS, ITERATIONS = 5, 8


def momentum_balance(s: Subject) -> tuple[float, list[Symmetry]]:
    """Measure p1.xi(q1) - p0.xi(q0) less h sum_i b_i f_i.xi(q_i), relative to p.xi.

    It vanishes for each linear symmetry xi of L (J. E. Marsden and M. West, Discrete mechanics and
    variational integrators, section 3.2.4). The symmetries are returned, too: none where L is not
    known, or depends on the time.
    """
    system, header = s.stepper.program.declared, s.stepper.program.header
    if system is None or header.conformal or "equations" not in header.functions:
        return 0.0, []
    plain = system.plain
    if any(plain.time in plain.graph.nodes[n].symbols for _, n in plain.energies):
        return 0.0, []
    symmetries = linear_symmetries(s.precise, s.z)
    scheme, force = read_scheme(s.stepper.scheme), _force(system)
    given = (*s.precise.parameters.values(), *(s.stepper.program.default_inputs or {}).values())
    values = [s.precise.context.mpf(x) for x in given]
    worst = 0.0
    for j in range(STEPS if symmetries else 0):
        q, v, t = _nodes(s, scheme, j)
        with mpmath.workdps(s.precise.context.dps):  # the functions of SymPy's text are global
            f = [force(*q[i], *v[i], *values, t[i]) for i in range(scheme.stages)]
        # as numbers of the context, which keep their digits here
        forces = np.array([[s.precise.context.convert(x) for x in row] for row in f], dtype=object)
        b = [_number(s, x) for x in scheme.quadrature.weights]
        ends = s.path.q[j : j + 2], s.path.p[j : j + 2]
        for symmetry in symmetries:
            before, after = symmetry.momentum(*ends)
            rates = symmetry.momentum(q, forces)
            change = s.h * sum(x * y for x, y in zip(b, rates, strict=True))
            size = symmetry.size(*ends) or 1.0
            worst = max(worst, abs(float(after - before - change)) / size)
    return worst, symmetries


def _force(system: MechanicalSystem) -> Any:
    """Return the forces as a function of q, v, parameters, inputs and t, in many digits."""
    plain = system.plain
    lines = Lines(plain, {("f", i): f for i, f in enumerate(plain.f)})
    return lines.function((*plain.q, *plain.v), "mpmath")


def _nodes(s: Subject, scheme: Scheme, j: int) -> tuple[Reals, Reals, Reals]:
    """Solve the equations of a step once more; return q, v and t at its nodes."""
    context, d, n = s.precise.context, scheme.degree, s.n
    m = len(s.precise.program.header.constraints)
    pulls = np.array([context.mpf(0)] * d * m, dtype=object).reshape(d, m) if m else None
    q, p, t = s.path.q[j], s.path.p[j], j * context.mpf(s.h)
    share = np.array([context.mpf(k) / d for k in range(1, d + 1)])
    points = q + share[:, None] * (s.path.q[j + 1] - q)
    for _ in range(ITERATIONS):
        at = At(q, points, s.h, s.precise.parameters, t, multipliers=pulls)
        left, slope = evaluate_equations(s.precise.program, at, p)
        change = s.precise.program.numbers.solve(slope, left)
        points = points - change[: d * n].reshape(d, n)
        pulls = None if pulls is None else pulls - change[d * n :].reshape(d, m)
    moved = points - q

    def combined(table: Any) -> Reals:
        rows = [[_number(s, x) for x in row[1:]] for row in table]
        return np.array(rows, dtype=object) @ moved

    c = np.array([_number(s, x) for x in scheme.quadrature.nodes], dtype=object)
    return q + combined(scheme.A), combined(scheme.B) / s.h, t + c * s.h


def _number(s: Subject, exact: sp.Expr) -> Any:
    return s.precise.context.mpf(str(sp.N(exact, s.precise.context.dps + 5)))
