"""Events that act on a run, as users declare them: impacts, changes, and points of a split."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import whole_number
from symsimpson.support.calling import explaining
from symsimpson.support.markup import fields_given
from symsimpson.support.names import spelled

#: What may be changed, and the blocks of a state that it stands in.
CHANGED = {"positions": "q", "velocities": "v", "momenta": "p"}


@explaining(also=("__init__",))
@dataclass(frozen=True)
class Impact:
    """An impact on a gap g(q, t) >= 0, by Newton's law of restitution.

    The momentum jumps along n = dg/dq, so that the rate of the gap becomes -e times what it was;
    tangential motion is kept, and for e = 1 and a wall at rest the energy.

    Parameters
    ----------
    restitution : number or expression
        e, between 0 (plastic) and 1 (elastic); of parameters and of the speed of approach,
        :data:`symsimpson.approach`, if it is an expression.

    Raises
    ------
    InputError
        If the number is not between 0 and 1.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.Impact(0.8)
    Impact(restitution=0.8)
    """

    restitution: Any = 1.0

    def __post_init__(self) -> None:
        given = self.restitution
        bare = isinstance(given, type)  # a function of nothing
        if bare or not hasattr(given, "free_symbols") or getattr(given, "is_number", True):
            real = isinstance(given, Real) and not isinstance(given, bool)
            real = real or (not bare and bool(getattr(given, "is_real", False)))
            number = float(given) if real and abs(given) <= 1 else float("nan")
            if not 0.0 <= number <= 1.0:
                reject(
                    f"restitution is {given!r}.",
                    remedy="Give a number between 0 (plastic) and 1 "
                    "(elastic); for a bumper that gives energy, take Change.",
                )


@explaining(also=("__init__",))
@dataclass(frozen=True)
class Change:
    """New values of coordinates, and of velocities or momenta, as expressions in the state before.

    Those that are not named stay.

    Parameters
    ----------
    positions, velocities, momenta : mapping from coordinate to expression, optional

    Raises
    ------
    InputError
        If nothing is changed, or both the velocity and the momentum of a coordinate.

    Examples
    --------
    >>> import symsimpson as ss
    >>> x, y = ss.coordinates("x y")
    >>> ss.Change(positions={x: y, y: x}).positions[x]
    y(t)
    """

    positions: Mapping[Any, Any] = field(default_factory=dict)
    velocities: Mapping[Any, Any] = field(default_factory=dict)
    momenta: Mapping[Any, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what in CHANGED:
            if not isinstance(getattr(self, what), Mapping):
                reject(
                    f"{what} is {getattr(self, what)!r}, not a mapping.",
                    remedy="Name coordinates: Change(velocities={x: -x.diff()}).",
                )
        if not any(getattr(self, what) for what in CHANGED):
            reject(
                "Change changes nothing.",
                remedy="Name coordinates: Change(velocities={x: -x.diff()}). To "
                "split a step alone, take Switch().",
            )
        both = {spelled(x) for x in self.velocities} & {spelled(x) for x in self.momenta}
        if both:
            reject(
                f"Change gives a velocity and a momentum of {', '.join(sorted(both))}.",
                remedy="Give one of them; the other follows.",
            )


@explaining(also=("__init__",))
@dataclass(frozen=True)
class Switch:
    """Nothing but an end of one part of a step: forces that have a kink there keep the order.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.Switch()
    Switch()
    """


@explaining(also=("__init__",))
@dataclass(frozen=True)
class Event:
    """A change of sign of an expression along a run, which acts on the run, or ends it.

    It is located to rounding, by a shorter step of the same scheme from the state before; then its
    action changes the state, and the rest of the step leads back to the grid of times.

    Parameters
    ----------
    expression : SymPy expression, equation or str
        As for :meth:`Trajectory.events`: coordinates, velocities, momenta, parameters, t. For an
        :class:`Impact` it is a gap, a SymPy expression of positions and t, positive where the body
        is free, or an inequality that holds there.
    name : str, optional
        By which ``run.events(name)`` gives its record; that of the expression unless given.
    direction : {0, 1, -1}
        Whether it acts where the expression changes its sign in both ways, up, or down. An impact
        takes place where the gap falls.
    action : Impact, Change or Switch, optional
        None where the run is to be ended, or the event to be recorded alone.
    when : expression, optional
        It acts only where this is positive.
    terminal : bool or int
        Whether the run ends there, at the first one or at that of a number; its state is then that
        after the action.

    Raises
    ------
    InputError
        If these make no sense.

    Examples
    --------
    >>> import symsimpson as ss
    >>> (z,) = ss.coordinates("z")
    >>> ball = ss.MechanicalSystem("ball", coordinates=(z,), kinetic=z.diff()**2/2, potential=10*z)
    >>> floor = ss.Event(z, name="floor", action=ss.Impact(0.8))
    >>> run = ss.compile(ball).integrate([1.0], v0=[0.0], h=0.01, t_end=2, events=[floor])
    >>> run.events("floor").t.round(6).tolist()
    [0.447214, 1.162755, 1.735189]
    """

    expression: Any
    name: str | None = field(default=None, kw_only=True)
    direction: int = field(default=0, kw_only=True)
    action: Impact | Change | Switch | None = field(default=None, kw_only=True)
    when: Any = field(default=None, kw_only=True)
    terminal: bool | int = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        if self.action is not None and not isinstance(self.action, (Impact, Change, Switch)):
            reject(
                f"the action of an event is {self.action!r}.",
                remedy="It is an Impact, a Change or a Switch, or None.",
            )
        if self.name is not None and not (isinstance(self.name, str) and self.name.strip()):
            reject(f"the name of an event is {self.name!r}.", remedy="It is a text.")
        if whole_number(self.direction) not in (-1, 0, 1):
            reject(
                f"direction is {self.direction!r}.",
                remedy="Pass 1 for a change of sign on the way up, -1 "
                "for one on the way down, or 0 for both.",
            )
        if isinstance(self.action, Impact) and self.direction == 1:
            reject(
                "an impact takes place where the gap falls: direction=-1.",
                remedy="Turn the sign of the gap, which is positive where the body is free.",
            )
        count = self.terminal
        if not isinstance(count, (Integral, np.bool_)) or count < 0:
            reject(
                f"terminal is {count!r}.",
                remedy="It is True, or the number of times after which the run ends.",
            )

    @property
    def key(self) -> str:
        """The name of its record."""
        return str(self.expression) if self.name is None else self.name

    @property
    def sign(self) -> int:
        """The direction in which it acts."""
        return -1 if isinstance(self.action, Impact) else self.direction

    def _repr_html_(self) -> str:
        return fields_given("Event", self)
