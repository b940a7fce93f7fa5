"""Results of searches for periodic orbits and for paths between two boundaries."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.study.orbits.boundary_path import ENERGY, PERIOD, Path
from symsimpson.study.orbits.outcome import FamilyStatus
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_methods
from symsimpson.support.names import did_you_mean

if TYPE_CHECKING:
    from symsimpson.run.ensemble.ensemble import Ensemble

#: A stability index is on the unit circle if it exceeds 1 by less than this.
ROUNDING_OF_INDEX = 1e-8


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Orbit(Path):
    """A periodic orbit; :meth:`Stepper.periodic` returns it.

    It has the attributes of :class:`Path`, with ``period`` in place of ``duration``.

    Attributes
    ----------
    period : float
        The period, or the duration of one part of a symmetric orbit or gait.
    multipliers : ndarray of complex
        The multipliers (Floquet multipliers) without the trivial ones, the largest first.
    stability_indices : ndarray of complex
        (l + 1/l)/2 of each pair of multipliers, if the motion is conservative.
    stable : bool
        True if no deviation grows exponentially.
    trivial : float
        Largest distance from 1 of the multipliers that are 1 if the steps resolve the orbit.
    unfolding : float
        The closing error that no correction reduces, relative to the scale; round-off if resolved.
    error : float or None
        Estimate of the error of the state and the period, if you passed ``error``.
    primitive : Orbit or None
        The orbit of the shortest period, if the status is SHORTER.
    derivative : ndarray, shape (2 n, 2 n)
        The derivative of the state after a period by the initial state (monodromy matrix).

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.henon_heiles(), "gauss8")
    >>> orbit = stepper.periodic([0, 0.25], v0=[0.335, 0], period=6.1, steps=48,
    ...                          fixed={"energy": 1/12, "x": 0})
    >>> orbit.success, round(orbit.period, 9), orbit.stability_indices.real.round(9).tolist()
    (True, 6.135235496, [0.323398323])
    """

    derivative: Floats
    multipliers: NDArray[np.complex128]
    stability_indices: NDArray[np.complex128]
    trivial: float
    unfolding: float
    error: float | None = None
    primitive: Orbit | None = None

    @property
    def stable(self) -> bool:
        """True if no deviation grows exponentially: all multipliers lie in or on the circle."""
        largest = abs(self.multipliers).max(initial=1.0)
        return self.success and bool(largest <= 1 + np.sqrt(2 * ROUNDING_OF_INDEX))

    def refined(self, factor: int = 2) -> Orbit:
        """Return the same orbit with ``factor`` times as many steps.

        Parameters
        ----------
        factor : int, default 2
            Ratio of the numbers of steps.

        Returns
        -------
        Orbit

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.refined(2).steps
        80
        """
        return self.search.refined(factor).orbit_near(self)

    def family(
        self,
        parameter: Any,
        *,
        to: float | None = None,
        count: int = 200,
        step: float = 0.01,
        largest_step: float = 0.1,
        progress: bool | None = None,
    ) -> Family:
        """Follow the orbit as a quantity changes (numerical continuation).

        Parameters
        ----------
        parameter : str or symbol
            "energy", "period", or a parameter of the system.
        to : float, optional
            The value at which the family ends. The default is no such value.
        count : int, default 200
            Largest number of new orbits.
        step, largest_step : float
            First and largest distance between neighbours, relative to the scale of the unknowns.
            Without ``to``, a negative step goes the other way.
        progress : bool, optional
            Whether to show a progress bar, as for :meth:`Stepper.integrate`.

        Returns
        -------
        Family
            The orbits, and the bifurcations between them.

        Raises
        ------
        InputError
            If an argument is invalid.

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> family = orbit.family("energy", to=-3.0)
        >>> family.status.name, bool(family["period"][-1] > family["period"][0])
        ('REACHED', True)
        """
        course = {"to": to, "count": count, "step": step, "largest_step": largest_step}
        return self.search.tools.follow(self, parameter, **course, progress=progress)

    def manifold(
        self, kind: str = "unstable", *, size: float = 1e-6, count: int = 20, periods: float = 2.0
    ) -> Ensemble:
        """Run from states beside the orbit, along its most unstable or most stable direction.

        Parameters
        ----------
        kind : {"unstable", "stable"}, default "unstable"
            Which manifold. Runs on the stable one go backwards in time.
        size : float, default 1e-6
            Distance from the orbit, relative to the scale. A negative size takes the other side.
        count : int, default 20
            Number of runs, which start evenly spaced along the orbit.
        periods : float, default 2.0
            Length of the runs, in periods.

        Returns
        -------
        Ensemble
            The runs, with all states.

        Raises
        ------
        InputError
            If no real multiplier has a size other than 1.

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.manifold()  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        symsimpson.errors.InputError: pendulum: this orbit has no unstable manifold. ...
        """
        return self.search.manifold(self, kind, size, count, periods)

    def plot(self, *, ax: Any = None) -> Any:
        """Draw the orbit in the plane of its first two coordinates, or of q and p.

        Parameters
        ----------
        ax : matplotlib axes, optional
            Axes to draw in, new ones by default.

        Returns
        -------
        matplotlib axes

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.plot().get_xlabel()
        'theta'
        """
        return self.search.tools.plot_orbit(self, ax)

    def plot_multipliers(self, *, ax: Any = None) -> Any:
        """Draw the multipliers and the unit circle in the complex plane.

        Parameters
        ----------
        ax : matplotlib axes, optional
            Axes to draw in, new ones by default.

        Returns
        -------
        matplotlib axes

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.plot_multipliers().get_xlabel()
        'real part'
        """
        return self.search.tools.plot_multipliers([self], ax)

    def save(self, path: Any) -> None:
        """Write the orbit to a file, which :meth:`Stepper.open_family` reads as a family of one.

        Parameters
        ----------
        path : path
            The file.

        Raises
        ------
        StorageError
            If the file cannot be written.
        InputError
            If the name does not end in ``.npz``.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.save(pathlib.Path(tempfile.mkdtemp()) / "swing.npz")
        """
        Family((self,), PERIOD, FamilyStatus.COUNT, (np.zeros(0),), self.search).save(path)

    def _title(self) -> str:
        stable = "stable" if self.stable else "unstable"
        return f"period {self.period:.10g}, {self.steps} steps, {stable}"


@dataclass(frozen=True, eq=False)
class Bifurcation:
    """An orbit at which a family turns, or other families branch off.

    Attributes
    ----------
    kind : str
        "fold", "branch point", "period doubling", "Krein collision", "torus" or "resonance".
    value : float
        The value of the quantity that changes along the family.
    orbit : Orbit
        The orbit.
    direction : ndarray, shape (2 n,)
        The direction (dq, dp) of the initial state in which other orbits lie.
    """

    kind: str
    value: float
    orbit: Orbit
    direction: Floats
    place: int  #: The number of the orbit before it.

    def __repr__(self) -> str:
        return f"Bifurcation({self.kind!r}, value={self.value:.12g})"


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
    status, message : FamilyStatus, str
        Why the family ended.
    bifurcations : tuple of Bifurcation
        Orbits at which the family turns, or others branch off.

    Examples
    --------
    >>> import symsimpson as ss
    >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
    >>> family = orbit.family("period", to=2.2)
    >>> family.status.name, round(float(family["period"][-1]), 9)
    ('REACHED', 2.2)
    """

    orbits: tuple[Orbit, ...]
    parameter: str
    status: FamilyStatus
    tangents: tuple[Floats, ...] = field(repr=False)  #: Directions of the unknowns.
    search: Any = field(repr=False)

    @overload
    def __getitem__(self, key: str) -> Floats: ...
    @overload
    def __getitem__(self, key: int) -> Orbit: ...
    def __getitem__(self, key: Any) -> Any:
        """Return an orbit by its number, or a quantity of all orbits by its name.

        Names are "period", "frequency", "energy", "stability", parameters, and initial coordinates
        and momenta.
        """
        if not isinstance(key, str):
            return self.orbits[key]
        quantities: dict[str, Any] = {
            PERIOD: lambda x: x.period,
            "frequency": lambda x: 1 / x.period,
            ENERGY: lambda x: x.energy,
            "stability": lambda x: abs(x.multipliers).max(initial=1.0),
        }
        names, parameters = self.search.stepper.coordinates, self.search.stepper.parameters
        quantities |= {name: lambda x, k=k: x.values[k] for k, name in enumerate(parameters)}
        quantities |= {f"p_{name}": lambda x, k=k: x.p0[k] for k, name in enumerate(names)}
        quantities |= {name: lambda x, k=k: x.q0[k] for k, name in enumerate(names)}
        if key not in quantities:
            reject(
                f"a family has no quantity {key!r}.{did_you_mean(key, quantities)}",
                remedy=f"Choose from {', '.join(quantities)}.",
            )
        return np.array([quantities[key](x) for x in self.orbits])

    @property
    def message(self) -> str:
        """The outcome as text."""
        return self.status.message

    def __len__(self) -> int:
        return len(self.orbits)

    def __iter__(self) -> Iterator[Orbit]:
        return iter(self.orbits)

    @cached_property
    def bifurcations(self) -> tuple[Bifurcation, ...]:
        """Orbits at which the family turns, or at which others branch off."""
        return self.search.tools.bifurcations(self)

    def resonances(self, a: int, b: int) -> tuple[Bifurcation, ...]:
        """Return the orbits with a multiplier exp(2 pi i a/b).

        Parameters
        ----------
        a, b : int
            Numerator and denominator.

        Returns
        -------
        tuple of Bifurcation

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.family("energy", count=3).resonances(1, 3)  # a pendulum has no multipliers
        ()
        """
        return self.search.tools.resonances(self, a, b)

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
            If no other family branches off.

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> family = orbit.family("energy", count=3)
        >>> [family.switch(place) for place in family.bifurcations]  # none of a pendulum
        []
        """
        return self.search.tools.switch(self, bifurcation, count, options)

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
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> len(orbit.family("energy", count=3).extend(count=2))
        6
        """
        return self.search.tools.extend(self, to, count)

    def plot(self, x: str | None = None, y: str = PERIOD, *, ax: Any = None) -> Any:
        """Draw one quantity of the orbits against another; unstable orbits are dashed.

        Parameters
        ----------
        x, y : str
            Names as for ``family["..."]``; the default of x is the quantity that changes.
        ax : matplotlib axes, optional
            Axes to draw in, new ones by default.

        Returns
        -------
        matplotlib axes

        Examples
        --------
        >>> import symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.family("energy", count=3).plot(y="frequency").get_ylabel()
        'frequency'
        """
        return self.search.tools.plot_family(self, x or self.parameter, y, ax)

    def save(self, path: Any) -> None:
        """Write the family to a file, which :meth:`Stepper.open_family` reads.

        Parameters
        ----------
        path : path
            The file.

        Raises
        ------
        StorageError
            If the file cannot be written.
        InputError
            If the name does not end in ``.npz``.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> orbit = ss.compile(ss.systems.pendulum()).periodic([1], [0], period=2.1, steps=40)
        >>> orbit.family("energy", count=3).save(pathlib.Path(tempfile.mkdtemp()) / "swings.npz")
        """
        self.search.tools.save(self, path)

    def __repr__(self) -> str:
        (low, high), search = self[self.parameter][[0, -1]], self.search
        return (
            f"Family({search.stepper.system}, {search.stepper.scheme}: {len(self)} orbits, "
            f"{self.parameter} from {low:.6g} to {high:.6g}; {self.status.name})"
        )
