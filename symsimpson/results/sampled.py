"""Parts of a long run: states at chosen times, or chosen quantities alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import UnknownNameError, reject
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.events import Actions, actions_of
from symsimpson.results.states import Outcome, Plotted, States
from symsimpson.results.tables import Savable, Variable, attribute_name, variable_of
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explaining
from symsimpson.support.names import counted, did_you_mean, public_names, spelled


@explaining()
class WithEvents(Savable, Outcome):
    """A result that knows what events did, though states between them may not be kept."""

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
            reject(
                f"the run had no event {name!r}.",
                remedy=f"{had}Zeros of expressions are found in single "
                "runs that store their steps: stepper.integrate(...) without t_eval= and save=.",
            )
        return actions_of(self, str(name))


@explaining()
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Sampled(WithEvents, States):
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
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Saved(WithEvents, Plotted):
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
    program: Program = field(repr=False)
    parameter_values: Any = field(repr=False)
    driven: Any = field(repr=False)

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
            reject(
                f"{key!r} was not saved.{did_you_mean(key, [*self.values])} "
                f"There are t, {', '.join(self.values)}.",
                error=UnknownNameError,
            )
        return self.values[key]

    #: Iterating over names or over times: neither is what everybody expects.
    __iter__ = None

    def _drawn(self) -> list[str]:
        return [name for name, values in self.values.items() if values.ndim == 1]

    def _variables(self) -> list[Variable]:
        return [
            variable_of(name, values, ("time",), self.program, key, doc=name)
            for k, (name, values) in enumerate(self.values.items())
            for key in [attribute_name(name, f"quantity_{k}")]
        ]

    def _about(self) -> dict[str, Any]:
        return super()._about() | self._outcome()

    def __repr__(self) -> str:
        return (
            f"Saved({self.program.system}, {self.program.scheme}: {', '.join(self.values)} at "
            f"{counted(self.t.size, 'time')}, {self.status.name})"
        )
