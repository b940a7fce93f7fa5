"""The public class of optimal control problems."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any

from symsimpson.declare.hamiltonian import HamiltonianSystem
from symsimpson.declare.retimed import RetimedSystem
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import reject
from symsimpson.program.input_values import whole_number
from symsimpson.study.control.problem_parts import read_grid
from symsimpson.study.control.symbolic_problem import SymbolicProblem, read_galerkin_scheme
from symsimpson.support.calling import explain_methods, warn
from symsimpson.support.contact_values import reject_contacts
from symsimpson.support.extras import import_library
from symsimpson.support.markup import fields_given
from symsimpson.support.names import shortened, spelled
from symsimpson.support.progress import read_progress

if TYPE_CHECKING:
    from symsimpson.schemes.scheme import Scheme
    from symsimpson.study.control.result import ControlResult

#: Ipopt stores the number of iterations in 32 bits.
MOST_ITERATIONS = 2**31 - 1


@explain_methods(also=("__init__",))
@dataclass(frozen=True, eq=False)
class OptimalControl:
    """An optimal control problem: find the motion of least cost between two boundary states.

    Parameters
    ----------
    system : MechanicalSystem
        The system to control. Its inputs appear in its forces. Time-transformed systems are
        rejected.
    cost : expression
        The running cost l(q, q', u, t). Its integral over the motion is minimised. The default
        is 0.
    final_cost : expression
        The cost Phi(q, q', t) of the final state. It is added to the integral. The default is 0.
    start, end : mapping
        Boundary conditions at t = 0 and at the final time. Keys are coordinates, velocities (by
        symbol, or by name as ``"x"`` and ``"v_x"``) or expressions of them. Values are numbers,
        expressions, or pairs (low, high). Quantities that you do not list are free.
    duration : number or (low, high)
        The length of the motion in the system's unit of time. It is required. With a pair, the
        solver finds the duration between these bounds.
    bounds : mapping
        Pairs (low, high) for inputs, coordinates, velocities or expressions. None means no bound.
        The bounds hold at all nodes. Bounds of coordinates also hold at the ends of steps.
    path : sequence of expression, relation or (low, expression, high)
        Path constraints, which hold at all nodes. A plain expression g means g <= 0. A tuple
        means low <= expression <= high. A relation is written as ``x**2 + y**2 >= 1``.
    conditions : mapping
        Equations between both ends. Each key is an expression of the final state, and its value
        is an expression of the initial state. A gait of period 1 in x has
        ``{x: x + 1, x.diff(): x.diff()}``.
    unknowns : mapping from parameter to (low, high)
        Parameters of the system that the solver finds, with their bounds.
    phases : sequence of mapping
        Consecutive phases whose durations the solver finds. Each phase maps inputs to numbers or
        to pairs (low, high), for example ``[{u: 1}, {u: -1}]``. Inputs may jump between phases,
        so a scheme keeps its order across such a switch.
    signals : mapping from symbol to function or array
        Known functions of time, such as a reference motion or measured data. Their symbols may
        appear in ``cost``, ``bounds`` and ``path``. Values are callables of an array of times,
        expressions of ``symsimpson.time``, or arrays of samples at equal time intervals. Samples
        span the whole duration. Signals require a duration that is a number.

    Raises
    ------
    InputError
        If an argument is invalid, or if two arguments contradict each other.
    ModelError
        If an expression contains symbols that do not belong to the problem.

    Examples
    --------
    >>> import sympy as sp, symsimpson as ss
    >>> (x,), u = ss.coordinates("x"), sp.Symbol("u", real=True)
    >>> cart = ss.MechanicalSystem(
    ...     "cart", coordinates=(x,), kinetic=x.diff()**2 / 2, potential=0 * x,
    ...     forces={x: u}, inputs=(u,))
    >>> problem = ss.OptimalControl(
    ...     cart, cost=u**2, start={x: 0, x.diff(): 0}, end={x: 1, x.diff(): 0}, duration=1)
    >>> result = problem.solve(steps=10)
    >>> result.success, round(result.cost, 9)
    (True, 12.0)
    """

    system: MechanicalSystem
    cost: Any = field(default=0, kw_only=True)
    final_cost: Any = field(default=0, kw_only=True)
    start: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    end: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    duration: Any = field(default=None, kw_only=True)  # required; None gets a message of its own
    bounds: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    path: Sequence[Any] = field(default=(), kw_only=True)
    conditions: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    unknowns: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    phases: Sequence[Mapping[Any, Any]] = field(default=(), kw_only=True)
    signals: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        system = self.system
        excluded = (RetimedSystem, HamiltonianSystem)
        if not isinstance(system, MechanicalSystem) or isinstance(system, excluded):
            reject(
                f"system is a {type(system).__name__}, which optimal control does not accept.",
                remedy="Pass a MechanicalSystem with inputs and without a time transformation.",
            )
        reject_contacts(system.modes, system.name, "optimal control")
        if system.plain.moving:
            reject(
                f"{system.name} has constraints of positions that contain the time.",
                why="Optimal control does not accept them.",
                remedy="Declare the motion by prescribed={coordinate: expression}, if possible.",
            )
        _ = self.reading  # raises errors of the arguments

    @cached_property
    def reading(self) -> SymbolicProblem:
        """The expressions of the problem as nodes of a graph."""
        return SymbolicProblem(self)

    def solve(
        self,
        scheme: str | Scheme = "lobatto6",
        *,
        steps: int | Sequence[int] = 40,
        guess: Any = None,
        error: float | None = None,
        tolerance: float = 1e-9,
        most_iterations: int = 500,
        condensed: bool = False,
        progress: bool | None = None,
    ) -> ControlResult:
        """Solve the problem with the discrete equations of motion of a scheme.

        Parameters
        ----------
        scheme : str or Scheme
            A scheme of the Galerkin family. The default is ``"lobatto6"``.
        steps : int or sequence of int
            The total number of steps (default 40), or one number for each phase.
        guess : ControlResult or mapping, optional
            The initial guess. Pass a result of any scheme and grid, a trajectory, or a mapping.
            A mapping gives coordinates and inputs, by symbol or by name. Its values are functions
            of time, expressions of ``symsimpson.time``, numbers, or arrays of samples at equal
            time intervals. It may also give numbers for ``"duration"`` and for parameters that
            the solver finds. By default, coordinates follow a straight line from start to end,
            and inputs are 0. If this line violates a bound or a path constraint, the solver also
            tries curved guesses on both sides. It does the same if a constraint has no gradient at
            a point of the line. It then returns the solution of least cost.
        error : float, optional
            The largest estimated error of the cost, a number between 0 and 1. The number of steps
            is doubled until the error is smaller, at most six times. The error is relative to the
            cost of the solution or of the first guess, whichever is larger. By default, the number
            of steps is not changed.
        tolerance : float
            The tolerance of the scaled optimality conditions. The default is 1e-9.
        most_iterations : int
            The largest number of iterations of the solver. The default is 500.
        condensed : bool
            Deprecated, without effect. States are always variables of the problem.
        progress : bool, optional
            Whether to show the cost and the iterations, which needs tqdm. The default, None,
            shows them after one second. The ``history`` of the result has the solver's record of
            each iteration.

        Returns
        -------
        ControlResult
            The solution, or the last iterate if the search failed. Its ``status`` says which.

        Raises
        ------
        InputError
            If an argument is invalid, or if casadi or SciPy is not installed.
        """
        import_library("scipy", "optimal control", "control")
        from symsimpson.study.control.solution import solve  # casadi and SciPy are slow to import

        galerkin_scheme = read_galerkin_scheme(scheme)
        grid = read_grid(steps, len(self.reading.phases))
        for name, value in (("tolerance", tolerance), ("error", error)):
            real = isinstance(value, Real) and not isinstance(value, bool) and 0 < value < 1
            if not real and (name != "error" or value is not None):
                reject(
                    f"{name} is {shortened(value)}, which is out of range.",
                    remedy="Pass a number between 0 and 1.",
                )
        read_progress(progress)
        if condensed:
            warn(
                "condensed=True has no effect: the full form finds the same optimum faster.\n"
                "Leave condensed out. The next version rejects this argument.",
                DeprecationWarning,
            )
        most = whole_number(most_iterations)
        if most is None or not 0 <= most <= MOST_ITERATIONS:
            reject(
                f"most_iterations is {shortened(most_iterations)}, which is out of range.",
                remedy=f"Pass a whole number from 0 to {MOST_ITERATIONS}.",
            )
        options = {"tol": float(tolerance), "max_iter": most, "print_level": 0}
        return solve(self.reading, galerkin_scheme, grid, guess, error, options, progress)

    def open(
        self, path: str | os.PathLike[str], scheme: str | Scheme | None = None
    ) -> ControlResult:
        """Read a solution of this problem that :meth:`ControlResult.save` wrote.

        The cost and the constraint violations are computed again and compared with the file.

        Parameters
        ----------
        path : str or path-like
            The ``.npz`` file to read.
        scheme : str or Scheme, optional
            The scheme of the solution. Pass it only if symsimpson does not know its name. By
            default, the name in the file selects the scheme.

        Returns
        -------
        ControlResult
            The solution as it was saved.

        Raises
        ------
        StorageError
            If the file does not contain a solution, or is damaged.
        InputError
            If the file contains the solution of another problem, or if SciPy is not installed.
        """
        import_library("scipy", "optimal control", "control")
        from symsimpson.study.control.solution import (
            open_solution,
        )  # casadi and SciPy are slow to import

        return open_solution(self.reading, path, scheme)

    def __repr__(self) -> str:
        return f"OptimalControl({self.system.name}: {', '.join(map(spelled, self.system.inputs))})"

    def _repr_html_(self) -> str:
        return fields_given(f"Optimal control of {self.system.name}", self)
