"""Problems of optimal control as users write them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, Any

from symsimpson.declare.retimed import RetimedSystem
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import reject
from symsimpson.program.input_values import whole_number
from symsimpson.study.control.problem_parts import read_grid
from symsimpson.study.control.reading import Reading, read_family
from symsimpson.support.calling import explaining, warn
from symsimpson.support.extras import library
from symsimpson.support.markup import fields_given
from symsimpson.support.names import shortened, spelled
from symsimpson.support.progress import read_progress

if TYPE_CHECKING:
    from symsimpson.schemes.scheme import Scheme
    from symsimpson.study.control.result import ControlResult

#: The solver counts iterations in 32 bits.
MOST_ITERATIONS = 2**31 - 1


@explaining(also=("__init__",))
@dataclass(frozen=True, eq=False)
class OptimalControl:
    """A problem of optimal control: least cost of a motion from a start to an end.

    Parameters
    ----------
    system : MechanicalSystem
        With inputs, and forces in which they stand.
    cost : expression
        The running cost l(q, q', u, t), integrated over the motion.
    final_cost : expression
        A cost of the end, Phi(q, q', t).
    start, end : mapping
        Values of coordinates and velocities, by symbol or by name (``"x"``, ``"v_x"``), or of
        expressions of them. What is not named is free.
    duration : number or (low, high)
        How long the motion is; or between which bounds it is found.
    bounds : mapping
        Pairs (low, high) of inputs, coordinates, velocities or expressions, None for no bound: at
        all nodes that the equations see, and of coordinates at the ends of steps.
    path : sequence of expression, relation or (low, expression, high)
        Expressions that are not to be positive, or between two numbers, and relations as
        ``x**2 + y**2 >= 1``, at all nodes.
    conditions : mapping
        Expressions at the end, and what of the start they are equal to: ``{x: x + 1, x.diff():
        x.diff()}`` for a motion that repeats itself one further on.
    unknowns : mapping from parameter to (low, high)
        Parameters that are found, too.
    phases : sequence of mapping
        Parts of the motion one after the other, whose durations are found, each with numbers or
        pairs (low, high) that its inputs keep to: ``[{u: 1}, {u: -1}]``. Inputs may jump where one
        ends: then switches do not take a scheme's order.
    signals : mapping from symbol to function or array
        Functions of the time that are known, as motions to be followed or measured ones, by the
        symbols for which they stand in ``cost``, ``bounds`` and ``path``: callables that take an
        array of times, expressions of ``symsimpson.time``, or arrays over equal times of the whole
        duration, which is a number then.

    Raises
    ------
    InputError
        If these make no sense, or contradict one another.
    ModelError
        If an expression contains something else than the symbols of the problem.

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
    duration: Any = field(default=None, kw_only=True)  # what is missing is told
    bounds: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    path: Sequence[Any] = field(default=(), kw_only=True)
    conditions: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    unknowns: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)
    phases: Sequence[Mapping[Any, Any]] = field(default=(), kw_only=True)
    signals: Mapping[Any, Any] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        system = self.system
        if not isinstance(system, MechanicalSystem) or isinstance(system, RetimedSystem):
            reject(
                f"{type(system).__name__} is no system that can be controlled.",
                remedy="Pass a MechanicalSystem with inputs, not a retimed one.",
            )
        object.__setattr__(self, "_read", Reading(self))

    @property
    def reading(self) -> Reading:
        """The problem in a graph."""
        reading: Reading = self.__dict__["_read"]
        return reading

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
        """Solve the problem for the motions of a scheme.

        Parameters
        ----------
        scheme : str or Scheme
            One of the Galerkin family.
        steps : int or sequence of int
            How many; or the number of steps of each phase.
        guess : ControlResult or mapping, optional
            Another result, of any scheme and grid; or functions of the time, expressions of
            ``symsimpson.time``, numbers or arrays over equal times, of coordinates and inputs by
            symbol or by name, and a number for "duration" and parameters that are found.
            Coordinates go in a straight line from start to end unless given, inputs are 0. Where
            that line runs into a bound or an obstacle, or passes a point at which a constraint
            has no slope, lines that are bent to both sides are tried, and the least cost is taken.
        error : float, optional
            The number of steps is doubled until the estimated error of the cost is below this, at
            most six times. The error is relative to the larger of the cost and the cost of the
            first guess.
        tolerance : float
            Of the optimality conditions, scaled.
        most_iterations : int
        condensed : bool
            Deprecated, without effect. States are always unknowns of the problem.
        progress : bool, optional
            Whether to show the cost and the iterations (needs tqdm); None shows them after a
            second. The result's ``history`` has the solver's report on each.

        Returns
        -------
        ControlResult
            However it ended: its ``status`` tells, and the last iterate is there.

        Raises
        ------
        InputError
            If an argument makes no sense, or casadi or SciPy is not installed.
        """
        library("scipy", "optimal control", "control")
        from symsimpson.study.control.solution import solve  # casadi and SciPy are slow to import

        galerkin_scheme = read_family(scheme)
        grid = read_grid(steps, len(self.reading.phases))
        for name, value in (("tolerance", tolerance), ("error", error)):
            real = isinstance(value, Real) and not isinstance(value, bool) and 0 < value < 1
            if not real and (name != "error" or value is not None):
                reject(f"{name} is {shortened(value)}.", remedy="Pass a number between 0 and 1.")
        read_progress(progress)
        if condensed:
            warn(
                "condensed=True has no effect: the full form finds the same optimum faster.\n"
                "Leave condensed out. The next version does not accept it.",
                DeprecationWarning,
            )
        most = whole_number(most_iterations)
        if most is None or not 0 <= most <= MOST_ITERATIONS:
            reject(
                f"most_iterations is {shortened(most_iterations)}.",
                remedy=f"Pass a whole number from 0 to {MOST_ITERATIONS}.",
            )
        options = {"tol": float(tolerance), "max_iter": most, "print_level": 0}
        return solve(self.reading, galerkin_scheme, grid, guess, error, options, progress)

    def open(
        self, path: str | os.PathLike[str], scheme: str | Scheme | None = None
    ) -> ControlResult:
        """Read a solution of this problem that :meth:`ControlResult.save` wrote.

        Parameters
        ----------
        path : str or path-like
        scheme : str or Scheme, optional
            The scheme of the solution, if it has a name that is not known here.

        Raises
        ------
        StorageError
            If the file is no such solution, or is damaged.
        InputError
            If it is the solution of another problem: its cost is computed anew; or SciPy is not
            installed.
        """
        library("scipy", "optimal control", "control")
        from symsimpson.study.control.solution import opened  # casadi and SciPy are slow to import

        return opened(self.reading, path, scheme)

    def __repr__(self) -> str:
        return f"OptimalControl({self.system.name}: {', '.join(map(spelled, self.system.inputs))})"

    def _repr_html_(self) -> str:
        return fields_given(f"Optimal control of {self.system.name}", self)
