"""Runs that tell whether a motion is chaotic."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import InputError
from symsimpson.program.input_values import read_count, whole_number
from symsimpson.program.program import Program
from symsimpson.program.recorders import growth
from symsimpson.results.chaos import Chaos, chaos_of
from symsimpson.run.ended import raise_failure, trajectory_of
from symsimpson.run.integrate import integrate
from symsimpson.run.start import started
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.stepping.variations import refuse_retimed, varied_program
from symsimpson.support.array_types import Floats

__all__ = ["directions", "lyapunov", "run_lyapunov"]


def directions(size: int, count: int) -> Floats:
    """Return random orthonormal columns as first variations, the same ones each time."""
    basis, _ = np.linalg.qr(np.random.default_rng(1980).normal(size=(size, count)))
    return np.ascontiguousarray(basis)


def _tangent_to_constraints(program: Program, spec: RunSpec, columns: Floats) -> Floats:
    """Make columns tangent to the constraints, by carrying them over a step that ends there."""
    if not program.header.constraints:
        return columns
    back = replace(spec, h=-spec.h, steps=1, every=0)
    before = integrate(program, back, progress=False)
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
    moved = integrate(program, there, progress=False).variations
    assert moved is not None
    basis, _ = np.linalg.qr(moved[0])
    return np.ascontiguousarray(basis)


def lyapunov(
    program: Program, request: Request, exponents: Any, every: Any, progress: bool | None
) -> Chaos:
    """Run as requested, with variations; see :func:`run_lyapunov`."""
    refuse_retimed(program, "Lyapunov exponents")
    program = varied_program(program, ())
    return run_lyapunov(program, read_run(program, request), exponents, every, progress)


def run_lyapunov(
    program: Program, spec: RunSpec, exponents: Any, every: Any, progress: bool | None
) -> Chaos:
    """Find Lyapunov exponents from variations made orthonormal after each ``every`` steps.

    Raises InputError, ConvergenceError or Interrupted.
    """
    header = program.header
    size = 2 * (program.n - len(header.constraints)) + len(header.velocity_constraints)
    stride = read_count("every", every, least=1)
    count = size if exponents is None else whole_number(exponents)
    if count is None or not 1 <= count <= size:
        raise InputError(
            f"exponents={exponents!r}, and {program.system} has {size} of them.\n"
            f"Pass a whole number from 1 to {size}, or None for all."
        )
    if spec.q0.dtype != np.float64:
        raise InputError("exponents are found in double precision.\nCompile without precision.")
    if spec.steps < stride:
        raise InputError(
            f"the run has {spec.steps} steps, and variations are made orthonormal after {stride}.\n"
            "Run longer, or pass a smaller every=."
        )
    run = started(
        program, spec, stride, spec.steps // stride + 1, recorders=(growth(header, count, stride),)
    )
    run.rows("TANGENTS", 1)[:] = count
    run.begin_growth(_tangent_to_constraints(program, spec, directions(2 * program.n, count)))
    with run.watched(spec.steps, progress):
        run.advance(spec.steps)
    trajectory = trajectory_of(program, run, spec.steps, run.status, spec, run.stored(), stride)
    if not trajectory.success:
        raise_failure(run, trajectory, trajectory)
    return chaos_of(run.recorded[1 : len(trajectory), :, 0], trajectory, count)
