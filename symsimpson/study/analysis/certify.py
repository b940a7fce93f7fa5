"""Measure whether a stepper is what it should be, on its own equations and state.

What a scheme promises is measured in many digits, on the text of the module that is compiled; then
the compiled code is held against the same text.
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
    drift,
    equations,
    fallbacks,
    iterations,
    jacobian,
    momentum_balance,
    newton,
    shadow,
    starts,
)
from symsimpson.study.analysis.order import observed_orders, order_of_errors, order_of_time
from symsimpson.study.analysis.pilot import choose_state, choose_step, follows
from symsimpson.study.analysis.precise import Precise
from symsimpson.study.analysis.subject import DIGITS, MOST, SHORT, STEPS, Subject, with_inputs
from symsimpson.study.analysis.symmetries import block_size
from symsimpson.study.analysis.variants import in_tau
from symsimpson.support.array_types import Floats
from symsimpson.support.progress import waiting
from symsimpson.text.header import digest

#: How far from a state, in units of its sizes, another one tells how errors grow: far above what
#: DIGITS leave, and so near that they still grow in proportion.
NEARBY = mpmath.mpf("1e-40")
#: Momenta that constraints share are not smaller than this part of the others, but for rounding.
ALONE = 1e-9
#: So often a step that a run would be warned of is halved.
HALVINGS = 40
#: A step is far too large if this part of it does not follow the motion.
TOO_LARGE = 64.0
#: Steps that show an error at all are doubled so often again before they are halved.
FAR = 30
#: What changes at an order below this in the step changes along the exact motion, too.
MOVES = 0.2


@waiting("certifying")
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
    """Measure order, symplecticity and all else that a stepper should have."""
    begin = time.perf_counter()
    if not stepper.program.numbers.compiled:
        reject(
            "a stepper of many digits has no certificate: it tests double-precision code.",
            remedy="Certify the stepper compiled without precision; its equations are the same.",
        )
    header = stepper.program.header
    if stepper.program.declared is None and (
        not header.conservative or header.velocity_constraints
    ):
        reject(
            f"{stepper.system}: a module by itself does not tell what its forces, velocity "
            "constraints and terms with the time are, so its order cannot be measured.",
            remedy="Certify a stepper that is compiled from the system: "
            "symsimpson.compile(system, ...).",
        )
    stepper = with_inputs(stepper, inputs)
    values = stepper.program.free_values(parameters)
    q, p = choose_state(stepper, {"q0": q0, "v0": v0, "p0": p0}, values)
    z, timed = np.concatenate([q, p]), None
    measured, exact = stepper, values
    if stepper.program.header.retimed:  # its steps are those of tau, where E0 is a number
        timed = Precise(stepper, values, DIGITS)
        measured, exact = in_tau(stepper), timed.from_start(z)
    step = _chosen_step(measured, q, p, exact) if h is None else read_step(h, FLOAT64)
    precise = Precise(measured, exact, DIGITS)
    held = bool(stepper.program.header.constraints)
    subject = Subject(measured, precise, precise.placed(z) if held else z, step, timed)
    if h is None and subject.doublings > 0:
        step = choose_step(
            measured, q, p, exact, LONG, first=step * 2.0 ** (subject.doublings + FAR)
        )
        subject = replace(subject, h=step)
    state = {"q0": q, "p0": p, "parameters": exact}
    error = None if h is None else _too_large(measured, state, step)
    if error is None:
        precise.sizes = subject.sizes
        with warnings.catch_warnings():
            if h is None:  # a step that nobody gave is as long as is measured well
                warnings.simplefilter("ignore", ResolutionWarning)
            checks = [check for measure in CHECKS for check in _guarded(measure, subject)]
    else:
        checks = [_not_measured("order", error)]
    return Certificate(
        stepper.system,
        stepper.scheme,
        stepper.order,
        digest(stepper.source),
        tuple(q.tolist()),
        tuple(p.tolist()),
        step,
        {name: float(value) for name, value in exact.items()},
        tuple(checks),
        time.perf_counter() - begin,
    )


def _chosen_step(stepper: Stepper, q: Any, p: Any, values: Mapping[str, float]) -> float:
    """Choose a step that follows the motion, and that no run would be warned of."""
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
    # half of a limit, at which nothing is measured well; other kernels may solve shorter steps
    return choose_step(stepper, q, p, values, LONG, first=step / 2 ** (halvings + 1))


def _too_large(
    stepper: Stepper, state: Mapping[str, Any], h: float
) -> ArithmeticError | ConvergenceError | None:
    """Return an error if a step is so large that nothing can be measured, or only very slowly."""
    if not follows(stepper, state, SHORT, h / TOO_LARGE):
        return ArithmeticError(
            f"in {STEPS} steps of h={h:g} the exact solution needs more than {MOST} steps: choose "
            "a smaller h"
        )
    try:
        for parts in (1, 2, 4):  # the order of the scheme is measured with these
            stepper.integrate(**state, h=h / parts, steps=STEPS * parts, every=None)
    except ConvergenceError as error:
        return error
    return None


def _guarded(measure: Callable[[Subject], Iterator[Check]], subject: Subject) -> Iterator[Check]:
    """Turn what goes wrong during a measurement into a row that has not passed."""
    try:
        yield from measure(subject)
    except KeyboardInterrupt:  # Interrupted is a SymsimpsonError, too
        raise
    except (SymsimpsonError, ArithmeticError, np.linalg.LinAlgError) as error:
        yield _not_measured((measure.__doc__ or "").split(":")[0], error)


def _not_measured(name: str, error: Exception) -> Check:
    first = str(error).partition("\n")[0]  # mpmath divides by zero without a word
    said = textwrap.shorten(f"{type(error).__name__}: {first}", 160, placeholder=" ...")
    reason = "What cannot be measured is not certified."
    return Check.not_asked(name, "", reason, said.removesuffix(":"))


def _symplectic(s: Subject) -> Iterator[Check]:
    """symplectic: the derivative of a step, Newton's method included; damped momenta shrink it."""
    conformal = s.stepper.program.header.conformal
    if s.forced and not conformal:
        what = "not asked: forces change it, as they change that of the flow"
        reason = "Without forces a step would be symplectic."
        yield Check.not_asked("symplectic", what, reason)
        return
    if s.rolling:
        what = "not asked: velocity constraints make a flow that is not symplectic"
        reason = "Their forces follow from no Lagrangian (van der Schaft and Maschke, 1994)."
        yield Check.not_asked("symplectic", what, reason)
        return
    n = s.n
    D, E = s.precise.tangent(s.z, s.h)
    # units of q and p in which both halves of the derivative are of like size
    p_by_q, q_by_p = (max(map(abs, block.ravel())) for block in (D[n:, :n], D[:n, n:]))
    ratio = (p_by_q / q_by_p) ** 0.5 if p_by_q and q_by_p else 1
    for matrix in (D, E):
        matrix[:n, n:] *= ratio
        matrix[n:, :n] /= ratio
    J = np.zeros((2 * n, 2 * n), dtype=object)
    J[:n, n:] += np.eye(n, dtype=int)
    J[n:, :n] -= np.eye(n, dtype=int)
    factor = s.precise.decay(s.z, s.h) if conformal else 1
    defect = max(map(abs, (D.T @ J @ D - factor * (E.T @ J @ E)).ravel()))
    size = max(map(abs, D.ravel()))
    what = f"D^T J D - {'exp(-2 gamma h) ' if conformal else ''}J of one step, relative to D^2"
    if s.stepper.program.header.constraints:
        what += "; for all displacements that constraints allow"
    yield Check.at_most(
        "conformal" if conformal else "symplectic",
        float(defect / size**2),
        EXACT,
        what,
        f"Zero, but for the differences that give D, in {DIGITS} digits.",
    )


