"""Verdicts on a run by its states: whether they are real, and whether steps resolved them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symsimpson.errors import ResolutionWarning
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import out_of_domain
from symsimpson.run.folds import ended_after, first_states, look_at_folds, unknown_values
from symsimpson.run.resolution import Sampled, energies_at, look_at_energy
from symsimpson.stepping.kept import KeptStates
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.calling import warn

__all__ = ["inputs_again", "passage_in_words", "verdict"]

#: Failures that a singular point of the coordinates explains, where the run has come to one.
AT_POLES = (
    Status.NOT_CONVERGED,
    Status.DIVERGED,
    Status.STEP_TOO_LARGE,
    Status.SINGULAR_JACOBIAN,
    Status.NOT_FINITE,
    Status.SINGULAR_LEGENDRE,
)

#: Around the smallest M, so many steps are taken again; so many at most with those before.
AROUND, MOST_AGAIN = 64, 200_000

#: So many runs may show that a motion goes where there are singular points.
TRIES = 3


def verdict(program: Program, run: Run, trajectory: Trajectory, kept: KeptStates) -> Trajectory:
    """Judge a run by its states: all that it stored, or some that were kept for this.

    Where the energy is no number, or constraints follow from one another, the run ended before;
    where the motion was not resolved, it is warned of.
    """
    if trajectory.records or trajectory.ended_by:  # energies change with what events do
        return _within_domain(program, run, trajectory, kept)
    judged = _by_energy(program, run, trajectory, kept)
    return look_at_folds(program, run, judged, kept)


def _by_energy(program: Program, run: Run, trajectory: Trajectory, kept: KeptStates) -> Trajectory:
    """Judge a run by the energy at its states, and by singular points and kinks that it passed."""
    trajectory = _at_pole(program, trajectory)
    if not trajectory.success and program.header.real_everywhere:
        return trajectory
    kept = _with_last(program, trajectory, kept)
    energies = look_at_energy(program, run, trajectory, kept)
    if energies is not None and energies.first_not_real is not None:
        ended = _ended_before(program, run, trajectory, kept, energies)
        return _at_pole(program, ended)
    if not trajectory.success:
        return trajectory
    message = _unresolved(program, run, trajectory, kept, energies)
    if not message:
        return trajectory
    message = f"{program.system}, {program.scheme}: {message}"
    warn(message, ResolutionWarning)
    return replace(trajectory, message=f"{trajectory.message} {message}")


def _within_domain(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Trajectory:
    """Judge a run on which events acted by whether its energy is a number, whatever that is."""
    if program.header.real_everywhere:
        return trajectory
    kept = _with_last(program, trajectory, kept)
    energies = energies_at(program, run, trajectory.steps, kept, np.arange(len(kept.q)))
    if energies.first_not_real is None:
        return trajectory
    ended = _ended_before(program, run, trajectory, kept, energies)
    records = tuple(record for record in ended.records if record.step < ended.steps)
    return replace(ended, records=records, ended_by=None)


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
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, energies: Sampled | None
) -> str:
    """Return what was not resolved, in words, or nothing."""
    tools, system, h = program.tools, program.declared, float(run.h)
    plain = run.W.dtype == np.float64 and tools is not None and system is not None
    asked = _around_smallest(program, run, trajectory, kept) if plain else None
    unknown = trajectory.every == 1 and not _stays_regular(program, trajectory)
    if tools is not None and plain and (unknown or asked is not None):
        passed = tools.unresolved_pole(program, system, trajectory, asked)
        if passed is not None:
            return passage_in_words(passed, h)
    if tools is not None and plain and unknown and not run.header.retimed:
        inputs = np.asarray(trajectory.input_values)[0, 0, 0]
        values = [*map(float, trajectory.parameter_values), *map(float, inputs)]
        jumped = tools.kink_passed(system, trajectory.t, trajectory.q, values)
        if jumped is not None:
            return (
                f"about t={jumped[0]:g} the motion passes {jumped[1]}, where the force or V jumps: "
                f"no scheme keeps its order there, and energies need not tell.\n{jumped[2]}."
            )
        _remember_box(program, trajectory)
    if energies is not None and energies.standing.any():
        place = int(energies.places[int(np.argmax(energies.standing))])
        return (
            f"about t={float(kept.recorded[place, 0]):g} the rate dt/dtau nearly vanishes, and the "
            "energy is off there: the motion may have been thrown back, and the states after it "
            "are unreliable.\nTake a rate that is positive wherever the motion comes."
        )
    left = None if energies is None else energies.left_at
    if left is None:
        return ""
    place, off = left
    since = run.t0 + h * (place * kept.every)
    if run.header.retimed:
        since = kept.recorded[place, 0]
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
    key = trajectory.parameter_values.tobytes()
    if program.findings.prepared is None or program.findings.irregular.get(key, 0) >= TRIES:
        return
    tools, system = program.tools, program.declared
    known = program.findings.regular.get(key)
    if known is not None and not np.isfinite(known[0]).any():  # all of space is regular
        return
    low, high = _bounds(trajectory)
    if known is not None:
        low, high = np.minimum(low, known[0]), np.maximum(high, known[1])
    assert tools is not None
    values = list(map(float, trajectory.parameter_values))
    box = tools.regular_box(system, values, low, high, float(trajectory.t[0]))
    if box is None:
        program.findings.irregular[key] = program.findings.irregular.get(key, 0) + 1
    else:
        program.findings.regular[key] = box


def _at_pole(program: Program, trajectory: Trajectory) -> Trajectory:
    """Say so where a run failed at a singular point of the coordinates."""
    tools, system = program.tools, program.declared
    if trajectory.status not in AT_POLES or tools is None or system is None:
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
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates, energies: Sampled
) -> Trajectory:
    """Return a run that ended before the first state at which the energy is no number."""
    q, p, _, recorded, every = kept
    bad = energies.first_not_real
    assert bad is not None
    about = trajectory.__getstate__() | {"reduced_values": unknown_values(trajectory)}
    result, good = program.numbers.result, max(bad - 1, 0)
    done, at = good * every, min(bad * every, trajectory.steps)
    retimed, where = run.header.retimed, run.t0 + run.h * at
    if retimed:
        where = recorded[min(bad, len(recorded) - 1), 0]
    if trajectory.every is None:
        last = slice(good, good + 1)
        about |= {"q": result(q[last]), "p": result(p[last])}
        about |= run.beside(recorded[last], result)
        about["t"] = result(np.array([run.t0 + run.h * done]))
        if retimed:
            about |= {
                "t": result(recorded[last, 0]),
                "tau_values": result(np.array([run.h * done])),
            }
    else:
        about |= first_states(trajectory, done // trajectory.every + 1)
    about |= ended_after(trajectory, done) | out_of_domain(program, run, where, at)
    return Trajectory(**about)
