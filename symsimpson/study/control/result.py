"""Solutions of optimal control problems, and last iterates of searches that failed."""

from __future__ import annotations

import os
from dataclasses import dataclass
from enum import Enum
from functools import cached_property, partial
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count
from symsimpson.program.status import Status
from symsimpson.results.html import solution
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.driving import make_input_history
from symsimpson.study.control.constraint_rows import correct_costates, project_momenta
from symsimpson.study.control.layout import Layout
from symsimpson.study.control.problem_parts import read_times
from symsimpson.study.control.transcription import lagrange
from symsimpson.study.control.uses import (
    compute_gains,
    draw_iterations,
    draw_motion,
    draw_sparsity,
    label_bounds,
    run_phases,
)
from symsimpson.support.array_files import write_arrays
from symsimpson.support.array_types import Floats
from symsimpson.support.names import counted


class ControlStatus(Enum):
    """How the search for a solution ended; each value is a message with advice."""

    SOLVED = "A local optimum was found."
    ACCEPTABLE = "A local optimum was found, less accurately than the tolerance requires."
    INFEASIBLE = (
        "The solver cannot reduce the violation of the constraints near its last iterate. Try "
        "another guess, wider bounds or a longer duration."
    )
    ITERATION_LIMIT = "The solver reached most_iterations. Increase it, or pass a better guess."
    RESTORATION_FAILED = (
        "The solver could not continue from its last iterate. If the tolerance is below 1e-11, "
        "increase it, because round-off errors are larger. Otherwise, try another guess."
    )
    NOT_RESOLVED = (
        "The discrete equations are solved, but the steps do not resolve the motion or its cost. "
        "Inputs may chatter from node to node, or large costs lie between nodes. The path may also "
        "be one that jumps to another branch of the constraints. Use more steps. If inputs act on "
        "velocities, use a Gauss scheme such as 'gauss6'. With constraints, pass a guess that "
        "follows them from start to end."
    )
    NOT_OPTIMAL = (
        "The constraints are satisfied, but the point is not a local minimum, or its multipliers "
        "are unbounded. Some conditions may be redundant, or tangent to others. Remove redundant "
        "conditions, prescribe all known values of an end, or try another guess."
    )
    NO_MASS = (
        "The discrete equations are solved, but the mass matrix is not positive definite along the "
        "motion. Check the masses, and bound masses that are unknown parameters."
    )
    INTERRUPTED = "The search was interrupted. The result is the last iterate."
    NOT_FINITE = "An energy, force or cost was not finite. Add bounds that exclude such states."