def _reversible(s: Subject) -> Iterator[Check]:
    """reversible: there with h and back with -h."""
    if not read_scheme(s.stepper.scheme).symmetric:
        what, reason = "not asked: the scheme is not symmetric", "Left Radau nodes are not."
        yield Check.not_asked("reversible", what, reason)
        return
    there, end = s.precise.flow(s.z, s.h, 20), 20 * s.precise.context.mpf(s.h)
    back = s.precise.flow(there, -s.h, 20, t0=end)
    apart, what = s.distance(back, s.z), "20 steps with h and back with -h"
    if apart > EXACT:  # what friction has damped grows on the way back, and roundings with it
        nearby = s.precise.placed(there + NEARBY * s.precise.sizes, end)
        moved = s.distance(s.precise.flow(nearby, -s.h, 20, t0=end), back)
        growth = max(1.0, moved / s.distance(nearby, there))
        apart /= growth
        what += f", errors growing {growth:.1e} times"
    yield Check.at_most("reversible", apart, EXACT, what, "The scheme is symmetric.")


def _momenta(s: Subject) -> Iterator[Check]:
    """momenta: what linear symmetries conserve."""
    reason = "A linear symmetry of L conserves its momentum exactly, at any h."
    if s.forced and not s.rolling:
        worst, symmetries = momentum_balance(s)
        if symmetries:
            names = ", ".join(symmetry.name for symmetry in symmetries)
            yield Check.at_most(
                "momenta",
                worst,
                EXACT,
                f"change of {names} less what forces gave",
                "Forces change the momentum of a linear symmetry of L by h sum_i b_i f_i.xi(q_i).",
            )
            return
    if not s.symmetries:
        header = s.stepper.program.header
        what = "none: there is no linear symmetry"
        if block_size(s.n) < s.n:
            what += " that moves or turns all points alike"
        if not header.conservative:
            what = "not asked: forces" if header.forces else "not asked: what depends on the time"
            what += " may change them"
        yield Check.not_asked("momenta", what, reason)
        return
    worst = 0.0
    for symmetry in s.symmetries:
        values = symmetry.momentum(s.path.q, s.path.p)
        size = symmetry.size(s.path.q, s.path.p) or 1.0
        worst = max(worst, float(max(abs(values - values[0]))) / size)
    what = f"change of {', '.join(symmetry.name for symmetry in s.symmetries)} in {SHORT} steps"
    yield Check.at_most("momenta", worst, EXACT, what, reason)


