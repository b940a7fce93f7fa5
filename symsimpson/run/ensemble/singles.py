"""Single runs of ensemble members that failed in a vector block or whose results are doubtful."""

from __future__ import annotations

import logging
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import (
    ConstraintWarning,
    InputError,
    ResolutionWarning,
    StabilityWarning,
    SymsimpsonError,
    reject,
)
from symsimpson.program.evaluation import evaluate
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ensemble.ensemble import Ensemble, spaced_members
from symsimpson.run.ensemble.members import EnsembleSpec, MemberResults
from symsimpson.run.lyapunov import run_lyapunov
from symsimpson.run.requested import run
from symsimpson.run.resolution import FEWEST, LAST_LIMIT, real_energies
from symsimpson.run.verdict import SINGULAR, may_fold, measure_independence
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.calling import warn, without_step_warnings
from symsimpson.text.interface import SMALL_PIVOT
from symsimpson.text.quantity import velocities_by

LOG = logging.getLogger(__name__)
#: Largest angle for fast sines and cosines.
FAST_SINES = 5e8
#: Powers of numbers above this may overflow.
LARGE_VALUE = 1e50
#: Number of variations for the largest Lyapunov exponent and for SALI, and the number of steps
#: after which they become orthonormal again.
PAIR, RENEWAL = 2, 20
#: Number of members, evenly spaced, whose step size is checked for stability.
CHECKED_MEMBERS = 8
#: Number of members that run again singly, those with the largest change of energy.
REPEATED_MEMBERS = 2
#: Largest number of other members that a warning names.
MOST_NAMED = 8
#: A run of more steps than this stores a sample of its states only.
LONGEST_STORED_RUN = 100_000
#: Members with a small M run again if they have at most ``SHORT`` steps, or if the ensemble has at
#: least ``MANY`` members.
SHORT, MANY = 2000, 128


def run_singly(program: Program, task: EnsembleSpec, results: MemberResults) -> bool:
    """Run failed members again singly, with fallback kernels; return whether Ctrl-C stopped it.

    Members also run again if the energy at a stored state is not finite, if coordinates are very
    large, or if constraints are linearly dependent. Their results are bitwise those of single runs.
    """
    status, small = results.codes[:, 0], (np.abs(task.q0) < FAST_SINES).all(axis=1)
    good = status == Status.SUCCESS
    if not program.header.real_everywhere and program.modes is None:
        good &= _have_real_energy(program, task, results)
    for ends in (results.q[:, -1], results.p[:, -1]):
        good &= ~(np.abs(ends) > LARGE_VALUE).any(axis=1)
    if len(program.header.constraints) > 1 and task.every and program.modes is None:
        good &= _have_independent_constraints(program, task, results)
    good |= (status == Status.BAD_INPUT) & small
    reductions = tuple(x for x in task.reductions if not x.of_variations) or None
    for member in np.flatnonzero(~good):
        LOG.info("%s: member %d runs again singly", program.system, member)
        try:
            with without_step_warnings():  # one warning for the ensemble is enough
                options = {"record": task.record, **_derivative_arguments(program, task)}
                options |= {"every": task.every or None, "reduce": reductions}
                request = task.request_of_member(member, program, **options)
                trajectory = run(program, request, on_failure="return")
        except InputError:
            for array in (results.q, results.p, results.recorded, results.seen):
                array[member] = np.nan
            results.codes[member] = Status.BAD_INPUT, 0, 0
            continue
        except KeyboardInterrupt:
            return True
        if trajectory.status is Status.INTERRUPTED:
            return True
        _write_results(program, task, results, member, trajectory)
    return False


