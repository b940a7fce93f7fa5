"""Periodic orbits, paths between boundaries, and families of orbits, as methods of a stepper."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from symsimpson.api.evaluator import Parameters
from symsimpson.api.examining import Analyser
from symsimpson.errors import reject
from symsimpson.support.calling import explain_methods

if TYPE_CHECKING:
    from symsimpson.stepping.event import Event
    from symsimpson.study.orbits.boundary_path import Path
    from symsimpson.study.orbits.orbit import Family, Orbit


@explain_methods()
class OrbitFinder(Analyser):
    """The part of a stepper that finds orbits."""

    def periodic(
        self,
        q0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        guess: Any = None,
        mode: tuple[ArrayLike, int] | None = None,
        size: float = 0.01,
        period: Any = None,
        steps: int | None = None,
        h: float | None = None,
        fixed: Mapping[Any, Any] | None = None,
        middle: Mapping[Any, Any] | None = None,
        conditions: Mapping[Any, Any] | None = None,
        unknowns: Any = (),
        parameters: Parameters | None = None,
        events: Sequence[Event] | None = None,
        t0: float = 0.0,
        error: float | None = None,
    ) -> Orbit:
        """Find a periodic orbit near a guess, with its multipliers.

        The orbit is one of the scheme: its states repeat up to round-off, and its error has the
        order of the scheme. Pass exactly one guess: an initial state, ``guess`` or ``mode``.

        Parameters
        ----------
        q0 : array_like, shape (n,), or mapping
            Guess of the initial positions.
        v0, p0 : array_like, shape (n,), or mapping
            Guess of the initial velocities or momenta. Pass exactly one of them.
        guess : Trajectory, Orbit or (q, p), optional
            States along the whole orbit: a run over a period, another orbit, or arrays of shape
            (m, n) at equal intervals of a period.
        mode : (array_like, int), optional
            An equilibrium, and the number of an oscillation about it: 0 for the slowest one.
        size : float, default 0.01
            The amplitude of the mode, in the unit of the coordinates.
        period : number or expression
            Guess of the period; for a driven system, the period of the drive as an expression of
            parameters.
        steps : int, default 64
            Number of steps in a period.
        h : float, optional
            Step size of orbits that end at an event, and of retimed systems.
        fixed : mapping, optional
            Initial values of coordinates, velocities or expressions, "energy" or "period".
        middle : mapping, optional
            Conditions on the state after half a period, for orbits that are mirrored in time:
            ``fixed={y: 0, x.diff(): 0}, middle={y: 0, x.diff(): 0}``.
        conditions : mapping, optional
            Final values of coordinates, as expressions of the initial coordinates:
            ``{phi: phi + shift}``. The default is the initial value. Velocities change likewise.
        unknowns : symbol or sequence of symbols, optional
            Parameters, or symbols of ``conditions``, to solve for.
        parameters : mapping, optional
            Values of the parameters, by symbol or name.
        events : sequence of Event, optional
            Events of each period, as in :meth:`integrate`. A terminal one ends it, as the landing
            of a foot does.
        t0 : float, default 0.0
            Initial time.
        error : float, optional
            Double the steps until the estimated relative error of state and period is below this.

        Returns
        -------
        Orbit
            The orbit, or the last iterate. ``orbit.status`` and ``orbit.message`` say how the
            search ended.

        Raises
        ------
        InputError
            If an argument is invalid, or if there are more conditions than an orbit can satisfy.
        SchemeError
            If steps of this scheme cannot be differentiated.

        Notes
        -----
        Each first integral I adds an unknown a, and a term a grad I to the closing [1]_. Newton's
        matrix is then regular, and a = 0 at a resolved orbit. Newton's method takes the smallest
        correction if conditions are missing.

        References
        ----------
        .. [1] F. J. Munoz-Almaraz, E. Freire, J. Galan, E. Doedel and A. Vanderbauwhede,
           Continuation of periodic orbits in conservative and Hamiltonian systems, Physica D 181
           (2003), 1-38.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "gauss8")
        >>> orbit = stepper.periodic([1.0], v0=[0.0], period=2.1, steps=32,
        ...                          fixed={"theta": 1, "v_theta": 0})
        >>> orbit.status.name, round(orbit.period, 9)
        ('FOUND', 2.139137601)
        """
        given = {name: value for name, value in locals().items() if name != "self"}
        return self._search("periodic", **given)

    def boundary(
        self,
        q0: ArrayLike | Mapping[Any, Any],
        q1: ArrayLike | Mapping[Any, Any],
        *,
        duration: float | None,
        steps: int | None = None,
        parameters: Parameters | None = None,
        t0: float = 0.0,
    ) -> Path:
        """Find a motion from one position to another.

        Parameters
        ----------
        q0, q1 : array_like, shape (n,), or mapping
            Positions at both ends, or values of coordinates, velocities and expressions there.
        duration : float or None
            The time between the ends. None leaves it free.
        steps : int, default 64
            Number of steps. With a multiple of 8, the search accepts worse guesses.
        parameters : mapping, optional
            Values of the parameters, by symbol or name.
        t0 : float, default 0.0
            Initial time.

        Returns
        -------
        Path
            The motion, or the last iterate. The search begins with a straight line.

        Raises
        ------
        InputError
            If an argument is invalid, or if there are more conditions than a motion can satisfy.

        Examples
        --------
        >>> import symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "gauss8")
        >>> path = stepper.boundary([0.0], [2.0], duration=1.0, steps=32)
        >>> path.success, path.trajectory.q[-1].round(9).tolist()
        (True, [2.0])
        """
        return self._search("boundary", (q0, q1), duration, steps, (parameters, t0))

    def open_family(
        self,
        path: str | os.PathLike[str],
        *,
        fixed: Mapping[Any, Any] | None = None,
        middle: Mapping[Any, Any] | None = None,
        conditions: Mapping[Any, Any] | None = None,
        events: Sequence[Event] | None = None,
        period: Any = None,
    ) -> Family:
        """Read a family of orbits from a file.

        Parameters
        ----------
        path : path
            A file that ``family.save`` or ``orbit.save`` wrote with a stepper of the same system
            and scheme.
        fixed, middle, conditions, events, period : optional
            The arguments of the search for the first orbit, because the file contains only
            numbers. Pass ``period`` for driven systems.

        Returns
        -------
        Family

        Raises
        ------
        StorageError
            If the file cannot be read, or belongs to another system or scheme.
        InputError
            If the family was found with arguments that you do not pass.

        Examples
        --------
        >>> import pathlib, tempfile, symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum(), "gauss8")
        >>> orbit = stepper.periodic([1.0], v0=[0.0], period=2.1, steps=32, fixed={"theta": 1})
        >>> place = pathlib.Path(tempfile.mkdtemp()) / "swing.npz"
        >>> orbit.save(place)
        >>> len(stepper.open_family(place, fixed={"theta": 1}))
        1
        """
        given = {name: value for name, value in locals().items() if name not in ("self", "path")}
        return self._search("open_family", path, **given)

    def _search(self, name: str, *given: Any, **options: Any) -> Any:
        """Call a function of the search for orbits."""
        tools = self.program.tools
        if tools is None:
            reject(
                "this stepper cannot search for orbits, because it belongs to a stored result.",
                where=self.system,
                remedy="Make a stepper with symsimpson.compile.",
            )
        return tools.find_orbits(name, self, *given, **options)
