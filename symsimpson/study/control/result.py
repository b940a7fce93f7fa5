"""The solution of a problem of optimal control, or the last iterate of one that was not found."""

from __future__ import annotations

import os
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count
from symsimpson.program.status import Status
from symsimpson.results.html import solution
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.driving import driven
from symsimpson.study.control.constraint_rows import projected, turned
from symsimpson.study.control.layout import Layout
from symsimpson.study.control.problem_parts import times_within
from symsimpson.study.control.transcription import lagrange
from symsimpson.study.control.uses import (
    draw_iterations,
    draw_motion,
    draw_sparsity,
    gains,
    labels_of,
    motions,
    write_solution,
)
from symsimpson.support.array_types import Floats
from symsimpson.support.names import counted


class ControlStatus(Enum):
    """How the search for a solution ended, with a sentence that says so."""

    SOLVED = "A local optimum was found."
    ACCEPTABLE = "An optimum was found, less exactly than was asked for."
    INFEASIBLE = (
        "The solver came to a point where the conditions cannot be satisfied better nearby. "
        "Another guess, wider bounds or a longer duration may help."
    )
    ITERATION_LIMIT = "The solver used all its iterations. Allow more, or begin nearer."
    RESTORATION_FAILED = (
        "The solver could not go on from where it is. A tolerance below 1e-11 asks for more than "
        "rounding allows; else another guess may help."
    )
    NOT_RESOLVED = (
        "The equations of steps are solved, but between the points at which they see forces, "
        "costs and constraints the motion, or its cost, is another one: inputs chatter from node "
        "to node, steps are too long, what is dear lies between nodes, or the path jumps to "
        "another branch of the constraints. Take more steps, a Gauss "
        "scheme such as 'gauss6' where inputs act on velocities, or a guess that follows the "
        "constraints from start to end."
    )
    NOT_OPTIMAL = (
        "The conditions are satisfied, but the cost falls further nearby, or multipliers without "
        "bound do not tell: some conditions follow from others, or touch them. Leave out what "
        "follows, give in full what is known of an end, or begin at another guess."
    )
    NO_MASS = (
        "The equations of steps are solved, but the mass matrix is not positive definite on the "
        "way: what has no mass follows no force. Check the masses, and bound those that are found."
    )
    INTERRUPTED = "The search was interrupted; the last iterate is kept."
    NOT_FINITE = "An energy, force or cost had no value on the way. Bound what must not be reached."


