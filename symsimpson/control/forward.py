"""Uses of a solution: its inputs run forward, gains that hold a run near it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.control.point_functions import PointFunctions, lagrange
from symsimpson.errors import InputError
from symsimpson.program.input_values import read_count, read_reals, shortened
from symsimpson.support.array_types import Floats

if TYPE_CHECKING:
    from symsimpson.control.layout import Layout
    from symsimpson.results.trajectory import Trajectory

__all__ = ["gains", "motions", "simulated"]

#: A matrix of a larger condition has no inverse.
SINGULAR = 1e14


def motions(
    layout: Layout, x: Floats, state: tuple[Floats, Floats], inputs: Floats, **how: Any
) -> Iterator[Trajectory]:
    """Run a stepper from (q, p) through phase after phase, with inputs at the nodes of steps.

    There may be several steps for each of the layout, inputs for each of them.
    """
    q, p = state
    for _, phase in _phases(layout, x, inputs):
        run = layout.stepper.integrate(q, p0=p, **phase, **how)
        yield run
        q, p = run.q[-1], run.p[-1]


def _phases(layout: Layout, x: Floats, inputs: Floats) -> Iterator[tuple[slice, dict[str, Any]]]:
    """Give the steps of each phase, and what runs take in it, with inputs at the nodes of steps."""
    read, grid, refine = layout.read, layout.grid, len(inputs) // layout.steps
    sizes = layout.sizes(x)
    parameters = dict(zip(read.found_names, x[layout.parameters].tolist(), strict=True))
    begin = grid.times(sizes)
    for phase, h in zip(grid.slices, sizes, strict=True):
        values = inputs[phase.start * refine : phase.stop * refine]
        of_names = {name: values[..., j] for j, name in enumerate(read.inputs)}
        given = {"h": float(h) / refine, "steps": len(values), "t0": float(begin[phase.start])}
        yield phase, {**given, "inputs": of_names or None, "parameters": parameters or None}


def simulated(result: Any, refine: int) -> tuple[Any, float]:
    """Run the inputs of a solution with finer steps; return the runs, and how far off they end."""
    layout, refine = result.layout, read_count("refine", refine, least=1)
    # inputs at the nodes of finer steps, each by the polynomial of its own step
    places = (np.arange(refine)[:, None] + layout.c) / refine
    values = np.einsum("rsi,kim->krsm", lagrange(layout.c, places), result.input_values)
    inputs = values.reshape(layout.steps * refine, layout.nodes, -1)
    runs = tuple(motions(layout, result.x, (result.q[0], result.p[0]), inputs))
    motion: Any = runs[0] if len(runs) == 1 else runs
    return motion, float(np.abs(runs[-1].q[-1] - result.q[-1]).max())


def gains(result: Any, Q: ArrayLike, R: ArrayLike, of: Any = ("q", "p")) -> Floats:
    """Return the gains of the linear regulator along a solution, for (q, p) or (q, v)."""
    layout, names = result.layout, result.layout.read.inputs
    if not isinstance(of, (tuple, list)) or list(of) not in (["q", "p"], ["q", "v"]):
        raise InputError(
            f"of is {shortened(of)}: the state of gains is made of momenta or of velocities.\n"
            "Pass ('q', 'p') or ('q', 'v')."
        )
    Q = _weights("Q", Q, 2 * layout.n, f"z = (q, {of[1]})")
    R = _weights("R", R, len(names), "inputs")
    if not (np.linalg.eigvalsh(R) > 0).all():
        raise InputError(
            f"R is {R.tolist()}, which is not positive definite: inputs would cost nothing, and "
            "gains have no bound.\nPass a positive definite matrix, as numpy.eye"
            f"({len(names)})."
        )
    A, B = (np.concatenate(x) for x in zip(*linearised(result), strict=True))
    # what of states (q, p) follows from a change of the state that is asked for, and back
    turned = np.eye(2 * layout.n) if of[1] == "p" else _by_velocities(result)
    back = np.linalg.inv(np.broadcast_to(turned, (layout.steps + 1, *Q.shape)))
    weights = back.swapaxes(1, 2) @ Q @ back
    P, K = weights[-1], np.zeros((layout.steps, len(names), 2 * layout.n))
    for k in reversed(range(layout.steps)):
        A_k, B_k = A[k], B[k]
        hessian = R + B_k.T @ P @ B_k
        if not (np.linalg.eigvalsh(hessian) > 0).all():  # it is, if Q has no negative eigenvalue
            raise InputError(
                f"Q is so negative that no gains are best from step {k} on.\n"
                "Pass a matrix without negative eigenvalues, or a larger R."
            )
        K[k] = np.linalg.solve(hessian, B_k.T @ P @ A_k)
        P = weights[k] + A_k.T @ P @ (A_k - B_k @ K[k])
    return K @ turned[:-1] if turned.ndim == 3 else K


def _by_velocities(result: Any) -> Floats:
    """Return the derivatives of (q, p) by (q, v) at the ends of steps, shape (N + 1, 2 n, 2 n)."""
    layout, read, n = result.layout, result.layout.read, result.layout.n
    runs = result.trajectories
    v = np.concatenate([*(run.v[:-1] for run in runs), runs[-1].v[-1:]])
    state = zip([*read.q, *read.v], [*result.q.T, *v.T], strict=True)
    at = {**layout.parameter_values(result.x), read.t: result.t, **dict(state)}
    turned = np.broadcast_to(np.eye(2 * n), (len(v), 2 * n, 2 * n)).copy()
    momenta = PointFunctions(read.graph, [*read.q, *read.v], read.momenta)
    turned[:, n:] = momenta.jacobian(at, len(v))
    if not (np.linalg.cond(turned[:, n:, n:]) < SINGULAR).all():
        raise InputError(
            "the mass matrix is singular on the way, and velocities do not tell momenta.\n"
            "Take gains for momenta, of=('q', 'p')."
        )
    return turned


def _weights(name: str, given: ArrayLike, size: int, of: str) -> Floats:
    """Read the matrix of a square sum, of which the symmetric part alone counts."""
    how = f"Pass a symmetric matrix of shape ({size}, {size}), for {of}."
    matrix = read_reals(name, given, how)
    if matrix.shape != (size, size):
        raise InputError(f"{name} has shape {matrix.shape}, not ({size}, {size}).\n{how}")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} has an entry that is not finite: {matrix.tolist()}.\n{how}")
    return (matrix + matrix.T) / 2


def linearised(result: Any) -> Iterator[tuple[Floats, Floats]]:
    """Give how the states at the ends of steps depend on those before, and on inputs held."""
    layout, q, p = result.layout, result.q, result.p
    names, symbols = layout.read.inputs, list(layout.read.system.inputs)
    for phase, given in _phases(layout, result.x, result.input_values):
        k = phase.start
        linear = layout.stepper.linearise(q[k], p0=p[k], **given, wrt=symbols)
        by_input = [linear.by_input[name].sum(axis=-1) for name in names]
        yield linear.by_state, np.stack(by_input, axis=-1)
