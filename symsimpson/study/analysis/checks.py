"""Measurements of a certificate: derivatives, iterations, energy and momenta of a stepper."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import mpmath
import numpy as np
import sympy as sp

from symsimpson.api.stepper import Stepper
from symsimpson.declare.system import MechanicalSystem
from symsimpson.reference.first_order import SystemOutputs
from symsimpson.run.step_equations import StepArguments, evaluate_equations
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.analysis.certificate import Check
from symsimpson.study.analysis.subject import DIGITS, Subject
from symsimpson.study.analysis.symmetries import Symmetry, linear_symmetries
from symsimpson.support.array_types import Reals

#: Largest value of a quantity that is exactly zero. Differences have two thirds of ``DIGITS``.
EXACT = 1e-25
#: Number of step sizes to try, each half the last one, until all compared kernels succeed.
HALVINGS = 8
#: Largest logarithm of the ratio of a Newton correction to the square of the first one.
MAX_RATIO = 7.0


def measure_equations(s: Subject) -> Iterator[Check]:
    """Compare the derivatives of the residual with differences."""
    if "equations" not in s.stepper.program.header.functions:
        return
    flow, n, d = s.flow, s.n, s.stepper.program.header.degree
    q, p = s.path.q, s.path.p
    part = np.arange(1, d + 1)[:, None] / flow.context.mpf(d)
    # a force such as |v| v has only one derivative at rest, so that every coordinate must move
    motion = np.arange(1, n + 1) / flow.context.mpf(2**30 * n) * flow.sizes[:n]
    nodes = q[0] + part * (q[1] - q[0] + motion)

    def evaluate(points: Any) -> tuple[Any, Any]:
        at = StepArguments(q[0], points, s.h, flow.parameters, 0)
        return evaluate_equations(flow.program, at, p[0])

    exact = evaluate(nodes)[1]
    columns = []
    for k in range(d * n):
        move = np.zeros((d, n), dtype=object)
        size = flow.small * flow.sizes[k % n]
        move[k // n, k % n] = size
        up, down = (evaluate(nodes + x)[0] for x in (move, -move))
        columns.append((up - down) / (2 * size))
    difference = max(map(abs, (exact - np.array(columns, dtype=object).T).ravel()))
    yield Check.at_most(
        "equations",
        float(difference / max(map(abs, exact.ravel()))),
        EXACT,
        "difference of exact derivatives of the residual from finite differences",
        f"They are equal, except for the error of differences in {DIGITS} digits.",
    )


def measure_initial_momenta(s: Subject) -> Iterator[Check]:
    """Check p0 = L_v(q0, v0), and yield a row only if it fails."""
    if s.clock is not None or s.stepper.program.header.canonical:  # H_pp may be singular
        return
    q, p, v = s.z[: s.n], s.z[s.n :], s.flow.gradient(s.z)[s.n :]
    parameters = s.flow.parameters
    start = s.flow.stepper.integrate(q, v0=v, h=s.h, steps=0, parameters=parameters)
    difference = float(max(abs((start.p[0] - p) / s.flow.sizes[s.n :])))
    if not difference <= EXACT:
        what = "difference of p from the momenta of the velocities at p"
        reason = "A run that begins with velocities has other momenta, and another energy."
        yield Check.at_most("starts", difference, EXACT, what, reason)


def compare_fallbacks(s: Subject) -> Iterator[Check]:
    """Compare a step of the fallback solvers with the same step of the first solver."""
    names = s.stepper.program.kernels.fallbacks
    if len(names) < 2 or s.clock is not None:
        return
    for halvings in range(HALVINGS):
        h = s.flow.context.ldexp(s.h, -halvings)
        ends = [s.flow.step_with(name, s.z, h) for name in names]
        states = [end for end in ends if end is not None]
        if len(states) == len(names):
            break
    else:
        failed = ", ".join(name for name, end in zip(names, ends, strict=True) if end is None)
        raise ArithmeticError(f"all steps from h to h/{2**halvings} fail with {failed}")
    part = f" of h/{2**halvings}" if halvings else ""
    difference = max(abs(x) for end in states[1:] for x in (end - states[0]) / s.flow.sizes)
    yield Check.at_most(
        "fallbacks",
        float(difference),
        EXACT,
        f"a step{part} by {', '.join(names[1:])}, minus the same step by {names[0]}",
        "If a solver does not converge, the next one solves the same equations.",
    )


def measure_jacobian(s: Subject) -> Iterator[Check]:
    """Measure the error of the Newton matrix, which may be reduced, at the solution of a step."""
    if s.stepper.program.header.newton_unknowns == 0:
        return
    yield Check.at_most(
        "Jacobian",
        s.flow.jacobian_defect(s.z, s.h),
        EXACT**0.5,
        "error after one iteration from a displaced solution, relative to the displacement",
        "With the exact Jacobian this error has second order: its size is "
        f"{float(s.flow.small):.0e}.",
    )


def measure_newton(s: Subject) -> Iterator[Check]:
    """Measure the order at which Newton corrections shrink."""
    if s.stepper.program.header.newton_unknowns == 0:
        return
    sizes = s.flow.corrections(s.z, s.h, 8)
    usable = [x for x in sizes if x > 10.0 ** (5 - DIGITS)]
    reason = "With the exact Jacobian each correction is about the square of the last one."
    text = ", ".join(f"{float(x):.0e}" for x in sizes[:5])
    order = order_of_corrections(usable) if len(usable) > 2 else 2.0  # one correction solves it
    yield Check.at_least("Newton", order, 1.7, f"corrections {text}", reason)


def order_of_corrections(sizes: Sequence[Any]) -> float:
    """Return the order of convergence that the last of three or more corrections shows.

    It is the larger of two estimates: from the last two ratios, and from the last size with the
    constant of the first ratio. A correction that is small by chance spoils the ratios.
    """
    logs = [float(mpmath.log(x)) for x in sizes]
    a, b, c = logs[-3:]
    if not c < b < a:
        return 0.0
    constant = min(max(logs[1] - 2 * logs[0], 0.0), MAX_RATIO)
    return max((c - b) / (b - a), (c - constant) / b if b < 0 else 0.0)


def count_iterations(s: Subject) -> Iterator[Check]:
    """Count the iterations of a step, of Newton's method or over stages."""
    limit = 16.0 if s.stepper.program.header.by_stages else 6.0
    run = s.integrate(1000, every=None)
    yield Check.at_most(
        "iterations",
        float(run.newton_iterations.sum()) / 1000,
        limit,
        "iterations a step",
        "With a reasonable step size the predictor is close to the solution.",
    )


