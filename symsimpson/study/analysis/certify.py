"""Certify a stepper: measure the properties that its scheme guarantees, on its own equations.

The properties of the scheme are measured in many digits, with the source of the generated module.
The compiled code is then compared with this source.
"""

from __future__ import annotations

import textwrap
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.api.stepper import Stepper
from symsimpson.errors import (
    ConvergenceError,
    ResolutionWarning,
    StabilityWarning,
    SymsimpsonError,
    reject,
)
from symsimpson.program.numbers import FLOAT64
from symsimpson.results.trajectory import Trajectory
from symsimpson.schemes.named import read_scheme
from symsimpson.stepping.inputs import read_step
from symsimpson.study.analysis.certificate import Certificate, Check
from symsimpson.study.analysis.checks import (
    EXACT,
    LONG,
    compare_fallbacks,
    count_iterations,
    measure_drift,
    measure_equations,
    measure_initial_momenta,
    measure_jacobian,
    measure_newton,
    measure_shadow_energy,
    momentum_balance,
)
from symsimpson.study.analysis.discrete_flow import DiscreteFlow
from symsimpson.study.analysis.order import measure_order, measure_time_order, observed_orders
from symsimpson.study.analysis.pilot import choose_state, choose_step, follows_motion
from symsimpson.study.analysis.subject import DIGITS, MAX_STEPS, SHORT, STEPS, Subject, fix_inputs
from symsimpson.study.analysis.symmetries import block_size
from symsimpson.study.analysis.variants import in_tau
from symsimpson.support.array_types import Floats
from symsimpson.support.progress import announce
from symsimpson.text.header import digest

#: The displacement, in units of the sizes, that shows how errors grow. It is far above round-off
#: in ``DIGITS`` digits, and small enough for linear growth.
NEARBY = mpmath.mpf("1e-40")
#: Smaller momenta, relative to those of other constraints, are round-off errors.
LEAST_MOMENTUM = 1e-9
#: Largest number of halvings of a step size that raises a stability warning.
HALVINGS = 40
#: A step size is far too large if this part of it does not follow the motion.
TOO_LARGE = 64.0
#: Number of further doublings of the first step size that shows an error, before it is halved.
EXTRA_DOUBLINGS = 30
#: A quantity whose change has a lower order than this is not conserved by the exact motion.
MIN_ORDER = 0.2


@announce("certifying")
def certify(
    stepper: Stepper,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    p0: ArrayLike | None = None,
    h: float | None = None,
    parameters: Mapping[Any, Any] | None = None,
    inputs: Mapping[Any, float] | None = None,
) -> Certificate:
    """Measure order, symplecticity and all other properties; see :meth:`Stepper.certify`."""
    begin = time.perf_counter()
    if not stepper.program.numbers.compiled:
        reject(
            f"{stepper.system}: a multiprecision stepper has no certificate.",
            why="A certificate tests double-precision code.",
            remedy="Certify the stepper compiled without precision=. It has the same equations.",
        )
    header = stepper.program.header
    if stepper.program.declared is None and (
        not header.conservative or header.velocity_constraints
    ):
        reject(
            f"{stepper.system}: the order of this stepper cannot be measured.",
            why="A generated module does not contain the expressions of its forces, velocity "
            "constraints and time-dependent terms.",
            remedy="Certify a stepper that is compiled from the system: "
            "symsimpson.compile(system, ...).",
        )
    stepper = fix_inputs(stepper, inputs)
    values = stepper.program.free_values(parameters)
    q, p = choose_state(stepper, {"q0": q0, "v0": v0, "p0": p0}, values)
    z, clock = np.concatenate([q, p]), None
    measured = stepper
    if stepper.program.header.retimed:  # measured in tau, where E0 is a constant
        clock = DiscreteFlow(stepper, values, DIGITS)
        measured, values = in_tau(stepper), clock.parameters_at(z)
    step = _choose_step(measured, q, p, values) if h is None else read_step(h, FLOAT64)
    flow = DiscreteFlow(measured, values, DIGITS)
    constrained = bool(stepper.program.header.constraints)
    subject = Subject(measured, flow, flow.project(z) if constrained else z, step, clock)
    if h is None and subject.doublings > 0:
        first = step * 2.0 ** (subject.doublings + EXTRA_DOUBLINGS)
        step = choose_step(measured, q, p, values, LONG, first=first)
        subject = replace(subject, h=step)
    begin_state = {"q0": q, "p0": p, "parameters": values}
    error = None if h is None else _reject_large_step(measured, begin_state, step)
    if error is None:
        flow.sizes = subject.sizes
        with warnings.catch_warnings():
            if h is None:  # the chosen step is the longest one with a meaningful measurement
                warnings.simplefilter("ignore", ResolutionWarning)
            checks = [
                check
                for name, measure in CHECKS.items()
                for check in _catch_failure(name, measure, subject)
            ]
    else:
        checks = [_failed_check("order", error)]
    return Certificate(
        stepper.system,
        stepper.scheme,
        stepper.order,
        digest(stepper.source),
        tuple(q.tolist()),
        tuple(p.tolist()),
        step,
        {name: float(value) for name, value in values.items()},
        tuple(checks),
        time.perf_counter() - begin,
    )


