"""The result of a run: a trajectory, a part of it, and its dataset for files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError, reject
from symsimpson.program.input_values import read_array
from symsimpson.results.energies import Energies
from symsimpson.results.states import RUN_ATTRIBUTES, FinishedRun, StateDerivatives, States
from symsimpson.results.tables import Savable, Variable
from symsimpson.support.array_types import Ints
from symsimpson.support.calling import explain_methods
from symsimpson.support.names import counted, did_you_mean, public_names

if TYPE_CHECKING:
    from symsimpson.plotting.films import Animation
    from symsimpson.results.events import Events
    from symsimpson.results.interpolate import DenseOutput
    from symsimpson.results.mode_history import ModeHistory

#: Upper bound of the round-off error of times, in steps.
STEP_ROUNDING = 1e-6
#: Attributes with a row for each state, or with a mapping to such arrays.
ROW_ATTRIBUTES = (
    "tau",
    "newton_iterations",
    "tangent",
    "sensitivity",
    "work",
    "power",
    "energy_balance",
    "energy_error",
    "shadow_energy",
    "multipliers",
    "constraint_error",
    "constraint_forces",
    "velocity_constraint_error",
)
#: Attributes of events with a row for each time.
EVENT_ROWS = ("t", "q", "p", "direction", "q_after", "p_after", "impulse", "simultaneous")
#: Attributes that a part shares with its run.
SHARED_ATTRIBUTES = ("sol", "records")


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Trajectory(Savable, Energies, StateDerivatives):
    """The stored states of a run, and its outcome.

    Arrays are float64. If the stepper has a ``precision``, they are object arrays of mpmath
    numbers. The class inherits the attributes of :class:`States`: ``v``, ``y``, ``energy``,
    ``invariants``, ``parameters``, quantities by name, and slices.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Times of the stored states.
    q, p : ndarray, shape (N + 1, n)
        Positions and conjugate momenta.
    newton_iterations : ndarray of int, shape (N + 1,)
        Newton iterations since the previous stored state; 0 for the initial state.
    h : number
        Step size, in the unit of time.
    steps : int
        Number of completed steps.
    every : int or None
        Number of steps between stored states. None means that only the final state is stored.
    status : Status
        Outcome of the run; ``Status.SUCCESS`` is 0.
    message : str
        Outcome of the run, as text.
    success : bool
        True if the run reached its end.
    error_estimate : float or None
        Largest error during the run, if :func:`symsimpson.integrate` measured it.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> run["theta"].shape, run["v_theta"].shape, run.y.shape, run.success
    ((51,), (51,), (2, 51), True)
    """

    @property
    def _names_varied(self) -> tuple[str, ...]:
        if self.varied_by is None:
            return super()._names_varied
        return self.program.names.varied(self.varied_by)

    def __getitem__(self, key: Any) -> Any:
        """Return a quantity by its name, shape (N + 1,), or some of the states.

        Keys are those of :class:`States`. The selected states have the attributes of the run, such
        as ``tangent``.
        """
        item = super().__getitem__(key)
        if isinstance(item, np.ndarray):
            return item
        return select_part(self, np.arange(len(self)), key)

    @property
    def tau(self) -> NDArray[Any]:
        """The transformed time of the states, from 0, shape (N + 1,).

        Without a time transformation, this is t - t0.
        """
        if self.tau_values is not None:
            return self.tau_values
        if self.every is not None:
            return self.t - self.t[0]
        if self.ended_by is not None:  # within a step
            return self.t - self._initial_state.t
        return self.t * 0 + self.h * self.steps

    @property
    def E0(self) -> Any:
        """The initial energy. A time-transformed system stays on this energy level."""
        values = self.parameters
        return values["E0"] if self.program.header.retimed else self._initial_energy

    @property
    def inputs(self) -> dict[str, NDArray[Any]]:
        """Values of the inputs by name, shape (steps,), or (steps, s) if nodes have their own.

        The values include those of a last step that an event divides. They do not include values
        for steps after the end of the run.
        """
        names, (stored,) = self.program.inputs, self.input_values
        count = max(self.steps, math.ceil(float(self.tau[-1] / self.h) - STEP_ROUNDING))
        values = np.broadcast_to(stored, (max(count, len(stored)), *stored.shape[1:]))[:count]
        shown = values[:, 0] if values.shape[1] == 1 else values
        return {name: shown[..., k] for k, name in enumerate(names)}

    @cached_property
    def sol(self) -> DenseOutput:
        """The dense output of the run: its states at any time; see :class:`DenseOutput`.

        Raises
        ------
        InputError
            If the run stores only its final state.
        """
        from symsimpson.results.interpolate import DenseOutput

        if self.history is not None or self.program.modes is not None:
            from symsimpson.results.mode_output import DenseOutputOfModes

            return DenseOutputOfModes(self)
        return DenseOutput(self)

    @property
    def modes(self) -> ModeHistory:
        """The modes of contacts and dry friction; see :class:`symsimpson.ModeHistory`.

        Raises
        ------
        InputError
            If the system has neither contacts nor friction.
        """
        if self.history is None:
            reject(
                "this run has no modes.",
                where=self.program.system,
                why="The system declares neither contacts nor friction, or the run is from a file.",
                remedy="Declare contacts={...} or friction={...}.",
            )
        history: ModeHistory = self.history
        return history

    def at(self, t: ArrayLike) -> States:
        """Return the states at any times of the run, with the order of the scheme.

        Parameters
        ----------
        t : float or array_like, shape (m,)
            Times within the run.

        Returns
        -------
        States
            The states at these times, with quantities such as ``energy``.

        Raises
        ------
        InputError
            If a time lies outside the run, or the run stores only its final state.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.at([0.05, 1/3])["theta"].shape
        (2,)
        """
        numbers = self.program.numbers
        with numbers.working():
            times = np.atleast_1d(numbers.result(read_array("t", t, numbers)))
        q, p = self.sol.states(times)
        return self.with_states(times, q, p)

    def events(self, expression: Any, *, direction: int = 0, wrap: Any = ()) -> Events:
        """Find the zeros of an expression during the run, up to round-off.

        A change of sign between two stored states brackets a zero. The dense output then locates
        it. If there are two zeros between two adjacent stored states, the method misses both. It
        returns a zero at a stored state once. It does not count a zero at the first state.

        Parameters
        ----------
        expression : SymPy expression, equation or str
            The expression may contain coordinates, momenta (``p_`` and a coordinate), velocities
            (``v_`` and a coordinate, or ``q1.diff()``), parameters, ``t`` and ``energy``.
            ``Mod(q1, 2*pi) - pi`` finds the angle pi in all turns. The jump of ``Mod`` does not
            count, but it should be far from the zero. The name of an event selects the record of
            the event. An event without a name has the text of its expression as name.
        direction : {0, 1, -1}, default 0
            1 finds only zeros where the expression increases along the run, -1 only those where it
            decreases. 0 finds both.
        wrap : bool, str, symbol or sequence of them, default ()
            Coordinates that are angles. In the expression and in the result, they are reduced to
            the range from -pi to pi. True selects all coordinates.

        Returns
        -------
        Events
            The states at the zeros; an :class:`Actions` if ``expression`` is the name of an event.

        Raises
        ------
        InputError
            If the expression contains an unknown name or function.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=80)
        >>> run.events("theta").t[:3].round(3), run.events("theta", direction=1).t.round(3)
        (array([0.535, 1.604, 2.674]), array([1.604, 3.743, 5.883]))
        """
        from symsimpson.results.events import find_zeros, merge_zeros, read_actions, read_zeros

        if self.event_names and (name := str(expression)) in self.event_names:
            return read_actions(self, name)
        try:
            wanted = read_zeros(self.program, expression, direction, wrap)
            return merge_zeros(self, wanted, [find_zeros(self, wanted)])
        except InputError as error:
            if not (isinstance(expression, str) and self.event_names):
                raise
            reject(
                f"the run has no event {expression!r}.{did_you_mean(expression, self.event_names)}",
                why=f"Its events are {', '.join(self.event_names)}.",
                remedy=f"{expression!r} is not a valid expression either. In {error}",
            )

    def frequencies(self, count: int, of: Any = None) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the main frequencies of a quasi-periodic run (Laskar's method).

        Parameters
        ----------
        count : int
        of : str or array_like, shape (N + 1,), optional
            The signal: a quantity by its name, or numbers. The default is the first coordinate.

        Returns
        -------
        frequencies, amplitudes : ndarray, shape (count,)
            The signal is the sum of A exp(i w t), the largest abs(A) first. A real signal is twice
            the real part, with positive w.

        Raises
        ------
        InputError
            If the states are too few, or not evenly spaced.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.henon_heiles(), "gauss8")
        >>> run = stepper.integrate([0.1, 0.0], v0=[0.0, 0.1], h=0.1, t_end=600.0)
        >>> run.frequencies(1)[0].round(6).tolist()
        [1.002927]
        """
        from symsimpson.results.frequencies import frequencies_of

        return frequencies_of(self, count, of)

    def animate(
        self,
        *,
        seconds: float | None = None,
        fps: int = 20,
        figsize: tuple[float, float] | None = None,
        dpi: float = 72,
    ) -> Animation:
        """Animate the system's ``positions``.

        The animation shows points, and lines between points at constant distance. matplotlib draws
        motion in the plane, and plotly draws motion in space. The animation plays in a notebook.
        ``.save("film.html")`` writes a page that plays without an internet connection.
        ``.save("film.png")`` writes the first frame.

        Parameters
        ----------
        seconds : float, optional
            Duration of the animation, in seconds. By default, the duration of the run if it is
            from 1 to 10, else 10.
        fps : int, default 20
            Frames per second.
        figsize : (float, float), optional
            Width and height of a frame, in inches. By default (4.2, 4.2) in the plane and
            (8.3, 9.2) in space.
        dpi : float, default 72
            Dots per inch.

        Returns
        -------
        Animation
            The animation, which plays in a notebook and can be saved.

        Raises
        ------
        InputError
            If the system declares no positions, a library is not installed, or an argument is
            invalid.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.animate(fps=10)
        Animation(50 frames; save('film.html') keeps it)
        """
        from symsimpson.plotting.films import animate

        return animate(self, seconds=seconds, fps=fps, figsize=figsize, dpi=dpi)

    def _file_dataset(self) -> Any:
        from symsimpson.results.datasets import trajectory_dataset

        return trajectory_dataset(self)

    def _result_kind(self) -> str:
        return "trajectory"

    def _extra_variables(self) -> list[Variable]:
        further = [Variable("newton_iterations", self.newton_iterations, ("time",))]
        if self.tau_values is not None:
            further.append(Variable("tau", self.tau_values, ("time",)))
        return further

    def _attributes(self) -> dict[str, Any]:
        return super()._attributes() | self._outcome_attributes()

    def _repr_html_(self) -> str:
        from symsimpson.results.html import trajectory

        return trajectory(self)

    def __repr__(self) -> str:
        program = self.program
        return (
            f"Trajectory({program.system}, {program.scheme}: {counted(self.steps, 'step')} of "
            f"h={float(self.h):g}, {counted(self.t.size, 'state')} stored, {self.status.name})"
        )


