"""Members of an ensemble that are run once more, each by itself: they failed, or are in doubt."""

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
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ensemble.ensemble import Ensemble, spread
from symsimpson.run.ensemble.members import Results, Task
from symsimpson.run.lyapunov import run_lyapunov
from symsimpson.run.requested import run
from symsimpson.run.resolution import FEWEST, LAST_LIMIT, real_energies
from symsimpson.run.verdict import SINGULAR, independence_at, may_fold
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.calling import warn, without_step_warnings
from symsimpson.text.interface import SMALL_PIVOT
from symsimpson.text.quantity import velocities_by

LOG = logging.getLogger(__name__)
#: Fast sines and cosines have a value for angles up to here.
FAST_SINES = 5e8
#: Powers of numbers above this may be none.
FAR = 1e50
#: So many variations of a motion tell its largest exponent and how two align; they are made
#: orthonormal after so many steps.
PAIR, RENEWAL = 2, 20
#: Of so many members, spread over all, the step is looked at.
LOOKED_AT = 8
#: So many of those whose energy changed most are run once more, each by itself.
AGAIN = 2
#: So many other members whose energy moved are named.
SHOWN = 8
#: A run of more steps than this keeps some of its states alone.
WHOLE = 100_000
#: Those at whose states M was small are run again if that is short, or a small part of all.
SHORT, MANY = 2000, 128


def run_singly(program: Program, task: Task, results: Results) -> bool:
    """Run members that failed once more, each by itself, where robust kernels may help it.

    What a member comes to then is what a single run of it comes to. So are those at whose stored
    states the energy is not real, or too large to be a number, or constraints follow from one
    another. Tells whether Ctrl-C stopped it.
    """
    status, small = results.codes[:, 0], (np.abs(task.q0) < FAST_SINES).all(axis=1)
    good = status == Status.SUCCESS
    if not program.header.real_everywhere:
        good &= _real(program, task, results)
    for ends in (results.q[:, -1], results.p[:, -1]):
        good &= ~(np.abs(ends) > FAR).any(axis=1)
    if len(program.header.constraints) > 1 and task.every:
        good &= _unfolded(program, task, results)
    good |= (status == Status.BAD_INPUT) & small
    reductions = tuple(x for x in task.reductions if not x.of_variations) or None
    for member in np.flatnonzero(~good):
        LOG.info("%s: member %d is run again, by itself", program.system, member)
        try:
            with without_step_warnings():  # not one for each member
                carried = {"record": task.record, **_carrying(program, task)}
                carried |= {"every": task.every or None, "reduce": reductions}
                asked = task.of_member(member, program, **carried)
                trajectory = run(program, asked, on_failure="return")
        except InputError:
            for array in (results.q, results.p, results.recorded, results.seen):
                array[member] = np.nan
            results.codes[member] = Status.BAD_INPUT, 0, 0
            continue
        except KeyboardInterrupt:
            return True
        if trajectory.status is Status.INTERRUPTED:
            return True
        _put(program, task, results, member, trajectory)
    return False


def _put(program: Program, task: Task, results: Results, member: Any, run: Trajectory) -> None:
    """Put what a single run has come to into the arrays of all."""
    left = [run.t[:, None]] if task.retimed else []
    if run.variations is not None:
        left.append(run.variations.swapaxes(1, 2).reshape(len(run), -1))
    left += [rows for _, rows in run.recorded_values]
    kept = np.concatenate([np.zeros((len(run), 0)), *left], axis=1)
    whole = run.steps // run.every + 1 if run.every else 1  # behind them, the end if retimed
    if task.reductions:
        known = dict(run.reduced_values)
        values = [known.get(reduction.name, np.nan) for reduction in task.reductions]
        if task.of_variations and run.success:
            values = _of_variations(program, task, member, values)
        results.seen[member, : 2 * len(values) : 2] = values
    if task.retimed:
        results.part[member] = run.tau[-1] - run.h * run.steps
    stride = task.every // (run.every or 1)
    for array, states in ((results.q, run.q), (results.p, run.p), (results.recorded, kept)):
        stored = states[:whole][::stride] if task.every else states[-1:]
        array[member, : len(stored)], array[member, len(stored) :] = stored, np.nan
    results.records[int(member)] = run.records
    results.codes[member] = run.status, run.steps, run.newton_iterations.sum()
    if not run.every or run.ended_by is not None:  # else behind so many whole steps
        results.ended_at[member] = run.t[-1]


def _carrying(program: Program, task: Task) -> dict[str, Any]:
    """Return what a single run is asked to carry along."""
    if task.tangents is None:
        return {}
    names = program.header.varied_by or ()
    given = task.tangents[:, : task.tangents.shape[1] - len(names)]
    return {"tangents": given, "sensitivities": names}


