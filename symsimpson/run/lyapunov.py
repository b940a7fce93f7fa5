"""Runs with Lyapunov exponents, which measure chaos."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count, whole_number
from symsimpson.program.program import Program
from symsimpson.program.recorders import growth
from symsimpson.results.motion_derivatives import Chaos, read_chaos
from symsimpson.run.ended import make_trajectory, raise_failure
from symsimpson.run.integrate import integrate, start_run
from symsimpson.stepping.inputs import program_with_derivatives, reject_retimed
from symsimpson.stepping.request import Request
from symsimpson.stepping.spec import RunSpec, read_run
from symsimpson.support.array_types import Floats

Spec = TypeVar("Spec", bound=RunSpec)


#: The part of a step whose derivative gives masses and a time scale. Smaller parts have more
#: round-off.
STEP_PART = 2.0**-3
#: Constraints fix a coordinate if its derivative by its own start is round-off, below this.
FIXED_COORDINATE = 2.0**-40
#: Bounds of the time scale, in steps.
SHORTEST, LONGEST = 2.0**-4, 2.0**12


def random_directions(size: int, count: int) -> Floats:
    """Return random orthonormal columns as first variations, the same ones each time.

    The columns are pairs: the first and the last, the second and the last but one, and so on. The
    scalar product of a column and J times another is not zero only within a pair. Symplectic steps
    conserve this, so the two exponents of a pair have opposite values.
    """
    n = size // 2
    draws = np.random.default_rng(1980).normal(size=(min(n, count), 2, n))
    basis, _ = np.linalg.qr((draws[:, 0] + 1j * draws[:, 1]).T)
    columns = np.vstack([basis.real, basis.imag])
    partners = np.vstack([-basis.imag, basis.real])[:, ::-1]
    return np.hstack([columns, partners])[:, :count]


def spec_of_first_part(spec: Spec) -> Spec:
    """Return the specification of a run over a part of the first step, with its derivative."""
    identity, inputs = np.eye(2 * spec.q0.shape[-1]), spec.inputs[:, :1]
    part = replace(spec, h=spec.h * STEP_PART, steps=1, every=0, inputs=inputs, tangents=identity)
    return replace(part, reductions=(), record=())


def initial_variations(derivative: Floats, h: float, count: int) -> Floats:
    """Return first variations, and as the last column the weights of dq and dp.

    ``derivative``, shape (..., 2 n, 2 n), comes from :func:`first_part`. The squared length of a
    variation is the sum of (m/T) dq^2 + (T/m) dp^2, so each term is an action in any units. Here
    1/m is the diagonal of M^-1. The time T makes both parts of the linearised equations equal in
    size: for an oscillator, it is 1/omega. The variations are orthonormal in this length.
    """
    n = derivative.shape[-1] // 2
    q_by_p, p_by_q = (
        x / (STEP_PART * h) for x in (derivative[..., :n, n:], derivative[..., n:, :n])
    )
    with np.errstate(all="ignore"):
        light = np.diagonal(q_by_p, axis1=-2, axis2=-1)
        moves = abs(np.diagonal(derivative[..., :n, :n], axis1=-2, axis2=-1)) > FIXED_COORDINATE
        light = np.where((light > 0) & moves, light, 0.0)
        m = np.where(light > 0, 1 / light, 0.0)
        pairs = (np.sqrt(x[..., :, None] * x[..., None, :]) for x in (m, light))
        blocks = zip((q_by_p, p_by_q), pairs, strict=True)
        slow, fast = (np.linalg.norm(x * pair, axis=(-2, -1)) for x, pair in blocks)
        T = np.clip(np.sqrt(slow / fast), SHORTEST * abs(h), LONGEST * abs(h))[..., None]
        weights = np.concatenate([m / T, light * T], axis=-1)[..., None]
        if (moves & (light == 0)).any():  # M^-1 or H_pp is not definite
            weights = _weights_by_rows(q_by_p, p_by_q)
        columns = random_directions(2 * n, count) * np.where(weights > 0, weights**-0.5, 0.0)
    return np.concatenate([columns, weights], axis=-1)


def _weights_by_rows(q_by_p: Floats, p_by_q: Floats) -> Floats:
    """Return weights of dq and dp from the largest entries of each row of the derivatives."""
    fast, slow = abs(p_by_q).max(axis=-1), abs(q_by_p).max(axis=-1)
    ratio = np.sqrt(np.where((fast > 0) & (slow > 0), fast / slow, 1.0))
    return np.concatenate([ratio, 1 / ratio], axis=-1)[..., None]


def _project_variations(program: Program, spec: RunSpec, columns: Floats) -> Floats:
    """Make columns tangent to the constraints: carry them over a step that ends at q0."""
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
    propagated = integrate(program, there, progress=False).variations
    assert propagated is not None
    factor = np.linalg.qr(np.sqrt(columns[:, -1:]) * propagated[0], mode="r")
    return np.concatenate([propagated[0] @ np.linalg.inv(factor), columns[:, -1:]], axis=1)


def lyapunov(
    program: Program, request: Request, exponents: Any, every: Any, progress: bool | None
) -> Chaos:
    """Run as requested, with variations; see :func:`run_lyapunov`."""
    reject_retimed(program, "Lyapunov exponents")
    program = program_with_derivatives(program, ())
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
            f"exponents={exponents!r}, but the system has {size} Lyapunov exponents.",
            where=program.system,
            remedy=f"Pass a whole number from 1 to {size}, or None for all.",
        )
    if spec.q0.dtype != np.float64:
        reject("Lyapunov exponents need double precision.", remedy="Compile without precision=.")
    if spec.steps < stride:
        reject(
            f"the run has {spec.steps} steps, fewer than every={stride}.",
            why="Variations become orthonormal after each every= steps.",
            remedy="Take more steps, or pass a smaller every=.",
        )
    run = start_run(
        program, spec, stride, spec.steps // stride + 1, recorders=(growth(header, count, stride),)
    )
    run.rows("TANGENTS", 1)[:] = count
    derivative = integrate(program, spec_of_first_part(spec), progress=False).variations
    assert derivative is not None
    columns = initial_variations(derivative[0], spec.h, count)
    run.begin_growth(_project_variations(program, spec, columns))
    with run.watched(spec.steps, progress):
        run.advance(spec.steps)
    trajectory = make_trajectory(
        program, run, spec.steps, run.status, spec, run.stored_states(), stride
    )
    if not trajectory.success:
        raise_failure(run, trajectory, trajectory)
    return read_chaos(run.recorded[1 : len(trajectory), :, 0], trajectory, count)
