"""Events that act on a run, as users declare them: impacts, state changes and switches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import whole_number
from symsimpson.support.calling import explain_methods
from symsimpson.support.markup import fields_given
from symsimpson.support.names import spelled

#: Arguments of :class:`Change`, and the block of the state that each one changes.
CHANGED = {"positions": "q", "velocities": "v", "momenta": "p"}


@explain_methods(also=("__init__",))
@dataclass(frozen=True)
class Impact:
    """An impact at a gap g(q, t) >= 0, by Newton's law of restitution.

    The momentum jumps along n = dg/dq. After the impact, the rate of the gap is -e times the rate
    before it. The tangential motion does not change. For e = 1 and a wall at rest, the impact
    conserves energy. Bodies that may rest need a :class:`Contact` of the system.

    Parameters
    ----------
    restitution : number or expression, default 1.0
        Coefficient of restitution e, between 0 (plastic) and 1 (elastic), dimensionless. An
        expression may contain parameters and the speed of approach,
        :data:`symsimpson.approach`.

    Raises
    ------
    InputError
        If a number is not between 0 and 1.

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
                    f"restitution is {given!r}, but must be between 0 (plastic) and 1 (elastic).",
                    remedy="For a bumper that adds energy, use Change.",
                )


@explain_methods(also=("__init__",))
@dataclass(frozen=True)
class Change:
    """New values of positions, velocities or momenta at an event.

    All expressions are evaluated at the state before the event. Positions and velocities that you
    do not list keep their values.

    Parameters
    ----------
    positions : mapping from coordinate to expression, optional
        New position of each listed coordinate.
    velocities : mapping from coordinate to expression, optional
        New velocity of each listed coordinate.
    momenta : mapping from coordinate to expression, optional
        New momentum of each listed coordinate. It excludes the velocity of the same coordinate.

    Raises
    ------
    InputError
        If no value changes, or if a coordinate has both a new velocity and a new momentum.

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
                    remedy="Pass coordinates as keys: Change(velocities={x: -x.diff()}).",
                )
            object.__setattr__(self, what, dict(getattr(self, what)))
        if not any(getattr(self, what) for what in CHANGED):
            reject(
                "Change changes nothing.",
                remedy="Pass coordinates as keys: Change(velocities={x: -x.diff()}). To split a "
                "step without a change, use Switch().",
            )
        both = {spelled(x) for x in self.velocities} & {spelled(x) for x in self.momenta}
        if both:
            reject(
                f"Change sets both the velocity and the momentum of {', '.join(sorted(both))}.",
                remedy="Set one of them; the other follows from it.",
            )

    def __hash__(self) -> int:
        return hash(tuple(frozenset(getattr(self, what).items()) for what in CHANGED))


@explain_methods(also=("__init__",))
@dataclass(frozen=True)
class Switch:
    """Split the step at the event without a change of the state.

    Use it where a force has a kink, so that the scheme keeps its order. Dry friction is a
    :class:`Friction` of the system, which also sticks.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.Switch()
    Switch()
    """


@explain_methods(also=("__init__",))
@dataclass(frozen=True)
class Event:
    """A sign change of an expression that acts on the run, ends it or is recorded.

    The run locates the sign change up to round-off, with a shorter step of the same scheme. Then
    the action changes the state. The rest of the step returns to the uniform time grid.

    Parameters
    ----------
    expression : SymPy expression, equation or str
        Expression whose sign change is the event, as for :meth:`Trajectory.events`. It may contain
        coordinates, velocities, momenta, parameters and t. For an :class:`Impact` it is the gap: a
        SymPy expression of positions and t that is positive where the body is free. An inequality
        that holds where the body is free is accepted as well.
    name : str, optional
        Name of the record: ``run.events(name)`` returns it. The default is the text of the
        expression.
    direction : {0, 1, -1}, default 0
        Sign change that counts: 0 for both, 1 for rising and -1 for falling. An impact always
        takes place where the gap falls.
    action : Impact, Change or Switch, optional
        What the event does to the state. With None, the run only records the event or ends.
    when : expression or inequality, optional
        Condition: the event acts only if the expression is positive or the inequality holds. By
        default it always acts.
    terminal : bool or int, default False
        If True, the run ends at the first event; a number k ends the run at the k-th event. The
        final state is the state after the action.

    Raises
    ------
    InputError
        If an argument has the wrong type or an invalid value.

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
                remedy="Pass an Impact, a Change, a Switch or None.",
            )
        if self.name is not None and not (isinstance(self.name, str) and self.name.strip()):
            reject(
                f"the name of an event is {self.name!r}, not a text.",
                remedy="Pass a string: Event(..., name='floor').",
            )
        if whole_number(self.direction) not in (-1, 0, 1):
            reject(
                f"direction is {self.direction!r}, but must be 1, -1 or 0.",
                remedy="Pass 1 for rising sign changes, -1 for falling ones, or 0 for both.",
            )
        if isinstance(self.action, Impact) and self.direction == 1:
            reject(
                "direction=1 does not apply to an impact.",
                why="An impact takes place where the gap falls: direction=-1.",
                remedy="Change the sign of the gap. It must be positive where the body is free.",
            )
        count = self.terminal
        if not isinstance(count, (Integral, np.bool_)) or count < 0:
            reject(
                f"terminal is {count!r}, but must be True, False or a count.",
                remedy="Pass True to end at the first event, or k to end at the k-th event.",
            )

    @property
    def key(self) -> str:
        """Name of the record: ``name``, or the text of the expression."""
        return str(self.expression) if self.name is None else self.name

    @property
    def sign(self) -> int:
        """Direction of the sign change that counts; -1 for an impact."""
        return -1 if isinstance(self.action, Impact) else self.direction

    def _repr_html_(self) -> str:
        return fields_given("Event", self)
