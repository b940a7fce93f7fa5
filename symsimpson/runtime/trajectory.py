"""The result of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from symsimpson.runtime.extras import data_library
from symsimpson.runtime.status import Status

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["Trajectory"]


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Trajectory:
    """States of a run, and how it ended.

    Numbers are float64, or numbers of mpmath in arrays of objects where the stepper was compiled
    with a ``precision``.

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
    status : Status
        0 is success.
    message : str
        The outcome in words.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> run["theta"].shape, run["v_theta"].shape, run.y.shape, run.success
    ((51,), (51,), (2, 51), True)
    """

    t: NDArray[Any]
    q: NDArray[Any]
    p: NDArray[Any]
    newton_iterations: NDArray[np.int64]
    h: Any
    steps: int
    status: Status
    message: str
    _stepper: Stepper = field(repr=False)
    _values: NDArray[Any] = field(repr=False)

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)  # a quarter of the time that setting each takes

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters that the run used, by name."""
        return dict(zip(self._stepper.parameters, self._values.tolist(), strict=True))

    @property
    def success(self) -> bool:
        """Whether the run reached its end."""
        return self.status is Status.SUCCESS

    @cached_property
    def v(self) -> NDArray[Any]:
        """Velocities at the stored states, shape (N + 1, n); computed when first asked for."""
        return self._evaluated("start", "VELOCITY", self._stepper.n)

    @property
    def y(self) -> NDArray[Any]:
        """Positions and momenta as SciPy's ``solve_ivp`` gives states, shape (2 n, N + 1)."""
        return np.concatenate([self.q, self.p], axis=1).T

    @cached_property
    def energy(self) -> NDArray[Any]:
        """H at the stored states, shape (N + 1,); computed when first asked for."""
        return self._evaluated("energy", "ENERGY", 1)[:, 0]

    @cached_property
    def energy_error(self) -> NDArray[Any]:
        """(H - H0)/|H0|, or H - H0 where H0 = 0; shape (N + 1,)."""
        change = self.energy - self.energy[0]
        start = abs(self.energy[0])
        return change / start if start > 0 else change

    @cached_property
    def invariants(self) -> dict[str, NDArray[Any]]:
        """The system's named invariants at the stored states, each of shape (N + 1,)."""
        names = self._stepper.invariants
        if not names:
            return {}
        found = self._evaluated("invariants", "INVARIANT", len(names))
        return {name: found[:, i] for i, name in enumerate(names)}

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Give a quantity at the stored states by its name, shape (N + 1,).

        Names are those of the coordinates, ``p_`` and ``v_`` before them, of the invariants, and
        "t" and "energy".

        Raises
        ------
        KeyError
            With the names that there are.
        """
        coordinates = self._stepper.coordinates
        if name in coordinates:  # a user's names come first
            return self.q[:, coordinates.index(name)]
        for prefix, what in (("p_", "p"), ("v_", "v")):
            if name.startswith(prefix) and name[2:] in coordinates:
                return cast(NDArray[Any], getattr(self, what)[:, coordinates.index(name[2:])])
        if name in self._stepper.invariants:
            return self.invariants[name]
        if name in ("t", "energy"):
            return cast(NDArray[Any], getattr(self, name))
        every = [*coordinates, *(f"{x}_{q}" for x in "pv" for q in coordinates)]
        raise KeyError(
            f"there is no {name!r}. There are {', '.join([*every, *self._stepper.invariants])}, "
            "t and energy"
        )

    def to_pandas(self) -> Any:
        """Give a ``pandas.DataFrame`` of positions, momenta and energy, with the times as index.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        pandas = data_library("pandas", "to_pandas")
        names = self._stepper.coordinates
        columns = {name: self[name] for name in (*names, *(f"p_{q}" for q in names), "energy")}
        frame = pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))
        frame.attrs = self._about()
        return frame

    def to_xarray(self) -> Any:
        """Give an ``xarray.Dataset`` with dimensions time and coord.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        xarray = data_library("xarray", "to_xarray")
        variables: dict[str, Any] = {
            name: (("time", "coord"), getattr(self, name)) for name in "qpv"
        }
        variables["energy"] = (("time",), self.energy)
        variables["newton_iterations"] = (("time",), self.newton_iterations)
        for k, values in enumerate(self.invariants.values()):
            variables[f"invariant_{k}"] = (("time",), values)
        names = {"time": self.t, "coord": list(self._stepper.coordinates)}
        found = xarray.Dataset(variables, names, self._about())
        for k, name in enumerate(self.invariants):
            found[f"invariant_{k}"].attrs["long_name"] = name
        return found

    def _about(self) -> dict[str, Any]:
        """Where the numbers come from."""
        stepper = self._stepper
        return {
            "system": stepper.system, "scheme": stepper.scheme, "order": stepper.order,
            "digest": stepper._facts.digest, "h": float(self.h), "status": self.status.name,
            "message": self.message,
            **{f"parameter {name}": float(value) for name, value in self.parameters.items()},
        }  # fmt: skip

    def _evaluated(self, kernel: str, block: str, count: int) -> NDArray[Any]:
        from symsimpson.runtime.evaluate import evaluate

        return evaluate(self._stepper, kernel, block, count, self.q, self.p, self._values)

    def __len__(self) -> int:
        return self.t.size

    def __repr__(self) -> str:
        stepper = self._stepper
        return (
            f"Trajectory({stepper.system}, {stepper.scheme}: {self.steps} steps of "
            f"h={float(self.h):g}, {self.t.size} states stored, {self.status.name})"
        )