#: What they are in the words of Ipopt.
STATUSES = {
    "Solve_Succeeded": ControlStatus.SOLVED,
    "Solved_To_Acceptable_Level": ControlStatus.ACCEPTABLE,
    "Infeasible_Problem_Detected": ControlStatus.INFEASIBLE,
    "Not_Enough_Degrees_Of_Freedom": ControlStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": ControlStatus.ITERATION_LIMIT,
    "User_Requested_Stop": ControlStatus.INTERRUPTED,
    "Invalid_Number_Detected": ControlStatus.NOT_FINITE,
}
FOUND = (ControlStatus.SOLVED, ControlStatus.ACCEPTABLE)
#: A cost that falls below that of the guess by so many times is not bounded.
UNBOUNDED = 1e6
#: What is text of a solution beside its numbers, as files hold it: the kinds of its parts.
SAVED: dict[str, Any] = {
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
        The largest of a row, in units of its size, and ``worst`` its name.
    history : dict from str to list of float
        What the solver tells of each, of the last search: ``obj`` the cost, ``inf_pr`` ...
    error : float or None
        An estimate of the error of the cost, if you requested one: relative to the larger of the
        cost and the cost of the first guess.
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
        if self.success or self.status in (ControlStatus.NOT_RESOLVED, ControlStatus.NO_MASS):
            return self.status.value
        if not np.isfinite(self.violation):
            return f"{self.status.value} Where the search ended, the {self.worst} has no value."
        text = f"{self.status.value} The {self.worst} is off by {self.violation:.1e}."
        if self.cost < -UNBOUNDED * max(1.0, abs(self.history.get("obj", [0.0])[0])):
            text += f" The cost fell to {self.cost:.1e}: bound what makes it negative."
        return text

    @property
    def duration(self) -> float:
        """How long the motion is."""
        return float(self.t[-1])

    @property
    def t(self) -> Floats:
        """Times of the ends of steps, shape (N + 1,)."""
        return self.layout.grid.times(self.layout.sizes(self.x))

    @property
    def switches(self) -> Floats:
        """Times at which a phase ends and the next begins."""
        return self.t[[phase.stop for phase in self.layout.grid.slices[:-1]]]

    @property
    def q(self) -> Floats:
        """Positions at the ends of steps, shape (N + 1, n)."""
        return self.x[self.layout.ends]

    @property
    def p(self) -> Floats:
        """Momenta there."""
        layout = self.layout
        return projected(layout, self.x) if layout.read.constraints else self.x[layout.momenta]

    @property
    def unknowns(self) -> dict[str, float]:
        """The parameters that were found, by name."""
        layout = self.layout
        values = self.x[layout.parameters].tolist()
        return dict(zip(layout.read.found_names, values, strict=True))

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

        Raises
        ------
        InputError
            If a time lies outside of the motion.
        """
        times, inputs = times_within(t, self.duration), self.layout.read.inputs
        return {name: self.functions[name](times) for name in inputs}

    @property
    def functions(self) -> dict[str, Any]:
        """Coordinates and inputs as functions of the time, as a guess has them."""
        layout = self.layout
        groups = (
            (layout.read.names, layout.places, self.x[layout.points]),
            (layout.read.inputs, layout.c, self.input_values),
        )
        return {
            name: lambda t, places=places, values=values[..., a]: self._between(places, values, t)
            for names, places, values in groups
            for a, name in enumerate(names)
        }

    def _between(self, places: Floats, values: Floats, t: Floats) -> Floats:
        """Return the polynomials of steps through values at places, shape (N, places), at times."""
        ends = self.t
        k = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, self.layout.steps - 1)
        within = (t - ends[k]) / (ends[k + 1] - ends[k])
        basis = lagrange(places, np.clip(within, 0.0, 1.0))
        return np.asarray((basis * values[k]).sum(axis=-1))

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
                mask = first[entries.col] // n == k
                np.add.at(by_q.reshape(-1), first[entries.col[mask]], values[mask])
                mask = (last[entries.col] >= 0) & (k == N - 1)
                np.add.at(by_q[-1], last[entries.col[mask]], -values[mask])
        if layout.read.constraints:
            by_q += turned(layout, self.x, self.x[layout.momenta] - self.p, by_p)
        return by_q, by_p

    @property
    def trajectory(self) -> Trajectory:
        """The motion as a run of the scheme has it: energies, figures, states between steps.

        Raises
        ------
        InputError
            If there are several phases: see ``trajectories``.
        """
        if len(self.trajectories) > 1:
            reject(
                f"the motion has {len(self.trajectories)} phases, each in steps of its own size.",
                remedy="Take result.trajectories, one for each phase.",
            )
        return self.trajectories[0]

    @cached_property
    def trajectories(self) -> tuple[Trajectory, ...]:
        """The motion in each phase as a run of the scheme has it."""
        layout, t, q, p = self.layout, self.t, self.q, self.p
        sizes, trajectories = layout.sizes(self.x).tolist(), []
        program = layout.stepper.program
        values = np.array([*layout.parameter_values(self.x).values()])
        for phase, h in zip(layout.grid.slices, sizes, strict=True):
            ends = slice(phase.start, phase.stop + 1)
            inputs = self.input_values[None, phase]
            trajectories.append(
                Trajectory(
                    t=t[ends],
                    q=q[ends],
                    p=p[ends],
                    newton_iterations=np.zeros(len(t[ends]), dtype=np.int64),
                    h=h,
                    steps=phase.stop - phase.start,
                    every=1,
                    status=Status.SUCCESS if self.success else Status.NOT_CONVERGED,
                    message=self.message,
                    program=program,
                    parameter_values=values,
                    input_values=inputs,
                    driven=driven(inputs, t[phase.start], h, phase.stop - phase.start),
                )
            )
        return tuple(trajectories)

    def simulate(self, refine: int = 10) -> tuple[Any, float]:
        """Run the inputs that were found from the start, with finer steps of the scheme.

        Parameters
        ----------
        refine : int
            How many steps in place of one.

        Returns
        -------
        Trajectory, or tuple of Trajectory if there are several phases
        float
            How far from the end of the solution its end is, in coordinates.
        """
        layout, refine = self.layout, read_count("refine", refine, least=1)
        # inputs at the nodes of finer steps, each by the polynomial of its own step
        places = (np.arange(refine)[:, None] + layout.c) / refine
        values = np.einsum("rsi,kim->krsm", lagrange(layout.c, places), self.input_values)
        inputs = values.reshape(layout.steps * refine, layout.nodes, -1)
        runs = tuple(motions(layout, self.x, (self.q[0], self.p[0]), inputs))
        motion: Any = runs[0] if len(runs) == 1 else runs
        return motion, float(np.abs(runs[-1].q[-1] - self.q[-1]).max())

    def arcs(self) -> list[dict[Any, float]]:
        """Return the arcs of the motion: which inputs stay at which bound, one arc after another.

        Returns
        -------
        list of dict from symbol to float
            What ``phases=`` of the same problem takes, to find the times of switches.

        Examples
        --------
        >>> import dataclasses, sympy as sp, symsimpson as ss
        >>> (x,), u = ss.coordinates("x"), sp.Symbol("u", real=True)
        >>> cart = ss.MechanicalSystem(
        ...     "cart", coordinates=(x,), kinetic=x.diff()**2 / 2, potential=0 * x,
        ...     forces={x: u}, inputs=(u,))
        >>> problem = ss.OptimalControl(
        ...     cart, cost=1, start={x: 0, x.diff(): 0}, end={x: 1, x.diff(): 0},
        ...     duration=(1, 5), bounds={u: (-2, 1)})
        >>> about = problem.solve(steps=10)
        >>> about.arcs()
        [{u: 1.0}, {u: -2.0}]
        >>> exact = dataclasses.replace(problem, phases=about.arcs()).solve(steps=2, guess=about)
        >>> round(exact.duration**2, 8), exact.switches.round(8)  # 3 and 2 / sqrt(3)
        (3.0, array([1.15470054]))
        """
        read, means = self.layout.read, self.input_values.mean(axis=1)
        labels = np.zeros(means.shape, dtype=np.int64)
        for k, (low, high) in read.of_inputs.items():
            if np.isfinite(low) and np.isfinite(high) and low < high:
                labels[:, k] = labels_of((means[:, k] - low) / (high - low))
        inputs, bounds = read.system.inputs, read.of_inputs
        return [
            {inputs[k]: bounds[k][bound > 0] for k, bound in enumerate(row) if bound}
            for row, _ in groupby(map(tuple, labels.tolist()))
        ]

    def lqr(self, Q: ArrayLike, R: ArrayLike, of: tuple[str, str] = ("q", "p")) -> Floats:
        """Return gains that hold a run near the solution: u = u_k - K_k (z - z_k) on step k.

        The gains belong to the linear regulator for the exact linear maps of the steps, with least
        sum of dz.Q.dz + du.R.du over the motion, and dz.Q.dz at its end.

        Parameters
        ----------
        Q : array_like, shape (2 n, 2 n)
            The weights of z.
        R : array_like, shape (m, m)
            The weights of the inputs.
        of : ("q", "p") or ("q", "v"), optional
            What z, ``Q`` and the gains refer to: momenta (the default), or velocities.

        Returns
        -------
        ndarray, shape (N, m, 2 n)

        Raises
        ------
        InputError
            If Q or R has another shape, or no finite numbers; if R is not positive definite.
        """
        return gains(self, Q, R, of)

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
        InputError
            If the name does not end in ``.npz``.
        """
        text: dict[str, Any] = {name: getattr(self, name) for name in SAVED}
        steps = self.layout.grid.steps
        text |= {"scheme": self.layout.scheme.name, "steps": steps if len(steps) > 1 else steps[0]}
        write_solution(path, text | {"status": self.status.name}, self.x, self.multipliers)

    def plot(self) -> Any:
        """Draw coordinates and inputs over the time, a panel for each unit; inputs with bounds.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        InputError
            If matplotlib is not installed.
        """
        return draw_motion(self)

    def plot_iterations(self) -> Any:
        """Draw the constraint violation and the optimality of each iteration, as a Figure."""
        return draw_iterations(self)

    def plot_sparsity(self) -> Any:
        """Draw the entries of the constraints' Jacobian and of the Hessian, as a Figure."""
        return draw_sparsity(self)

    _repr_html_ = solution

    def __repr__(self) -> str:
        layout = self.layout
        return (
            f"ControlResult({layout.read.system.name}, {layout.scheme.name}: "
            f"{' + '.join(map(str, layout.grid.steps))} steps, cost {self.cost:.9g}, "
            f"{self.status.name} after {counted(self.iterations, 'iteration')})"
        )
