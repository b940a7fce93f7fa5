"""Members of an ensemble that are run by themselves, where robust kernels may help them."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.derivatives.lyapunov import run_lyapunov
from symsimpson.ensemble.task import Results, Task
from symsimpson.errors import ConstraintWarning, InputError
from symsimpson.program.evaluating import evaluate_members
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.folds import SINGULAR, close, independence_of
from symsimpson.run.requested import run
from symsimpson.support.calling import warn, without_step_warnings

__all__ = ["PAIR", "RENEWAL", "run_singly"]

LOG = logging.getLogger(__name__)
#: Fast sines and cosines have a value for angles up to here.
FAST_SINES = 5e8
#: Powers of numbers above this may be none.
FAR = 1e50
#: So many variations of a motion tell its largest exponent and how two align; they are made
#: orthonormal after so many steps.
PAIR, RENEWAL = 2, 20


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
    energies = evaluate_members(program, "energy", "ENERGY", 1, t, q, p, task.parameters)
    nothing = np.isnan(q).all(axis=2)  # behind the end of a member
    return np.asarray((np.isfinite(energies[..., 0]) | nothing).all(axis=1))


def _unfolded(program: Program, task: Task, results: Results) -> NDArray[np.bool_]:
    """Return at whose stored states all constraints are independent; warn of those nearly not."""
    count = len(program.header.constraints)
    pivots = evaluate_members(
        program,
        "multipliers",
        "HELD_PIVOT",
        count,
        task.times,
        results.q,
        results.p,
        task.parameters,
    )
    with np.errstate(invalid="ignore"):  # of members that failed
        independence = independence_of(pivots)
    folded = (independence < SINGULAR).any(axis=1)
    near = np.flatnonzero(close(independence).any(axis=1) & ~folded)
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