FOUND = (ControlStatus.SOLVED, ControlStatus.ACCEPTABLE)
#: A cost below minus this multiple of the first cost counts as unbounded.
UNBOUNDED = 1e6
#: Entries of a result in the JSON text of a file, with their conversions.
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
    """A solution of an optimal control problem, or the last iterate of a failed search.

    N is the number of steps, n of coordinates, m of inputs, and s of nodes in a step.

    Attributes
    ----------
    layout : Layout
        The variables and rows of the nonlinear program.
    x : ndarray
        The values of all variables.
    multipliers : ndarray
        The multiplier of each row of the nonlinear program, except the cost.
    cost : float
        The cost of the motion.
    status : ControlStatus
        How the search ended.
    iterations : int
        The number of iterations in all searches.
    seconds : float
        The run time of the solver, in seconds.
    in_functions : float
        The part of ``seconds`` that functions of the problem took.
    violation : float
        The largest violation of a row, divided by the size of the row.
    worst : str
        The name of the row with the largest violation.
    history : dict from str to list of float
        Ipopt's record of the last search, with one number for each iteration. The key ``obj`` has
        the cost, ``inf_pr`` the constraint violation, and ``inf_du`` the optimality error.
    error : float or None
        The estimated error of the cost, relative to the larger of the cost and the cost of the
        first guess. It is None unless you pass ``error=`` to ``solve``.

    Examples
    --------
    >>> import sympy as sp, symsimpson as ss
    >>> (x,), u = ss.coordinates("x"), sp.Symbol("u", real=True)
    >>> cart = ss.MechanicalSystem(
    ...     "cart", coordinates=(x,), kinetic=x.diff()**2 / 2, potential=0 * x,
    ...     forces={x: u}, inputs=(u,))
    >>> problem = ss.OptimalControl(
    ...     cart, cost=u**2, start={x: 0, x.diff(): 0}, end={x: 1, x.diff(): 0}, duration=1)
    >>> result = problem.solve("gauss4", steps=10)
    >>> result.message
    'A local optimum was found.'
    >>> result.q.shape, result.input_values.shape
    ((11, 1), (10, 2, 1))
    >>> result.inputs([0.0, 1.0])["u"].round(6)  # u = 6 - 12 t
    array([ 6., -6.])
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
        """True if the search found a local optimum."""
        return self.status in FOUND

    @property
    def message(self) -> str:
        """The status as a sentence, with the largest violation if the search failed."""
        if self.success or self.status in (ControlStatus.NOT_RESOLVED, ControlStatus.NO_MASS):
            return self.status.value
        if not np.isfinite(self.violation):
            return f"{self.status.value} At the last iterate, the {self.worst} is not finite."
        text = f"{self.status.value} The {self.worst} has an error of {self.violation:.1e}."
        if self.cost < -UNBOUNDED * max(1.0, abs(self.history.get("obj", [0.0])[0])):
            text += f" The cost fell to {self.cost:.1e}. Bound the terms that make it negative."
        return text

    @property
    def duration(self) -> float:
        """The length of the motion, in the system's unit of time."""
        return float(self.t[-1])

    @property
    def t(self) -> Floats:
        """Times at the ends of steps, shape (N + 1,)."""
        return self.layout.grid.times(self.layout.sizes(self.x))

    @property
    def switches(self) -> Floats:
        """Times at which one phase ends and the next begins, shape (phases - 1,)."""
        return self.t[[phase.stop for phase in self.layout.grid.slices[:-1]]]

    @property
    def q(self) -> Floats:
        """Positions at the ends of steps, shape (N + 1, n)."""
        return self.x[self.layout.ends]

    @property
    def p(self) -> Floats:
        """Momenta at the ends of steps, shape (N + 1, n)."""
        layout = self.layout
        constrained = bool(layout.problem.constraint_names)
        return project_momenta(layout, self.x) if constrained else self.x[layout.momenta]

    @property
    def unknowns(self) -> dict[str, float]:
        """Values of the parameters in ``unknowns=``, by name."""
        layout = self.layout
        values = self.x[layout.parameters].tolist()
        return dict(zip(layout.problem.free_names, values, strict=True))

    @property
    def input_values(self) -> Floats:
        """Inputs at the nodes of all steps, shape (N, s, m)."""
        return self.x[self.layout.inputs]

    def inputs(self, t: ArrayLike) -> dict[str, Floats]:
        """Return the inputs at given times.

        In each step, an input is the polynomial through its values at the nodes.

        Parameters
        ----------
        t : array_like
            Times between 0 and the duration, of any shape.

        Returns
        -------
        dict from name to ndarray
            The values of each input, in the shape of ``t``.

        Raises
        ------
        InputError
            If a time lies outside of the motion.
        """
        times, inputs = read_times(t, self.duration), self.layout.problem.inputs
        return {name: self.functions[name](times) for name in inputs}

    @property
    def functions(self) -> dict[str, Any]:
        """Coordinates and inputs as functions of time, by name; ``guess=`` accepts this mapping."""
        layout = self.layout
        groups = (
            (layout.problem.names, layout.places, self.x[layout.points]),
            (layout.problem.inputs, layout.c, self.input_values),
        )
        return {
            name: partial(self._interpolate, places, values[..., a])
            for names, places, values in groups
            for a, name in enumerate(names)
        }

    def _interpolate(self, places: Floats, values: Floats, t: Floats) -> Floats:
        """Evaluate at times the polynomials of steps through values, shape (N, places)."""
        ends = self.t
        k = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, self.layout.steps - 1)
        within = (t - ends[k]) / (ends[k + 1] - ends[k])
        basis = lagrange(places, np.clip(within, 0.0, 1.0))
        return np.asarray((basis * values[k]).sum(axis=-1))

    @cached_property
    def costates(self) -> tuple[Floats, Floats]:
        """Derivatives of the optimal cost by the state at the ends of steps.

        The first array has derivatives by q at constant p, the second by p. Both have shape
        (N + 1, n), and the order of accuracy of the scheme.
        """
        layout = self.layout
        nlp, *_ = layout.nlp
        steps = layout.step_rows - 1  # row 0 is the cost
        first = layout.scale * self.multipliers[steps[:, 0]]
        last = layout.end_scale * self.multipliers[steps[:, -1]]
        by_p = np.concatenate([first - last, -last[-1:]])
        rows, n, N = np.concatenate([[1.0], self.multipliers]), layout.n, layout.steps
        by_q = np.zeros((N + 1, n))
        first, last = (np.full(layout.size, -1) for _ in range(2))  # coordinates of which step end
        first[layout.points[:, 0]] = np.arange(N * n).reshape(N, n)
        last[layout.points[-1, -1]] = np.arange(n)
        for block in nlp.blocks[
            : layout.step_block_count
        ]:  # the terms of each step in the Lagrangian
            for slopes, points in zip(block.gradient(self.x, rows), block.maps, strict=True):
                entries = points.tocoo()
                k = entries.row // (block.count // N)
                values = entries.data * slopes[entries.row]
                mask = first[entries.col] // n == k
                np.add.at(by_q.reshape(-1), first[entries.col[mask]], values[mask])
                mask = (last[entries.col] >= 0) & (k == N - 1)
                np.add.at(by_q[-1], last[entries.col[mask]], -values[mask])
        if layout.problem.constraint_names:
            by_q += correct_costates(layout, self.x, self.x[layout.momenta] - self.p, by_p)
        return by_q, by_p

    @property
    def trajectory(self) -> Trajectory:
        """The motion as a trajectory, with energies, figures and states between steps.

        Raises
        ------
        InputError
            If the motion has several phases. Use ``trajectories`` instead.
        """
        if len(self.trajectories) > 1:
            reject(
                f"the motion has {len(self.trajectories)} phases with different step sizes.",
                remedy="Use result.trajectories, which has one trajectory for each phase.",
            )
        return self.trajectories[0]

    @cached_property
    def trajectories(self) -> tuple[Trajectory, ...]:
        """The motion as one trajectory for each phase."""
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
                    driven=make_input_history(inputs, t[phase.start], h, phase.stop - phase.start),
                )
            )
        return tuple(trajectories)

    def simulate(self, refine: int = 10) -> tuple[Any, float]:
        """Simulate the motion from the start with the optimal inputs and smaller steps.

        Parameters
        ----------
        refine : int
            The number of steps in place of each step. The default is 10.

        Returns
        -------
        Trajectory, or tuple of Trajectory if there are several phases
            The simulated motion.
        float
            The largest difference of a final coordinate from the solution.
        """
        layout, refine = self.layout, read_count("refine", refine, least=1)
        # evaluate the polynomial of each step at the nodes of its finer steps
        places = (np.arange(refine)[:, None] + layout.c) / refine
        values = np.einsum("rsi,kim->krsm", lagrange(layout.c, places), self.input_values)
        inputs = values.reshape(layout.steps * refine, layout.nodes, -1)
        runs = tuple(run_phases(layout, self.x, (self.q[0], self.p[0]), inputs))
        motion: Any = runs[0] if len(runs) == 1 else runs
        return motion, float(np.abs(runs[-1].q[-1] - self.q[-1]).max())

    def arcs(self) -> list[dict[Any, float]]:
        """Return the arcs of the motion: the inputs at their bounds, in order of time.

        Returns
        -------
        list of dict from symbol to float
            The inputs that are at a bound in each arc, with this bound. Pass the list as
            ``phases=`` of the same problem to find the switching times.

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
        problem, means = self.layout.problem, self.input_values.mean(axis=1)
        labels = np.zeros(means.shape, dtype=np.int64)
        for k, (low, high) in problem.input_bounds.items():
            if np.isfinite(low) and np.isfinite(high) and low < high:
                labels[:, k] = label_bounds((means[:, k] - low) / (high - low))
        inputs, bounds = problem.system.inputs, problem.input_bounds
        return [
            {inputs[k]: bounds[k][bound > 0] for k, bound in enumerate(row) if bound}
            for row, _ in groupby(map(tuple, labels.tolist()))
        ]

    def lqr(self, Q: ArrayLike, R: ArrayLike, of: tuple[str, str] = ("q", "p")) -> Floats:
        """Return feedback gains K of the linear-quadratic regulator along the solution.

        On step k, the feedback is u = u_k - K_k (z - z_k). The gains use the exact linearisation of
        each step. They minimise the sum of dz.Q.dz + du.R.du over all steps, plus dz.Q.dz at the
        end.

        Parameters
        ----------
        Q : array_like, shape (2 n, 2 n)
            The weights of the state z. Only the symmetric part counts.
        R : array_like, shape (m, m)
            The weights of the inputs, which must be positive definite.
        of : ("q", "p") or ("q", "v"), optional
            Whether the state z has momenta (the default) or velocities.

        Returns
        -------
        ndarray, shape (N, m, 2 n)
            The gains of each step.

        Raises
        ------
        InputError
            If Q or R has a wrong shape or is not finite, or if R is not positive definite.
        """
        return compute_gains(self, Q, R, of)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the solution to a file; :meth:`OptimalControl.open` of the same problem reads it.

        Parameters
        ----------
        path : str or path-like
            The name of the file, for example ``"swing.npz"``. The format is NumPy's, without
            pickled objects.

        Raises
        ------
        StorageError
            If the file cannot be written.
        InputError
            If the name does not end in ``.npz``.
        """
        text: dict[str, Any] = {name: getattr(self, name) for name in SAVED}
        steps = self.layout.grid.steps
        text |= {"scheme": self.layout.scheme.name, "steps": steps if len(steps) > 1 else steps[0]}
        text["status"] = self.status.name
        write_arrays(path, "solution", text, {"x": self.x, "multipliers": self.multipliers})

    def plot(self) -> Any:
        """Draw coordinates and inputs over time, with one panel for each unit.

        Dotted lines show the bounds of inputs.

        Returns
        -------
        matplotlib.figure.Figure
            The figure with all panels.

        Raises
        ------
        InputError
            If matplotlib is not installed.
        """
        return draw_motion(self)

    def plot_iterations(self) -> Any:
        """Draw the constraint violation and the optimality error of each iteration.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, with a logarithmic axis.
        """
        return draw_iterations(self)

    def plot_sparsity(self) -> Any:
        """Draw the sparsity patterns of the Jacobian of the constraints and of the Hessian.

        Returns
        -------
        matplotlib.figure.Figure
            The figure with one panel for each matrix.
        """
        return draw_sparsity(self)

    _repr_html_ = solution

    def __repr__(self) -> str:
        layout = self.layout
        return (
            f"ControlResult({layout.problem.system.name}, {layout.scheme.name}: "
            f"{' + '.join(map(str, layout.grid.steps))} steps, cost {self.cost:.9g}, "
            f"{self.status.name} after {counted(self.iterations, 'iteration')})"
        )
