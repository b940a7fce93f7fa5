"""States at times, with all that follows from them, with how their run ended."""

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
from symsimpson.results.quantities import Quantities
from symsimpson.results.tables import Tabular, Variable, attribute_name
from symsimpson.stepping.driving import Driven, inputs_there
from symsimpson.support.calling import explaining
from symsimpson.support.names import counted


@dataclass(frozen=True, eq=False, repr=False, init=False, kw_only=True)
class Outcome:
    """How a run ended, and what was observed during the run."""

    h: Any
    steps: int
    status: Status
    message: str
    reduced_values: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    #: Records of events that acted, in the order of time, and the names of all events.
    records: tuple[Any, ...] = field(default=(), repr=False)
    event_names: tuple[str, ...] = ()
    #: The largest error along the path, if :func:`symsimpson.integrate` measured it.
    error_estimate: float | None = None

    @property
    def success(self) -> bool:
        """Whether the run reached its end."""
        return self.status is Status.SUCCESS

    @property
    def reduced(self) -> dict[str, float]:
        """The quantities requested by ``reduce``; NaN where states after the end were taken in."""
        return dict(self.reduced_values)

    def _outcome(self) -> dict[str, Any]:
        """Return it for files."""
        estimate = {} if self.error_estimate is None else {"error_estimate": self.error_estimate}
        return {
            "h": float(self.h),
            "steps": self.steps,
            "status": self.status.name,
            "message": self.message,
            **estimate,
        }


class Differentiated:
    """Derivatives that were carried along beside states; ensembles have an axis of members."""

    program: Program
    variations: NDArray[Any] | None

    @property
    def _names_varied(self) -> tuple[str, ...]:
        """Parameters and inputs that it was differentiated by."""
        return self.program.names.varied(self.program.header.varied_by or ())

    @property
    def tangent(self) -> NDArray[Any]:
        """Variations (dq, dp) of N stored states of n coordinates, shape (N, 2 n, k) for k of them.

        Raises
        ------
        InputError
            If the run carried none along.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (51, 2, 2)
        >>> stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, tangents=2).tangent.shape
        (2, 2, 2)
        """
        variations = self._carried("tangents=4")
        count = variations.shape[-1] - len(self._names_varied)
        return variations[..., :count] if count else self._missing("tangents=4")

    @property
    def sensitivity(self) -> dict[str, NDArray[Any]]:
        """Derivatives of N stored states (q, p), by name of parameter or input, shape (N, 2 n).

        Raises
        ------
        InputError
            If the run carried none along.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, sensitivities="l")
        >>> run.sensitivity["l"].shape
        (51, 2)
        """
        variations, names = self._carried("sensitivities='l'"), self._names_varied
        first = variations.shape[-1] - len(names)
        return {name: variations[..., first + j] for j, name in enumerate(names)}

    def _carried(self, ask: str) -> NDArray[Any]:
        """Return all variations; those by parameters stand behind those of the state."""
        return self._missing(ask) if self.variations is None else self.variations

    def _missing(self, ask: str) -> NoReturn:
        reject(
            "this run carried no derivatives of this kind along.",
            remedy=f"Ask for them: integrate(..., {ask}).",
        )


#: Names of all that runs have; runs themselves put them here.
OF_RUNS = set[str]()


class PartialRunError(InputError, AttributeError):
    """Some states of a run lack what the whole run has."""


def _kind_of(key: Any) -> str:
    """Return the kind of numbers in a list or an array of numpy; an empty list may be of any."""
    try:
        return "i" if isinstance(key, list) and not key else np.asarray(key).dtype.kind
    except ValueError:  # lists of several lengths
        return "O"


def about_program(program: Program) -> dict[str, Any]:
    """Return attributes of a dataset: system, scheme, order and digest."""
    names = {x: getattr(program, x) for x in ("system", "scheme", "order")}
    return names | {"digest": program.header.digest}


