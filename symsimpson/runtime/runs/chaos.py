"""Runs that tell whether a motion is chaotic."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.inputs import read_count, whole_number
from symsimpson.runtime.results.chaos import Chaos, chaos_of
from symsimpson.runtime.runs.integrate import (
    begin_run,
    integrate,
    look_at_step,
    new_run,
    raise_failure,
    trajectory_of,
)
from symsimpson.runtime.runs.run import Kept
from symsimpson.runtime.runs.spec import RunSpec

if TYPE_CHECKING:
    from symsimpson.runtime.evaluator import Evaluator

__all__ = ["directions", "find_chaos", "kept_growth"]

Floats = NDArray[np.float64]


def kept_growth(stepper: Evaluator, count: int, every: int) -> Kept:
    """Say what a run keeps of so many variations, made orthonormal after so many steps."""
    rows, room = stepper._module.header.room_for_growth(count)
    return Kept("tangent", rows, room, count, every)


def directions(size: int, count: int) -> Floats:
    """Return orthonormal columns to begin with, the same ones each time, along nothing special."""
    found, _ = np.linalg.qr(np.random.default_rng(1980).normal(size=(size, count)))
    return np.ascontiguousarray(found)


def _allowed(stepper: Evaluator, spec: RunSpec, columns: Floats) -> Floats:
    """Return directions that constraints allow at the start: a step there moves any into them."""
    if not stepper._module.header.constraints:
        return columns
    back = replace(spec, h=-spec.h, steps=1, every=0)
    before = integrate(stepper, back, None, None, False, "raise")
    there = replace(
        spec,
        q0=before.q[0],
        other0=before.p[0],
        given="p0",
        t0=spec.t0 - spec.h,
        steps=1,
        every=0,
        tangents=columns,
    )
    moved = integrate(stepper, there, None, None, False, "raise")._tangents
    assert moved is not None
    found, _ = np.linalg.qr(moved[0])
    return np.ascontiguousarray(found)


def find_chaos(
    stepper: Evaluator, spec: RunSpec, exponents: Any, every: Any, progress: bool | None
) -> Chaos:
    """Run with variations that are made orthonormal after each ``every`` steps.

    Raises
    ------
    InputError, ConvergenceError, Interrupted
    """
    size = 2 * (stepper.n - len(stepper._module.header.constraints))
    stride = read_count("every", every, least=1)
    count = size if exponents is None else whole_number(exponents)
    if count is None or not 1 <= count <= size:
        raise InputError(
            f"exponents={exponents!r}, and {stepper.system} has {size} of them.\n"
            f"Pass a whole number from 1 to {size}, or None for all."
        )
    if spec.q0.dtype != np.float64:
        raise InputError("exponents are found in double precision.\nCompile without precision.")
    if spec.steps < stride:
        raise InputError(
            f"the run has {spec.steps} steps, and variations are made orthonormal after {stride}.\n"
            "Run longer, or pass a smaller every=."
        )
    run = new_run(
        stepper, spec, stride, spec.steps // stride + 1, kept=kept_growth(stepper, count, stride)
    )
    begin_run(stepper, run, spec)
    run.rows("TANGENTS", 1)[:] = count
    run.begin_growth(_allowed(stepper, spec, directions(2 * stepper.n, count)))
    look_at_step(stepper, run, spec)
    with run.watched(spec.steps, progress):
        run.advance(spec.steps)
    trajectory = trajectory_of(stepper, run, spec.steps, run.status, spec, run.stored(), stride)
    if not trajectory.success:
        raise_failure(run, trajectory, trajectory)
    return chaos_of(stepper, run.kept[1 : len(trajectory), :, 0], trajectory, count)
