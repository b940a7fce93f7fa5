"""Parts of a long run: states at chosen times, or chosen quantities alone."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError, UnknownNameError
from symsimpson.module.quantity import QUANTITIES
from symsimpson.module.quantity import VECTORS as WITH_COORDINATES
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.outcome import Outcome
from symsimpson.results.records import Actions, Record, actions_of
from symsimpson.results.states import States, attribute_name, with_units
from symsimpson.results.tables import apart, dataframe, write
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explaining
from symsimpson.support.extras import library
from symsimpson.support.names import counted, did_you_mean, public_names, spelled

__all__ = ["Sampled", "Saved", "member_of"]

#: Quantities that have a number for each coordinate.
VECTORS = tuple(vector.name for vector in WITH_COORDINATES)


@explaining()
class WithEvents:
    """A result that knows what events did, though states between them may not be kept."""

    records: tuple[Record, ...]
    event_names: tuple[str, ...]

    def events(self, name: Any) -> Actions:
        """Return the states in which an event acted on the run, by its name.

        One without a name has that of its expression.

        Raises
        ------
        InputError
            If the run had no such event.

        Examples
        --------
        >>> import symsimpson as ss
        >>> (z,) = ss.coordinates("z")
        >>> ball = ss.MechanicalSystem(
        ...     "ball", coordinates=(z,), kinetic=z.diff()**2 / 2, potential=10 * z)
        >>> run = ss.compile(ball).integrate(
        ...     [1.0], v0=[0.0], h=0.01, t_eval=[0, 2],
        ...     events=[ss.Event(z, name="floor", action=ss.Impact())])
        >>> run.events("floor").t.round(6).tolist()
        [0.447214, 1.341641]
        """
        if str(name) not in self.event_names:
            had = f"It had {', '.join(self.event_names)}. " if self.event_names else ""
            raise InputError(
                f"the run had no event {name!r}.\n{had}Zeros of expressions are found in single "
                "runs that store their steps: stepper.integrate(...) without t_eval= and save=."
            )
        return actions_of(self, str(name))

    def save(self: Any, path: str | os.PathLike[str]) -> None:
        """Keep the states or quantities in a file, of the kind that its ending says.

        The kinds are those of :meth:`Trajectory.save`. No run goes on from such a file, which
        :func:`symsimpson.open_trajectory` refuses: numpy, pandas or xarray read it.

        Raises
        ------
        InputError
            If the name ends otherwise, or a library is missing.
        StorageError
            If the file cannot be written.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, t_eval=[0.0, 0.25, 3.1])
        >>> run.save(pathlib.Path(tempfile.mkdtemp()) / "run.csv")
        """
        write(path, "result", self._arrays, self._table, self.to_xarray)


@explaining()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Sampled(WithEvents, Outcome, States):
    """The states of a run at chosen times; ``integrate(..., t_eval=times)`` gives them.

    A member of an ensemble, ``ensemble[3]``, gives its stored states.

    It has the attributes of :class:`States`, and how the run ended: ``status``, ``message``,
    ``success``, its ``steps`` and ``h``. Of a run that failed, the times that it reached are there.
    A member of a retimed system has ``tau``, the time of the steps, shape (N,).

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.pendulum())
    >>> run = stepper.integrate([1.0], v0=[0.0], h=0.1, t_eval=[0.0, 0.25, 3.1])
    >>> run
    Sampled(pendulum, simpson: 3 states, 0 <= t <= 3.1)
    >>> run.energy.shape, run.steps, run.success
    ((3,), 31, True)
    """

    h: Any
    steps: int
    status: Status
    message: str
    records: tuple[Record, ...] = field(default=(), repr=False)
    event_names: tuple[str, ...] = ()
    reduced_values: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    error_estimate: float | None = None
    tau: Floats | None = field(default=None, repr=False)

    def _about(self) -> dict[str, Any]:
        return super()._about() | self._outcome()


def member_of(ensemble: Any, member: int) -> Sampled:
    """Return the stored states of a member of an ensemble."""
    n, driven = ensemble.program.n, ensemble.driven
    t, q, p = ensemble.t, *(np.asarray(x[member]).reshape(-1, n) for x in (ensemble.q, ensemble.p))
    if ensemble.t.shape == ensemble.q.shape[:-1]:  # times of its own, up to its end
        t = ensemble.t[member].reshape(-1)
        t, q, p = (x[: np.isfinite(t).sum()] for x in (t, q, p))
    tau = None if ensemble.tau is None else ensemble.tau[member].reshape(-1)[: len(t)]
    status = Status(int(ensemble.status[member]))
    return Sampled(
        t=t,
        q=q,
        p=p,
        tau=tau,
        program=ensemble.program,
        parameter_values=ensemble.parameter_values[member],
        driven=None if driven is None else driven.of_member(member),
        h=np.nan if driven is None else driven.h,
        steps=int(ensemble.steps[member]),
        status=status,
        message=status.message,
        records=ensemble.records.get(member, ()),
        event_names=ensemble.event_names,
        reduced_values=tuple((name, float(x[member])) for name, x in ensemble.reduced.items()),
    )


@explaining()
@dataclass(frozen=True, eq=False, repr=False)
class Saved(WithEvents, Outcome):
    """Chosen quantities of a run; ``integrate(..., save=names)`` gives them.

    Attributes
    ----------
    t : ndarray, shape (N,)
    values : mapping from str to ndarray
        The quantities by name, shape (N,); (N, n) for q, p and v.
    h : number
    steps : int
    status : Status
    message : str

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.double_pendulum())
    >>> kept = stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.01, t_end=10, save=("q1", "energy"))
    >>> kept
    Saved(double_pendulum, simpson: q1, energy at 1001 times, SUCCESS)
    >>> kept["q1"].shape
    (1001,)
    """

    t: NDArray[Any]
    values: Mapping[str, NDArray[Any]]
    h: Any
    steps: int
    status: Status
    message: str
    program: Program = field(repr=False)
    parameter_values: Any = field(default=None, repr=False)
    driven: Any = field(default=None, repr=False)
    records: tuple[Record, ...] = field(default=(), repr=False)
    event_names: tuple[str, ...] = ()
    reduced_values: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    error_estimate: float | None = None

    __dir__ = public_names

    def _ipython_key_completions_(self) -> list[str]:
        return ["t", *self.values]

    def __getitem__(self, name: Any) -> NDArray[Any]:
        """Return a quantity by its name.

        Raises
        ------
        UnknownNameError
            If it was not saved.
        """
        key = spelled(name)
        if key == "t":
            return self.t
        if key not in self.values:
            raise UnknownNameError(
                f"{key!r} was not saved.{did_you_mean(key, [*self.values])} "
                f"There are t, {', '.join(self.values)}."
            )
        return self.values[key]

    #: Iterating over names or over times: neither is what everybody expects.
    __iter__ = None

    def plot(self, names: str | Sequence[str] | None = None, *more: str, ax: Any = None) -> Any:
        """Draw quantities over time, all that have one number unless named; returns the axes.

        Raises
        ------
        InputError
            If matplotlib is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> kept = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, save=["theta"])
        >>> kept.plot().get_ylabel()
        'theta'
        """
        from symsimpson.plotting.run_figures import plot

        single = [name for name, values in self.values.items() if values.ndim == 1]
        return plot(self, (names, *more) if more else single if names is None else names, ax=ax)

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` of the quantities, with the times as index.

        Raises
        ------
        InputError
            If pandas is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> kept = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, save=["q", "energy"])
        >>> list(kept.to_pandas().columns)
        ['theta', 'energy']
        """
        return dataframe(self._table(), "t", self._about(), self.program.units)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` with the dimension time, and coord for q, p and v.

        Raises
        ------
        InputError
            If xarray is not installed.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> kept = stepper.integrate([1.0], v0=[0.0], h=0.1, steps=50, save=["q", "energy"])
        >>> kept.to_xarray()["q"].dims
        ('time', 'coord')
        """
        xarray = library("xarray", "to_xarray", "data")
        variables = {}
        for k, (name, values) in enumerate(self.values.items()):
            key = attribute_name(name, f"quantity_{k}")
            axes = ("coord",) if name in VECTORS else (f"corner_{key}", f"axis_{key}")
            places = axes[len(axes) + 1 - values.ndim :]
            variables[key] = ("time", *places), values, {"long_name": name}
        named = {"time": self.t, "coord": list(self.program.coordinates)}
        return with_units(xarray.Dataset(variables, named, self._about()), self.program.units)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {"t": self.t, **self.values}

    def _table(self) -> dict[str, NDArray[Any]]:
        table, names = {"t": self.t}, self.program.names
        taken = {*self.values, *(x for vector in WITH_COORDINATES for x in vector.shown(names))}
        for name, values in self.values.items():
            if values.ndim == 1:
                table[name] = values
            elif values.ndim == 2:
                quantity = QUANTITIES.get(name)
                parts = [f"{name}_{x}" for x in "xyz"[: values.shape[1]]]  # of a point
                shown = quantity.shown(names) if quantity else parts
                columns = {x: values[:, k] for k, x in enumerate(shown)}
                table |= columns if quantity else apart(columns, taken, "point_")
        return table

    def _about(self) -> dict[str, Any]:
        program = self.program
        return {"system": program.system, "scheme": program.scheme} | self._outcome()

    def __repr__(self) -> str:
        return (
            f"Saved({self.program.system}, {self.program.scheme}: {', '.join(self.values)} at "
            f"{counted(self.t.size, 'time')}, {self.status.name})"
        )