def _choose_step(stepper: Stepper, q: Floats, p: Floats, values: Mapping[str, float]) -> float:
    """Choose a step size that follows the motion, without a stability warning."""
    step, program = choose_step(stepper, q, p, values, LONG), stepper.program
    tools, system = program.tools, program.declared
    if tools is None or system is None:
        return step
    v = stepper.integrate(q, p0=p, h=step, steps=0, parameters=values).v[0]
    inputs = (program.default_inputs or {}).values()
    numbers = [*map(float, values.values()), *map(float, inputs)]
    for halvings in range(HALVINGS):
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always", StabilityWarning)
            tools.check_step(program, system, q, v, numbers, step / 2**halvings, 0.0)
        if not warned:
            break
    if not halvings:
        return step
    # half the step size of the limit, because errors at a limit have no order; another kernel may
    # solve shorter steps, so that the choice begins again
    return choose_step(stepper, q, p, values, LONG, first=step / 2 ** (halvings + 1))


def _reject_large_step(
    stepper: Stepper, begin: Mapping[str, Any], h: float
) -> ArithmeticError | ConvergenceError | None:
    """Return an error if h is far too large: steps of h to h/4 fail, or finer ones do not help."""
    if not follows_motion(stepper, begin, SHORT, h / TOO_LARGE):
        return ArithmeticError(
            f"the exact solution over {STEPS} steps of h={h:g} needs more than {MAX_STEPS} steps. "
            "Choose a smaller h."
        )
    try:
        for parts in (1, 2, 4):  # the measurement of the order takes these steps
            stepper.integrate(**begin, h=h / parts, steps=STEPS * parts, every=None)
    except ConvergenceError as error:
        return error
    return None


def _catch_failure(
    name: str, measure: Callable[[Subject], Iterator[Check]], subject: Subject
) -> Iterator[Check]:
    """Measure a property, and turn an error into a check that has not passed."""
    try:
        yield from measure(subject)
    except KeyboardInterrupt:  # Interrupted is a SymsimpsonError, too
        raise
    except (SymsimpsonError, ArithmeticError, np.linalg.LinAlgError) as error:
        yield _failed_check(name, error)


def _failed_check(name: str, error: Exception) -> Check:
    """Return the check of a measurement that raised an error."""
    first = str(error).partition("\n")[0]  # empty for a division by zero in mpmath
    text = textwrap.shorten(f"{type(error).__name__}: {first}", 160, placeholder=" ...")
    reason = "A property that cannot be measured does not pass."
    return Check.without_value(name, "", reason, text.removesuffix(":"))


