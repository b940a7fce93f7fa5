"""The result of a run."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.errors import InputError
from symsimpson.program.input_values import read_array
from symsimpson.program.status import Status
from symsimpson.results.differentiated import Differentiated
from symsimpson.results.energies import Energies
from symsimpson.results.states import OF_RUNS, States
from symsimpson.results.tables import write
from symsimpson.support.calling import explaining
from symsimpson.support.names import counted, did_you_mean

if TYPE_CHECKING:
    from symsimpson.plotting.animate import Animation
    from symsimpson.results.events import Events
    from symsimpson.results.interpolate import DenseOutput
    from symsimpson.results.records import Record

__all__ = ["Trajectory"]

#: Times of steps are rounded by less than this, in steps.
ROUNDED = 1e-6


@explaining()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Trajectory(Energies, Differentiated):
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

    newton_iterations: NDArray[np.int64]
    h: Any
    steps: int
    every: int | None
    status: Status
    message: str
    input_values: NDArray[Any] = field(repr=False)
    variations: NDArray[Any] | None = field(default=None, repr=False)
    tau_values: NDArray[Any] | None = field(default=None, repr=False)
    begun: tuple[Any, NDArray[Any]] | None = field(default=None, repr=False)
    varied_by: tuple[str, ...] | None = field(default=None, repr=False)
    recorded_values: tuple[tuple[str, NDArray[Any]], ...] = field(default=(), repr=False)
    reduced_values: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    #: What events did, in the order of time, their names, and the one that ended the run.
    records: tuple[Record, ...] = field(default=(), repr=False)
    event_names: tuple[str, ...] = ()
    ended_by: str | None = None
    error_estimate: float | None = None

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
        from symsimpson.results.part import part_of

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
        if self.event_names and (name := str(expression)) in self.event_names:
            from symsimpson.results.records import actions_of

            return actions_of(self, name)
        from symsimpson.results.events import find_events

        try:
            return find_events(self, expression, direction, wrap)
        except InputError as error:
            if not (isinstance(expression, str) and self.event_names):
                raise
            meant = did_you_mean(expression, self.event_names)
            raise InputError(
                f"the run has no event {expression!r}.{meant}\nIts events are "
                f"{', '.join(self.event_names)}. If it is meant as an expression: {error}"
            ) from None

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
        from symsimpson.plotting.animate import animate

        return animate(self, seconds=seconds, fps=fps, figsize=figsize, dpi=dpi)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the run to a file, in the format of its extension.

        ``.nc`` (netCDF) and ``.zarr`` (a store of Zarr) hold what :meth:`to_xarray` gives, and the
        generated module, so that :func:`symsimpson.open_trajectory` gives back this trajectory.
        ``.csv`` and ``.parquet`` are tables, with the columns of :meth:`to_pandas`, and ``.npz``
        has arrays t, q, p, v, energy and points.

        Raises
        ------
        InputError
            If there is no such format, a library is missing, or the run has many digits.
        StorageError
            If the file cannot be written.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.zarr"
        >>> run.save(path)
        >>> ss.open_trajectory(path).steps
        50
        """
        from symsimpson.results.saving import dataset_of

        dataset = partial(dataset_of, self)
        write(path, "trajectory", self._arrays, self._table, dataset, trajectory=self)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return super()._arrays() | {f"point_{name}": x for name, x in self.points.items()}

    def _further(self) -> dict[str, Any]:
        further = {"newton_iterations": (("time",), self.newton_iterations)}
        if self.tau_values is not None:
            further["tau"] = (("time",), self.tau_values)
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
