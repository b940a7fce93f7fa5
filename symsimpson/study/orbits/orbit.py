"""Results of searches for periodic orbits and for paths between two boundaries."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import reject
from symsimpson.results.trajectory import Trajectory
from symsimpson.study.orbits.multipliers import Multipliers
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_methods

if TYPE_CHECKING:
    from symsimpson.run.ensemble.ensemble import Ensemble
    from symsimpson.study.orbits.family import Family
    from symsimpson.study.orbits.search import Search


class OrbitStatus(enum.IntEnum):
    """How the search for an orbit ended.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.OrbitStatus.SHORTER.success, ss.OrbitStatus.NOT_CONVERGED.success
    (True, False)
    """

    FOUND = 0
    FOUND_COARSE = 1
    SHORTER = 2
    NOT_ISOLATED = 3
    NOT_CONVERGED = 4
    STEP_FAILED = 5
    NOT_RESOLVED = 6
    EQUILIBRIUM = 7
    WRONG_EVENT = 8
    INTERRUPTED = 9

    @property
    def success(self) -> bool:
        """Whether the result is an orbit."""
        return self <= OrbitStatus.NOT_ISOLATED

    @property
    def message(self) -> str:
        """The status as a sentence, with what to do."""
        return _MESSAGES[self]


_MESSAGES = {
    OrbitStatus.FOUND: "The orbit closes up to round-off.",
    OrbitStatus.FOUND_COARSE: "The orbit closes, but not up to round-off. Take more steps.",
    OrbitStatus.SHORTER: "The orbit repeats one of a shorter period, orbit.primitive.",
    OrbitStatus.NOT_ISOLATED: "All motions nearby are periodic, too. This one is the nearest to "
    "the guess.",
    OrbitStatus.NOT_CONVERGED: "Newton's method did not converge. Give a nearer guess, a guess "
    "along the whole orbit (guess=), or take more steps.",
    OrbitStatus.STEP_FAILED: "A step failed. Give a nearer guess, or take more steps.",
    OrbitStatus.NOT_RESOLVED: "The steps do not resolve the orbit. Take more steps.",
    OrbitStatus.EQUILIBRIUM: "The state does not move: it is an equilibrium.",
    OrbitStatus.WRONG_EVENT: "The run missed the event that ends it. Give a nearer guess.",
    OrbitStatus.INTERRUPTED: "The search was interrupted with Ctrl-C.",
}


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A motion between two boundaries; :meth:`Stepper.boundary` returns it.

    Attributes
    ----------
    duration : float
        The time from one boundary to the other.
    steps : int
        Number of steps.
    q0, v0, p0 : ndarray, shape (n,)
        The initial state.
    energy : float
        H at the initial state.
    parameters : mapping from str to float
        Values of the parameters.
    unknowns : mapping from str to float
        Values of the unknowns.
    status : OrbitStatus
        How the search ended.
    success : bool
        True if the path was found.
    message : str
        The outcome as text.
    residual : float
        The largest error of the boundary conditions, relative to the scale of the motion.
    iterations : int
        Number of Newton iterations.

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.kepler_plane(), "gauss8")
    >>> path = stepper.boundary([1.0, 0.0], [-0.5, 1.2], duration=2.0, steps=24)
    >>> path.success, path.v0.round(9).tolist()
    (True, [-0.094933487, 1.134076482])
    """

    period: float = field(kw_only=True)
    steps: int = field(kw_only=True)
    q0: Floats = field(kw_only=True)
    p0: Floats = field(kw_only=True)
    values: Floats = field(kw_only=True)  #: Of the parameters.
    unknowns: Mapping[str, float] = field(kw_only=True)
    status: OrbitStatus = field(kw_only=True)
    message: str = field(kw_only=True)
    residual: float = field(kw_only=True)
    iterations: int = field(kw_only=True)
    #: Sizes of Newton's corrections, relative to the scale.
    corrections: tuple[float, ...] = field(kw_only=True)
    search: Search = field(kw_only=True)

    @property
    def duration(self) -> float:
        """The time from one boundary to the other."""
        return self.period

    @property
    def success(self) -> bool:
        """True if the search found what it was to find."""
        return self.status.success

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters."""
        names = self.search.stepper.parameters
        return dict(zip(names, self.values.tolist(), strict=True))

    @property
    def h(self) -> float:
        """The step size; of retimed systems, in transformed time."""
        flow = self.search.shooting.flow
        fixed = flow.to_event or flow.retimed
        return float(flow.spec.h) if fixed else self.period / self.steps

    @cached_property
    def trajectory(self) -> Trajectory:
        """The run over the whole path."""
        return self.search.run(self, every=1)

    @property
    def v0(self) -> Floats:
        """The initial velocities, shape (n,)."""
        if not np.isfinite([*self.q0, *self.p0]).all():
            return np.full(len(self.q0), np.nan)
        return np.asarray(self._start.v[0])

    @property
    def energy(self) -> float:
        """H at the initial state."""
        return float(self._start.energy[0])

    @cached_property
    def _start(self) -> Trajectory:
        """A run of no steps from the initial state."""
        return self.search.run(self, every=1, whole=False)

    def _title(self) -> str:
        return f"duration {self.period:.10g}, {self.steps} steps"

    def __repr__(self) -> str:
        name = f"{type(self).__name__}({self.search.stepper.system}, {self.search.stepper.scheme}"
        return f"{name}: {self._title()}; {self.status.name})"


@explain_methods()
@dataclass(frozen=True, eq=False, repr=False)
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
        Largest distance from 1 of the multipliers that are 1 for every orbit. It measures how well
        the steps resolve the orbit.
    unfolding : float
        The part of the closing error that no correction can reduce, relative to the scale. It is
        round-off for a resolved orbit.
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
    >>> x, y = ss.systems.henon_heiles().coordinates
    >>> orbit = stepper.periodic([0, 0.25], v0=[0.335, 0], period=6.1, steps=48,
    ...                          fixed={"energy": 1/12, x: 0})
    >>> orbit.success, round(orbit.period, 9), orbit.stability_indices.real.round(9).tolist()
    (True, 6.135235496, [0.323398323])
    """

    derivative: Floats = field(kw_only=True)
    floquet: Multipliers = field(kw_only=True)
    unfolding: float = field(kw_only=True)
    error: float | None = field(kw_only=True, default=None)
    primitive: Orbit | None = field(kw_only=True, default=None)

    @property
    def multipliers(self) -> NDArray[np.complex128]:
        """The multipliers without the trivial ones, the largest first."""
        return self.floquet.values

    @property
    def stability_indices(self) -> NDArray[np.complex128]:
        """(l + 1/l)/2 of each pair of multipliers."""
        return self.floquet.indices

    @property
    def stable(self) -> bool:
        """True if no deviation grows exponentially."""
        return self.success and self.floquet.stable

    @property
    def trivial(self) -> float:
        """Largest distance of a trivial multiplier from 1."""
        return self.floquet.trivial

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
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> orbit = stepper.periodic([1.0], v0=[0.0], period=2.1, steps=40, fixed={"theta": 1})
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
            First and largest distance between neighbours, relative to the scale of the unknowns. A
            negative step goes the other way, if ``to`` is not given.
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
        >>> stepper = ss.compile(ss.systems.pendulum(), "gauss8")
        >>> orbit = stepper.periodic([0.5], v0=[0.0], period=2.04, steps=32,
        ...                          fixed={"theta": 0.5, "v_theta": 0})
        >>> family = orbit.family("energy", to=-5.0, count=20)
        >>> family.status.name, bool(family["period"][-1] > family["period"][0])
        ('REACHED', True)
        """
        from symsimpson.study.orbits.family import follow

        return follow(self, parameter, to, count, step, largest_step, progress)

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
        >>> stepper = ss.compile(ss.systems.pendulum(), "gauss8")
        >>> orbit = stepper.periodic([1.0], v0=[0.0], period=2.1, steps=40, fixed={"theta": 1})
        >>> orbit.manifold()
        Traceback (most recent call last):
        symsimpson.errors.InputError: pendulum: this orbit has no unstable manifold.
        Its multipliers are those of a stable orbit, or complex.
        """
        unstable = kind == "unstable"
        if kind not in ("unstable", "stable"):
            reject(f"kind is {kind!r}.", remedy="Pass 'unstable' or 'stable'.")
        values, vectors = np.linalg.eig(self.derivative)
        sizes = abs(values) if unstable else 1 / np.maximum(abs(values), 1e-300)
        place = int(np.argmax(np.where(abs(values.imag) <= 1e-9 * abs(values), sizes, 0.0)))
        if sizes[place] < 1 + 1e-6:
            reject(
                f"this orbit has no {kind} manifold.",
                where=self.search.stepper.system,
                why="Its multipliers are those of a stable orbit, or complex.",
            )
        return self.search.runs_beside(self, vectors[:, place].real, size, count, periods, unstable)

    def plot(self, *, ax: Any = None) -> Any:
        """Draw the orbit in the plane of its first two coordinates, or of q and p.

        Parameters
        ----------
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> orbit = stepper.periodic([1.0], v0=[0.0], period=2.1, steps=40, fixed={"theta": 1})
        >>> orbit.plot().get_xlabel()
        'theta'
        """
        from symsimpson.study.orbits.figures import plot_orbit

        return plot_orbit(self, ax)

    def plot_multipliers(self, *, ax: Any = None) -> Any:
        """Draw the multipliers and the unit circle in the complex plane.

        Parameters
        ----------
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> orbit = stepper.periodic([1.0], v0=[0.0], period=2.1, steps=40, fixed={"theta": 1})
        >>> orbit.plot_multipliers().get_xlabel()
        'real part'
        """
        from symsimpson.study.orbits.figures import plot_multipliers

        return plot_multipliers([self], ax)

    def save(self, path: Any) -> None:
        """Write the orbit to a file, which :meth:`Stepper.open_family` reads as a family of one.

        Parameters
        ----------
        path : path
            The file; its name gets the suffix ``.npz``.

        Raises
        ------
        StorageError
            If the file cannot be written.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> orbit = stepper.periodic([1.0], v0=[0.0], period=2.1, steps=40, fixed={"theta": 1})
        >>> orbit.save(pathlib.Path(tempfile.mkdtemp()) / "swing")
        """
        from symsimpson.study.orbits.family import family_of

        family_of(self).save(path)

    def _title(self) -> str:
        stable = "stable" if self.stable else "unstable"
        return f"period {self.period:.10g}, {self.steps} steps, {stable}"
