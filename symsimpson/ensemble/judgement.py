"""Judgement of the steps of an ensemble, before its members run and behind it."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from symsimpson.ensemble.ensemble import Ensemble, spread
from symsimpson.ensemble.lanes import energies_at_start
from symsimpson.ensemble.task import Task
from symsimpson.errors import InputError, ResolutionWarning, StabilityWarning, SymsimpsonError
from symsimpson.module.interface import SMALL_PIVOT
from symsimpson.module.quantity import velocities_by
from symsimpson.program.evaluating import evaluate
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.run.requested import run
from symsimpson.run.resolution import FEWEST, LAST_LIMIT
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.calling import warn

__all__ = ["look_at_ends", "look_at_steps"]

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


def look_at_steps(program: Program, task: Task) -> None:
    """Warn of steps that do not resolve what is fast at the start of some members."""
    tools, system = program.tools, program.declared
    if tools is None or system is None:
        return
    for member in spread(task.members, LOOKED_AT):
        q, other, values = task.q0[member], task.other0[member], task.parameters[member]
        key = task.h, values.tobytes()
        if key in program.findings.checked_steps:
            continue
        v = other
        if not task.velocities:
            kernel = velocities_by(program.header)
            state = (np.full(1, task.t0), q[None], other[None])
            v = evaluate(program, kernel, "VELOCITY", program.n, state, values)[0]
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
    """Say why, where no member could begin; warn of members whose motion was not resolved.

    Raises InputError if no member could begin.
    """
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
        raise InputError(f"no member could begin. Of the first: {error}") from None
    except SymsimpsonError:
        return


def _energies_left(program: Program, task: Task, ensemble: Ensemble, some: Ints) -> Floats:
    """Return how far energies are from those at the start, in units of the kinetic energy."""
    if not some.size:
        return np.zeros(0)
    begun = task.part(some)
    q, p = (np.asarray(x[:])[some] for x in (ensemble.q, ensemble.p))
    if task.every:  # members of retimed systems end after steps of their own
        last = np.arange(len(q)), np.isfinite(q[..., 0]).sum(axis=1) - 1
        q, p = q[last], p[last]
    t_end = task.t0 if task.retimed else task.times[-1]
    ended = replace(begun, q0=q, other0=p, given="p0", t0=t_end)
    (start, kinetic), (end, later) = (energies_at_start(program, x).T for x in (begun, ended))
    scale = np.maximum(kinetic, later)
    with np.errstate(all="ignore"):
        left = np.where(scale > 0, abs(end - start) / scale, 0.0)
    return np.where(np.isfinite(start + kinetic), np.nan_to_num(left, nan=np.inf), 0.0)