def _measure_symplecticity(s: Subject) -> Iterator[Check]:
    """Measure D^T J D - J, with D the derivative of a step, Newton's method included.

    For a conformal system it is D^T J D - exp(-2 gamma h) J.
    """
    conformal = s.stepper.program.header.conformal
    if s.has_forces and not conformal:
        what = "not measured: with forces, the exact flow is not symplectic either"
        reason = "Without forces a step would be symplectic."
        yield Check.without_value("symplectic", what, reason)
        return
    if s.is_nonholonomic:
        what = "not measured: with velocity constraints, the exact flow is not symplectic"
        reason = "Their forces follow from no Lagrangian (van der Schaft and Maschke, 1994)."
        yield Check.without_value("symplectic", what, reason)
        return
    n = s.n
    D, E = s.flow.tangent(s.z, s.h)
    # scale p relative to q so that both off-diagonal blocks of D have the same size
    p_by_q, q_by_p = (max(map(abs, block.ravel())) for block in (D[n:, :n], D[:n, n:]))
    ratio = (p_by_q / q_by_p) ** 0.5 if p_by_q and q_by_p else 1
    for matrix in (D, E):
        matrix[:n, n:] *= ratio
        matrix[n:, :n] /= ratio
    J = np.zeros((2 * n, 2 * n), dtype=object)
    J[:n, n:] += np.eye(n, dtype=int)
    J[n:, :n] -= np.eye(n, dtype=int)
    factor = s.flow.decay(s.z, s.h) if conformal else 1
    defect = max(map(abs, (D.T @ J @ D - factor * (E.T @ J @ E)).ravel()))
    size = max(map(abs, D.ravel()))
    what = f"D^T J D - {'exp(-2 gamma h) ' if conformal else ''}J of one step, relative to D^2"
    if s.stepper.program.header.constraints:
        what += ", for all displacements that satisfy the constraints"
    yield Check.at_most(
        "conformal" if conformal else "symplectic",
        float(defect / size**2),
        EXACT,
        what,
        f"It is zero, except for the error of the differences that give D, in {DIGITS} digits.",
    )


def _measure_reversibility(s: Subject) -> Iterator[Check]:
    """Measure the distance from the initial state after steps with h and back with -h."""
    if not read_scheme(s.stepper.scheme).symmetric:
        what = "not measured: the scheme is not symmetric"
        yield Check.without_value("reversible", what, "Left Radau nodes are not symmetric.")
        return
    forward, end = s.flow.advance(s.z, s.h, 20), 20 * s.flow.context.mpf(s.h)
    back = s.flow.advance(forward, -s.h, 20, t0=end)
    distance, what = s.distance(back, s.z), "20 steps with h and back with -h"
    if distance > EXACT:  # backwards in time, friction amplifies round-off errors
        nearby = s.flow.project(forward + NEARBY * s.flow.sizes, end)
        change = s.distance(s.flow.advance(nearby, -s.h, 20, t0=end), back)
        growth = max(1.0, change / s.distance(nearby, forward))
        distance /= growth
        what += f", divided by the growth of errors, {growth:.1e}"
    yield Check.at_most("reversible", distance, EXACT, what, "The scheme is symmetric.")


def _measure_momenta(s: Subject) -> Iterator[Check]:
    """Measure the change of the momenta that linear symmetries conserve.

    With forces, measure its difference from the impulse of the forces.
    """
    reason = "A linear symmetry of L conserves its momentum exactly, for any h."
    if s.has_forces and not s.is_nonholonomic:
        worst, symmetries = momentum_balance(s)
        if symmetries:
            names = ", ".join(symmetry.name for symmetry in symmetries)
            yield Check.at_most(
                "momenta",
                worst,
                EXACT,
                f"change of {names} minus the impulse of the forces",
                "Forces change the momentum of a linear symmetry of L by h sum_i b_i f_i.xi(q_i).",
            )
            return
    if not s.symmetries:
        header = s.stepper.program.header
        what = "not measured: the system has no linear symmetry"
        if block_size(s.n) < s.n:
            what += " that translates or rotates all points"
        if not header.conservative:
            cause = "forces" if header.forces else "terms that depend on the time"
            what = f"not measured: {cause} may change the momenta"
        yield Check.without_value("momenta", what, reason)
        return
    worst = 0.0
    for symmetry in s.symmetries:
        values = symmetry.momentum(s.path.q, s.path.p)
        size = symmetry.size(s.path.q, s.path.p) or 1.0
        worst = max(worst, float(max(abs(values - values[0]))) / size)
    what = f"change of {', '.join(symmetry.name for symmetry in s.symmetries)} in {SHORT} steps"
    yield Check.at_most("momenta", worst, EXACT, what, reason)