RUN_ATTRIBUTES |= {x for x in (*dir(Trajectory), *Trajectory.__dataclass_fields__) if x[0] != "_"}


@dataclass(frozen=True, eq=False, repr=False)
class Part(States):
    """Some of the states of a run, with the attributes of the run at these states.

    The class inherits the attributes of :class:`States`. These attributes have the rows of the
    whole run at the selected states: ``tau``, ``newton_iterations``, ``tangent``,
    ``sensitivity``, ``work``, ``power``, ``energy_balance``, ``energy_error``,
    ``shadow_energy``, ``multipliers``, ``constraint_error``, ``velocity_constraint_error`` and
    ``constraint_forces``.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> bool((run[3:5].energy_error == run.energy_error[3:5]).all())
    True
    """

    _run: Any = field(repr=False)
    _places: Ints = field(repr=False)

    def __getattr__(self, name: str) -> Any:
        if name in SHARED_ATTRIBUTES:
            return getattr(self._run, name)
        if name not in ROW_ATTRIBUTES:
            return super().__getattr__(name)
        values = getattr(self._run, name)
        if isinstance(values, dict):
            return {key: rows[self._places] for key, rows in values.items()}
        return values[self._places]

    @property
    def _connected(self) -> bool:
        """True if the states are a slice of the run, without gaps."""
        return np.unique(np.diff(self._places)).size <= 1

    def __dir__(self) -> list[str]:
        """Return the public names, including those of the run."""
        return [*{*public_names(self), *ROW_ATTRIBUTES, "sol"}]

    def __getitem__(self, key: Any) -> Any:
        """Return a quantity by its name, shape (N,), or some of the states."""
        item = super().__getitem__(key)
        return item if isinstance(item, np.ndarray) else select_part(self._run, self._places, key)

    def at(self, t: ArrayLike) -> States:
        """Return the states at any times of the whole run, like :meth:`Trajectory.at`."""
        return self._run.at(t)

    def events(self, expression: Any, *, direction: int = 0, wrap: Any = ()) -> Events:
        """Find the zeros of an expression between the first and the last of these states.

        Arguments are those of :meth:`Trajectory.events`. The name of an event selects its record in
        this period.
        """
        events = self._run.events(expression, direction=direction, wrap=wrap)
        here = (events.t >= min(self.t, default=0)) & (events.t <= max(self.t, default=0))
        values = {f.name: getattr(events, f.name) for f in fields(events)}
        rows = {x: values[x][here] for x in EVENT_ROWS if x in values}
        return type(events)(**{**values, **rows})

    def animate(self, **options: Any) -> Animation:
        """Animate this part of the run, with the arguments of :meth:`Trajectory.animate`."""
        from symsimpson.plotting.films import animate

        return animate(self, **options)


def select_part(run: FinishedRun, places: Ints, key: Any) -> Part:
    """Return the states of a run that ``key`` selects among the states numbered ``places``."""
    some = np.atleast_1d(places[key])
    return Part(
        t=run.t[some],
        q=run.q[some],
        p=run.p[some],
        program=run.program,
        parameter_values=run.parameter_values,
        driven=run.driven,
        history=run.history,
        _run=run,
        _places=some,
    )