def _invariants(s: Subject) -> Iterator[Check]:
    """invariants: change with the order of the scheme, or not at all."""
    if not s.stepper.invariants:
        return
    h = s.precise.context.mpf(s.h)
    runs: list[Trajectory] = []
    for name in s.stepper.invariants:
        changes: list[float] = []
        order, least = 0.0, s.stepper.order - 0.5
        while order < least and len(changes) < 4:  # a large step may not be asymptotic yet
            if len(changes) == len(runs):
                parts = 2 ** len(runs)
                runs.append(s.precise.run(s.z, h / parts, 8 * parts))
            values = runs[len(changes)].invariants[name]
            changes.append(float(max(abs(values - values[0]))))
            size = float(max(map(abs, values)))
            kept = changes[-1] < EXACT * size or size < EXACT
            if len(changes) > 2:
                order = float(observed_orders(changes[-2:])[0])
            order = float(s.stepper.order) if kept else order
        what = f"{name}: " + ("does not change" if kept else f"changes by {changes[0]:.1e} at h")
        reason = "What the exact flow conserves changes at the order of the scheme."
        if abs(order) < MOVES:
            what = f"{name}: not asked: it changes by {changes[-1]:.1e} with all steps"
            yield Check.not_asked("invariant", what, reason)
        else:
            yield Check.at_least("invariant", order, least, what, reason)


def _constraints(s: Subject) -> Iterator[Check]:
    """constraints: of positions and of velocities, along compiled steps."""
    held = s.stepper.program.header.constraints
    if not held:
        return
    run = s.compiled(1000, every=10)
    slopes, m = run._slopes(), run.constraint_error.shape[1]
    size = np.linalg.norm(slopes, axis=2)
    contained = (slopes != 0).any(axis=0)  # coordinates beside have units of their own
    positions, velocities = slice(m), slice(m, None)
    for what, name, error, states, some in (
        ("constraints", "phi(q)", run.constraint_error, "q", positions),
        ("rolling", "A v - b", run.velocity_constraint_error, "v", velocities),
    ):
        if error.size:
            reach = _largest(contained[some], getattr(run, states))
            reach = np.maximum(reach, np.minimum(1.0, reach.max(axis=0)))
            reach[reach == 0] = 1.0
            yield Check.at_most(
                what,
                float((np.abs(error / size[:, some]) / reach).max()),
                4 * FLOAT64.epsilon,
                f"{name} in 1000 steps, relative to its slope and to {states}",
                "Imposed anew in each step: a rounding, and no drift.",
            )
    pulls = run._evaluated("start", "MULTIPLIER", len(held))
    part = np.abs((pulls[..., None] * slopes).sum(axis=1)).max(axis=0)
    largest = _largest(contained, run.p).max(axis=0)
    scale = (contained * largest[:, None]).max(axis=0)
    yield Check.at_most(
        "velocities",
        float((part / np.maximum(scale, ALONE * scale.max())).max()),
        1e-13,
        "what constraints would take from p in 1000 steps, relative to p",
        "Momenta are projected in each step, so that Phi v = 0.",
    )


def _largest(contained: NDArray[np.bool_], x: Floats) -> Floats:
    """Return the largest of the coordinates that each constraint contains, at each state."""
    return np.stack([np.abs(x[:, some]).max(axis=1, initial=0.0) for some in contained], axis=1)


def _rounding(s: Subject) -> Iterator[Check]:
    """rounding: compiled code against many digits."""
    run = s.compiled(SHORT, every=None)
    end = np.concatenate([s.path.q[-1], s.path.p[-1]])
    nearby = s.precise.placed(s.z + 1e-9 * s.scale)
    moved = s.precise.flow(nearby, s.h, SHORT)
    growth = max(1.0, s.distance(moved, end) / 1e-9)
    difference = s.distance(np.concatenate([run.q[-1], run.p[-1]]), end) / growth
    yield Check.at_most(
        "rounding",
        difference,
        1e-13,
        f"compiled against {DIGITS} digits after {SHORT} steps, errors growing {growth:.1f} times",
        "Compensated sums leave a rounding error of 1e-16 in a step.",
    )


CHECKS: tuple[Callable[[Subject], Iterator[Check]], ...] = (
    order_of_errors,
    order_of_time,
    _symplectic,
    _reversible,
    _momenta,
    _constraints,
    _invariants,
    equations,
    starts,
    fallbacks,
    jacobian,
    newton,
    iterations,
    _rounding,
    shadow,
    drift,
)