@explaining()
class Plotted:
    """Quantities over time, which can be drawn."""

    @property
    def _connected(self) -> bool:
        """Whether states follow one another, so that lines may connect them."""
        return True

    def _drawn(self) -> list[str] | None:
        """Return the quantities to draw unless some are named; None for the coordinates."""
        return None

    def plot(self, names: str | Sequence[str] | None = None, *more: str, ax: Any = None) -> Any:
        """Draw quantities over time.

        A run takes steps again where lines between its stored states would miss the motion. Dots
        are drawn where that takes too many steps, or where the states alone are known.

        Parameters
        ----------
        names : str or sequence of str, optional
            As in ``run["q1"]``; all coordinates unless given, or all saved numbers.
        *more : str
            Further ones.
        ax : matplotlib axes, optional
            Axes to draw in. Unless given, there are new ones: one for each unit, and one for
            quantities whose ranges differ from other ranges by more than 30 times.

        Returns
        -------
        matplotlib axes
            The first ones.

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

        wanted = (names, *more) if more else self._drawn() if names is None else names
        return plot(self, wanted, connected=self._connected, ax=ax)


@explaining()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class States(Quantities, Tabular, Plotted):
    """States of one system at some times: part of a run, or places between its steps.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times.
    q, p : ndarray, shape (N, n)
        Positions and conjugate momenta.

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
    #: How inputs went, where that is known.
    driven: Driven | None = field(repr=False)

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)  # a quarter of the time that setting each takes

    def __getattr__(self, name: str) -> Any:
        kind = type(self).__name__
        if name not in OF_RUNS:
            raise AttributeError(f"{kind!r} object has no attribute {name!r}")
        raise PartialRunError(
            f"{kind} has no {name!r}: these are some states of a run.\nAsk the run itself, "
            f"run.{name}. Run a member of an ensemble alone: stepper.integrate(...)."
        )

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters that the run used, by name."""
        return dict(zip(self.program.parameters, self.parameter_values.tolist(), strict=True))

    @property
    def y(self) -> NDArray[Any]:
        """Positions and momenta as SciPy's ``solve_ivp`` gives states, shape (2 n, N)."""
        return np.concatenate([self.q, self.p], axis=1).T

    @overload
    def __getitem__(self, key: str) -> NDArray[Any]: ...
    @overload
    def __getitem__(self, key: int | slice | NDArray[Any] | list[int]) -> States: ...
    def __getitem__(self, key: Any) -> NDArray[Any] | States:
        """Return a quantity by its name, or some of the states.

        Names are those of the coordinates, ``p_`` and ``v_`` before them, of the invariants and
        positions, and "t", "energy" and "kinetic_energy", shape (N,); or "q", "p" and "v", shape
        (N, n). What the user named comes first. A whole number selects one state; a slice or an
        array of numbers selects several, as in numpy.

        Raises
        ------
        UnknownNameError
            With the names that there are; it is an InputError, and a KeyError.
        IndexError
            If there is no such state.
        """
        if isinstance(key, (str, bool, float)) or hasattr(key, "free_symbols"):
            return self._named(key)
        several = isinstance(key, (list, np.ndarray))
        if several and _kind_of(key) not in "biu":
            reject(
                f"{key!r} are no numbers of states.",
                remedy="Ask for one quantity, run['energy'], for "
                "several by run.to_pandas()[[...]], or for states by whole numbers, run[[0, 5]].",
            )
        some: Any = key
        if not (isinstance(key, slice) or (several and np.ndim(key))):
            try:
                number = operator.index(key)
            except TypeError:
                return self._named(key)
            if not -len(self) <= number < len(self):
                raise IndexError(f"there is no state {number}: there are {len(self)}, from 0 on")
            some = [number]
        return self.with_states(self.t[some], self.q[some], self.p[some])

    def with_states(self, t: NDArray[Any], q: NDArray[Any], p: NDArray[Any]) -> States:
        """Return other states of the same system, with the same parameters."""
        program, values = self.program, self.parameter_values
        return States(t=t, q=q, p=p, program=program, parameter_values=values, driven=self.driven)

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}  # without what was computed

    def plot_phase(self, x: str | None = None, y: str | None = None, *, ax: Any = None) -> Any:
        """Draw one quantity over another, as a curve like :meth:`plot` draws.

        Call ``ax.set_aspect("equal")`` for two quantities of the same unit.

        Parameters
        ----------
        x, y : str, optional
            As in ``run["q1"]``; the first coordinate, and the momentum of ``x``, unless given.
        ax : matplotlib axes, optional
            Drawn into; made if there are none.

        Returns
        -------
        matplotlib axes

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
        """Draw the paths of the system's ``positions``, into ``ax`` if given; returns the axes.

        Paths are curves like :meth:`plot` draws, on axes of equal scales.

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

    def _variables(self) -> list[Variable]:
        return [*self._quantities(("time",)), *self._further()]

    def _further(self) -> list[Variable]:
        """Return variables that a subclass has beside those of all states."""
        return []

    def _about(self) -> dict[str, Any]:
        """Return attributes of a dataset: system, scheme, order, digest and parameters."""
        names = zip(self.parameters.items(), self.program.names.parameters.own, strict=True)
        return about_program(self.program) | {
            f"parameter {attribute_name(name, identifier)}": float(value)
            for (name, value), identifier in names
        }

    def _where(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        return self.t, self.q, self.parameter_values

    def _evaluated(
        self, kernel: str, block: str, count: int, *, driven: bool = False
    ) -> NDArray[Any]:
        from symsimpson.program.observed import evaluate

        states, values = (self.t, self.q, self.p), self.parameter_values
        inputs = inputs_there(self.program, self.driven, self.t) if driven else NO_INPUTS
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
class Stored(Outcome, States):
    """Arrays and settings of a finished run, from which other quantities are computed.

    Attributes
    ----------
    newton_iterations : ndarray of int, shape (N + 1,)
    every : int or None
        Steps from one stored state to the next.
    input_values : ndarray, shape (1, steps, s, m)
        Inputs by step, node and number, of one run; an axis of one entry stands for all.
    variations : ndarray, shape (N + 1, 2 n, k), or None
    tau_values : ndarray or None
        The variable in which steps are fixed, where it is not the time.
    begun : tuple of number and ndarray, shape (2, n), or None
        The initial time and the initial q and p, if only the last state is stored.
    varied_by : tuple of str or None
        Names that ``variations`` are derivatives by; None for those of the program.
    recorded_values : tuple of pairs
        Names of what was recorded beside states, and arrays of shape (N + 1, k).
    ended_by : str or None
        The name of the event that ended the run.
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
        """The sums requested by ``record``, by name, shape (N + 1, k) each."""
        return dict(self.recorded_values)