def _write_results(
    program: Program, task: EnsembleSpec, results: MemberResults, member: Any, run: Trajectory
) -> None:
    """Write the results of a single run into the arrays of the ensemble."""
    columns = [run.t[:, None]] if task.retimed else []
    if run.variations is not None:
        columns.append(run.variations.swapaxes(1, 2).reshape(len(run), -1))
    columns += [rows for _, rows in run.recorded_values]
    recorded = np.concatenate([np.zeros((len(run), 0)), *columns], axis=1)
    whole = run.steps // run.every + 1 if run.every else 1  # without the end of a retimed run
    if task.reductions:
        known = dict(run.reduced_values)
        values = [known.get(reduction.name, np.nan) for reduction in task.reductions]
        if task.of_variations and run.success:
            values = _reduce_variations(program, task, member, values)
        results.seen[member, : 2 * len(values) : 2] = values
    if task.retimed:
        results.part[member] = run.tau[-1] - run.h * run.steps
    stride = task.every // (run.every or 1)
    for array, states in ((results.q, run.q), (results.p, run.p), (results.recorded, recorded)):
        stored = states[:whole][::stride] if task.every else states[-1:]
        array[member, : len(stored)], array[member, len(stored) :] = stored, np.nan
    results.records[int(member)] = run.records
    results.codes[member] = run.status, run.steps, run.newton_iterations.sum()
    if not run.every or run.ended_by is not None:  # other runs end after whole steps
        results.ended_at[member] = run.t[-1]


def _derivative_arguments(program: Program, task: EnsembleSpec) -> dict[str, Any]:
    """Return the arguments ``tangents`` and ``sensitivities`` of a single run of a member."""
    if task.tangents is None:
        return {}
    names = program.header.varied_by or ()
    given = task.tangents[:, : task.tangents.shape[1] - len(names)]
    return {"tangents": given, "sensitivities": names}


def _reduce_variations(
    program: Program, task: EnsembleSpec, member: Any, values: list[float]
) -> list[float]:
    """Return the values of all reductions of a member; compute reductions of variations."""
    member_task = replace(
        task,
        q0=task.q0[member],
        other0=task.other0[member],
        parameters=task.parameters[member],
        inputs=task.inputs[min(member, len(task.inputs) - 1)][None],
    )
    chaos = run_lyapunov(program, member_task, PAIR, RENEWAL, progress=False)
    known = {"lyapunov": chaos.exponents[0], "megno": chaos.megno[-1], "sali": chaos.sali[-1]}
    pairs = zip(task.reductions, values, strict=True)
    return [float(known.get(reduction.kind, value)) for reduction, value in pairs]


def _have_real_energy(
    program: Program, task: EnsembleSpec, results: MemberResults
) -> NDArray[np.bool_]:
    """Return which members have a finite energy at their initial and all stored states."""
    # with v0, zero momenta are enough to check that V is finite
    first = 0 * task.other0 if task.velocities else task.other0
    q = np.concatenate([task.q0[:, None], results.q], axis=1)
    p = np.concatenate([first[:, None], results.p], axis=1)
    t = np.zeros(1)  # retimed systems are autonomous
    if not task.retimed:
        t = np.concatenate([[task.t0], task.times])
    nothing = np.isnan(q).all(axis=2)  # states after the end of a member
    real = real_energies(program, (t, q, p), task.parameters) | nothing
    return np.asarray(real.all(axis=1))


def _have_independent_constraints(
    program: Program, task: EnsembleSpec, results: MemberResults
) -> NDArray[np.bool_]:
    """Return which members have independent constraints at all stored states.

    Warn if constraints may become dependent between two steps.
    """
    states = task.times, results.q, results.p
    independence = measure_independence(program, states, task.parameters)
    folded = (independence < SINGULAR).any(axis=1)
    near = np.flatnonzero(may_fold(independence).any(axis=1) & ~folded)
    if near.size and task.every == 1:
        warn(
            f"{program.system}, {program.scheme}: in {near.size} of {task.members} members, the "
            f"first of them {near[0]}, constraints may be linearly dependent between two steps, "
            "for example because bars of a linkage fold into a line. The linkage may continue "
            f"along either branch, and h={task.h:g} does not resolve which.\n"
            "Use a smaller h, or lengths at which the linkage does not fold.",
            ConstraintWarning,
        )
    return np.asarray(~folded)