def _measure_invariants(s: Subject) -> Iterator[Check]:
    """Measure the order at which the user's invariants change; the full order if they do not."""
    if not s.stepper.invariants:
        return
    h = s.flow.context.mpf(s.h)
    runs: list[Trajectory] = []
    for name in s.stepper.invariants:
        changes: list[float] = []
        order, least = 0.0, s.stepper.order - 0.5
        while order < least and len(changes) < 4:  # a large step may not be asymptotic
            if len(changes) == len(runs):
                parts = 2 ** len(runs)
                runs.append(s.flow.run(s.z, h / parts, 8 * parts))
            values = runs[len(changes)].invariants[name]
            changes.append(float(max(abs(values - values[0]))))
            size = float(max(map(abs, values)))
            constant = changes[-1] < EXACT * size or size < EXACT
            if len(changes) > 2:
                order = float(observed_orders(changes[-2:])[0])
            order = float(s.stepper.order) if constant else order
        change = "does not change" if constant else f"changes by {changes[0]:.1e} with h"
        reason = "A quantity that the exact flow conserves changes at the order of the scheme."
        if abs(order) < MIN_ORDER:
            what = f"{name}: not measured: it changes by {changes[-1]:.1e} with all step sizes"
            yield Check.without_value("invariant", what, reason)
        else:
            yield Check.at_least("invariant", order, least, f"{name}: {change}", reason)


def _measure_constraints(s: Subject) -> Iterator[Check]:
    """Measure the violation of position and velocity constraints by compiled steps."""
    constraints = s.stepper.program.header.constraints
    if not constraints:
        return
    run = s.integrate(1000, every=10)
    slopes, m = run._slopes(), run.constraint_error.shape[1]
    size = np.linalg.norm(slopes, axis=2)
    contained = (slopes != 0).any(axis=0)  # the other coordinates may have other units
    positions, velocities = slice(m), slice(m, None)
    for row, name, error, states, some in (
        ("constraints", "phi(q)", run.constraint_error, "q", positions),
        ("rolling", "A v - b", run.velocity_constraint_error, "v", velocities),
    ):
        if error.size:
            scale = _largest_coordinates(contained[some], getattr(run, states))
            scale = np.maximum(scale, np.minimum(1.0, scale.max(axis=0)))
            scale[scale == 0] = 1.0
            yield Check.at_most(
                row,
                float((np.abs(error / size[:, some]) / scale).max()),
                4 * FLOAT64.epsilon,
                f"{name} in 1000 steps, relative to its slope and to {states}",
                "Each step imposes it again: only round-off remains, without drift.",
            )
    multipliers = run._evaluate_rows("start", "MULTIPLIER", len(constraints))
    part = np.abs((multipliers[..., None] * slopes).sum(axis=1)).max(axis=0)
    largest = _largest_coordinates(contained, run.p).max(axis=0)
    scale = (contained * largest[:, None]).max(axis=0)
    yield Check.at_most(
        "velocities",
        float((part / np.maximum(scale, LEAST_MOMENTUM * scale.max())).max()),
        1e-13,
        "change of p by another projection in 1000 steps, relative to p",
        "Momenta are projected in each step, so that Phi v = 0.",
    )


def _largest_coordinates(contained: NDArray[np.bool_], x: Floats) -> Floats:
    """Return the largest coordinate that each constraint contains, shape (states, constraints)."""
    return np.stack([np.abs(x[:, some]).max(axis=1, initial=0.0) for some in contained], axis=1)


def _measure_rounding(s: Subject) -> Iterator[Check]:
    """Measure the difference of compiled steps from steps in many digits."""
    run = s.integrate(SHORT, every=None)
    end = np.concatenate([s.path.q[-1], s.path.p[-1]])
    nearby = s.flow.project(s.z + 1e-9 * s.scale)
    growth = max(1.0, s.distance(s.flow.advance(nearby, s.h, SHORT), end) / 1e-9)
    difference = s.distance(np.concatenate([run.q[-1], run.p[-1]]), end) / growth
    yield Check.at_most(
        "rounding",
        difference,
        1e-13,
        f"difference from {DIGITS} digits after {SHORT} steps, divided by the growth of errors, "
        f"{growth:.1f}",
        "Compensated sums leave a round-off error of 1e-16 in a step.",
    )


#: The measurements by the name of a failed check, in the order of the certificate.
CHECKS: dict[str, Callable[[Subject], Iterator[Check]]] = {
    "order": measure_order,
    "time": measure_time_order,
    "symplectic": _measure_symplecticity,
    "reversible": _measure_reversibility,
    "momenta": _measure_momenta,
    "constraints": _measure_constraints,
    "invariants": _measure_invariants,
    "equations": measure_equations,
    "starts": measure_initial_momenta,
    "fallbacks": compare_fallbacks,
    "Jacobian": measure_jacobian,
    "Newton": measure_newton,
    "iterations": count_iterations,
    "rounding": _measure_rounding,
    "shadow": measure_shadow_energy,
    "drift": measure_drift,
}
