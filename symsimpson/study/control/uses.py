"""Uses of a solution: finer runs, gains, arcs, figures, files."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import StorageError, reject
from symsimpson.plotting.axes import axes, colours, label, name_axis
from symsimpson.program.input_values import read_reals
from symsimpson.study.control.transcription import PointFunctions
from symsimpson.support.array_types import Floats, Ints
from symsimpson.support.files import read_path, written_beside
from symsimpson.support.names import shortened

if TYPE_CHECKING:
    from symsimpson.results.trajectory import Trajectory
    from symsimpson.study.control.layout import Layout


#: A matrix of a larger condition has no inverse.
SINGULAR = 1e14


def motions(
    layout: Layout, x: Floats, state: tuple[Floats, Floats], inputs: Floats
) -> Iterator[Trajectory]:
    """Run a stepper from (q, p) through phase after phase, with inputs at the nodes of steps.

    There may be several steps for each of the layout, inputs for each of them.
    """
    q, p = state
    for _, phase in _phases(layout, x, inputs):
        run = layout.stepper.integrate(q, p0=p, **phase)
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


def gains(result: Any, Q: ArrayLike, R: ArrayLike, of: Any = ("q", "p")) -> Floats:
    """Return the gains of the linear regulator along a solution, for (q, p) or (q, v)."""
    layout, names = result.layout, result.layout.read.inputs
    if not isinstance(of, (tuple, list)) or list(of) not in (["q", "p"], ["q", "v"]):
        reject(
            f"of is {shortened(of)}: the state of gains is made of momenta or of velocities.",
            remedy="Pass ('q', 'p') or ('q', 'v').",
        )
    Q = _weights("Q", Q, 2 * layout.n, f"z = (q, {of[1]})")
    R = _weights("R", R, len(names), "inputs")
    if not (np.linalg.eigvalsh(R) > 0).all():
        reject(
            f"R is {R.tolist()}, which is not positive definite: inputs would cost nothing, and "
            "gains have no bound.",
            remedy=f"Pass a positive definite matrix, as numpy.eye({len(names)}).",
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
            reject(
                f"Q is so negative that no gains are best from step {k} on.",
                remedy="Pass a matrix without negative eigenvalues, or a larger R.",
            )
        K[k] = np.linalg.solve(hessian, B_k.T @ P @ A_k)
        P = weights[k] + A_k.T @ P @ (A_k - B_k @ K[k])
    return K @ turned[:-1] if turned.ndim == 3 else K


def _by_velocities(result: Any) -> Floats:
    """Return the derivatives of (q, p) by (q, v) at the ends of steps, shape (N + 1, 2 n, 2 n)."""
    layout, read, n = result.layout, result.layout.read, result.layout.n
    runs = result.trajectories
    v = np.concatenate([*(run.v[:-1] for run in runs), runs[-1].v[-1:]])
    turned = np.broadcast_to(np.eye(2 * n), (len(v), 2 * n, 2 * n)).copy()
    momenta = PointFunctions(read.graph, [*read.q, *read.v], read.momenta)
    turned[:, n:] = momenta.jacobian(layout.at_ends(result.x, v), len(v))
    if not (np.linalg.cond(turned[:, n:, n:]) < SINGULAR).all():
        reject(
            "the mass matrix is singular on the way, and velocities do not tell momenta.",
            remedy="Take gains for momenta, of=('q', 'p').",
        )
    return turned


def _weights(name: str, given: ArrayLike, size: int, of: str) -> Floats:
    """Read the matrix of a square sum, of which the symmetric part alone counts."""
    how = f"Pass a symmetric matrix of shape ({size}, {size}), for {of}."
    matrix = read_reals(name, given, how)
    if matrix.shape != (size, size):
        reject(f"{name} has shape {matrix.shape}, not ({size}, {size}).", remedy=f"{how}")
    if not np.isfinite(matrix).all():
        reject(f"{name} has an entry that is not finite: {matrix.tolist()}.", remedy=f"{how}")
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


#: An input is at a bound if the rest is this part of its range; in as many steps a switch is seen.
AT_BOUND, OF_A_SWITCH = 0.02, 2


def labels_of(part: Floats) -> Ints:
    """Return -1 or 1 where an input is at a bound, 0 where it is between them for some steps.

    A few steps between two bounds have a switch in them, and belong to the nearer one.
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
    """Draw coordinates and inputs over the time, a panel for each unit, inputs with bounds."""
    read, units = result.layout.read, result.layout.read.system.units
    t = np.linspace(0, result.duration, 12 * result.layout.steps + 1)
    groups: dict[tuple[str, Any], list[str]] = {}
    for kind, names in (("coordinates", read.names), ("inputs", read.inputs)):
        for name in names:
            groups.setdefault((kind, units.get(name)), []).append(name)
    size = (6.4, 1.4 + 1.7 * len(groups))
    panels = np.atleast_1d(axes(None, size, nrows=len(groups), sharex=True))
    values = {name: result.functions[name](t) for name in read.names} | result.inputs(t)
    for ax, ((kind, unit), names) in zip(panels, groups.items(), strict=True):
        for name, colour in zip(names, colours(len(names)), strict=True):
            ax.plot(t, values[name], label=label(name), color=colour)
            bounds = read.of_inputs.get(read.inputs.index(name), ()) if kind == "inputs" else ()
            for bound in filter(np.isfinite, bounds):
                ax.axhline(bound, color=colour, linestyle=":", linewidth=1)
        name_axis(ax, "y", kind if len(names) > 1 else names[0], unit)
        if len(names) > 1:
            ax.legend()
    name_axis(panels[-1], "x", "t", units.get("t"))
    return panels[0].figure


