"""The result of a run: all its stored states, or some of them, and its dataset for files."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError, reject
from symsimpson.program.input_values import read_array
from symsimpson.results.energies import Energies
from symsimpson.results.states import OF_RUNS, Differentiated, States, Stored
from symsimpson.results.tables import Savable, Variable
from symsimpson.support.array_types import Ints
from symsimpson.support.calling import explaining
from symsimpson.support.names import counted, did_you_mean, public_names

if TYPE_CHECKING:
    from symsimpson.plotting.films import Animation
    from symsimpson.results.events import Events
    from symsimpson.results.interpolate import DenseOutput

#: Times of steps are rounded by less than this, in steps.
ROUNDED = 1e-6
#: What a run has a row of for each state, or a mapping of such rows.
ROWS = (
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
#: What events have a row of for each time.
ROWS_OF_EVENTS = ("t", "q", "p", "direction", "q_after", "p_after", "impulse", "simultaneous")
#: What a part shares with its run.
WHOLE = ("sol", "records")


@explaining()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Trajectory(Savable, Energies, Differentiated):
    """States of a run, and how it ended.

    Arrays are float64, or object arrays of mpmath numbers if the stepper was compiled with a
    ``precision``. The attributes of :class:`States` are available, too: ``v``, ``y``, ``energy``,
    ``invariants``, ``parameters``, quantities by name, slices.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Times of the stored states.
    q, p : ndarray, shape (N + 1, n)
        Positions and conjugate momenta.
    newton_iterations : ndarray of int, shape (N + 1,)
        Iterations since the state stored before; 0 for the first.
    h : number
        The step.
    steps : int
        Steps done.
    every : int or None
        Steps from one stored state to the next; None where only the last is stored.
    status : Status
        0 is success.
    message : str
        The outcome as a text.
    error_estimate : float or None
        The largest error along the path that :func:`symsimpson.integrate` measured.

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

        As :class:`States`; what the run knows of these states, such as their ``tangent``, stays.
        """
        item = super().__getitem__(key)
        if isinstance(item, np.ndarray):
            return item
        return part_of(self, np.arange(len(self)), key)

    @property
    def tau(self) -> NDArray[Any]:
        """The variable in which steps are fixed, from 0, shape (N + 1,): t - t0 unless retimed."""
        if self.tau_values is not None:
            return self.tau_values
        if self.every is not None:
            return self.t - self.t[0]
        if self.ended_by is not None:  # within a step
            return self.t - self._beginning.t
        return self.t * 0 + self.h * self.steps

    @property
    def E0(self) -> Any:
        """The initial energy, the energy level on which a retimed system is integrated."""
        values = self.parameters
        return values["E0"] if self.program.header.retimed else self._first_energy

    @property
    def inputs(self) -> dict[str, NDArray[Any]]:
        """Values of the inputs by name: shape (steps,), or (steps, s) if nodes have their own.

        A step that an event ended is one of them; what was given for steps behind the end is not.
        """
        names, (given,) = self.program.inputs, self.input_values
        count = max(self.steps, math.ceil(float(self.tau[-1] / self.h) - ROUNDED))
        values = np.broadcast_to(given, (max(count, len(given)), *given.shape[1:]))[:count]
        shown = values[:, 0] if values.shape[1] == 1 else values
        return {name: shown[..., k] for k, name in enumerate(names)}

    @cached_property
    def sol(self) -> DenseOutput:
        """The states at any time of the run; see :class:`DenseOutput`.

        Raises
        ------
        InputError
            If only the last state is stored.
        """
        from symsimpson.results.interpolate import DenseOutput

        return DenseOutput(self)

    def at(self, t: ArrayLike) -> States:
        """Return the states at any times of the run, with the order of the scheme.

        Parameters
        ----------
        t : array_like, shape (m,)

        Returns
        -------
        States

        Raises
        ------
        InputError
            If a time lies outside of the run, or only the last state is stored.

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
        """Find the zeros of an expression along the run, to rounding error.

        A change of sign between two stored states brackets a zero, which is located on the dense
        output. Two zeros between neighbouring stored states are missed. A zero at a stored state
        is found once; one at the first state is not counted.

        Parameters
        ----------
        expression : SymPy expression, equation or str
            In coordinates, momenta (``p_`` and a coordinate), velocities (``v_`` and a coordinate,
            or ``q1.diff()``), parameters, ``t`` and ``energy``. ``Mod(q1, 2*pi) - pi`` finds an
            angle in all turns: the jump of ``Mod``, which should lie far from the zero, is none.
            Or an event that acted on the run, by its name, or by its expression if it has none:
            then its record, :class:`Actions`.
        direction : {0, 1, -1}
            0 for all zeros; 1 or -1 for those where it increases or decreases along the run.
        wrap : True, or names of coordinates
            Angles to reduce to the range from -pi to pi, in the expression and in the result;
            True for all coordinates.

        Returns
        -------
        Events

        Raises
        ------
        InputError
            If the expression contains something else.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=80)
        >>> run.events("theta").t[:3].round(3), run.events("theta", direction=1).t.round(3)
        (array([0.535, 1.604, 2.674]), array([1.604, 3.743, 5.883]))
        """
        from symsimpson.results.events import actions_of, gather, read_zeros, zeros

        if self.event_names and (name := str(expression)) in self.event_names:
            return actions_of(self, name)
        try:
            wanted = read_zeros(self.program, expression, direction, wrap)
            return gather(self, wanted, [zeros(self, wanted)])
        except InputError as error:
            if not (isinstance(expression, str) and self.event_names):
                raise
            meant = did_you_mean(expression, self.event_names)
            reject(
                f"the run has no event {expression!r}.{meant}",
                remedy="Its events are "
                f"{', '.join(self.event_names)}. If it is meant as an expression: {error}",
            )

    def animate(
        self,
        *,
        seconds: float | None = None,
        fps: int = 20,
        figsize: tuple[float, float] | None = None,
        dpi: float = 72,
    ) -> Animation:
        """Film the system's ``positions``: points, and lines where their distance is constant.

        Linkages in the plane are drawn by matplotlib, motion in space by plotly. The film plays
        in a notebook, and on a page that ``.save("film.html")`` writes, without any connection.
        ``.save("film.png")`` writes the first frame.

        Parameters
        ----------
        seconds : float, optional
            Length of the animation; the length of the run if this is from 1 to 10, else 10.
        fps : int
            Frames a second.
        figsize : (float, float), optional
            Width and height of a frame in inches; (4.2, 4.2) in the plane, (8.3, 9.2) in space.
        dpi : float
            Dots per inch.

        Returns
        -------
        Animation

        Raises
        ------
        InputError
            If the system declares no positions, a library is not installed, or these numbers
            make no film.

        Examples
        --------
        >>> import symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> run.animate(fps=10)
        Animation(50 frames; save('film.html') keeps it)
        """
        from symsimpson.plotting.films import animate

        return animate(self, seconds=seconds, fps=fps, figsize=figsize, dpi=dpi)

    def _contents(self) -> Any:
        return dataset_of(self)

    def _kind_of_result(self) -> str:
        return "trajectory"

    def _further(self) -> list[Variable]:
        further = [Variable("newton_iterations", self.newton_iterations, ("time",))]
        if self.tau_values is not None:
            further.append(Variable("tau", self.tau_values, ("time",)))
        return further

    def _about(self) -> dict[str, Any]:
        return super()._about() | self._outcome()

    def _repr_html_(self) -> str:
        from symsimpson.results.html import trajectory

        return trajectory(self)

    def __repr__(self) -> str:
        program = self.program
        return (
            f"Trajectory({program.system}, {program.scheme}: {counted(self.steps, 'step')} of "
            f"h={float(self.h):g}, {counted(self.t.size, 'state')} stored, {self.status.name})"
        )


