"""Verdicts on a finished run: domain of the energy, singular points, constraints, resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import ConstraintWarning, ResolutionWarning
from symsimpson.program.evaluation import evaluate
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import describe_domain_error, shorten
from symsimpson.run.resolution import (
    EnergySamples,
    find_unexplained_shift,
    sample_energies,
    select_states,
)
from symsimpson.stepping.constrained_start import DEPENDENT, name_dependent
from symsimpson.stepping.request import Request
from symsimpson.stepping.run import Run, StoredStates
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.calling import warn
from symsimpson.text.quantity import slopes_of

#: Failures of a step that a singular point of the coordinates may explain, or constraints.
UNSOLVED = (
    *(Status.NOT_CONVERGED, Status.DIVERGED, Status.STEP_TOO_LARGE),
    *(Status.SINGULAR_JACOBIAN, Status.NOT_FINITE),
)
#: Number of steps to repeat on each side of the smallest M, and the largest number of repeated
#: steps, including those from the last stored state.
STEPS_AROUND, MOST_REPEATED_STEPS = 64, 200_000
#: Number of runs near singular points after which no box of regular coordinates is searched.
TRIES = 3
#: Constraints are linearly dependent if their independence is below this.
SINGULAR = DEPENDENT**0.5
#: A failed step is explained by dependent constraints if their independence is below
#: ``NEARLY_DEPENDENT`` and would vanish within ``STEPS_AHEAD`` steps.
NEARLY_DEPENDENT, STEPS_AHEAD = 0.1, 4


def judge_run(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates
) -> Trajectory:
    """Judge a run by the states that it stored, or by samples.

    The run ends before the first state whose energy is not finite, or at which constraints are
    linearly dependent. The function warns if steps did not resolve the motion. For runs with
    events, it only checks that the energy is finite.
    """
    if trajectory.records or trajectory.ended_by:  # events change the energy
        return _judge_energy(program, run, trajectory, stored, acted=True)
    judged = _judge_energy(
        program, run, _explain_singular_point(program, trajectory), stored, acted=False
    )
    return _judge_constraints(program, run, judged, stored)


def _judge_energy(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates, *, acted: bool
) -> Trajectory:
    """Judge a run by its energy, and by the singular points and kinks that it passed."""
    unjudged = acted or not trajectory.success
    if unjudged and program.header.real_everywhere:
        return trajectory
    stored = _append_final_state(program, trajectory, stored)
    samples = sample_energies(program, run, trajectory.steps, stored)
    bad = None if samples is None else samples.first_not_real
    if bad is not None:
        ended = _cut_before(program, run, trajectory, stored, bad)
        return ended if acted else _explain_singular_point(program, ended)
    message = "" if unjudged else _describe_unresolved(program, run, trajectory, stored, samples)
    if not message:
        return trajectory
    message = f"{program.system}, {program.scheme}: {message}"
    warn(message, ResolutionWarning)
    return replace(trajectory, message=f"{trajectory.message} {message}")


def _append_final_state(
    program: Program, trajectory: Trajectory, stored: StoredStates
) -> StoredStates:
    """Append the final state to the samples of a run that stored only the final state."""
    if trajectory.every is not None or program.header.real_everywhere:
        return stored
    numbers = program.numbers
    with numbers.working():
        ends = [numbers.read(x[:1]) for x in (trajectory.q, trajectory.p)]
    q, p = (np.concatenate(parts) for parts in zip(stored[:2], ends, strict=True))
    return StoredStates(q, p, *stored[2:])


def _describe_unresolved(
    program: Program,
    run: Run,
    trajectory: Trajectory,
    stored: StoredStates,
    samples: EnergySamples | None,
) -> str:
    """Return a message about a passage that the steps did not resolve, or an empty text."""
    irregular = _describe_irregular(program, run, trajectory, stored)
    if irregular or samples is None:
        return irregular
    if samples.standing.any():
        place = int(samples.places[int(np.argmax(samples.standing))])
        return (
            f"the rate dt/dtau nearly vanishes at about t={float(stored.recorded[place, 0]):g}, "
            "and the energy has an error there. The motion may have been reflected, so the states "
            "after it are unreliable.\nUse a rate that is positive along the whole motion."
        )
    shift = find_unexplained_shift(program, run, trajectory, stored, samples)
    if shift is None:
        return ""
    (place, off), h = shift, float(run.h)
    since = stored.recorded[place, 0] if run.header.retimed else run.t0 + h * (place * stored.every)
    energy, scale, but = "energy", "", ""
    if not run.header.conservative:
        energy, scale = "energy minus the work of forces", " and this work"
        but = ", unless damping makes the motion independent of its past"
    return (
        f"from about t={float(since):g} on, the {energy} has a permanent error of {off:.0%} of the "
        f"kinetic energy{scale}. The step size h={h:g} did not resolve a fast part of the motion, "
        "such as a close encounter or a fast oscillation. The states after it are "
        f"unreliable{but}.\n"
        "Use a smaller h, or a scheme of higher order."
    )


def _describe_irregular(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates
) -> str:
    """Return a message about an unresolved singular point or kink, or an empty text."""
    tools, system = program.tools, program.declared
    if tools is None or system is None or run.W.dtype != np.float64:
        return ""
    request = _request_around_smallest(program, run, trajectory, stored)
    unknown = trajectory.every == 1 and not _stays_regular(program, trajectory)
    if unknown or request is not None:
        passed = tools.unresolved_pole(program, system, trajectory, request)
        if passed is not None:
            return describe_passage(passed, float(run.h))
    if not unknown or run.header.retimed:
        return ""
    inputs = np.asarray(trajectory.input_values)[0, 0, 0]
    values = [*map(float, trajectory.parameter_values), *map(float, inputs)]
    jumped = tools.kink_passed(system, trajectory.t, trajectory.q, values)
    if jumped is not None:
        return (
            f"the motion passes {jumped[1]} at about t={jumped[0]:g}, where the force or V jumps. "
            "Every scheme loses its order there, and the energy may not show the error.\n"
            f"{jumped[2]}."
        )
    _store_regular_box(program, trajectory)
    return ""


def describe_passage(passed: tuple[float, str, bool], h: float) -> str:
    """Return the message about a passage that steps did not resolve, with advice.

    ``passed`` has the time, the place, and whether it is a singular point of the coordinates.
    """
    t, where, singular = passed
    place = f"{where}, where its inertia is small"
    advice = "Use a smaller h, or a scheme of higher order."
    if singular:
        place = f"a singular point of the coordinates, near {where}"
        advice = (
            "Use coordinates that are regular there, such as Cartesian ones with a constraint (see "
            "the guide to constraints). A smaller h helps only if the passage is wide enough."
        )
    return (
        f"the motion passes {place}, at about t={t:g}, too fast for the step size h={h:g}. Finer "
        f"steps lead to other states, so the states after it are unreliable.\n{advice}"
    )


def inputs_for_repetition(
    program: Program, inputs: Reals, first: int, last: int, finer: int = 1
) -> dict[str, Floats]:
    """Return the inputs to repeat steps of a run, each divided into ``finer`` steps.

    ``inputs`` have shape (1, N, s, m). The values at the nodes of a step define a polynomial.
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