def _of_variations(program: Program, task: Task, member: Any, values: list[float]) -> list[float]:
    """Return what reductions of a member come to, with those of its variations."""
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


def _real(program: Program, task: Task, results: Results) -> NDArray[np.bool_]:
    """Return which members have a real energy where they begin, and at all stored states."""
    # a momentum of zero where velocities were given: V has its value all the same
    first = 0 * task.other0 if task.velocities else task.other0
    q = np.concatenate([task.q0[:, None], results.q], axis=1)
    p = np.concatenate([first[:, None], results.p], axis=1)
    t = np.zeros(1)  # where it is retimed, no time matters
    if not task.retimed:
        t = np.concatenate([[task.t0], task.times])
    nothing = np.isnan(q).all(axis=2)  # behind the end of a member
    real = real_energies(program, (t, q, p), task.parameters) | nothing
    return np.asarray(real.all(axis=1))


def _unfolded(program: Program, task: Task, results: Results) -> NDArray[np.bool_]:
    """Return at whose stored states all constraints are independent; warn of those nearly not."""
    states = task.times, results.q, results.p
    independence = independence_at(program, states, task.parameters)
    folded = (independence < SINGULAR).any(axis=1)
    near = np.flatnonzero(may_fold(independence).any(axis=1) & ~folded)
    if near.size and task.every == 1:
        warn(
            f"{program.system}, {program.scheme}: in {near.size} of {task.members} members, the "
            f"first of them {near[0]}, constraints may follow from one another between two steps, "
            f"as where bars of a linkage fold into a line. The linkage may continue along either "
            f"branch, and h={task.h:g} does not resolve which.\nTake a smaller h, or lengths at "
            "which the linkage does not fold.",
            ConstraintWarning,
        )
    return np.asarray(~folded)


def look_at_steps(program: Program, task: Task) -> None:
    """Warn of steps that do not resolve what is fast at the start of some members."""
    tools, system = program.tools, program.declared
    if tools is None or system is None:
        return
    for member in spread(task.members, LOOKED_AT):
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


def look_at_ends(program: Program, task: Task, ensemble: Ensemble) -> None:
    """Raise InputError if no member could begin; warn of motions that are not resolved."""
    status = np.asarray(ensemble.status[:])
    if (status == Status.BAD_INPUT).all():
        _refuse(program, task)
    if task.steps < FEWEST or task.of_variations:
        return
    some = np.flatnonzero(status == Status.SUCCESS)
    left = _energies_left(program, task, ensemble, some)
    worst = some[np.argsort(-left)[:AGAIN]][: int((left > LAST_LIMIT).sum())].tolist()
    by_energy = len(worst)
    cheap = task.steps <= SHORT or task.members >= MANY
    if ensemble.small_pivots is not None and cheap:  # M was small
        pivots = ensemble.small_pivots[some]
        worst += some[np.argsort(pivots)[:AGAIN]][: int((pivots < SMALL_PIVOT).sum())].tolist()
    off = some[left > LAST_LIMIT].tolist()
    for member in dict.fromkeys(worst):
        who = _named(member, [k for k in off if k != member])
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            every = 1 if task.steps <= (WHOLE if member in worst[:by_energy] else SHORT) else None
            asked = task.of_member(member, program, every=every)
            single = run(program, asked, None, False, "return")
        if not single.success:
            message = f"{who}, does not come to its end by itself: {single.message}"
            warn(message, ResolutionWarning)
            return
        for warning in warned:
            if issubclass(warning.category, ResolutionWarning):
                warn(f"{who}: {warning.message}", ResolutionWarning)
                return


def _named(member: int, others: list[int]) -> str:
    """Name a member that was run again, and others whose energy moved."""
    if not others:
        return f"member {member}, as others may"
    more = ", ..." if len(others) > SHOWN else ""
    return f"member {member}, and probably {', '.join(map(str, others[:SHOWN]))}{more}"


def _refuse(program: Program, task: Task) -> None:
    """Raise what a run of the first member raises."""
    try:
        run(program, task.of_member(0, program), progress=False)
    except InputError as error:
        reject(f"no member could begin. Of the first: {error}")
    except SymsimpsonError:
        return


def _energies_left(program: Program, task: Task, ensemble: Ensemble, some: Ints) -> Floats:
    """Return how far energies are from those at the start, in units of the kinetic energy."""
    if not some.size:
        return np.zeros(0)
    q, p = (np.asarray(x[:])[some] for x in (ensemble.q, ensemble.p))
    if task.every:  # members of retimed systems end after steps of their own
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
        left = np.where(scale > 0, abs(end - start) / scale, 0.0)
    return np.where(np.isfinite(start + kinetic), np.nan_to_num(left, nan=np.inf), 0.0)
