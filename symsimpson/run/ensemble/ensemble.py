"""Results of an ensemble, by member."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.energies import WORK, named_parts
from symsimpson.results.events import Record
from symsimpson.results.quantities import Quantities
from symsimpson.results.sampled import Sampled, member_of
from symsimpson.results.states import Differentiated, about_program
from symsimpson.results.tables import Savable, Variable, table_of
from symsimpson.results.trajectory import RECORDED
from symsimpson.stepping.driving import Driven, inputs_there
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explaining
from symsimpson.support.names import counted

#: Names that a dataset has for itself.
STATES = ("q", "p", "q0", "v0", "p0", "variations")
RESERVED = (*STATES, "status", "steps", "newton_iterations", "member", "time", "coord")


def spread(members: int, most: int) -> NDArray[np.int64]:
    """Return so many members at most, spread over all."""
    return np.unique(np.linspace(0, members - 1, min(members, most)).astype(np.int64))


@explaining()
@dataclass(frozen=True, eq=False, repr=False)
class Ensemble(Quantities, Differentiated, Savable):
    """The results of the members of an ensemble.

    ``energy``, ``v``, ``invariants``, ``tangent``, ``sensitivity`` and quantities by name are as
    for one run, with a first axis of K members; ``ensemble[3]`` gives the states of one member.

    Attributes
    ----------
    t : ndarray, shape (stored,)
        Times of the stored states; of a retimed system those of each member, shape (K, stored), or
        (K,) where only the last states are stored, as they are with events that end members.
    q, p : ndarray, shape (K, stored, n), or (K, n) where only the last states are stored
        NaN after the last state of a member that failed. If the ensemble went to a store, they
        are Zarr arrays on disk, which give NumPy arrays when sliced.
    status : ndarray of int, shape (K,)
        A :class:`Status` for each member.
    steps, newton_iterations : ndarray of int, shape (K,)
    parameters : mapping from str to ndarray, shape (K,)
    reduced : mapping from str to ndarray, shape (K,)
        The quantities requested by ``reduce``.
    recorded : mapping from str to ndarray, shape (K, stored, k), or (K, k)
        The sums requested by ``record``.
    initial : mapping from str to ndarray, shape (K, n)
        The initial states of the members: q0, and v0 or p0.
    store : path of the store, or None
    tau : ndarray in the shape of t, or None
        The time of the steps, if the system is retimed.
    ended_at : ndarray, shape (K,), or None
        The time at which each member came to its end, if there are events.

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.pendulum())
    >>> stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50)
    Ensemble(pendulum, simpson: 2 members, 1 state of each stored; 2 SUCCESS)
    >>> many = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, every=10)
    >>> many["theta"].shape, many.energy.shape, many[1].q.shape
    ((2, 6), (2, 6), (6, 1))
    """

    t: Floats
    q: Any
    p: Any
    status: NDArray[np.int64]
    steps: NDArray[np.int64]
    newton_iterations: NDArray[np.int64]
    parameters: Mapping[str, Floats]
    reduced: Mapping[str, Floats]
    initial: Mapping[str, Floats]
    program: Program = field(repr=False)
    store: str | None = None
    variations: NDArray[Any] | None = field(default=None, repr=False)
    tau: Floats | None = None
    recorded: Mapping[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    ended_at: Floats | None = None
    #: What events did, in the order of time, in the members in which some acted; and their names.
    records: Mapping[int, tuple[Record, ...]] = field(default_factory=dict, repr=False)
    event_names: tuple[str, ...] = field(default=(), repr=False)
    #: How inputs went, and how small pivots of M were, where that is known.
    driven: Driven | None = field(default=None, repr=False)
    small_pivots: Floats | None = field(default=None, repr=False)
    _ahead: float = field(default=1.0, repr=False)  #: -1 if the time goes back with the steps.
    note: str = field(default="", repr=False)  #: What the message says of the step.

    @overload
    def __getitem__(self, key: str) -> NDArray[Any]: ...
    @overload
    def __getitem__(self, key: int) -> Sampled: ...
    def __getitem__(self, key: Any) -> NDArray[Any] | Sampled:
        """Return a quantity of all members by its name, or the states of one member.

        Names are those of a run, of what ``reduce`` asked for, and of parameters.

        Raises
        ------
        UnknownNameError
            With the names that there are; it is an InputError, and a KeyError.
        IndexError
            If there is no such member.
        """
        try:
            member = None if isinstance(key, bool) else operator.index(key)
        except TypeError:
            member = None
        if member is None:
            return self._named(key)
        if not -len(self) <= member < len(self):
            raise IndexError(f"there is no member {member}: there are {len(self)}, from 0 on")
        return member_of(self, member % len(self))

    @property
    def stored(self) -> int:
        """Number of stored states per member; after a failure they are NaN."""
        return int(self.q.shape[1]) if self.q.ndim == 3 else 1

    @property
    def parameter_values(self) -> Floats:
        """Values of the parameters, a row for each member."""
        columns = [self.parameters[name] for name in self.program.parameters]
        return np.column_stack(columns) if columns else np.zeros((len(self), 0))

    def _evaluated(
        self, kernel: str, block: str, count: int, *, driven: bool = False
    ) -> NDArray[Any]:
        program, values = self.program, self.parameter_values
        q, p = np.asarray(self.q), np.asarray(self.p)
        t = np.zeros(1) if self.tau is not None else self.t  # where retimed, no time matters
        if driven and program.inputs:
            rows = []
            for k in range(len(q)):  # each with its own inputs
                member = self[k]
                states = (member.t, member.q, member.p)
                inputs = inputs_there(program, member.driven, member.t)
                rows.append(evaluate(program, kernel, block, count, states, values[k], inputs))
            return np.reshape(rows, (*q.shape[:-1], count))
        return evaluate(program, kernel, block, count, (t, q, p), values)

    def _where(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        values = self.parameter_values
        return self.t, np.asarray(self.q), values[:, None] if self.q.ndim == 3 else values

    def _own(self, key: str) -> Any:
        return self.reduced.get(key, self.parameters.get(key))

    def _own_names(self) -> list[str]:
        return [*self.reduced, *self.parameters]

    @property
    def work(self) -> dict[str, NDArray[Any]]:
        """The work of each force since the start, and of all under "total", in the shape of t.

        Raises
        ------
        InputError
            If it was not recorded.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.damped_pendulum())
        >>> many = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, record="work")
        >>> many.work["total"].shape
        (2,)
        """
        if self.program.header.conservative:
            return named_parts(self.program, np.zeros((*np.shape(self.q)[:-1], 0)))
        if WORK not in self.recorded:
            reject(
                "this ensemble did not record the work of forces.",
                remedy="Ask for it: stepper.ensemble(..., record='work').",
            )
        return named_parts(self.program, np.asarray(self.recorded[WORK]))

    @property
    def message(self) -> str:
        """The outcome in words."""
        counts = {code: int((self.status == code).sum()) for code in Status}
        words = ", ".join(f"{count} {code.name}" for code, count in counts.items() if count)
        return f"{words}.{self.note}" if self.note else words

    def _opened(self, xarray: Any) -> Any:
        if self.store is None:
            return None
        how = {"chunks": None, "consolidated": False, "decode_times": False}
        data = xarray.open_zarr(self.q.store, **how).set_coords(list(self._parameters_in_dataset()))
        return data.drop_encoding().drop_attrs(deep=False).assign_attrs(self._about())

    def _parameters_in_dataset(self) -> dict[str, Floats]:
        _, names = self._names_in_dataset()
        return dict(zip(names.values(), self.parameters.values(), strict=True))

    def _names_in_dataset(self) -> tuple[dict[str, str], dict[str, str]]:
        return names_in_dataset(self.reduced, self.program.names.parameters.own)

    @property
    def _dims(self) -> tuple[str, ...]:
        """The axes of the states of members in a dataset."""
        return ("member", "time") if self.q.ndim == 3 else ("member",)

    def _variables(self) -> list[Variable]:
        dims, of_member = self._dims, ("member",)
        states = {"q": ("coord",), "p": ("coord",)}
        variables = [Variable(x, getattr(self, x), (*dims, *axes)) for x, axes in states.items()]
        if self.variations is not None:
            axes = (*dims, "state", "variation")
            variables.append(Variable("variations", self.variations, axes))
        for name, rows in self.recorded.items():
            variables.append(Variable(f"{RECORDED}{name}", rows, (*dims, f"{name}_number")))
        for name, values in self.initial.items():
            variables.append(Variable(name, values, ("member", "coord")))
        for name in ("status", "steps", "newton_iterations", "ended_at"):
            if getattr(self, name) is not None:
                variables.append(Variable(name, getattr(self, name), of_member))
        reduced, _ = self._names_in_dataset()
        return variables + [
            Variable(reduced[name], values, of_member) for name, values in self.reduced.items()
        ]

    def _axes(self) -> dict[str, Any]:
        parameters = self._parameters_in_dataset()
        axes: dict[str, Any] = {name: (("member",), x) for name, x in parameters.items()}
        axes |= {"coord": list(self.program.coordinates), "member": np.arange(len(self))}
        if self.tau is not None:
            axes |= {"t": (self._dims, self.t), "tau": (self._dims, self.tau)}
        elif self.q.ndim == 3:
            axes["time"] = self.t
        return axes

    def _table(self) -> dict[str, NDArray[Any]]:
        shape = np.shape(self.energy)
        by_member = {"member": np.arange(len(self)), **self.parameters, **self.reduced}
        index = {
            name: np.reshape(x, (-1, *[1] * (len(shape) - 1))) for name, x in by_member.items()
        }
        index.setdefault("t", self.t)
        index = {name: np.broadcast_to(x, shape).reshape(-1) for name, x in index.items()}
        return table_of(index, self._quantities(self._dims), self.program)

    def _kind_of_result(self) -> str:
        return "ensemble"

    def _arrays(self) -> dict[str, NDArray[Any]]:
        names = ("t", "q", "p", "status", "steps", "newton_iterations")
        arrays = {name: np.asarray(getattr(self, name)) for name in names}
        arrays |= {f"parameter_{name}": x for name, x in self.parameters.items()}
        return arrays | {f"reduced_{name}": x for name, x in self.reduced.items()}

    def plot(self, name: str | None = None, *, most: int | None = None, ax: Any = None) -> Any:
        """Draw the median and bands of 50 and 90 % of members, or a histogram of last states.

        Parameters
        ----------
        name : str, optional
            As in ``ensemble["q1"]``; the first coordinate unless given.
        most : int, optional
            Draw lines of at most this number of members, spread over all, in place of bands.
        ax : matplotlib axes, optional
            Axes to draw in; new ones unless given.

        Returns
        -------
        matplotlib axes

        Raises
        ------
        InputError
            If matplotlib is not installed, or ``most`` is no positive whole number.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> many = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, every=10)
        >>> many.plot("energy").get_ylabel()
        'energy'
        """
        most = None if most is None else read_count("most", most, 1)
        from symsimpson.plotting.run_figures import plot_members

        return plot_members(self, name, most, ax=ax)

    def _about(self) -> dict[str, Any]:
        """Where the numbers come from."""
        t_end = float(self._ahead * np.nanmax(self._ahead * self.t))
        return about_program(self.program) | {"outcome": self.message, "t_end": t_end}

    def __len__(self) -> int:
        return self.status.size

    def _repr_html_(self) -> str:
        from symsimpson.results.html import ensemble

        return ensemble(self, self._about()["t_end"])

    def __repr__(self) -> str:
        stored = f"{counted(len(self), 'member')}, {counted(self.stored, 'state')} of each stored"
        return f"Ensemble({self.program.system}, {self.program.scheme}: {stored}; {self.message})"


def names_in_dataset(
    reduced: Iterable[str], parameters: Iterable[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return names under which quantities of a user's naming stand in a dataset.

    A name that is taken already gets a prefix; one that is no identifier, which might name a
    path, gives way to a number.
    """
    taken = set(RESERVED)
    mappings: list[dict[str, str]] = []
    for prefix, names in (("reduced", reduced), ("parameter", parameters)):
        chosen: dict[str, str] = {}
        for k, name in enumerate(names):
            choices = chain((name, f"{prefix}_{name}"), (f"{prefix}_{i}" for i in count(k)))
            free = (x for x in choices if x.isidentifier() and x not in taken)
            chosen[name] = next(x for x in free if not x.startswith(RECORDED))
            taken.add(chosen[name])
        mappings.append(chosen)
    return mappings[0], mappings[1]