def draw_iterations(result: Any) -> Any:
    """Draw by how much constraints are violated, and optimality is missed, in each iteration."""
    ax = axes(None, (6.4, 3.2))
    for name, key in (("constraint violation", "inf_pr"), ("optimality", "inf_du")):
        values = np.array(result.history.get(key, []))
        ax.semilogy(np.where(values > 0, values, np.nan), label=name)
    ax.set(xlabel="iteration", ylabel="largest, scaled")
    ax.legend()
    return ax.figure


def draw_sparsity(result: Any) -> Any:
    """Draw where the Jacobian of the constraints and the Hessian of the Lagrangian have entries."""
    programme, *_ = result.layout.programme
    left, right = axes(None, (8.0, 4.0), ncols=2)
    rows, size = programme.shape
    named = (
        (left, "Jacobian", programme.jacobian_places, rows, "constraint"),
        (right, "Hessian, upper half", programme.hessian_places, size, "variable"),
    )
    for ax, name, (row, column), height, of_rows in named:
        ax.plot(column, row, linestyle="", marker="s", markersize=max(0.4, 120 / size))
        ax.set(
            title=f"{name}: {len(row)} entries",
            xlim=(-0.5, size - 0.5),
            ylim=(height - 0.5, -0.5),
            xlabel="variable",
            ylabel=of_rows,
        )
    return left.figure


#: What a file may raise that is not there, not whole, or not what it should be.
DAMAGE = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error),
    *(NotImplementedError, RuntimeError, OverflowError, MemoryError),
)


def write_solution(
    path: str | os.PathLike[str], saved: dict[str, Any], x: Floats, multipliers: Floats
) -> None:
    """Write a solution to a file of NumPy's kind ``.npz``, and what is saved of it as JSON.

    Raises StorageError if it cannot be written; InputError if the name ends otherwise.
    """
    place, text = read_path("path", path), np.array(json.dumps(saved))
    if place.suffix != ".npz":
        reject(
            f"{str(place)!r} is no name of NumPy's kind, as solutions are written.",
            remedy="End it in "
            ".npz; result.trajectory.save writes the motion to files of other kinds.",
        )
    with written_beside(place, "solution") as whole, whole.open("wb") as file:
        np.savez_compressed(file, saved=text, x=x, multipliers=multipliers)


def read_solution(
    path: str | os.PathLike[str], kinds: dict[str, Any]
) -> tuple[Path, dict[str, Any], Floats, Floats]:
    """Read what :func:`write_solution` wrote, each part of what is saved by a function of its kind.

    Raises StorageError if the file is none of these, or is damaged.
    """
    place = read_path("path", path)
    try:
        with place.open("rb") as file, np.load(file, allow_pickle=False) as held:
            saved = json.loads(str(held["saved"]))
            x, multipliers = (np.asarray(held[k]) for k in ("x", "multipliers"))
        if any(vector.ndim != 1 or vector.dtype != np.float64 for vector in (x, multipliers)):
            raise ValueError("these are no vectors of numbers")
        if not (np.isfinite(x).all() and np.isfinite(multipliers).all()):
            raise ValueError("they are not all numbers")
        return place, {key: kind(saved[key]) for key, kind in kinds.items()}, x, multipliers
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        reject(
            f"{place}: the solution cannot be read: {error.strerror}.",
            remedy="Save one with result.save(path), and name that file.",
            error=StorageError,
        )
    except DAMAGE as error:
        reject(
            f"{place}: this is no solution that symsimpson saved: {type(error).__name__}.",
            remedy="Save one with result.save(path), and open it with the same problem.",
            error=StorageError,
        )