LONG = 100_000
#: Up to this order the energy oscillates by much more than the shadow energy.
HIGHEST_ORDER = 4
#: Number of steps of the run that measures the shadow energy, and the divisor of h for it.
SHADOW_STEPS, FINER = 100, 4
#: Round-off error of the shadow energy, relative to the energy.
SHADOW_ROUNDING = 1e-12


def shadow_is_testable(stepper: Stepper) -> bool:
    """Return whether runs have a shadow energy that oscillates much less than the energy."""
    header = stepper.program.header
    family = "equations" in header.functions and not header.constraints
    differentiable = stepper.program.differentiate is not None
    return family and header.conservative and differentiable and header.order <= HIGHEST_ORDER


def measure_shadow_energy(s: Subject) -> Iterator[Check]:
    """Check that the shadow energy oscillates by less than half of the oscillation of H.

    The oscillation over ``SHADOW_STEPS`` steps of h/4 is the largest value minus the smallest
    value. If the largest distance of the shadow energy from H is larger, it replaces the
    oscillation of H.
    """
    if not shadow_is_testable(s.stepper):
        return
    run = s.integrate(SHADOW_STEPS, every=1, parts=FINER)
    scale = float(run.energy_scale)
    shadow = run.shadow_energy
    # the midpoint rule conserves H of the linear oscillator, and also its distance from the shadow
    oscillation = max(np.ptp(run.energy), np.abs(shadow - run.energy).max()) / scale
    yield Check.at_most(
        "shadow",
        float(np.ptp(shadow)) / scale,
        0.5 * float(oscillation) + SHADOW_ROUNDING,
        f"oscillation of the shadow energy in {SHADOW_STEPS} steps of h/{FINER}; that of H is "
        f"{oscillation:.1e}",
        "A scheme conserves its shadow energy much better than H, so that a drift is visible.",
    )