def _request_around_smallest(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates
) -> Request | None:
    """Return a request that repeats the steps around the smallest M; None if not needed.

    A run that stores all states needs no repetition.
    """
    if trajectory.every == 1 or not run.value("PIVOT_TIME") < np.inf:
        return None
    place = round(float((run.value("PIVOT_TIME") - run.t0) / run.h))
    # a retimed run must start at its initial state, which determines the rate
    some = len(stored.q) and not run.header.retimed
    first = max(0, place - STEPS_AROUND) // stored.every * stored.every if some else 0
    q, p = (x[first // stored.every] for x in stored[:2]) if some else run.begun[1]
    steps = min(place + STEPS_AROUND, trajectory.steps) - first
    free = {name: trajectory.parameters[name] for name in program.free_values()}
    t = run.t0 + run.h * first
    if steps > MOST_REPEATED_STEPS:
        return None
    inputs = inputs_for_repetition(program, trajectory.input_values, first, first + steps) or None
    again = {"t0": t, "steps": steps, "every": 1, "parameters": free, "inputs": inputs}
    return Request(q, p0=p, h=run.h, **again)


def _stays_regular(program: Program, trajectory: Trajectory) -> bool:
    """Return whether a run stays in a known box without singular points and kinks."""
    fixed = program.header.autonomous and not program.inputs
    values = trajectory.parameter_values
    return fixed and program.findings.regular_between(values, *_bounds_of_coordinates(trajectory))


def _bounds_of_coordinates(trajectory: Trajectory) -> tuple[Reals, Reals]:
    """Return the minima and the maxima of the coordinates, each of shape (n,)."""
    columns = np.ascontiguousarray(trajectory.q.T)  # 10 times faster than along the other axis
    return columns.min(axis=1), columns.max(axis=1)


def _store_regular_box(program: Program, trajectory: Trajectory) -> None:
    """Store a box of coordinates without singular points and kinks, for later short runs."""
    key, findings = trajectory.parameter_values.tobytes(), program.findings
    if findings.prepared is None or findings.irregular.get(key, 0) >= TRIES:
        return
    tools, system, known_box = program.tools, program.declared, findings.regular.get(key)
    everywhere = known_box is not None and not np.isfinite(known_box[0]).any()
    if everywhere:  # the coordinates are regular in all of space
        return
    low, high = _bounds_of_coordinates(trajectory)
    if known_box is not None:
        low, high = np.minimum(low, known_box[0]), np.maximum(high, known_box[1])
    assert tools is not None
    values = list(map(float, trajectory.parameter_values))
    box = tools.regular_box(system, values, low, high, float(trajectory.t[0]))
    if box is None:
        findings.irregular[key] = findings.irregular.get(key, 0) + 1
    else:
        findings.regular[key] = box


def _explain_singular_point(program: Program, trajectory: Trajectory) -> Trajectory:
    """Replace the message of a run that failed at a singular point of the coordinates."""
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
        f"t={float(trajectory.t[-1]):g} with h={float(trajectory.h):g} failed. The mass matrix is "
        f"nearly singular near {where}. {status.message}"
    )
    return replace(trajectory, status=status, message=message)


def _cut_before(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates, bad: int
) -> Trajectory:
    """Cut a run before the stored state number ``bad``, whose energy is not finite."""
    q, p, _, recorded, every = stored
    result, good, retimed = program.numbers.result, max(bad - 1, 0), run.header.retimed
    done, at = good * every, min(bad * every, trajectory.steps)
    where = recorded[min(bad, len(recorded) - 1), 0] if retimed else run.t0 + run.h * at
    about = shorten(trajectory, done) | describe_domain_error(program, run, where, at)
    if trajectory.every is None:
        last, tau = slice(good, good + 1), np.array([run.h * done])
        about |= {"q": result(q[last]), "p": result(p[last])}
        about |= run.recorded_fields(recorded[last], result)
        about["t"] = result(recorded[last, 0] if retimed else run.t0 + tau)
        about["tau_values"] = result(tau) if retimed else None
    about["records"] = tuple(record for record in trajectory.records if record.step < done)
    return replace(trajectory, **about | {"ended_by": None})


@np.errstate(invalid="ignore")  # failed members of an ensemble have states of NaN
def measure_independence(
    program: Program, states: tuple[Reals, Reals, Reals], values: Reals
) -> Floats:
    """Return the independence of the constraints at states (t, q, p), from 0 to 1.

    It is 0 if the constraints are linearly dependent, and 1 where each is at its maximum over the N
    states. ``q`` and ``p`` have shape (..., N, n).
    """
    count = len(program.header.constraints)
    pivots = evaluate(program, "multipliers", "HELD_PIVOT", count, states, values)
    # square roots scale as gradients; each is relative to its maximum, because units may differ
    sizes = np.sqrt(np.maximum(pivots.astype(np.float64), 0.0))
    independence: Floats = (sizes / sizes.max(axis=-2, keepdims=True)).min(axis=-1)
    return independence


def may_fold(independence: Floats) -> NDArray[np.bool_]:
    """Return for each pair of successive states whether constraints may be dependent between."""
    return np.asarray(independence[..., 1:] < np.abs(np.diff(independence, axis=-1)))


def _judge_constraints(
    program: Program, run: Run, trajectory: Trajectory, stored: StoredStates
) -> Trajectory:
    """Judge a run by the independence of its constraints.

    The run ends before a state with dependent constraints. The function warns if constraints may be
    dependent between two states. If a step failed shortly before such a state, the message says so.
    """
    names = program.names.constraints.shown
    if len(names) < 2 or len(stored.q) < 2:
        return trajectory
    every, failed = stored.every, trajectory.status in UNSOLVED
    t, q, p = select_states(run, stored, trajectory.steps, np.arange(len(stored.q)))
    if failed:  # add the current state, and a state about one step before it
        end = np.array([run.current_time]), *run.end()
        v = evaluate(program, "energy", "VELOCITY", program.n, end, run.parameters)
        before = end[0] - run.h, end[1] - run.h * v, end[2]
        t, q, p = map(np.concatenate, zip((t, q, p), before, end, strict=True))
    independences = measure_independence(program, (t, q, p), run.parameters)
    independence = independences[: len(stored.q)]
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
            f"{who}: the constraints {which} are linearly dependent at t={float(t[bad]):g}, at "
            f"step {bad * every} of {trajectory.steps}. {Status.SINGULAR_CONSTRAINTS.message}"
        )
        steps = trajectory.steps if trajectory.every is None else (bad - 1) * every
        about = shorten(trajectory, steps) | {"message": message}
        return replace(trajectory, status=Status.SINGULAR_CONSTRAINTS, **about)
    if failed and independences[-1] < min(
        NEARLY_DEPENDENT, STEPS_AHEAD * (independences[-2] - independences[-1])
    ):
        message = (
            f"{trajectory.message} The constraints {dependent(-1)} become linearly dependent "
            "there, for example because bars of a linkage fold into a line. End the run earlier, "
            "or choose lengths and motions without such a position."
        )
        return replace(trajectory, message=message)
    near = np.flatnonzero(may_fold(independence))
    if every > 1 or not near.size:  # distant states say nothing about those between
        return trajectory
    since = float(t[near[0] + 1])
    message = (
        f"{who}: the constraints are nearly linearly dependent at about t={since:g}, and may be "
        "dependent between two steps. Examples are bars of a linkage that fold into a line, or "
        "wheels in one line. The motion may continue along either branch, and "
        f"h={float(run.h):g} does not resolve which.\n"
        "Use a smaller h, or lengths and motions without such a position."
    )
    warn(message, ConstraintWarning)
    return replace(trajectory, message=f"{trajectory.message} {message}")
