"""The solution of a problem of optimal control, or the last iterate of one that was not found."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.control import figures
from symsimpson.control.held import projected, resolved
from symsimpson.control.layout import Layout
from symsimpson.control.points import lagrange
from symsimpson.control.saving import write_solution
from symsimpson.control.status import STATUSES, ControlStatus
from symsimpson.errors import InputError
from symsimpson.program.values import read_count

if TYPE_CHECKING:
    from symsimpson.api.stepper import Stepper
    from symsimpson.control.ipopt import Outcome
    from symsimpson.results.trajectory import Trajectory

__all__ = ["TOLD", "ControlResult", "result_of"]

Floats = NDArray[np.float64]
FOUND = (ControlStatus.SOLVED, ControlStatus.ACCEPTABLE)
#: What is told of a solution beside its numbers, as files hold it: the kinds of its parts.
TOLD: dict[str, Any] = {
    "cost": float,
    "status": ControlStatus.__getitem__,
    "iterations": int,
    "seconds": float,
    "in_functions": float,
    "violation": float,
    "worst": str,
    "history": dict,
    "error": lambda error: None if error is None else float(error),
}


@dataclass(frozen=True, eq=False, repr=False)
class ControlResult:
    """A solution, or the last iterate.

    Attributes
    ----------
    layout : Layout
    x : ndarray
        All unknowns.
    multipliers : ndarray
        Of the rows.
    cost : float
    status : ControlStatus
    iterations : int
    seconds, in_functions : float
        Of the solver, and of these in functions of the problem.
    violation : float
        The largest of a row, and ``worst`` its name.
    history : dict from str to list of float
        What the solver tells of each iteration: ``obj`` the cost, ``inf_pr`` the violation, ...
    error : float or None
        An estimate of the relative error of the cost, if one was asked for.
    """

    layout: Layout
    x: Floats
    multipliers: Floats
    cost: float
    status: ControlStatus
    iterations: int
    seconds: float
    in_functions: float
    violation: float
    worst: str
    history: dict[str, list[float]]
    error: float | None = None

    @property
    def success(self) -> bool:
        """Whether an optimum was found."""
        return self.status in FOUND

    @property
    def message(self) -> str:
        """The status as a sentence, with the largest violation if there is one to tell."""
        silent = self.success or self.status is ControlStatus.NOT_RESOLVED
        told = "" if silent else f" The {self.worst} is off by {self.violation:.1e}."
        return self.status.value + told

    @property
    def duration(self) -> float:
        """How long the motion is."""
        layout = self.layout
        if layout.h is None:
            return float(layout.read.duration[0])
        return float(self.x[layout.h]) * layout.steps

    @property
    def t(self) -> Floats:
        """Times of the ends of steps."""
        return np.asarray(self.duration / self.layout.steps * np.arange(self.layout.steps + 1))

    @property
    def q(self) -> Floats:
        """Positions at the ends of steps, shape (N + 1, n)."""
        points = self.layout.points
        return self.x[np.concatenate([points[:, 0], points[-1:, -1]])]

    @property
    def p(self) -> Floats:
        """Momenta there."""
        layout, p = self.layout, self.x[self.layout.momenta]
        if not layout.read.constraints:
            return p
        return projected(
            layout, self.q, p, {**layout.parameter_values(self.x), layout.read.t: self.t}
        )

    @property
    def unknowns(self) -> dict[str, float]:
        """The parameters that were found, by name."""
        layout = self.layout
        names = [str(a) for a in layout.read.system.parameters]
        found = zip(layout.read.found, self.x[layout.parameters].tolist(), strict=True)
        return {names[i]: x for i, x in found}

    @property
    def input_values(self) -> Floats:
        """Inputs at the nodes of steps, shape (N, s, m)."""
        return self.x[self.layout.inputs]

    def inputs(self, t: ArrayLike) -> dict[str, Floats]:
        """Return the inputs at times: the polynomials through their values at nodes.

        Parameters
        ----------
        t : array_like

        Returns
        -------
        dict from name to ndarray
        """
        basis, k = self._basis(np.asarray(t, dtype=np.float64), self.layout.c)
        found = np.einsum("...i,...im->...m", basis, self.input_values[k])
        return {name: found[..., j] for j, name in enumerate(self.layout.read.inputs)}

    @property
    def functions(self) -> dict[str, Any]:
        """Coordinates and inputs as functions of the time, as a guess has them."""
        layout = self.layout

        def coordinate(a: int) -> Any:
            def value(t: Floats) -> Floats:
                basis, k = self._basis(t, layout.places)
                return np.asarray((basis * self.x[layout.points[:, :, a]][k]).sum(axis=-1))

            return value

        found = {name: coordinate(a) for a, name in enumerate(layout.read.names)}
        for name in layout.read.inputs:
            found[name] = lambda t, name=name: self.inputs(t)[name]
        return found

    def _basis(self, t: Floats, places: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Return Lagrange's polynomials of places in steps, at times, and the steps' numbers."""
        layout = self.layout
        h = self.duration / layout.steps
        k = np.clip(np.floor(t / h).astype(np.int64), 0, layout.steps - 1)
        return lagrange(places, np.clip(t / h - k, 0.0, 1.0)), k

    @cached_property
    def costates(self) -> tuple[Floats, Floats]:
        """Derivatives of the least cost by the state at the ends of steps: by q at fixed p, by p.

        Each of shape (N + 1, n), of the order of the scheme.
        """
        layout = self.layout
        programme, *_ = layout.programme
        steps = layout.step_rows - 1  # behind the row of the cost
        first = layout.scale * self.multipliers[steps[:, 0]]
        last = layout.end_scale * self.multipliers[steps[:, -1]]
        by_p = np.concatenate([first - last, -last[-1:]])
        rows, n, N = np.concatenate([[1.0], self.multipliers]), layout.n, layout.steps
        by_q = np.zeros((N + 1, n))
        first, last = (np.full(layout.size, -1) for _ in range(2))  # whose coordinates they are
        first[layout.points[:, 0]] = np.arange(N * n).reshape(N, n)
        last[layout.points[-1, -1]] = np.arange(n)
        for block in programme.blocks[: layout.of_steps]:  # each step's own part of the Lagrangian
            for slopes, points in zip(block.gradient(self.x, rows), block.maps, strict=True):
                entries = points.tocoo()
                k = entries.row // (block.count // N)
                values = entries.data * slopes[entries.row]
                own = first[entries.col] // n == k
                np.add.at(by_q.reshape(-1), first[entries.col[own]], values[own])
                own = (last[entries.col] >= 0) & (k == N - 1)
                np.add.at(by_q[-1], last[entries.col[own]], -values[own])
        return by_q, by_p

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion as a run of the scheme has it: energies, figures, states between steps."""
        from symsimpson.program.status import Status
        from symsimpson.results.trajectory import Trajectory

        layout = self.layout
        stepper = stepper_of(layout)
        return Trajectory(
            t=self.t,
            q=self.q,
            p=self.p,
            newton_iterations=np.zeros(layout.steps + 1, dtype=np.int64),
            h=self.duration / layout.steps,
            steps=layout.steps,
            every=1,
            status=Status.SUCCESS if self.success else Status.NOT_CONVERGED,
            message=self.message,
            program=stepper.program,
            parameter_values=np.array([*layout.parameter_values(self.x).values()]),
            input_values=self.input_values[None],
        )

    def simulate(self, refine: int = 10) -> tuple[Trajectory, float]:
        """Run the inputs that were found from the start, with finer steps of the scheme.

        Parameters
        ----------
        refine : int
            How many steps in place of one.

        Returns
        -------
        Trajectory
        float
            How far from the end of the solution its end is, in coordinates.
        """
        layout, refine = self.layout, read_count("refine", refine, least=1)
        stepper = stepper_of(layout)
        steps, h = layout.steps * refine, self.duration / layout.steps / refine
        given: dict[str, Any] = {"parameters": self.unknowns or None}
        if layout.read.inputs:
            given["inputs"] = self._refined(refine)
        run = stepper.integrate(self.q[0], p0=self.p[0], h=h, steps=steps, **given)
        return run, float(np.abs(run.q[-1] - self.q[-1]).max())

    def lqr(self, Q: ArrayLike, R: ArrayLike) -> Floats:
        """Return gains that hold a run near the solution: u = u_k - K_k (z - z_k), held over steps.

        They are those of the linear regulator of the exact linear maps of the steps, of least
        sum of dz.Q.dz + du.R.du over the motion, and dz.Q.dz behind it.

        Parameters
        ----------
        Q : array_like, shape (2 n, 2 n)
            For z = (q, p).
        R : array_like, shape (m, m)

        Returns
        -------
        ndarray, shape (N, m, 2 n)

        Raises
        ------
        InputError
            If Q or R has another shape.
        """
        layout, run = self.layout, self.trajectory
        names = layout.read.inputs
        linear = stepper_of(layout).linearise(
            self.q[0],
            p0=self.p[0],
            h=run.h,
            steps=layout.steps,
            inputs={name: self.input_values[..., j] for j, name in enumerate(names)},
            parameters=self.unknowns or None,
            wrt=list(layout.read.system.inputs),
        )
        sizes = (("Q", Q, 2 * layout.n), ("R", R, len(names)))
        for name, given, size in sizes:
            if np.shape(given) != (size, size):
                raise InputError(f"{name} has shape {np.shape(given)}, not ({size}, {size}).")
        Q, R = np.asarray(Q, dtype=np.float64), np.asarray(R, dtype=np.float64)
        B = np.stack([linear.by_input[name].sum(axis=-1) for name in names], axis=-1)
        P, gains = Q, np.zeros((layout.steps, len(names), 2 * layout.n))
        for k in reversed(range(layout.steps)):
            A_k, B_k = linear.by_state[k], B[k]
            gains[k] = np.linalg.solve(R + B_k.T @ P @ B_k, B_k.T @ P @ A_k)
            P = Q + A_k.T @ P @ (A_k - B_k @ gains[k])
        return gains

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the solution to a file, which :meth:`OptimalControl.open` of its problem reads.

        Parameters
        ----------
        path : str or path-like
            Such as ``"swing.npz"``: NumPy's format, numbers alone.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        told: dict[str, Any] = {name: getattr(self, name) for name in TOLD}
        told |= {"scheme": self.layout.scheme.name, "steps": self.layout.steps}
        write_solution(path, told | {"status": self.status.name}, self.x, self.multipliers)

    def plot(self) -> Any:
        """Draw coordinates and inputs over the time, inputs with their bounds.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        InputError
            If matplotlib is not installed.
        """
        return figures.motion(self)

    def plot_sparsity(self) -> Any:
        """Draw where the Jacobian of the rows and the Hessian of the Lagrangian have entries.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        InputError
            If matplotlib is not installed.
        """
        return figures.sparsity(self)

    def _refined(self, refine: int) -> dict[str, Floats]:
        """Return inputs at the nodes of finer steps, each by the polynomial of its own step."""
        layout = self.layout
        places = (np.arange(refine)[:, None] + layout.c) / refine
        values = np.einsum("rsi,kim->krsm", lagrange(layout.c, places), self.input_values)
        shape = layout.steps * refine, layout.nodes
        return {name: values[..., j].reshape(shape) for j, name in enumerate(layout.read.inputs)}

    def __repr__(self) -> str:
        layout = self.layout
        return (
            f"ControlResult({layout.read.system.name}, {layout.scheme.name}: {layout.steps} "
            f"steps, cost {self.cost:.9g}, {self.status.name} after {self.iterations} iterations)"
        )


def stepper_of(layout: Layout) -> Stepper:
    """Return the stepper of a problem's system and scheme."""
    from symsimpson.api.compiling import compile as compile_stepper  # solving compiles nothing

    return compile_stepper(layout.read.system, layout.scheme)


def result_of(layout: Layout, outcome: Outcome) -> ControlResult:
    """Return what a solver came to."""
    programme, low, high = layout.programme
    cost, rows = programme.values(outcome.x)
    off = np.maximum(np.maximum(low - rows, rows - high), 0.0) / layout.scales
    worst = int(np.argmax(off)) if off.size else 0
    status = STATUSES.get(outcome.said, ControlStatus.RESTORATION_FAILED)
    if status in FOUND and not resolved(layout, outcome.x, layout.parameter_values(outcome.x)):
        status = ControlStatus.NOT_RESOLVED
    return ControlResult(
        layout,
        outcome.x,
        outcome.multipliers,
        cost,
        status,
        outcome.iterations,
        outcome.seconds,
        outcome.in_functions,
        float(off.max(initial=0.0)),
        layout.names[worst],
        outcome.history,
    )