def measure_drift(s: Subject) -> Iterator[Check]:
    """Check that energy and momenta have no trend over ``LONG`` steps.

    A check that fails with h is repeated with h/2, and so on up to h/16. Trends of a user's
    invariants are measured without a threshold, and so is the energy with velocity constraints.
    For a system that is not conservative, the balance of energy and work is checked instead.
    """
    if not s.stepper.program.header.conservative:
        yield from _measure_balance(s)
        return
    for parts in (1, 2, 4, 8, 16):  # coarse steps of chaotic motions jump between levels of H
        rows = list(_measure_trends(s, parts))
        if all(row.passed for row in rows):
            break
    yield from rows


def _measure_trends(s: Subject, parts: int) -> Iterator[Check]:
    """Measure trends over ``LONG`` steps of size h / parts."""
    run = s.integrate(LONG, every=20, parts=parts)
    energy = {"energy": run.energy}
    momenta = {x.name: x.momentum(run.q, run.p) for x in s.symmetries}
    # a nonholonomic step is not symplectic, so that its energy may drift
    constant, watched = (momenta, energy) if s.is_nonholonomic else (energy | momenta, {})
    # round-off grows with the terms of a momentum: with the path of a free centre of mass
    sizes = {x.name: x.size(run.q, run.p) for x in s.symmetries}
    if s.clock is not None:  # K is zero, except for errors
        sizes["energy"] = float(run.energy_scale)
    steps = f"{LONG} steps" + (f" of h/{parts}" if parts > 1 else "")
    for k, (name, values) in enumerate((constant | watched | run.invariants).items()):
        size = sizes.get(name, float(np.abs(values).max())) or 1.0
        blocks = (values[1:] / size).reshape(20, -1)
        trend = abs(float(np.polyfit(np.arange(20), blocks.mean(axis=1), 1)[0])) * 20
        oscillation = float(np.ptp(blocks))
        what = f"{name}: trend over {steps}; it oscillates by {oscillation:.1e}"
        if k < len(constant):
            yield Check.at_most(
                "drift",
                trend,
                max(1e-12, 0.2 * oscillation),
                what,
                "A symplectic map has no trend. By chance, a fifth of the oscillation may appear.",
            )
        else:
            reason = "The scheme does not guarantee that it is conserved."
            yield Check.at_most("watched", trend, float("inf"), what, reason)


