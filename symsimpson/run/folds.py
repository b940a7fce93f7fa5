"""Where constraints of a run follow from one another: linkages that fold."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import ConstraintWarning
from symsimpson.module.matrices import slopes_of
from symsimpson.program.evaluating import evaluate_in
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.constrained_start import DEPENDENT, name_dependent
from symsimpson.stepping.kept import KeptStates
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.calling import warn

__all__ = [
    "SINGULAR",
    "UNSOLVED",
    "close",
    "ended_after",
    "first_states",
    "independence_of",
    "look_at_folds",
    "unknown_values",
]

#: What a run may have a row of for each state.
BY_STATE = ("t", "q", "p", "newton_iterations", "tau_values", "variations")
#: Where they are less independent than this, constraints follow from one another.
SINGULAR = DEPENDENT**0.5
#: Failures of a step that a singular point of the coordinates may explain, or constraints.
UNSOLVED = (
    *(Status.NOT_CONVERGED, Status.DIVERGED, Status.STEP_TOO_LARGE),
    *(Status.SINGULAR_JACOBIAN, Status.NOT_FINITE),
)
#: Constraints do that are no more independent than so much, and not at all so many steps later.
NEAR, AHEAD = 0.1, 4


def independence_of(pivots: Reals) -> Floats:
    """Return how far constraints are from following from one another at states one by one.

    It is 1 where each is held best, 0 where one follows from others; ``pivots`` are what is left of
    each constraint in HELD, shape (..., N, m).
    """
    # roots, as sizes of slopes are; each relative to its largest, since units may differ
    sizes = np.sqrt(np.maximum(pivots.astype(np.float64), 0.0))
    independence: Floats = (sizes / sizes.max(axis=-2, keepdims=True)).min(axis=-1)
    return independence


def close(independence: Floats) -> NDArray[np.bool_]:
    """Return between which states one constraint may have followed from others."""
    return np.asarray(independence[..., 1:] < np.abs(np.diff(independence, axis=-1)))


def first_states(trajectory: Trajectory, count: int) -> dict[str, Any]:
    """Return so many of the stored states of a run, with all that it has beside each."""
    columns = {name: getattr(trajectory, name) for name in BY_STATE}
    some = {name: rows[:count] for name, rows in columns.items() if rows is not None}
    recorded = tuple((name, rows[:count]) for name, rows in trajectory.recorded_values)
    return {**some, "recorded_values": recorded}


def ended_after(trajectory: Trajectory, steps: int) -> dict[str, Any]:
    """Return what tells that a run ended after fewer steps; its last inputs are those before."""
    inputs = trajectory.driven
    return {"steps": steps, "driven": None if inputs is None else replace(inputs, steps=steps)}


def unknown_values(trajectory: Trajectory) -> tuple[tuple[str, float], ...]:
    """Return what observed values came to where the run ended before states that they took in."""
    return tuple((name, np.nan) for name, _ in trajectory.reduced_values)


def look_at_folds(
    program: Program, run: Run, trajectory: Trajectory, kept: KeptStates
) -> Trajectory:
    """Look at how independent the constraints were at states of a run.

    Where one follows from others the run ended before; where that may have been so between two
    states, it is warned of; where a step failed shortly before, its message says so.
    """
    names = program.names.constraints.shown
    q, p, *_, every = kept
    if len(names) < 2 or len(q) < 2:
        return trajectory
    header, failed = program.header, trajectory.status in UNSOLVED
    t = run.t0 + run.h * np.minimum(np.arange(len(q)) * every, trajectory.steps)
    if failed:  # where it came to, and as far before as a step leads
        end = np.array([run.now]), *run.end()
        v = evaluate_in(run.W, program, "energy", "VELOCITY", program.n, end)
        before = end[0] - run.h, end[1] - run.h * v, end[2]
        t, q, p = map(np.concatenate, zip((t, q, p), before, end, strict=True))
    pivots = evaluate_in(run.W, program, "multipliers", "HELD_PIVOT", len(names), (t, q, p))
    known = independence_of(pivots)
    independence = known[: len(kept.q)]
    singular = np.flatnonzero(independence < SINGULAR)
    who = f"{program.system}, {program.scheme}"

    def dependent(at: int) -> str:
        size, states = header.layout["HELD_SIZE"], (t[[at]], q[[at]], p[[at]])
        (rows,) = evaluate_in(run.W, program, "multipliers", "CONSTRAINT_QQ", size, states)
        return name_dependent(names, slopes_of(header, rows).astype(np.float64))

    if singular.size:
        bad = int(singular[0])
        which = dependent(bad)
        message = (
            f"{who}: the constraints {which} depend on each other at t={float(t[bad]):g}, at "
            f"step {bad * every} of {trajectory.steps}. {Status.SINGULAR_CONSTRAINTS.message}"
        )
        about = trajectory.__getstate__() | {"reduced_values": unknown_values(trajectory)}
        if trajectory.every is not None:
            about |= first_states(trajectory, bad)
            about |= ended_after(trajectory, (bad - 1) * every)
        return Trajectory(**about | {"status": Status.SINGULAR_CONSTRAINTS, "message": message})
    if failed and known[-1] < min(NEAR, AHEAD * (known[-2] - known[-1])):
        told = (
            f"{trajectory.message} The constraints {dependent(-1)} come to depend on each other "
            "there, as where bars of a linkage fold into a line: end the run before, or choose "
            "lengths and motions at which they do not."
        )
        return Trajectory(**trajectory.__getstate__() | {"message": told})
    near = np.flatnonzero(close(independence))
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
    return Trajectory(**trajectory.__getstate__() | {"message": f"{trajectory.message} {message}"})
