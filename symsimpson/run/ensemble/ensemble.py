"""Results of an ensemble: states, statuses and reductions of all members."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.program.evaluation import evaluate
from symsimpson.program.input_values import read_count
from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.results.datasets import RECORDED
from symsimpson.results.energies import WORK, name_columns
from symsimpson.results.event_record import EventRecord
from symsimpson.results.quantities import Quantities
from symsimpson.results.sampled import Sampled, member_states
from symsimpson.results.states import StateDerivatives, program_attributes
from symsimpson.results.tables import Savable, Variable, build_table
from symsimpson.stepping.driving import InputHistory, inputs_at_times
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_methods
from symsimpson.support.names import counted

#: Names of variables and axes that each dataset of an ensemble has.
STATES = ("q", "p", "q0", "v0", "p0", "variations")
RESERVED = (*STATES, "status", "steps", "newton_iterations", "member", "time", "coord")


def spaced_members(members: int, most: int) -> NDArray[np.int64]:
    """Return the numbers of at most ``most`` members, evenly spaced."""
    return np.unique(np.linspace(0, members - 1, min(members, most)).astype(np.int64))


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False)
class Ensemble(Quantities, StateDerivatives, Savable):
    """Results of an ensemble of K members.

    ``energy``, ``v``, ``invariants``, ``tangent``, ``sensitivity`` and quantities by name are as
    for one run, with a first axis for the members. ``ensemble[3]`` returns the states of one
    member.

    Attributes
    ----------
    t : ndarray, shape (stored,)
        Times of the stored states. Retimed members have different times: shape (K, stored), or
        (K,) if only the final states are stored. So do members with step sizes or initial times of
        their own. An ensemble with events that stores only the final states also has shape (K,).
    q, p : ndarray, shape (K, stored, n), or (K, n) if only the final states are stored
        Positions and conjugate momenta. Values after the failure of a member are NaN. With a
        store, they are Zarr arrays on disk; a slice of them is a NumPy array.
    status : ndarray of int, shape (K,)
        The :class:`Status` of each member.
    steps, newton_iterations : ndarray of int, shape (K,)
        Number of completed steps, and number of Newton iterations in all of them.
    parameters : mapping from str to ndarray, shape (K,)
        Values of each parameter.
    reduced : mapping from str to ndarray, shape (K,)
        Values of the reductions in ``reduce``.
    recorded : mapping from str to ndarray, shape (K, stored, k), or (K, k)
        Values of the sums in ``record``.
    initial : mapping from str to ndarray, shape (K, n)
        Initial states of the members: q0, and v0 or p0.
    store : str or None
        Path of the store; None if the ensemble is in memory.
    tau : ndarray in the shape of t, or None
        Transformed time, if the system is retimed.
    ended_at : ndarray, shape (K,), or None
        Time at which each member ended, if the ensemble has events.

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
    #: Records of events in the order of time, by member; names of the events.
    records: Mapping[int, tuple[EventRecord, ...]] = field(default_factory=dict, repr=False)
    event_names: tuple[str, ...] = field(default=(), repr=False)
    #: Inputs of the members, and the smallest pivot of M of each member, if known.
    driven: InputHistory | None = field(default=None, repr=False)
    small_pivots: Floats | None = field(default=None, repr=False)
    _ahead: float = field(default=1.0, repr=False)  #: Sign of h.
    note: str = field(default="", repr=False)  #: Sentence of the message about the step size.

    @overload
    def __getitem__(self, key: str) -> NDArray[Any]: ...
    @overload
    def __getitem__(self, key: int) -> Sampled: ...
    def __getitem__(self, key: Any) -> NDArray[Any] | Sampled:
        """Return a quantity of all members by its name, or the states of one member.

        The name belongs to a quantity of a run, a reduction or a parameter.

        Raises
        ------
        UnknownNameError
            If the name is unknown. The message lists all names. The class is a subclass of
            InputError and of KeyError.
        IndexError
            If the member does not exist.
        """
        try:
            member = None if isinstance(key, bool) else operator.index(key)
        except TypeError:
            member = None
        if member is None:
            return self._look_up(key)
        if not -len(self) <= member < len(self):
            raise IndexError(
                f"member {member} does not exist; the numbers are 0 to {len(self) - 1}"
            )
        return member_states(self, member % len(self))

    @property
    def stored(self) -> int:
        """Number of stored states of each member; values after a failure are NaN."""
        return int(self.q.shape[1]) if self.q.ndim == 3 else 1

    @property
    def parameter_values(self) -> Floats:
        """Values of the parameters, a row for each member."""
        columns = [self.parameters[name] for name in self.program.parameters]
        return np.column_stack(columns) if columns else np.zeros((len(self), 0))

    def _evaluate_rows(
        self, kernel: str, block: str, count: int, *, driven: bool = False
    ) -> NDArray[Any]:
        program, values = self.program, self.parameter_values
        q, p = np.asarray(self.q), np.asarray(self.p)
        t = np.zeros(1) if self.tau is not None else self.t  # retimed systems are autonomous
        if driven and program.inputs:
            rows = []
            for k in range(len(q)):  # members may have different inputs
                member = self[k]
                states = (member.t, member.q, member.p)
                inputs = inputs_at_times(program, member.driven, member.t)
                rows.append(evaluate(program, kernel, block, count, states, values[k], inputs))
            return np.reshape(rows, (*q.shape[:-1], count))
        return evaluate(program, kernel, block, count, (t, q, p), values)

    def _point_arguments(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return t, q and the parameter values, to evaluate declared positions."""
        values = self.parameter_values
        return self.t, np.asarray(self.q), values[:, None] if self.q.ndim == 3 else values

    def _special_quantity(self, key: str) -> Any:
        return self.reduced.get(key, self.parameters.get(key))

    def _special_names(self) -> list[str]:
        return [*self.reduced, *self.parameters]

    @property
    def work(self) -> dict[str, NDArray[Any]]:
        """Work of each force since the initial state, in the shape of t; "total" is their sum.

        Raises
        ------
        InputError
            If the ensemble did not record the work.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.damped_pendulum())
        >>> many = stepper.ensemble([[1.0], [2.0]], v0=[0.0], h=0.1, steps=50, record="work")
        >>> many.work["total"].shape
        (2,)
        """
        if self.program.header.conservative:
            return name_columns(self.program, np.zeros((*np.shape(self.q)[:-1], 0)))
        if WORK not in self.recorded:
            reject(
                "this ensemble did not record the work of forces.",
                remedy="Pass record='work': stepper.ensemble(..., record='work').",
            )
        return name_columns(self.program, np.asarray(self.recorded[WORK]))

    @property
    def message(self) -> str:
        """Outcome as a text: the number of members with each status."""
        counts = {code: int((self.status == code).sum()) for code in Status}
        words = ", ".join(f"{count} {code.name}" for code, count in counts.items() if count)
        return f"{words}.{self.note}" if self.note else words

    def _read_dataset(self, xarray: Any) -> Any:
        if self.store is None:
            return None
        how = {"chunks": None, "consolidated": False, "decode_times": False}
        data = xarray.open_zarr(self.q.store, **how).set_coords(list(self._parameters_in_dataset()))
        return data.drop_encoding().drop_attrs(deep=False).assign_attrs(self._attributes())

    def _parameters_in_dataset(self) -> dict[str, Floats]:
        _, names = self._names_in_dataset()
        return dict(zip(names.values(), self.parameters.values(), strict=True))

    def _names_in_dataset(self) -> tuple[dict[str, str], dict[str, str]]:
        return names_in_dataset(self.reduced, self.program.names.parameters.own)

    @property
    def _dims(self) -> tuple[str, ...]:
        """Names of the axes of states in a dataset."""
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
        elif self.t.ndim == 2:
            axes["t"] = self._dims, self.t
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
        return build_table(index, self._quantities(self._dims), self.program)

    def _result_kind(self) -> str:
        return "ensemble"

    def _arrays(self) -> dict[str, NDArray[Any]]:
        names = ("t", "q", "p", "status", "steps", "newton_iterations")
        arrays = {name: np.asarray(getattr(self, name)) for name in names}
        arrays |= {f"parameter_{name}": x for name, x in self.parameters.items()}
        return arrays | {f"reduced_{name}": x for name, x in self.reduced.items()}

    def plot(self, name: str | None = None, *, most: int | None = None, ax: Any = None) -> Any:
        """Draw the median and bands of 50 and 90 % of members, or a histogram of final states.

        Parameters
        ----------
        name : str, optional
            Name of the quantity, as in ``ensemble["q1"]``. The default is the first coordinate.
        most : int, optional
            Draw lines of at most this number of members, evenly spaced, instead of bands.
        ax : matplotlib axes, optional
            Axes to draw in. The default is a new figure.

        Returns
        -------
        matplotlib axes
            Axes with the plot.

        Raises
        ------
        InputError
            If matplotlib is not installed, or ``most`` is not a positive whole number.

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

    def _attributes(self) -> dict[str, Any]:
        """Return the metadata of files: program, outcome and final time."""
        t_end = float(self._ahead * np.nanmax(self._ahead * self.t))
        return program_attributes(self.program) | {"outcome": self.message, "t_end": t_end}

    def __len__(self) -> int:
        return self.status.size

    def _repr_html_(self) -> str:
        from symsimpson.results.html import ensemble

        return ensemble(self, self._attributes()["t_end"])

    def __repr__(self) -> str:
        stored = f"{counted(len(self), 'member')}, {counted(self.stored, 'state')} of each stored"
        return f"Ensemble({self.program.system}, {self.program.scheme}: {stored}; {self.message})"


def names_in_dataset(
    reduced: Iterable[str], parameters: Iterable[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return the names of reductions and parameters in a dataset, as mappings from user names.

    A name that occurs already gets a prefix. A name that is not an identifier, and could be a path,
    becomes a prefix with a number.
    """
    used = set(RESERVED)
    mappings: list[dict[str, str]] = []
    for prefix, names in (("reduced", reduced), ("parameter", parameters)):
        chosen: dict[str, str] = {}
        for k, name in enumerate(names):
            choices = chain((name, f"{prefix}_{name}"), (f"{prefix}_{i}" for i in count(k)))
            free = (x for x in choices if x.isidentifier() and x not in used)
            chosen[name] = next(x for x in free if not x.startswith(RECORDED))
            used.add(chosen[name])
        mappings.append(chosen)
    return mappings[0], mappings[1]
