"""Verdicts on a run by its states: whether they are real, regular, independent, resolved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import ConstraintWarning, ResolutionWarning
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import out_of_domain, shortened
from symsimpson.run.resolution import EnergySamples, kept_states, level_left, sample_energies
from symsimpson.stepping.constrained_start import DEPENDENT, name_dependent
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import KeptStates, Run
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.calling import warn
from symsimpson.text.quantity import slopes_of

#: Failures of a step that a singular point of the coordinates may explain, or constraints.
UNSOLVED = (
    *(Status.NOT_CONVERGED, Status.DIVERGED, Status.STEP_TOO_LARGE),
    *(Status.SINGULAR_JACOBIAN, Status.NOT_FINITE),
)
#: Around the smallest M, so many steps are taken again; so many at most with those before.
AROUND, MOST_AGAIN = 64, 200_000
#: So many runs may show that a motion goes where there are singular points.
TRIES = 3
#: Where they are less independent than this, constraints follow from one another.
SINGULAR = DEPENDENT**0.5
#: Constraints do that are no more independent than so much, and not at all so many steps later.
NEAR, AHEAD = 0.1, 4


def verdict(program: Program, run: Run, trajectory: Trajectory, kept: KeptStates) -> Trajectory:
    """Judge a run by its states: all that it stored, or some that were kept for this.

    Where the energy is no number, or constraints follow from one another, the run ended before.
    The function warns where steps did not resolve the motion. On runs on which events acted, the
    energy must be a number, whatever that is.
    """
    if trajectory.records or trajectory.ended_by:  # energies change with what events do
        return _by_energy(program, run, trajectory, kept, acted=True)
    judged = _by_energy(program, run, _at_pole(program, trajectory), kept, acted=False)
    return _by_constraints(program, run, judged, kept)


def _by_energy(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, *, acted: bool
) -> Trajectory:
    """Judge a run by the energy at its states, and by singular points and kinks that it passed."""
    unjudged = acted or not trajectory.success
    if unjudged and program.header.real_everywhere:
        return trajectory
    kept = _with_last(program, trajectory, kept)
    seen = sample_energies(program, run, trajectory.steps, kept)
    bad = None if seen is None else seen.first_not_real
    if bad is not None:
        ended = _ended_before(program, run, trajectory, kept, bad)
        return ended if acted else _at_pole(program, ended)
    message = "" if unjudged else _unresolved(program, run, trajectory, kept, seen)
    if not message:
        return trajectory
    message = f"{program.system}, {program.scheme}: {message}"
    warn(message, ResolutionWarning)
    return replace(trajectory, message=f"{trajectory.message} {message}")


def _with_last(program: Program, trajectory: Trajectory, kept: KeptStates) -> KeptStates:
    """Return states that were kept with the last one, if a run stored this alone."""
    if trajectory.every is not None or program.header.real_everywhere:
        return kept
    numbers = program.numbers
    with numbers.working():
        ends = [numbers.read(x[:1]) for x in (trajectory.q, trajectory.p)]
    q, p = (np.concatenate(parts) for parts in zip(kept[:2], ends, strict=True))
    return KeptStates(q, p, *kept[2:])


def _unresolved(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, seen: EnergySamples | None
) -> str:
    """Return what was not resolved, in words, or nothing."""
    irregular = _irregular(program, run, trajectory, kept)
    if irregular or seen is None:
        return irregular
    if seen.standing.any():
        place = int(seen.places[int(np.argmax(seen.standing))])
        return (
            f"about t={float(kept.recorded[place, 0]):g} the rate dt/dtau nearly vanishes, and the "
            "energy is off there: the motion may have been thrown back, and the states after it "
            "are unreliable.\nTake a rate that is positive wherever the motion comes."
        )
    left = level_left(program, run, trajectory, kept, seen)
    if left is None:
        return ""
    (place, off), h = left, float(run.h)
    since = kept.recorded[place, 0] if run.header.retimed else run.t0 + h * (place * kept.every)
    energy, scale, but = "energy", "", ""
    if not run.header.conservative:
        energy, scale = "energy less the work of forces", " and this work"
        but = ", unless damping makes the motion forget how it came there"
    return (
        f"from about t={float(since):g} on the {energy} is off by {off:.0%} of the kinetic "
        f"energy{scale} and does not come back. A fast part of the motion, such as a close "
        f"encounter or a fast oscillation, was not resolved with h={h:g}; the states after it are "
        f"unreliable{but}.\n"
        "Take a smaller h, or a scheme of higher order."
    )


def _irregular(program: Program, run: Run, trajectory: Trajectory, kept: KeptStates) -> str:
    """Return which singular point or kink steps did not resolve, in words, or nothing."""
    tools, system = program.tools, program.declared
    if tools is None or system is None or run.W.dtype != np.float64:
        return ""
    asked = _around_smallest(program, run, trajectory, kept)
    unknown = trajectory.every == 1 and not _stays_regular(program, trajectory)
    if unknown or asked is not None:
        passed = tools.unresolved_pole(program, system, trajectory, asked)
        if passed is not None:
            return passage_in_words(passed, float(run.h))
    if not unknown or run.header.retimed:
        return ""
    inputs = np.asarray(trajectory.input_values)[0, 0, 0]
    values = [*map(float, trajectory.parameter_values), *map(float, inputs)]
    jumped = tools.kink_passed(system, trajectory.t, trajectory.q, values)
    if jumped is not None:
        return (
            f"about t={jumped[0]:g} the motion passes {jumped[1]}, where the force or V jumps: "
            f"no scheme keeps its order there, and energies need not tell.\n{jumped[2]}."
        )
    _remember_box(program, trajectory)
    return ""


def passage_in_words(passed: tuple[float, str, bool], h: float) -> str:
    """Return what to say of a passage that steps did not resolve, near a singular point or not."""
    t, where, singular = passed
    passes = f"{where}, where its inertia is small,"
    advice = "Take a smaller h, or a scheme of higher order."
    if singular:
        passes = f"a singular point of the coordinates, near {where},"
        advice = (
            "Use coordinates that are regular there, such as Cartesian ones held by a constraint "
            "(see the guide to constraints); a smaller h helps only where the passage is wide "
            "enough."
        )
    return (
        f"about t={t:g} the motion passes {passes} faster than steps of h={h:g} resolve: finer "
        f"steps lead elsewhere, and the states after it are unreliable.\n{advice}"
    )


def inputs_again(
    program: Program, inputs: Reals, first: int, last: int, finer: int = 1
) -> dict[str, Floats]:
    """Return inputs for taking steps of a run again, each in ``finer`` parts.

    ``inputs`` have the shape (1, N, s, m). The values at nodes define a polynomial on each step.
    """
    steps = np.minimum(np.arange(first, last), inputs.shape[1] - 1)
    rows = inputs[0, steps].astype(np.float64)
    if rows.shape[1] == 1:
        rows = np.repeat(rows, finer, axis=0)
    elif finer > 1:
        nodes = np.array(program.header.input_places, dtype=np.float64)
        parts = (np.arange(finer)[:, None] + nodes) / finer
        weights = np.vander(parts.ravel(), len(nodes)) @ np.linalg.inv(np.vander(nodes))
        rows = np.matmul(weights, rows).reshape(-1, *rows.shape[1:])
    return {name: rows[None, :, :, k] for k, name in enumerate(program.inputs)}


def _around_smallest(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Request | None:
    """Return how to take the steps again at which M was small, if a run has not all its states."""
    if trajectory.every == 1 or not run.value("PIVOT_TIME") < np.inf:
        return None
    place = round(float((run.value("PIVOT_TIME") - run.t0) / run.h))
    # a retimed run has its rate from its start
    some = len(kept.q) and not run.header.retimed
    first = max(0, place - AROUND) // kept.every * kept.every if some else 0
    q, p = (x[first // kept.every] for x in kept[:2]) if some else run.begun[1]
    steps = min(place + AROUND, trajectory.steps) - first
    free = {name: trajectory.parameters[name] for name in program.free_values()}
    t = run.t0 + run.h * first
    if steps > MOST_AGAIN:
        return None
    inputs = inputs_again(program, trajectory.input_values, first, first + steps) or None
    again = {"t0": t, "steps": steps, "every": 1, "parameters": free, "inputs": inputs}
    return Request(q, p0=p, h=run.h, **again)


def _stays_regular(program: Program, trajectory: Trajectory) -> bool:
    """Return whether a run is known to stay where coordinates have no singular points or kinks."""
    fixed = program.header.autonomous and not program.inputs
    values = trajectory.parameter_values
    return fixed and program.findings.regular_between(values, *_bounds(trajectory))


def _bounds(trajectory: Trajectory) -> tuple[Reals, Reals]:
    """Return the least and the largest values of the coordinates."""
    columns = np.ascontiguousarray(trajectory.q.T)  # along which it takes a tenth of the time
    return columns.min(axis=1), columns.max(axis=1)


def _remember_box(program: Program, trajectory: Trajectory) -> None:
    """Remember where short runs may go without being looked at one by one."""
    key, findings = trajectory.parameter_values.tobytes(), program.findings
    if findings.prepared is None or findings.irregular.get(key, 0) >= TRIES:
        return
    tools, system, known = program.tools, program.declared, findings.regular.get(key)
    if known is not None and not np.isfinite(known[0]).any():  # all of space is regular
        return
    low, high = _bounds(trajectory)
    if known is not None:
        low, high = np.minimum(low, known[0]), np.maximum(high, known[1])
    assert tools is not None
    values = list(map(float, trajectory.parameter_values))
    box = tools.regular_box(system, values, low, high, float(trajectory.t[0]))
    if box is None:
        findings.irregular[key] = findings.irregular.get(key, 0) + 1
    else:
        findings.regular[key] = box


def _at_pole(program: Program, trajectory: Trajectory) -> Trajectory:
    """Say so where a run failed at a singular point of the coordinates."""
    tools, system = program.tools, program.declared
    failed = trajectory.status in (*UNSOLVED, Status.SINGULAR_LEGENDRE)
    if not failed or tools is None or system is None:
        return trajectory
    where, lost = tools.at_pole(system, trajectory)
    status = Status.SINGULAR_LEGENDRE if lost else Status.COORDINATE_SINGULARITY
    if not where or trajectory.status is status:
        return trajectory
    message = (
        f"{program.system}, {program.scheme}: step {trajectory.steps} at "
        f"t={float(trajectory.t[-1]):g} with h={float(trajectory.h):g} was not taken: near {where} "
        f"the mass matrix is nearly singular. {status.message}"
    )
    return replace(trajectory, status=status, message=message)


def _ended_before(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, bad: int
) -> Trajectory:
    """Return a run that ended before the kept state at which the energy is no number."""
    q, p, _, recorded, every = kept
    result, good, retimed = program.numbers.result, max(bad - 1, 0), run.header.retimed
    done, at = good * every, min(bad * every, trajectory.steps)
    where = recorded[min(bad, len(recorded) - 1), 0] if retimed else run.t0 + run.h * at
    about = shortened(trajectory, done) | out_of_domain(program, run, where, at)
    if trajectory.every is None:
        last, tau = slice(good, good + 1), np.array([run.h * done])
        about |= {"q": result(q[last]), "p": result(p[last])}
        about |= run.beside(recorded[last], result)
        about["t"] = result(recorded[last, 0] if retimed else run.t0 + tau)
        about["tau_values"] = result(tau) if retimed else None
    about["records"] = tuple(record for record in trajectory.records if record.step < done)
    return replace(trajectory, **about | {"ended_by": None})


@np.errstate(invalid="ignore")  # members of ensembles that failed have no states
def independence_at(program: Program, states: tuple[Reals, Reals, Reals], values: Reals) -> Floats:
    """Return how far constraints are from following from one another at states (t, q, p).

    It is 1 where each is as independent as at any of the N states, 0 where one follows from others.
    ``q`` and ``p`` have shape (..., N, n).
    """
    count = len(program.header.constraints)
    pivots = evaluate(program, "multipliers", "HELD_PIVOT", count, states, values)
    # roots, as sizes of slopes are; each relative to its largest, since units may differ
    sizes = np.sqrt(np.maximum(pivots.astype(np.float64), 0.0))
    independence: Floats = (sizes / sizes.max(axis=-2, keepdims=True)).min(axis=-1)
    return independence


def may_fold(independence: Floats) -> NDArray[np.bool_]:
    """Return between which states one constraint may have followed from others."""
    return np.asarray(independence[..., 1:] < np.abs(np.diff(independence, axis=-1)))


def _by_constraints(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Trajectory:
    """Look at how independent the constraints were at states of a run.

    Where one follows from others the run ended before; where that may have been so between two
    states, it is warned of; where a step failed shortly before, its message says so.
    """
    names = program.names.constraints.shown
    if len(names) < 2 or len(kept.q) < 2:
        return trajectory
    every, failed = kept.every, trajectory.status in UNSOLVED
    t, q, p = kept_states(run, kept, trajectory.steps, np.arange(len(kept.q)))
    if failed:  # where it came to, and as far before as a step leads
        end = np.array([run.now]), *run.end()
        v = evaluate(program, "energy", "VELOCITY", program.n, end, run.parameters)
        before = end[0] - run.h, end[1] - run.h * v, end[2]
        t, q, p = map(np.concatenate, zip((t, q, p), before, end, strict=True))
    known = independence_at(program, (t, q, p), run.parameters)
    independence = known[: len(kept.q)]
    singular = np.flatnonzero(independence < SINGULAR)
    who = f"{program.system}, {program.scheme}"

    def dependent(at: int) -> str:
        size, state = program.header.layout["HELD_SIZE"], (t[at], q[at], p[at])
        rows = evaluate(program, "multipliers", "CONSTRAINT_QQ", size, state, run.parameters)
        return name_dependent(names, slopes_of(program.header, rows).astype(np.float64))

    if singular.size:
        bad = int(singular[0])
        which = dependent(bad)
        message = (
            f"{who}: the constraints {which} depend on each other at t={float(t[bad]):g}, at "
            f"step {bad * every} of {trajectory.steps}. {Status.SINGULAR_CONSTRAINTS.message}"
        )
        steps = trajectory.steps if trajectory.every is None else (bad - 1) * every
        about = shortened(trajectory, steps) | {"message": message}
        return replace(trajectory, status=Status.SINGULAR_CONSTRAINTS, **about)
    if failed and known[-1] < min(NEAR, AHEAD * (known[-2] - known[-1])):
        told = (
            f"{trajectory.message} The constraints {dependent(-1)} come to depend on each other "
            "there, as where bars of a linkage fold into a line: end the run before, or choose "
            "lengths and motions at which they do not."
        )
        return replace(trajectory, message=told)
    near = np.flatnonzero(may_fold(independence))
    if every > 1 or not near.size:  # of states that are far apart nothing can be said
        return trajectory
    since = float(t[near[0] + 1])
    message = (
        f"{who}: about t={since:g} constraints come close to following from one another, and may "
        "do so between two steps, as where bars of a linkage fold into a line or wheels stand in "
        f"one. The motion may go on along either branch, and h={float(run.h):g} does not resolve "
        "which.\nTake a smaller h, or lengths and motions at which they do not."
    )
    warn(message, ConstraintWarning)
    return replace(trajectory, message=f"{trajectory.message} {message}")