def check_steps(program: Program, task: EnsembleSpec) -> None:
    """Warn if h is beyond linear stability at the initial state of some members."""
    tools, system = program.tools, program.declared
    if tools is None or system is None:
        return
    for member in spaced_members(task.members, CHECKED_MEMBERS):
        q, v, values = task.q0[member], task.other0[member], task.parameters[member]
        if (task.h, values.tobytes()) in program.findings.checked_steps:
            continue
        if not task.velocities:
            kernel, state = velocities_by(program.header), (np.asarray(task.t0), q, v)
            v = evaluate(program, kernel, "VELOCITY", program.n, state, values)
        inputs = task.inputs[min(member, len(task.inputs) - 1), 0, 0]
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            constants = np.concatenate([values, inputs])
            tools.check_step(program, system, q, v, constants, task.h, task.t0)
        for warning in warned:
            if issubclass(warning.category, StabilityWarning):
                warn(f"member {member}: {warning.message}", warning.category)
                return


def check_results(program: Program, task: EnsembleSpec, ensemble: Ensemble) -> None:
    """Raise InputError if no member could start; warn if steps do not resolve a motion."""
    status = np.asarray(ensemble.status[:])
    if (status == Status.BAD_INPUT).all():
        _raise_first_error(program, task)
    if task.steps < FEWEST or task.of_variations:
        return
    some = np.flatnonzero(status == Status.SUCCESS)
    changes = _energy_changes(program, task, ensemble, some)
    worst = some[np.argsort(-changes)[:REPEATED_MEMBERS]][
        : int((changes > LAST_LIMIT).sum())
    ].tolist()
    by_energy = len(worst)
    cheap = task.steps <= SHORT or task.members >= MANY
    if ensemble.small_pivots is not None and cheap:
        pivots = ensemble.small_pivots[some]
        worst += some[np.argsort(pivots)[:REPEATED_MEMBERS]][
            : int((pivots < SMALL_PIVOT).sum())
        ].tolist()
    off = some[changes > LAST_LIMIT].tolist()
    for member in dict.fromkeys(worst):
        who = _name_members(member, [k for k in off if k != member])
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            every = (
                1
                if task.steps <= (LONGEST_STORED_RUN if member in worst[:by_energy] else SHORT)
                else None
            )
            request = task.request_of_member(member, program, every=every)
            single = run(program, request, None, False, "return")
        if not single.success:
            message = f"{who}, does not reach its end in a single run: {single.message}"
            warn(message, ResolutionWarning)
            return
        for warning in warned:
            if issubclass(warning.category, ResolutionWarning):
                warn(f"{who}: {warning.message}", ResolutionWarning)
                return


def _name_members(member: int, others: list[int]) -> str:
    """Name a member that ran again, and other members whose energy changed."""
    if not others:
        return f"member {member}, and possibly others"
    more = ", ..." if len(others) > MOST_NAMED else ""
    return f"member {member}, and probably {', '.join(map(str, others[:MOST_NAMED]))}{more}"


def _raise_first_error(program: Program, task: EnsembleSpec) -> None:
    """Raise the error of a single run of the first member."""
    try:
        run(program, task.request_of_member(0, program), progress=False)
    except InputError as error:
        reject(f"no member could start. Error of the first member: {error}")
    except SymsimpsonError:
        return


def _energy_changes(program: Program, task: EnsembleSpec, ensemble: Ensemble, some: Ints) -> Floats:
    """Return the change of energy of some members, in units of their kinetic energy."""
    if not some.size:
        return np.zeros(0)
    q, p = (np.asarray(x[:])[some] for x in (ensemble.q, ensemble.p))
    if task.every:  # retimed members have different numbers of steps
        last = np.arange(len(q)), np.isfinite(q[..., 0]).sum(axis=1) - 1
        q, p = q[last], p[last]
    t = np.array([task.t0, task.t0 if task.retimed else task.times[-1]])
    q0, p0, values = task.q0[some], task.other0[some], task.parameters[some]
    if task.velocities:
        p0 = evaluate(program, "legendre", "MOMENTUM", program.n, (t[:1], q0, p0), values)
    states = t, np.stack([q0, q], axis=1), np.stack([p0, p], axis=1)
    energies = evaluate(program, "energy", "ENERGY", 2, states, values)
    (start, kinetic), (end, later) = energies.transpose(1, 2, 0)
    scale = np.maximum(kinetic, later)
    with np.errstate(all="ignore"):
        changes = np.where(scale > 0, abs(end - start) / scale, 0.0)
    return np.where(np.isfinite(start + kinetic), np.nan_to_num(changes, nan=np.inf), 0.0)
