"""Results of runs that store only states at chosen times, or only chosen quantities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import UnknownNameError, reject
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.events import Actions, read_actions
from symsimpson.results.states import Plottable, RunOutcome, States
from symsimpson.results.tables import Savable, Variable, attribute_name, make_variable
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_methods
from symsimpson.support.names import counted, did_you_mean, public_names, spelled


@explain_methods()
class EventRecords(Savable, RunOutcome):
    """A result with the records of events, which may not store states between the events."""

    def events(self, name: Any) -> Actions:
        """Return the record of an event: the states at which it acted on the run.

        Parameters
        ----------
        name : str or expression
            Name of the event. An event without a name has the text of its expression as name.

        Returns
        -------
        Actions
            The states before and after each action.

        Raises
        ------
        InputError
            If the run had no event of this name.

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
            reject(
                f"the run has no event {name!r}.",
                why=f"Its events are {', '.join(self.event_names)}." * bool(self.event_names),
                remedy="To find the zeros of an expression, call stepper.integrate(...) without "
                "t_eval= and save=.",
            )
        return read_actions(self, str(name))


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Sampled(EventRecords, States):
    """The states of a run at chosen times; ``integrate(..., t_eval=times)`` returns them.

    A member of an ensemble, ``ensemble[3]``, is a Sampled with its stored states. The class
    inherits the attributes of :class:`States`, such as ``q`` and ``energy``. If the run fails, the
    states end at the last time that it reached.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times of the states.
    q, p : ndarray, shape (N, n)
        Positions and conjugate momenta.
    h : number
        Step size of the run, in the unit of time.
    steps : int
        Number of steps of the run.
    status : Status
        Outcome of the run; ``Status.SUCCESS`` is 0.
    message : str
        Outcome of the run, as text.
    tau : ndarray, shape (N,), or None
        Transformed time of the states of an ensemble member, if the system has a time
        transformation.

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

    tau: Floats | None = field(default=None, repr=False)

    def _attributes(self) -> dict[str, Any]:
        return super()._attributes() | self._outcome_attributes()


def member_states(ensemble: Any, member: int) -> Sampled:
    """Return the stored states of a member of an ensemble."""
    n, driven = ensemble.program.n, ensemble.driven
    t, q, p = ensemble.t, *(np.asarray(x[member]).reshape(-1, n) for x in (ensemble.q, ensemble.p))
    if ensemble.t.shape == ensemble.q.shape[:-1]:  # each member has its own times and its own end
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


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Saved(EventRecords, Plottable):
    """Chosen quantities of a run; ``integrate(..., save=names)`` returns them.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times of the values.
    values : mapping from str to ndarray
        The quantities by name. The shape is (N,), or (N, n) for q, p and v.
    h : number
        Step size of the run, in the unit of time.
    steps : int
        Number of steps of the run.
    status : Status
        Outcome of the run; ``Status.SUCCESS`` is 0.
    message : str
        Outcome of the run, as text.

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
    program: Program = field(repr=False)
    parameter_values: Any = field(repr=False)
    driven: Any = field(repr=False)

    __dir__ = public_names

    def _ipython_key_completions_(self) -> list[str]:
        return ["t", *self.values]

    def __getitem__(self, name: Any) -> NDArray[Any]:
        """Return a saved quantity, or "t", by its name.

        Raises
        ------
        UnknownNameError
            If the quantity was not saved.
        """
        key = spelled(name)
        if key == "t":
            return self.t
        if key not in self.values:
            reject(
                f"{key!r} was not saved.{did_you_mean(key, [*self.values])}",
                why=f"The saved quantities are t, {', '.join(self.values)}.",
                error=UnknownNameError,
            )
        return self.values[key]

    #: Iteration is disabled, because it could mean names or times.
    __iter__ = None

    def _default_names(self) -> list[str]:
        return [name for name, values in self.values.items() if values.ndim == 1]

    def _variables(self) -> list[Variable]:
        return [
            make_variable(name, values, ("time",), self.program, key, doc=name)
            for k, (name, values) in enumerate(self.values.items())
            for key in [attribute_name(name, f"quantity_{k}")]
        ]

    def _attributes(self) -> dict[str, Any]:
        return super()._attributes() | self._outcome_attributes()

    def __repr__(self) -> str:
        return (
            f"Saved({self.program.system}, {self.program.scheme}: {', '.join(self.values)} at "
            f"{counted(self.t.size, 'time')}, {self.status.name})"
        )
