"""Some of the states of a run, with what the run knows of them."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.results.states import States
from symsimpson.results.stored import Stored
from symsimpson.support.array_types import Ints
from symsimpson.support.names import public_names

if TYPE_CHECKING:
    from symsimpson.plotting.animate import Animation
    from symsimpson.results.events import Events

__all__ = ["Part"]

#: What a run has a row of for each state, or a mapping of such rows.
ROWS = (
    "tau",
    "newton_iterations",
    "tangent",
    "sensitivity",
    "work",
    "power",
    "energy_balance",
    "energy_error",
    "shadow_energy",
    "multipliers",
    "constraint_error",
    "constraint_forces",
    "velocity_constraint_error",
)
#: What events have a row of for each time.
ROWS_OF_EVENTS = ("t", "q", "p", "direction", "q_after", "p_after", "impulse", "simultaneous")
#: What a part shares with its run.
WHOLE = ("sol", "records")


@dataclass(frozen=True, eq=False, repr=False)
class Part(States):
    """Some of the states of a run; what the run knows of each of them is there, too.

    Attributes are those of :class:`States`; ``tau``, ``newton_iterations``, ``tangent``,
    ``sensitivity``, ``work``, ``power``, ``energy_balance``, ``energy_error``,
    ``shadow_energy``, ``multipliers``, ``constraint_error``, ``velocity_constraint_error`` and
    ``constraint_forces`` are rows of those of the whole run.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=50)
    >>> bool((run[3:5].energy_error == run.energy_error[3:5]).all())
    True
    """

    _run: Any = field(repr=False)
    _places: Ints = field(repr=False)

    def __getattr__(self, name: str) -> Any:
        if name in WHOLE:
            return getattr(self._run, name)
        if name not in ROWS:
            return super().__getattr__(name)
        values = getattr(self._run, name)
        if isinstance(values, dict):
            return {key: rows[self._places] for key, rows in values.items()}
        return values[self._places]

    @property
    def _connected(self) -> bool:
        """Whether the states are a slice of the run: others have gaps."""
        return np.unique(np.diff(self._places)).size <= 1

    def __dir__(self) -> list[str]:
        """Return public names, with rows of the run."""
        return [*{*public_names(self), *ROWS, "sol"}]

    def __getitem__(self, key: Any) -> Any:
        """Return a quantity by its name, shape (N,), or some of the states."""
        item = super().__getitem__(key)
        return item if isinstance(item, np.ndarray) else part_of(self._run, self._places, key)

    def at(self, t: ArrayLike) -> States:
        """Return the states at any times of the whole run, as :meth:`Trajectory.at`."""
        return self._run.at(t)

    def events(self, expression: Any, *, direction: int = 0, wrap: Any = ()) -> Events:
        """Find the zeros of an expression from the first to the last of these states.

        As :meth:`Trajectory.events`; the name of an event gives its record in this time.
        """
        events = self._run.events(expression, direction=direction, wrap=wrap)
        here = (events.t >= min(self.t, default=0)) & (events.t <= max(self.t, default=0))
        values = {f.name: getattr(events, f.name) for f in fields(events)}
        rows = {x: values[x][here] for x in ROWS_OF_EVENTS if x in values}
        return type(events)(**{**values, **rows})

    def animate(self, **options: Any) -> Animation:
        """Animate this part of the run, with the arguments of :meth:`Trajectory.animate`."""
        from symsimpson.plotting.animate import animate

        return animate(self, **options)


def part_of(run: Stored, places: Ints, key: Any) -> Part:
    """Return the states of a run that a key selects among those with numbers ``places``."""
    some = np.atleast_1d(places[key])
    return Part(
        t=run.t[some],
        q=run.q[some],
        p=run.p[some],
        program=run.program,
        parameter_values=run.parameter_values,
        driven=run.driven,
        _run=run,
        _places=some,
    )
