"""Families of orbits."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from symsimpson.errors import StorageError, reject
from symsimpson.program.input_values import read_count
from symsimpson.study.orbits.conditions import ENERGY, PERIOD
from symsimpson.study.orbits.continuation import Continuation, FamilyStatus
from symsimpson.study.orbits.find import OrbitArguments, read_search
from symsimpson.study.orbits.orbit import Orbit
from symsimpson.study.orbits.search import Search
from symsimpson.study.orbits.shooting import Solution
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_methods
from symsimpson.support.files import read_path
from symsimpson.support.names import did_you_mean, spelled

if TYPE_CHECKING:
    from symsimpson.study.orbits.bifurcations import Bifurcation


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False)
class Family:
    """A family of periodic orbits; :meth:`Orbit.family` returns it.

    Attributes
    ----------
    orbits : tuple of Orbit
        The orbits in the order of the family.
    parameter : str
        The name of the quantity that changes.
    status : FamilyStatus
        Why the family ended.
    message : str
        The outcome as text.
    bifurcations : tuple of Bifurcation
        Orbits at which the family turns, or others branch off.

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.pendulum(), "gauss8")
    >>> orbit = stepper.periodic([0.5], v0=[0.0], period=2.04, steps=32,
    ...                          fixed={"theta": 0.5, "v_theta": 0})
    >>> family = orbit.family("period", to=2.2)
    >>> family.status.name, round(float(family["period"][-1]), 9)
    ('REACHED', 2.2)
    """

    orbits: tuple[Orbit, ...]
    parameter: str
    status: FamilyStatus
    tangents: tuple[Floats, ...] = field(repr=False)  #: Directions of the unknowns.
    search: Search = field(repr=False)

    @overload
    def __getitem__(self, key: str) -> Floats: ...
    @overload
    def __getitem__(self, key: int) -> Orbit: ...
    def __getitem__(self, key: Any) -> Any:
        """Return an orbit by its number, or a quantity of all orbits by its name.

        Names are "period", "energy", "stability", parameters, and coordinates and momenta of the
        initial states.
        """
        if not isinstance(key, str):
            return self.orbits[key]
        names, parameters = self.search.stepper.coordinates, self.search.stepper.parameters
        if key in names:
            return np.array([x.q0[names.index(key)] for x in self.orbits])
        if key.removeprefix("p_") in names:
            return np.array([x.p0[names.index(key.removeprefix("p_"))] for x in self.orbits])
        if key in parameters:
            return np.array([x.values[parameters.index(key)] for x in self.orbits])
        if key == "stability":
            return np.array([abs(x.multipliers).max(initial=1.0) for x in self.orbits])
        if key in (PERIOD, ENERGY):
            return np.array([getattr(x, key) for x in self.orbits])
        known = [PERIOD, ENERGY, "stability", *parameters, *names, *(f"p_{x}" for x in names)]
        reject(
            f"a family has no quantity {key!r}.{did_you_mean(key, known)}",
            remedy=f"Choose from {', '.join(known)}.",
        )

    @property
    def message(self) -> str:
        """The outcome as text."""
        return self.status.message

    def __len__(self) -> int:
        return len(self.orbits)

    def __iter__(self) -> Iterator[Orbit]:
        return iter(self.orbits)

    @cached_property
    def continuation(self) -> Continuation:
        """The equations of the family."""
        return Continuation(self.search, self.parameter, self.orbits[0])

    @cached_property
    def bifurcations(self) -> tuple[Bifurcation, ...]:
        """Orbits at which the family turns, or at which others branch off."""
        from symsimpson.study.orbits.bifurcations import find_bifurcations

        return find_bifurcations(self)

    def resonances(self, a: int, b: int) -> tuple[Bifurcation, ...]:
        """Return the orbits with a multiplier exp(2 pi i a/b).

        Parameters
        ----------
        a, b : int
            Numerator and denominator.

        Returns
        -------
        tuple of Bifurcation
        """
        from symsimpson.study.orbits.bifurcations import find_resonances

        return find_resonances(self, a, b)

    def switch(self, bifurcation: Bifurcation, *, count: int = 50, **options: Any) -> Family:
        """Follow the other family at a branch point or a period doubling.

        Parameters
        ----------
        bifurcation : Bifurcation
            One of ``family.bifurcations``.
        count : int, default 50
            Largest number of new orbits.
        **options
            The other arguments of :meth:`Orbit.family`.

        Returns
        -------
        Family
            The other family, which begins beside the bifurcation.

        Raises
        ------
        InputError
            If no other family branches off, or none was found.
        """
        from symsimpson.study.orbits.bifurcations import other_orbit

        first = other_orbit(self, bifurcation)
        state = np.concatenate([first.q0, first.p0])
        states = [np.concatenate([x.q0, x.p0]) for x in self.orbits]
        gaps = [abs(x - state).max() for x in states] if first.success else [0.0]
        near = abs(np.diff(states, axis=0)).max(axis=1) if len(states) > 1 else np.zeros(1)
        place = min(bifurcation.place, len(near) - 1)
        if min(gaps) < 1e-12 * near[place]:
            return family_of(first, self.parameter, FamilyStatus.SAME_FAMILY)
        return first.family(self.parameter, count=count, **options)

    def extend(self, *, to: float | None = None, count: int = 200) -> Family:
        """Continue the family beyond its last orbit.

        Parameters
        ----------
        to : float, optional
            The value at which the family ends.
        count : int, default 200
            Largest number of new orbits.

        Returns
        -------
        Family
            The whole family.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "gauss8")
        >>> orbit = stepper.periodic([0.5], v0=[0.0], period=2.04, steps=32,
        ...                          fixed={"theta": 0.5, "v_theta": 0})
        >>> len(orbit.family("energy", count=3).extend(count=2))
        6
        """
        last = Continuation(self.search, self.parameter, self.orbits[-1])
        step = 0.01
        if len(self.orbits) > 1:
            step = last.distance(self.orbits[-2], self.orbits[-1])
        orbits, tangents, status, search = last.run(
            to, count, step, 10 * step, self.tangents[-1], None
        )
        return Family(
            (*self.orbits, *orbits[1:]),
            self.parameter,
            status,
            (*self.tangents, *tangents[1:]),
            search,
        )

    def plot(self, x: str | None = None, y: str = PERIOD, *, ax: Any = None) -> Any:
        """Draw one quantity of the orbits against another; unstable orbits are dashed.

        Parameters
        ----------
        x, y : str
            Names of the quantities, as for ``family["..."]``. The defaults are the quantity that
            changes and the period; "frequency" is 1/period.
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes
        """
        from symsimpson.study.orbits.figures import plot_family

        return plot_family(self, x or self.parameter, y, ax)

    def save(self, path: Any) -> None:
        """Write the family to a file, which :meth:`Stepper.open_family` reads.

        Parameters
        ----------
        path : path
            The file; its name gets the suffix ``.npz``.

        Raises
        ------
        StorageError
            If the file cannot be written.
        """
        place = FilePath(read_path("path", path)).with_suffix(".npz")
        orbits, search = self.orbits, self.search
        about = {
            "digest": search.stepper.program.header.digest,
            "scheme": search.stepper.scheme,
            "parameter": self.parameter,
            "status": int(self.status),
            "steps": [x.search.flow.steps for x in orbits],
            "unknowns": [dict(x.unknowns) for x in orbits],
        }
        try:
            np.savez(
                place,
                about=json.dumps(about),
                q=[x.q0 for x in orbits],
                p=[x.p0 for x in orbits],
                period=[x.period for x in orbits],
                values=[x.values for x in orbits],
                tangents=np.array(self.tangents),
            )
        except OSError as error:
            raise StorageError(f"the family cannot be written to {place}: {error}") from error

    def __repr__(self) -> str:
        low, high = self[self.parameter][[0, -1]]
        name = f"Family({self.search.stepper.system}, {self.search.stepper.scheme}"
        return (
            f"{name}: {len(self)} orbits, {self.parameter} from {low:.6g} to {high:.6g}; "
            f"{self.status.name})"
        )


def family_of(
    orbit: Orbit, parameter: str = PERIOD, status: FamilyStatus = FamilyStatus.COUNT
) -> Family:
    """Return the family that has this orbit only."""
    tangent = np.zeros(orbit.search.shooting.columns)
    return Family((orbit,), parameter, status, (tangent,), orbit.search)


def open_family(stepper: Any, path: Any) -> Family:
    """Read a family from a file; see :meth:`Stepper.open_family`."""
    place = FilePath(read_path("path", path))
    place = place if place.suffix == ".npz" else place.with_suffix(".npz")
    try:
        with np.load(place, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            q, p, period, values, tangents = (
                np.asarray(file[x], dtype=np.float64)
                for x in ("q", "p", "period", "values", "tangents")
            )
    except (OSError, ValueError, KeyError) as error:
        raise StorageError(f"{place} has no family of orbits: {error}") from error
    if (about["digest"], about["scheme"]) != (stepper.program.header.digest, stepper.scheme):
        raise StorageError(f"{place} belongs to another system or scheme than this stepper.")
    orbits, integrals = [], None
    parameter = str(about["parameter"])
    names = [*about["unknowns"][0]]
    if parameter in stepper.parameters and parameter not in names:
        names.append(parameter)
    for k in range(len(q)):
        known = dict(zip(stepper.parameters, values[k].tolist(), strict=True))
        given = OrbitArguments(
            q[k],
            None,
            p[k],
            period=float(period[k]),
            steps=int(about["steps"][k]),
            unknowns=tuple(names),
            parameters=known,
        )
        search, point = read_search(stepper, given, integrals)
        integrals = search.shooting.integrals
        orbits.append(search.orbit(Solution(search.shooting.sweep(point), True, ())))
    status = FamilyStatus(int(about["status"]))
    return Family(tuple(orbits), parameter, status, tuple(tangents), orbits[0].search)


def follow(
    orbit: Orbit,
    parameter: Any,
    to: float | None,
    count: Any,
    step: float,
    largest: float,
    progress: bool | None,
) -> Family:
    """Follow a family from an orbit; see :meth:`Orbit.family`."""
    if not orbit.success:
        reject(
            f"this orbit was not found: {orbit.status.name}.",
            where=orbit.search.stepper.system,
            remedy="A family begins at an orbit whose success is True.",
        )
    continuation = Continuation(orbit.search, spelled(parameter), orbit)
    count = read_count("count", count, least=1)
    course = continuation.run(to, count, step, largest, None, progress)
    return Family(course.orbits, continuation.name, course.status, course.tangents, course.search)