def _measure_balance(s: Subject) -> Iterator[Check]:
    """Measure the order of the energy minus the work of forces, with h, h/2, up to h/8."""
    if "work" not in s.stepper.program.header.functions:
        return
    largest: list[float] = []
    for parts in (1, 2, 4, 8):  # until steps are small enough to show the order
        run = s.integrate(200 * parts, every=1, parts=parts)
        largest.append(float(np.abs(run.energy_balance).max() / run.energy_scale))
        if parts == 1:
            continue
        is_round_off = largest[-1] < 1e-12
        order = float(s.stepper.order) if is_round_off else math.log2(largest[-2] / largest[-1])
        if order >= s.stepper.order - 1.0:
            break
    coarse, fine = ("h" if n == 1 else f"h/{n}" for n in (parts // 2, parts))
    yield Check.at_least(
        "balance",
        order,
        s.stepper.order - 1.0,
        f"energy minus work: {largest[-2]:.1e} and {largest[-1]:.1e} of the energy "
        f"with {coarse} and {fine}",
        "The change of energy differs from the work by an error of the order of the scheme.",
    )


#: Number of steps of the momentum balance, and of Newton iterations of each step.
STEPS, ITERATIONS = 5, 8


def momentum_balance(s: Subject) -> tuple[float, list[Symmetry]]:
    """Measure p1.xi(q1) - p0.xi(q0) - h sum_i b_i f_i.xi(q_i), relative to p.xi.

    It vanishes for each linear symmetry xi of L (J. E. Marsden and M. West, Discrete mechanics and
    variational integrators, section 3.2.4). Returns the largest value, and the symmetries. The list
    is empty if L is unknown or depends on the time.
    """
    system, header = s.stepper.program.declared, s.stepper.program.header
    if system is None or header.conformal or "equations" not in header.functions:
        return 0.0, []
    plain = system.plain
    if any(plain.time in plain.graph.nodes[n].symbols for _, n in plain.energies):
        return 0.0, []
    symmetries = linear_symmetries(s.flow, s.z)
    scheme, force = read_scheme(s.stepper.scheme), _force(system)
    inputs = (s.stepper.program.default_inputs or {}).values()
    values = [s.flow.context.mpf(x) for x in (*s.flow.parameters.values(), *inputs)]
    worst = 0.0
    for j in range(STEPS if symmetries else 0):
        q, v, t = _solve_nodes(s, scheme, j)
        with mpmath.workdps(s.flow.context.dps):  # SymPy's functions use the global precision
            f = [force(*q[i], *v[i], *values, t[i]) for i in range(scheme.stages)]
        # the arithmetic below has the precision of the context
        forces = np.array([[s.flow.context.convert(x) for x in row] for row in f], dtype=object)
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
    """Return the forces as an mpmath function of q, v, parameters, inputs and t."""
    plain = system.plain
    lines = SystemOutputs(plain, {("f", i): f for i, f in enumerate(plain.f)})
    return lines.function((*plain.q, *plain.v), "mpmath")


def _solve_nodes(s: Subject, scheme: Scheme, j: int) -> tuple[Reals, Reals, Reals]:
    """Solve the equations of step j; return q, v of shape (stages, n), and t of its nodes."""
    context, d, n = s.flow.context, scheme.degree, s.n
    m = len(s.flow.program.header.constraints)
    multipliers = np.array([context.mpf(0)] * d * m, dtype=object).reshape(d, m) if m else None
    q, p, t = s.path.q[j], s.path.p[j], j * context.mpf(s.h)
    part = np.array([context.mpf(k) / d for k in range(1, d + 1)])
    points = q + part[:, None] * (s.path.q[j + 1] - q)
    for _ in range(ITERATIONS):
        at = StepArguments(q, points, s.h, s.flow.parameters, t, multipliers=multipliers)
        residual, jacobian = evaluate_equations(s.flow.program, at, p)
        change = s.flow.program.numbers.solve(jacobian, residual)
        points = points - change[: d * n].reshape(d, n)
        if multipliers is not None:
            multipliers = multipliers - change[d * n :].reshape(d, m)
    increments = points - q

    def combine(table: Any) -> Reals:
        rows = [[_number(s, x) for x in row[1:]] for row in table]
        return np.array(rows, dtype=object) @ increments

    c = np.array([_number(s, x) for x in scheme.quadrature.nodes], dtype=object)
    return q + combine(scheme.A), combine(scheme.B) / s.h, t + c * s.h


def _number(s: Subject, exact: sp.Expr) -> Any:
    """Return an exact number of a scheme in the digits of the context."""
    return s.flow.context.mpf(str(sp.N(exact, s.flow.context.dps + 5)))
