"""Events that act on a run: impacts, changes of the state, and points where a step is split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from symsimpson.errors import InputError
from symsimpson.program.observed import Observed, read_expression, watchers
from symsimpson.support.names import spelled

if TYPE_CHECKING:
    from symsimpson.module.header import Header
    from symsimpson.program.program import Program
    from symsimpson.program.recorders import Recorder
    from symsimpson.stepping.request import Request

__all__ = ["Acting", "Change", "Event", "Impact", "Switch", "read_acting"]

#: What may be changed, and the blocks of a state that it stands in.
CHANGED = {"positions": "q", "velocities": "v", "momenta": "p"}


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
        if not hasattr(given, "free_symbols") or given.is_number:
            real = isinstance(given, Real) and not isinstance(given, bool)
            real = real or bool(getattr(given, "is_real", False))
            number = float(given) if real else float("nan")
            if not 0.0 <= number <= 1.0:
                raise InputError(
                    f"restitution is {given!r}.\nGive a number between 0 (plastic) and 1 "
                    "(elastic); for a bumper that gives energy, take Change."
                )


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
                raise InputError(
                    f"{what} is {getattr(self, what)!r}, not a mapping.\n"
                    "Name coordinates: Change(velocities={x: -x.diff()})."
                )
        if not any(getattr(self, what) for what in CHANGED):
            raise InputError(
                "Change changes nothing.\nName coordinates: Change(velocities={x: -x.diff()}). To "
                "split a step alone, take Switch()."
            )
        both = {spelled(x) for x in self.velocities} & {spelled(x) for x in self.momenta}
        if both:
            raise InputError(
                f"Change gives a velocity and a momentum of {', '.join(sorted(both))}.\n"
                "Give one of them; the other follows."
            )


@dataclass(frozen=True)
class Switch:
    """Nothing but an end of one part of a step: forces that have a kink there keep the order.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.Switch()
    Switch()
    """


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
        is free.
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
            raise InputError(
                f"the action of an event is {self.action!r}.\nIt is an Impact, a Change or a "
                "Switch, or None."
            )
        if self.name is not None and not (isinstance(self.name, str) and self.name.strip()):
            raise InputError(f"the name of an event is {self.name!r}.\nIt is a text.")
        if not isinstance(self.direction, Integral) or self.direction not in (-1, 0, 1):
            raise InputError(
                f"direction is {self.direction!r}.\nPass 1 for a change of sign on the way up, -1 "
                "for one on the way down, or 0 for both."
            )
        if isinstance(self.action, Impact) and self.direction == 1:
            raise InputError(
                "an impact takes place where the gap falls: direction=-1.\nTurn the sign of the "
                "gap, which is positive where the body is free."
            )
        count = self.terminal
        if not isinstance(count, (Integral, bool)) or count < 0:
            raise InputError(
                f"terminal is {count!r}.\nIt is True, or the number of times after which the run "
                "ends."
            )

    @property
    def key(self) -> str:
        """The name of its record."""
        return str(self.expression) if self.name is None else self.name

    @property
    def sign(self) -> int:
        """The direction in which it acts."""
        return -1 if isinstance(self.action, Impact) else self.direction


@dataclass(frozen=True)
class Acting:
    """Events of a run, and where what they ask for stands among expressions that are evaluated.

    Attributes
    ----------
    events : tuple of Event
    watched : tuple of Observed
        Expressions of events, in their order; then all others.
    when : tuple of int or None
        Where the condition of each event stands.
    rate, slopes : tuples of int or None
        Where the rate of the gap of each impact stands, and the first of its derivatives by q.
    changes : tuple of tuples
        What each event changes: a block of the state, a coordinate, and where its value stands.
    """

    events: tuple[Event, ...]
    watched: tuple[Observed, ...]
    when: tuple[int | None, ...]
    rate: tuple[int | None, ...]
    slopes: tuple[int | None, ...]
    changes: tuple[tuple[tuple[str, int, int], ...], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(event.key for event in self.events)

    def last_of(self, records: Sequence[Any]) -> Any:
        """Return the record with which an event ends a run, if there is one."""
        for k, event in enumerate(self.events):
            acted = [one for one in records if one.event == k]
            if event.terminal and len(acted) >= int(event.terminal):
                return acted[-1]
        return None

    def watchers(self, header: Header, first: int) -> tuple[Recorder, ...]:
        """Return what looks for the events, with rows from the first free one on."""
        signs, gaps = [one.sign for one in self.events], [rate is not None for rate in self.rate]
        return watchers(header, self.watched[: len(self.events)], signs, gaps, first)


def read_acting(program: Program, request: Request) -> Acting | None:
    """Read the events of a run, if there are any.

    Raises
    ------
    InputError
        If they do not fit the system, or what else is asked for.
    """
    given = request.events
    if given is None or (isinstance(given, Sequence) and not len(given)):
        return None
    why = ""
    if program.numbers.epsilon != 2.0**-52:
        why = "many digits"
    elif program.header.retimed:
        why = "a rate: the energy of a retimed run stays as it is"
    if request.record not in (None, ()):
        why = "record="
    if why:
        raise InputError(
            f"{program.system}: events that act do not go with {why}.\nLeave one of them out; "
            "events without an action are found behind a run, by run.events(expression)."
        )
    return read_events(program, given)


def read_events(program: Program, given: Any) -> Acting:
    """Read the events of a run.

    Raises
    ------
    InputError
        If they are none, or do not fit the system.
    """
    if isinstance(given, Event):
        given = (given,)
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise InputError(
            f"events is {given!r}, no sequence.\n"
            "Pass events=[symsimpson.Event(expression, action=...)]."
        )
    events = tuple(given)
    for one in events:
        if not isinstance(one, Event):
            raise InputError(
                f"events contains {one!r}, which is no Event.\n"
                "Pass events=[symsimpson.Event(expression, action=...)]."
            )
    _check_names(program, events)
    for one in events:
        _check_restitution(program, one)
    watched = [read_expression(program, one.expression) for one in events]

    def place(expression: Any) -> int:
        watched.append(read_expression(program, expression))
        return len(watched) - 1

    when = tuple(None if one.when is None else place(_positive(one.when)) for one in events)
    gaps = [
        _of_gap(program, one, place) if isinstance(one.action, Impact) else (None, None)
        for one in events
    ]
    changes = tuple(_changes(program, one, place) for one in events)
    rates, slopes = (tuple(gap[k] for gap in gaps) for k in range(2))
    return Acting(events, tuple(watched), when, rates, slopes, changes)


def _check_names(program: Program, events: Sequence[Event]) -> None:
    names = [one.key for one in events]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"two events are called {name!r}.\nGive them names: Event(..., name='floor')."
            )
        if name in program.names.coordinates.places and events[names.index(name)].name is not None:
            raise InputError(
                f"{name!r} is a coordinate; run.events({name!r}) could not tell them apart.\n"
                "Give the event another name."
            )


def _positive(condition: Any) -> Any:
    """Return what is positive where a condition holds, an expression or an inequality.

    Raises
    ------
    InputError
        If it is an equation.
    """
    if not hasattr(condition, "rel_op"):
        return condition
    if condition.rel_op not in ("<", "<=", ">", ">="):
        raise InputError(
            f"the condition when={condition} holds nowhere but in points.\n"
            "Give an expression that is to be positive, or an inequality."
        )
    sign = 1 if condition.rel_op in (">", ">=") else -1
    return sign * (condition.lhs - condition.rhs)


def _check_restitution(program: Program, event: Event) -> None:
    """Refuse a restitution of something else than parameters and the speed of approach.

    Raises
    ------
    InputError
    """
    given = getattr(event.action, "restitution", 1.0)
    names = {str(symbol) for symbol in getattr(given, "free_symbols", ())}
    strange = sorted(names - {"approach", *program.parameters})
    if strange:
        raise InputError(
            f"the restitution {given} contains {', '.join(strange)}.\n"
            "It is made of parameters and of the speed of approach, symsimpson.approach."
        )


def _of_gap(program: Program, event: Event, place: Any) -> tuple[int, int]:
    """Return where the rate of a gap stands, and the first of its slopes."""
    from sympy.core.function import AppliedUndef  # SymPy is slow to import, and is there by now

    gap = event.expression
    if hasattr(gap, "lhs") and hasattr(gap, "rhs"):
        gap = gap.lhs - gap.rhs
    if not hasattr(gap, "atoms"):
        raise InputError(
            f"the gap of an impact, {event.key!r}, is differentiated.\n"
            "Write it as a SymPy expression in the coordinates of the system."
        )
    places = {f: program.names.coordinates.place(f) for f in gap.atoms(AppliedUndef)}
    own = {place: f for f, place in places.items() if place is not None}
    if not own:
        raise InputError(
            f"the gap {event.key!r} depends on no coordinate.\nAn impact changes velocities along "
            "its slope. Use Change, with this expression of the time."
        )
    ((t,),) = {f.args for f in own.values()}
    moving = [q.diff(t) for q in own.values() if gap.has(q.diff(t))]
    if moving:
        raise InputError(
            f"the gap of an impact is a function of positions and t, and {event.key!r} contains "
            f"the velocity of {spelled(moving[0].expr)}.\nUse Change for what is to happen there."
        )
    slopes = [place(gap.diff(own[k]) if k in own else 0 * t) for k in range(program.n)]
    return place(gap.diff(t)), slopes[0]


def _changes(program: Program, event: Event, place: Any) -> tuple[tuple[str, int, int], ...]:
    """Return what an event changes."""
    if not isinstance(event.action, Change):
        return ()
    names, found = program.names.coordinates, []
    for what, block in CHANGED.items():
        for coordinate, expression in getattr(event.action, what).items():
            number = names.place(coordinate)
            if number is None:
                raise InputError(
                    f"Change names {spelled(coordinate)!r}, which is no coordinate.\n"
                    f"The system has {', '.join(names.shown)}."
                )
            found.append((block, number, place(expression)))
    return tuple(found)