OF_RUNS |= {x for x in (*dir(Trajectory), *Trajectory.__dataclass_fields__) if x[0] != "_"}


@dataclass(frozen=True, eq=False, repr=False)
class Part(States):
    """Some of the states of a run; what the run knows of each of them is there, too.

    Attributes are those of :class:`States`; ``tau``, ``newton_iterations``, ``tangent``,
    ``sensitivity``, ``work``, ``power``, ``energy_balance``, ``energy_error``,
    ``shadow_energy``, ``multipliers``, ``constraint_error``, ``velocity_constraint_error`` and
    ``constraint_forces`` are rows of those of the whole run.

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
        if name in WHOLE:
            return getattr(self._run, name)
        if name not in ROWS:
            return super().__getattr__(name)
        values = getattr(self._run, name)
        if isinstance(values, dict):
            return {key: rows[self._places] for key, rows in values.items()}
        return values[self._places]

    @property
    def _connected(self) -> bool:
        """Whether the states are a slice of the run: others have gaps."""
        return np.unique(np.diff(self._places)).size <= 1

    def __dir__(self) -> list[str]:
        """Return public names, with rows of the run."""
        return [*{*public_names(self), *ROWS, "sol"}]

    def __getitem__(self, key: Any) -> Any:
        """Return a quantity by its name, shape (N,), or some of the states."""
        item = super().__getitem__(key)
        return item if isinstance(item, np.ndarray) else part_of(self._run, self._places, key)

    def at(self, t: ArrayLike) -> States:
        """Return the states at any times of the whole run, as :meth:`Trajectory.at`."""
        return self._run.at(t)

    def events(self, expression: Any, *, direction: int = 0, wrap: Any = ()) -> Events:
        """Find the zeros of an expression from the first to the last of these states.

        As :meth:`Trajectory.events`; the name of an event gives its record in this time.
        """
        events = self._run.events(expression, direction=direction, wrap=wrap)
        here = (events.t >= min(self.t, default=0)) & (events.t <= max(self.t, default=0))
        values = {f.name: getattr(events, f.name) for f in fields(events)}
        rows = {x: values[x][here] for x in ROWS_OF_EVENTS if x in values}
        return type(events)(**{**values, **rows})

    def animate(self, **options: Any) -> Animation:
        """Animate this part of the run, with the arguments of :meth:`Trajectory.animate`."""
        from symsimpson.plotting.films import animate

        return animate(self, **options)


def part_of(run: Stored, places: Ints, key: Any) -> Part:
    """Return the states of a run that a key selects among those with numbers ``places``."""
    some = np.atleast_1d(places[key])
    return Part(
        t=run.t[some],
        q=run.q[some],
        p=run.p[some],
        program=run.program,
        parameter_values=run.parameter_values,
        driven=run.driven,
        _run=run,
        _places=some,
    )


#: Before the names of what was recorded, in files.
RECORDED = "recorded_"
#: The name of what events did.
EVENTS = "acted"


def dataset_of(run: Stored) -> Any:
    """Return an ``xarray.Dataset`` from which the trajectory can be made again."""
    dataset = run.to_xarray()
    text = np.frombuffer(run.program.source.encode(), dtype=np.uint8)  # long, for an attribute
    dataset["module"] = (("byte",), text, {"long_name": "the generated module, a text in UTF-8"})
    if run.event_names:
        text = np.frombuffer(_of_events(run).encode(), dtype=np.uint8)
        dataset[EVENTS] = (("byte_of_events",), text, {"long_name": "records of events, JSON"})
    if run.input_values.size:
        about = {"long_name": "inputs of steps, at their nodes"}
        dataset["inputs"] = (("step", "node", "input"), run.input_values[0], about)
    if run.begun is not None:
        dataset.attrs["begun"] = [float(run.begun[0]), *run.begun[1].ravel().tolist()]
    dataset.attrs |= {
        "every": run.every or 0,
        "parameter_values": run.parameter_values.tolist(),
        "sha256": digest_of(run),
    }
    for name, rows in run.recorded_values:
        dataset[f"{RECORDED}{name}"] = (("time", f"{name}_number"), rows)
    if users := run.program.names.users:
        dataset.attrs["names"] = json.dumps(users)
    if run.reduced_values:
        dataset.attrs["reduced"] = json.dumps(run.reduced_values)
    if run.variations is not None:
        about = {"long_name": "variations of the state, then of what is varied"}
        dataset["variations"] = (("time", "state", "variation"), run.variations, about)
        if run.varied_by is not None:
            dataset.attrs["varied_by"] = list(run.varied_by) or [""]
    return dataset


def _of_events(run: Stored) -> str:
    """Return what events did, as JSON."""
    records = [x.as_json for x in run.records]
    return json.dumps({"names": run.event_names, "ended_by": run.ended_by, "records": records})


def digest_of(run: Stored) -> str:
    """Return a digest of all that a trajectory is made of."""
    reduced = (run.reduced_values,) if run.reduced_values else ()
    outcome = run.status.name, run.message, run.program.source
    acted = (_of_events(run),) if run.event_names else ()
    users = run.program.names.users
    named = (json.dumps(users),) if users else ()
    estimate = () if run.error_estimate is None else (float(run.error_estimate),)
    about = (float(run.h), run.steps, run.every, *outcome, *reduced, *acted, *named, *estimate)
    content = hashlib.sha256(repr(about).encode())
    tau = () if run.tau_values is None else (run.tau_values,)
    beside = [] if run.variations is None else [run.variations]
    beside += [] if run.begun is None else [np.array(run.begun[0]), run.begun[1]]
    beside += [rows for _, rows in run.recorded_values]
    states = run.t, run.q, run.p
    arrays = run.parameter_values, run.newton_iterations, run.input_values, *tau, *beside
    for array in (*states, *arrays):
        content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()
