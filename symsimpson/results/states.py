"""The states of a run, with their quantities, figures and derivatives, and its outcome."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NoReturn, overload

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError, reject
from symsimpson.program.numbers import NO_INPUTS
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.mode_history import force_variables, forces_by_name, quantity_names
from symsimpson.results.quantities import NO_KINETIC_ENERGY, Quantities
from symsimpson.results.tables import Tabular, Variable, attribute_name
from symsimpson.stepping.driving import InputHistory, inputs_at_times
from symsimpson.support.calling import explain_methods
from symsimpson.support.names import counted


@dataclass(frozen=True, eq=False, repr=False, init=False, kw_only=True)
class RunOutcome:
    """The outcome of a run, and the quantities that it observed.

    Attributes
    ----------
    h : number
        Step size, in the unit of time.
    steps : int
        Number of steps.
    status : Status
        Outcome of the run; ``Status.SUCCESS`` is 0.
    message : str
        Outcome of the run, as text.
    """

    h: Any
    steps: int
    status: Status
    message: str
    reduced_values: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    #: Records of the events that acted, in the order of time, and the names of all events.
    records: tuple[Any, ...] = field(default=(), repr=False)
    event_names: tuple[str, ...] = ()
    #: The largest error during the run, if :func:`symsimpson.integrate` measured it.
    error_estimate: float | None = None

    @property
    def success(self) -> bool:
        """True if the run reached its end."""
        return self.status is Status.SUCCESS

    @property
    def reduced(self) -> dict[str, float]:
        """The results of ``reduce`` by name; NaN if they would include states after the end."""
        return dict(self.reduced_values)

    def _outcome_attributes(self) -> dict[str, Any]:
        """Return the outcome as attributes of a dataset."""
        estimate = {} if self.error_estimate is None else {"error_estimate": self.error_estimate}
        return {
            "h": float(self.h),
            "steps": self.steps,
            "status": self.status.name,
            "message": self.message,
            **estimate,
        }


class StateDerivatives:
    """Derivatives of the stored states; in ensembles, the first axis counts the members."""

    program: Program
    variations: NDArray[Any] | None

    @property
    def _names_varied(self) -> tuple[str, ...]:
        """Names of the parameters and inputs that the run differentiated by."""
        return self.program.names.varied(self.program.header.varied_by or ())

    @property
    def tangent(self) -> NDArray[Any]:
        """The k variations (dq, dp) of N stored states, shape (N, 2 n, k).

        Raises
        ------
        InputError
            If the run did not compute variations.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (51, 2, 2)
        >>> stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (2, 2, 2)
        """
        variations = self._all_variations("tangents=4")
        count = variations.shape[-1] - len(self._names_varied)
        return variations[..., :count] if count else self._reject_missing("tangents=4")

    @property
    def sensitivity(self) -> dict[str, NDArray[Any]]:
        """The derivatives of N stored states (q, p) by parameters and inputs, shape (N, 2 n) each.

        The keys are the names of the parameters and inputs.

        Raises
        ------
        InputError
            If the run did not compute sensitivities.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, sensitivities="l")
        >>> run.sensitivity["l"].shape
        (51, 2)
        """
        variations, names = self._all_variations("sensitivities='l'"), self._names_varied
        first = variations.shape[-1] - len(names)
        return {name: variations[..., first + j] for j, name in enumerate(names)}

    def _all_variations(self, argument: str) -> NDArray[Any]:
        """Return all variations: of the initial state first, then of parameters and inputs."""
        return self._reject_missing(argument) if self.variations is None else self.variations

    def _reject_missing(self, argument: str) -> NoReturn:
        reject(
            "this run did not compute derivatives of this kind.",
            remedy=f"Pass {argument} to integrate.",
        )


#: What states of one run share.
SHARED = ("program", "parameter_values", "driven", "history")
#: Names of the attributes of a trajectory, which the module of trajectories adds.
RUN_ATTRIBUTES = set[str]()


class PartialRunError(InputError, AttributeError):
    """An attribute of a whole run was read from some of its states."""


def _kind_of(key: Any) -> str:
    """Return the NumPy kind of the numbers in a list or an array; "i" for an empty list."""
    try:
        return "i" if isinstance(key, list) and not key else np.asarray(key).dtype.kind
    except ValueError:  # lists of several lengths
        return "O"


def program_attributes(program: Program) -> dict[str, Any]:
    """Return the system, scheme, order and digest as attributes of a dataset."""
    names = {x: getattr(program, x) for x in ("system", "scheme", "order")}
    return names | {"digest": program.header.digest}


@explain_methods()
class Plottable:
    """A result whose quantities can be drawn over time."""

    @property
    def _connected(self) -> bool:
        """True if the states are consecutive, so that lines may connect them."""
        return True

    def _default_names(self) -> list[str] | None:
        """Return the quantities that ``plot`` draws by default; None means the coordinates."""
        return None

    def plot(self, names: str | Sequence[str] | None = None, *more: str, ax: Any = None) -> Any:
        """Draw quantities over time.

        If lines between the stored states would miss the motion, the method repeats steps of the
        run to draw a curve. If this needs too many steps, or only the states are known, it draws
        dots.

        Parameters
        ----------
        names : str or sequence of str, optional
            Names as in ``run["q1"]``. By default, the method draws all coordinates, or all saved
            scalar quantities.
        *more : str
            More names.
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes: one for each unit. Quantities
            whose ranges differ by more than a factor of 30 have separate axes.

        Returns
        -------
        matplotlib axes
            The first axes of the figure.

        Raises
        ------
        InputError
            If matplotlib is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.plot("theta", "energy").get_xlabel()
        't'
        """
        from symsimpson.plotting.run_figures import plot

        wanted = (names, *more) if more else self._default_names() if names is None else names
        return plot(self, wanted, connected=self._connected, ax=ax)


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class States(Quantities, Tabular, Plottable):
    """States of one system at N times: a part of a run, or states between its steps.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times of the states.
    q, p : ndarray, shape (N, n)
        Positions and conjugate momenta.
    v : ndarray, shape (N, n)
        Velocities dq/dt.
    energy, kinetic_energy : ndarray, shape (N,)
        The energy H and its kinetic part.
    parameter_values : ndarray
        Values of the parameters of the run, in the order of ``program.parameters``.
    program : Program
        The compiled module of the run.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> run[10:20]
    Part(pendulum, simpson: 10 states, 1 <= t <= 1.9)
    >>> run[10:20]["theta"].shape, run[-1].t
    ((10,), array([5.]))
    """

    t: NDArray[Any]
    q: NDArray[Any]
    p: NDArray[Any]
    program: Program = field(repr=False)
    parameter_values: NDArray[Any] = field(repr=False)
    #: The inputs as functions of time, if they are known.
    driven: InputHistory | None = field(repr=False)
    #: The modes of contacts and friction; None without either.
    history: Any = field(repr=False)

    def __init__(self, **fields: Any) -> None:
        self.__dict__["history"] = None
        self.__dict__.update(fields)  # four times faster than the generated constructor

    def __getattr__(self, name: str) -> Any:
        kind = type(self).__name__
        if name == "kinetic_energy":  # its property raised the same error
            raise AttributeError(NO_KINETIC_ENERGY)
        if name not in RUN_ATTRIBUTES:
            raise AttributeError(f"{kind!r} object has no attribute {name!r}")
        raise PartialRunError(
            f"{kind} has no {name!r}: it has only some states of a run.\nUse the attribute of the "
            f"run, run.{name}. Run a member of an ensemble alone: stepper.integrate(...)."
        )

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters of the run, by name."""
        return dict(zip(self.program.parameters, self.parameter_values.tolist(), strict=True))

    @property
    def y(self) -> NDArray[Any]:
        """Positions and momenta in the layout of SciPy's ``solve_ivp``, shape (2 n, N)."""
        return np.concatenate([self.q, self.p], axis=1).T

    @overload
    def __getitem__(self, key: str) -> NDArray[Any]: ...
    @overload
    def __getitem__(self, key: int | slice | NDArray[Any] | list[int]) -> States: ...
    def __getitem__(self, key: Any) -> NDArray[Any] | States:
        """Return a quantity by its name, or some of the states.

        An integer selects one state. A slice or an array of integers selects several states, as in
        NumPy. These names select quantities:

        - a coordinate, or a coordinate with the prefix ``p_`` or ``v_``: shape (N,);
        - an invariant, "t", "energy" or "kinetic_energy": shape (N,);
        - "q", "p" or "v": shape (N, n);
        - a point of ``positions``: its coordinates.

        Names that you declare precede names of the package.

        Raises
        ------
        UnknownNameError
            If the name is unknown. It is an InputError and a KeyError.
        IndexError
            If there is no state of this number.
        """
        if isinstance(key, (str, bool, float)) or hasattr(key, "free_symbols"):
            return self._look_up(key)
        several = isinstance(key, (list, np.ndarray))
        if several and _kind_of(key) not in "biu":
            reject(
                f"{key!r} does not select states, because these are not integers.",
                remedy="Use run['energy'] for one quantity, run.to_pandas()[[...]] for several, "
                "and run[[0, 5]] for states.",
            )
        some: Any = key
        if not (isinstance(key, slice) or (several and np.ndim(key))):
            try:
                number = operator.index(key)
            except TypeError:
                return self._look_up(key)
            if not -len(self) <= number < len(self):
                raise IndexError(
                    f"there is no state {number}: the run has {len(self)} states, the first is 0"
                )
            some = [number]
        return self.with_states(self.t[some], self.q[some], self.p[some])

    def with_states(self, t: NDArray[Any], q: NDArray[Any], p: NDArray[Any]) -> States:
        """Return States of other t, q and p, with the same system, parameters and inputs."""
        about = {name: getattr(self, name) for name in SHARED}
        return States(t=t, q=q, p=p, **about)

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}  # without cached quantities

    def plot_phase(self, x: str | None = None, y: str | None = None, *, ax: Any = None) -> Any:
        """Draw one quantity over another, with the curves of :meth:`plot`.

        Call ``ax.set_aspect("equal")`` if both quantities have the same unit.

        Parameters
        ----------
        x : str, optional
            Name of the horizontal quantity, as in ``run["q1"]``. By default, the first coordinate.
        y : str, optional
            Name of the vertical quantity. By default, the momentum of ``x``.
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes
            The axes of the figure.

        Raises
        ------
        InputError
            If matplotlib is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.plot_phase("theta", "v_theta").get_ylabel()
        'v_theta'
        """
        from symsimpson.plotting.run_figures import plot_phase

        return plot_phase(self, x, y, connected=self._connected, ax=ax)

    def plot_path(self, *, ax: Any = None) -> Any:
        """Draw the paths of the system's ``positions`` on axes of equal scales.

        Parameters
        ----------
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes
            The axes of the figure.

        Raises
        ------
        InputError
            If the system declares no positions, or matplotlib is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.plot_path().get_aspect()
        1.0
        """
        from symsimpson.plotting.films import plot_path

        return plot_path(self, connected=self._connected, ax=ax)

    def _special_quantity(self, key: str) -> Any:
        return forces_by_name(self)[key] if key in self._special_names() else None

    def _special_names(self) -> list[str]:
        return quantity_names(self.program, self.history)

    def _variables(self) -> list[Variable]:
        plain = self._quantities(("time",))
        return [*plain, *force_variables(self), *self._extra_variables()]

    def _extra_variables(self) -> list[Variable]:
        """Return the variables that only a subclass has."""
        return []

    def _attributes(self) -> dict[str, Any]:
        """Return the system, scheme, order, digest and parameters as attributes of a dataset."""
        names = zip(self.parameters.items(), self.program.names.parameters.own, strict=True)
        return program_attributes(self.program) | {
            f"parameter {attribute_name(name, identifier)}": float(value)
            for (name, value), identifier in names
        }

    def _point_arguments(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return t, q and the parameter values, to evaluate declared positions."""
        return self.t, self.q, self.parameter_values

    def _inputs_at_states(self) -> NDArray[Any]:
        return inputs_at_times(self.program, self.driven, self.t)[0, :, 0]

    def _evaluate_rows(
        self, kernel: str, block: str, count: int, *, driven: bool = False
    ) -> NDArray[Any]:
        from symsimpson.program.evaluation import evaluate

        states, values = (self.t, self.q, self.p), self.parameter_values
        inputs = inputs_at_times(self.program, self.driven, self.t) if driven else NO_INPUTS
        return evaluate(self.program, kernel, block, count, states, values, inputs)

    def __len__(self) -> int:
        return self.t.size

    def _repr_html_(self) -> str:
        from symsimpson.results.html import states

        return states(self)

    def __repr__(self) -> str:
        times = counted(len(self), "state")
        if len(self):
            times += f", {float(self.t[0]):g} <= t <= {float(self.t[-1]):g}"
        return f"{type(self).__name__}({self.program.system}, {self.program.scheme}: {times})"


@dataclass(frozen=True, eq=False, repr=False, init=False)
class FinishedRun(RunOutcome, States):
    """The arrays and settings of a finished run, from which it computes other quantities.

    Attributes
    ----------
    newton_iterations : ndarray of int, shape (N + 1,)
        Newton iterations since the previous stored state; 0 for the initial state.
    every : int or None
        Number of steps between stored states; None if only the final state is stored.
    input_values : ndarray, shape (1, steps, s, m)
        Values of the m inputs by step and node. An axis of length 1 stands for all steps or nodes.
    variations : ndarray, shape (N + 1, 2 n, k), or None
        Derivatives of the stored states, if the run computed them.
    tau_values : ndarray, shape (N + 1,), or None
        Transformed time of the states, if the system has a time transformation.
    begun : tuple of number and ndarray, shape (2, n), or None
        Initial time, and initial q and p, if only the final state is stored.
    varied_by : tuple of str or None
        Names of the parameters and inputs that the run differentiated by. None means those of the
        program.
    recorded_values : tuple of (str, ndarray) pairs
        The recorded sums: names, and arrays of shape (N + 1, k).
    ended_by : str or None
        Name of the terminal event that ended the run.
    """

    newton_iterations: NDArray[np.int64]
    every: int | None
    input_values: NDArray[Any] = field(repr=False)
    variations: NDArray[Any] | None = field(default=None, repr=False)
    tau_values: NDArray[Any] | None = field(default=None, repr=False)
    begun: tuple[Any, NDArray[Any]] | None = field(default=None, repr=False)
    varied_by: tuple[str, ...] | None = field(default=None, repr=False)
    recorded_values: tuple[tuple[str, NDArray[Any]], ...] = field(default=(), repr=False)
    ended_by: str | None = None

    @property
    def recorded(self) -> dict[str, NDArray[Any]]:
        """The sums that ``record`` names, shape (N + 1, k) each."""
        return dict(self.recorded_values)
