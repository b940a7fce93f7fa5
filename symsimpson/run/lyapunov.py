"""Runs that tell whether a motion is chaotic."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count, whole_number
from symsimpson.program.program import Program
from symsimpson.program.recorders import growth
from symsimpson.results.motion_derivatives import Chaos, chaos_of
from symsimpson.run.ended import raise_failure, trajectory_of
from symsimpson.run.integrate import integrate, started
from symsimpson.stepping.inputs import refuse_retimed, varied_program
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Floats

Spec = TypeVar("Spec", bound=RunSpec)


#: The part of a step whose derivative gives masses and a time scale. Smaller parts have more
#: round-off.
PART = 2.0**-3
#: Constraints fix a coordinate if its derivative by its own start is round-off, below this.
FIXED = 2.0**-40
#: Bounds of the time scale, in steps.
SHORTEST, LONGEST = 2.0**-4, 2.0**12


def directions(size: int, count: int) -> Floats:
    """Return random orthonormal columns as first variations, the same ones each time.

    The scalar product of a column and J times another is not zero for the first and the last
    column, the second and the last but one, and so on. Steps that are symplectic keep this, so
    exponents of such a pair have opposite values.
    """
    n = size // 2
    draws = np.random.default_rng(1980).normal(size=(min(n, count), 2, n))
    basis, _ = np.linalg.qr((draws[:, 0] + 1j * draws[:, 1]).T)
    columns = np.vstack([basis.real, basis.imag])
    partners = np.vstack([-basis.imag, basis.real])[:, ::-1]
    return np.hstack([columns, partners])[:, :count]


def first_part(spec: Spec) -> Spec:
    """Return the run over a part of the first step, with its derivative."""
    identity, inputs = np.eye(2 * spec.q0.shape[-1]), spec.inputs[:, :1]
    part = replace(spec, h=spec.h * PART, steps=1, every=0, inputs=inputs, tangents=identity)
    return replace(part, reductions=(), record=())


def first_columns(derivative: Floats, h: float, count: int) -> Floats:
    """Return first variations, and as the last column the weights of dq and dp.

    ``derivative``, shape (..., 2 n, 2 n), comes from :func:`first_part`. The squared length of a
    variation is the sum of (m/T) dq^2 + (T/m) dp^2, so each term is an action in any units. 1/m is
    the diagonal of M^-1. T makes both parts of the linearised equations equal in size: it is
    1/omega of an oscillator. The variations are orthonormal in this length.
    """
    n = derivative.shape[-1] // 2
    q_by_p, p_by_q = (x / (PART * h) for x in (derivative[..., :n, n:], derivative[..., n:, :n]))
    with np.errstate(all="ignore"):
        light = np.diagonal(q_by_p, axis1=-2, axis2=-1)
        moves = abs(np.diagonal(derivative[..., :n, :n], axis1=-2, axis2=-1)) > FIXED
        light = np.where((light > 0) & moves, light, 0.0)
        m = np.where(light > 0, 1 / light, 0.0)
        pairs = (np.sqrt(x[..., :, None] * x[..., None, :]) for x in (m, light))
        blocks = zip((q_by_p, p_by_q), pairs, strict=True)
        slow, fast = (np.linalg.norm(x * pair, axis=(-2, -1)) for x, pair in blocks)
        T = np.clip(np.sqrt(slow / fast), SHORTEST * abs(h), LONGEST * abs(h))[..., None]
        weights = np.concatenate([m / T, light * T], axis=-1)[..., None]
        columns = directions(2 * n, count) * np.where(weights > 0, weights**-0.5, 0.0)
    return np.concatenate([columns, weights], axis=-1)


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
        tangents=np.ascontiguousarray(columns[:, :-1]),
    )
    moved = integrate(program, there, progress=False).variations
    assert moved is not None
    factor = np.linalg.qr(np.sqrt(columns[:, -1:]) * moved[0], mode="r")
    return np.concatenate([moved[0] @ np.linalg.inv(factor), columns[:, -1:]], axis=1)


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
        reject(
            f"exponents={exponents!r}, and {program.system} has {size} of them.",
            remedy=f"Pass a whole number from 1 to {size}, or None for all.",
        )
    if spec.q0.dtype != np.float64:
        reject("exponents are found in double precision.", remedy="Compile without precision.")
    if spec.steps < stride:
        reject(
            f"the run has {spec.steps} steps, and variations are made orthonormal after {stride}.",
            remedy="Run longer, or pass a smaller every=.",
        )
    run = started(
        program, spec, stride, spec.steps // stride + 1, recorders=(growth(header, count, stride),)
    )
    run.rows("TANGENTS", 1)[:] = count
    derivative = integrate(program, first_part(spec), progress=False).variations
    assert derivative is not None
    columns = first_columns(derivative[0], spec.h, count)
    run.begin_growth(_tangent_to_constraints(program, spec, columns))
    with run.watched(spec.steps, progress):
        run.advance(spec.steps)
    trajectory = trajectory_of(program, run, spec.steps, run.status, spec, run.stored(), stride)
    if not trajectory.success:
        raise_failure(run, trajectory, trajectory)
    return chaos_of(run.recorded[1 : len(trajectory), :, 0], trajectory, count)
