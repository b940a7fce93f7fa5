"""Functions of a solution: finer runs, feedback gains, arcs, figures and files."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.graph.point_functions import PointFunctions
from symsimpson.plotting.axes import choose_colours, escape_label, get_axes, name_axis
from symsimpson.program.input_values import read_reals
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.names import shortened

if TYPE_CHECKING:
    from symsimpson.results.trajectory import Trajectory
    from symsimpson.study.control.layout import Layout


#: A matrix with a larger condition number counts as singular.
SINGULAR = 1e14


def run_phases(
    layout: Layout, x: Floats, state: tuple[Floats, Floats], inputs: Floats
) -> Iterator[Trajectory]:
    """Run a stepper from (q, p) through all phases, and yield the trajectory of each phase.

    ``inputs`` has the values at nodes. A multiple of the layout's steps refines each step.
    """
    q, p = state
    for _, phase in _iterate_phases(layout, x, inputs):
        run = layout.stepper.integrate(q, p0=p, **phase)
        yield run
        q, p = run.q[-1], run.p[-1]


def _iterate_phases(
    layout: Layout, x: Floats, inputs: Floats
) -> Iterator[tuple[slice, dict[str, Any]]]:
    """Yield the range of steps of each phase, and the arguments of its run."""
    problem, grid, refine = layout.problem, layout.grid, len(inputs) // layout.steps
    sizes = layout.sizes(x)
    parameters = dict(zip(problem.free_names, x[layout.parameters].tolist(), strict=True))
    begin = grid.times(sizes)
    for phase, h in zip(grid.slices, sizes, strict=True):
        values = inputs[phase.start * refine : phase.stop * refine]
        of_names = {name: values[..., j] for j, name in enumerate(problem.inputs)}
        given = {"h": float(h) / refine, "steps": len(values), "t0": float(begin[phase.start])}
        yield phase, {**given, "inputs": of_names or None, "parameters": parameters or None}


def compute_gains(result: Any, Q: ArrayLike, R: ArrayLike, of: Any = ("q", "p")) -> Floats:
    """Return the gains of the linear-quadratic regulator, for states (q, p) or (q, v)."""
    layout, names = result.layout, result.layout.problem.inputs
    if not isinstance(of, (tuple, list)) or list(of) not in (["q", "p"], ["q", "v"]):
        reject(
            f"of is {shortened(of)}, but a state has either momenta or velocities.",
            remedy="Pass ('q', 'p') or ('q', 'v').",
        )
    Q = _read_weights("Q", Q, 2 * layout.n, f"z = (q, {of[1]})")
    R = _read_weights("R", R, len(names), "inputs")
    if not (np.linalg.eigvalsh(R) > 0).all():
        reject(
            f"R is {R.tolist()}, which is not positive definite.",
            why="Inputs would cost nothing, and gains would be unbounded.",
            remedy=f"Pass a positive definite matrix, for example numpy.eye({len(names)}).",
        )
    A, B = (np.concatenate(x) for x in zip(*linearise_steps(result), strict=True))
    # derivatives of (q, p) by the user's state, and their inverse
    derivatives = np.eye(2 * layout.n) if of[1] == "p" else _differentiate_momenta(result)
    back = np.linalg.inv(np.broadcast_to(derivatives, (layout.steps + 1, *Q.shape)))
    weights = back.swapaxes(1, 2) @ Q @ back
    P, K = weights[-1], np.zeros((layout.steps, len(names), 2 * layout.n))
    for k in reversed(range(layout.steps)):
        A_k, B_k = A[k], B[k]
        hessian = R + B_k.T @ P @ B_k
        if not (np.linalg.eigvalsh(hessian) > 0).all():  # true if Q has no negative eigenvalue
            reject(
                f"Q has negative eigenvalues, and from step {k} on the cost has no minimum.",
                remedy="Pass a matrix without negative eigenvalues, or a larger R.",
            )
        K[k] = np.linalg.solve(hessian, B_k.T @ P @ A_k)
        P = weights[k] + A_k.T @ P @ (A_k - B_k @ K[k])
    return K @ derivatives[:-1] if derivatives.ndim == 3 else K


def _differentiate_momenta(result: Any) -> Floats:
    """Return the derivatives of (q, p) by (q, v) at the ends of steps, shape (N + 1, 2 n, 2 n)."""
    layout, problem, n = result.layout, result.layout.problem, result.layout.n
    runs = result.trajectories
    v = np.concatenate([*(run.v[:-1] for run in runs), runs[-1].v[-1:]])
    derivatives = np.broadcast_to(np.eye(2 * n), (len(v), 2 * n, 2 * n)).copy()
    momenta = PointFunctions(problem.graph, [*problem.q, *problem.v], problem.momenta)
    derivatives[:, n:] = momenta.jacobian(layout.values_at_step_ends(result.x, v), len(v))
    if not (np.linalg.cond(derivatives[:, n:, n:]) < SINGULAR).all():
        reject(
            "the mass matrix is singular at a state of the solution.",
            why="Velocities do not determine the momenta there.",
            remedy="Use gains for momenta: of=('q', 'p').",
        )
    return derivatives


def _read_weights(name: str, given: ArrayLike, size: int, of: str) -> Floats:
    """Return the symmetric part of a weight matrix."""
    how = f"Pass a symmetric matrix of shape ({size}, {size}), for {of}."
    matrix = read_reals(name, given, how)
    if matrix.shape != (size, size):
        reject(f"{name} has shape {matrix.shape}, not ({size}, {size}).", remedy=how)
    if not np.isfinite(matrix).all():
        reject(f"{name} has an entry that is not finite: {matrix.tolist()}.", remedy=how)
    return (matrix + matrix.T) / 2


def linearise_steps(result: Any) -> Iterator[tuple[Floats, Floats]]:
    """Yield the derivatives of each step by its initial state and by constant inputs."""
    layout, q, p = result.layout, result.q, result.p
    names, symbols = layout.problem.inputs, list(layout.problem.system.inputs)
    for phase, given in _iterate_phases(layout, result.x, result.input_values):
        k = phase.start
        linear = layout.stepper.linearise(q[k], p0=p[k], **given, wrt=symbols)
        by_input = [linear.by_input[name].sum(axis=-1) for name in names]
        yield linear.by_state, np.stack(by_input, axis=-1)


#: An input is at a bound within this fraction of its range. A switch takes at most this many steps.
AT_BOUND, OF_A_SWITCH = 0.02, 2


def label_bounds(part: Floats) -> Ints:
    """Return -1 or 1 for each step at a lower or upper bound, and 0 for steps between bounds.

    ``part`` is the position of the input in its range, from 0 to 1. One or two consecutive steps
    between bounds contain a switch, and belong to the nearer bound.
    """
    labels = np.where(part < AT_BOUND, -1, np.where(part > 1 - AT_BOUND, 1, 0))
    first = 0
    for bound, same in groupby(labels.tolist()):
        last = first + len([*same])
        if not bound and last - first <= OF_A_SWITCH:
            labels[first:last] = np.where(part[first:last] < 0.5, -1, 1)
        first = last
    return labels


def draw_motion(result: Any) -> Any:
    """Draw coordinates and inputs over time, with one panel for each unit."""
    problem, units = result.layout.problem, result.layout.problem.system.units
    t = np.linspace(0, result.duration, 12 * result.layout.steps + 1)
    groups: dict[tuple[str, Any], list[str]] = {}
    for kind, names in (("coordinates", problem.names), ("inputs", problem.inputs)):
        for name in names:
            groups.setdefault((kind, units.get(name)), []).append(name)
    size = (6.4, 1.4 + 1.7 * len(groups))
    panels = np.atleast_1d(get_axes(None, size, nrows=len(groups), sharex=True))
    values = {name: result.functions[name](t) for name in problem.names} | result.inputs(t)
    for ax, ((kind, unit), names) in zip(panels, groups.items(), strict=True):
        for name, colour in zip(names, choose_colours(len(names)), strict=True):
            ax.plot(t, values[name], label=escape_label(name), color=colour)
            number = problem.inputs.index(name) if kind == "inputs" else -1
            for bound in filter(np.isfinite, problem.input_bounds.get(number, ())):
                ax.axhline(bound, color=colour, linestyle=":", linewidth=1)
        name_axis(ax, "y", kind if len(names) > 1 else names[0], unit)
        if len(names) > 1:
            ax.legend()
    name_axis(panels[-1], "x", "t", units.get("t"))
    return panels[0].figure


def draw_iterations(result: Any) -> Any:
    """Draw the constraint violation and the optimality error of each iteration."""
    ax = get_axes(None, (6.4, 3.2))
    for name, key in (("constraint violation", "inf_pr"), ("optimality", "inf_du")):
        values = np.array(result.history.get(key, []))
        ax.semilogy(np.where(values > 0, values, np.nan), label=name)
    ax.set(xlabel="iteration", ylabel="largest, scaled")
    ax.legend()
    return ax.figure


def draw_sparsity(result: Any) -> Any:
    """Draw the sparsity of the Jacobian of the constraints and the Hessian of the Lagrangian."""
    nlp, *_ = result.layout.nlp
    left, right = get_axes(None, (8.0, 4.0), ncols=2)
    rows, size = nlp.shape
    named = (
        (left, "Jacobian", nlp.jacobian_places, rows, "constraint"),
        (right, "Hessian, upper half", nlp.hessian_places, size, "variable"),
    )
    for ax, name, (row, column), height, row_sizes in named:
        ax.plot(column, row, linestyle="", marker="s", markersize=max(0.4, 120 / size))
        ax.set(
            title=f"{name}: {len(row)} entries",
            xlim=(-0.5, size - 0.5),
            ylim=(height - 0.5, -0.5),
            xlabel="variable",
            ylabel=row_sizes,
        )
    return left.figure
