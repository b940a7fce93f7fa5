"""Read and check the events of a run; collect the expressions that they evaluate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from symsimpson.errors import ModelError, reject
from symsimpson.program.observed import (
    ObservedExpression,
    check_not_constant,
    event_recorders,
    read_expression,
)
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder
from symsimpson.stepping.event import CHANGED, Change, Event, Impact
from symsimpson.stepping.inputs import STEP
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Reals
from symsimpson.support.names import speed_of_approach, spelled
from symsimpson.text.header import Header

#: Number of event lists that a program caches, because SymPy takes milliseconds to read one.
MOST_KNOWN = 64


@dataclass(frozen=True)
class RunEvents:
    """Events of a run, and the expressions that the run evaluates for them.

    All other fields are indices into ``watched``.
    """

    events: tuple[Event, ...]
    watched: tuple[
        ObservedExpression, ...
    ]  #: Expressions of the events in their order, then all others.
    when: tuple[int | None, ...]  #: Index of the condition of each event.
    #: Index of the rate of the gap of each impact, and of its first derivative by q.
    rate: tuple[int | None, ...]
    slopes: tuple[int | None, ...]
    #: Changes of each event: block of the state, number of the coordinate, index of the new value.
    changes: tuple[tuple[tuple[str, int, int], ...], ...]
    sizes: tuple[int, ...]  #: Index of the size of the terms of each event expression.

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(event.key for event in self.events)

    def split_alone(self, events: Sequence[int] | None = None) -> bool:
        """Return whether all given events only split a step; by default, whether any event does."""
        only = [not (isinstance(x.action, (Impact, Change)) or x.terminal) for x in self.events]
        return any(only) if events is None else all(only[k] for k in events)

    def last_of(self, records: Sequence[Any]) -> Any:
        """Return the record of the terminal event that ends the run, or None."""
        for k, event in enumerate(self.events):
            if event.terminal:  # other events may have many records: do not read them
                acted = [record for record in records if record.event == k]
                if len(acted) >= int(event.terminal):
                    return acted[-1]
        return None

    def watchers(self, header: Header, first: int, *, values: bool = False) -> tuple[Recorder, ...]:
        """Return the recorders that detect the events, with workspace rows from ``first`` on."""
        signs = [event.sign for event in self.events]
        gaps = [rate is not None for rate in self.rate]
        watched = self.watched[: len(self.events)]
        return event_recorders(header, watched, signs, gaps, first, values=values)


def read_run_events(program: Program, request: Request) -> RunEvents | None:
    """Read the events of a run, or return None if it has none.

    Raises InputError if the events are invalid for the system, or if the arithmetic is
    multiprecision or the system is retimed.
    """
    given = request.events
    if isinstance(given, RunEvents):  # read for all members of an ensemble
        return given
    if given is None or (isinstance(given, Sequence) and not len(given)):
        return None
    remedy = "Remove one of the two. After a run, run.events(expression) finds sign changes."
    if program.numbers.epsilon != 2.0**-52:
        reject(
            "events cannot be combined with multiprecision.", where=program.system, remedy=remedy
        )
    if program.header.retimed:
        reject(
            "events cannot be combined with a time transformation.",
            where=program.system,
            why="The energy of such a run must not change.",
            remedy=remedy,
        )
    known, key = program.findings.events, tuple(given) if isinstance(given, list) else given
    try:
        events = known.get(key)
    except TypeError:  # the mappings of a Change are not hashable
        key = None
    if key is not None and events is not None:
        return events
    events = read_events(program, given)
    if key is not None:
        if len(known) == MOST_KNOWN:
            known.clear()
        known[key] = events
    return events


def check_variations(program: Program, inputs: Reals) -> None:
    """Raise InputError if derivatives of a run with events are not available."""
    if program.declared is None:
        reject(
            "derivatives of a run with events need T and V, which a generated module lacks.",
            where=program.system,
            remedy="Make the stepper with symsimpson.compile. To continue from a checkpoint, "
            "repeat the call that started the run: integrate(..., checkpoint=...).",
        )
    header = program.header
    of_steps = {*(header.varied_by or ())} & {*STEP} - {*header.parameters, *header.inputs}
    if of_steps:
        reject(
            f"a run with events cannot be differentiated by {' and '.join(of_steps)}.",
            where=program.system,
            why="The times of events do not follow the time grid.",
            remedy="Differentiate by the state, by parameters or by inputs, or remove the events.",
        )
    if inputs.size and inputs.shape[2] > 1:
        reject(
            "derivatives of a run with events require inputs that are constant over each step.",
            where=program.system,
            remedy="Pass one value for each step.",
        )


def read_events(program: Program, given: Any) -> RunEvents:
    """Read the events of a run; raise InputError if they are invalid for the system."""
    if isinstance(given, Event):
        given = (given,)
    if not isinstance(given, Sequence) or isinstance(given, str):
        reject(
            f"events is {given!r}, not a sequence of events.",
            remedy="Pass events=[symsimpson.Event(expression, action=...)].",
        )
    events = tuple(given)
    for candidate in events:
        if not isinstance(candidate, Event):
            reject(
                f"events contains {candidate!r}, which is not an Event.",
                remedy=f"Write symsimpson.Event({candidate}, action=...) instead.",
            )
    _check_names(program, events)
    for event in events:
        _check_restitution(program, event)
    watched = [
        read_expression(
            program, _event_expression(entry), what=f"the expression of the event {entry.key!r}"
        )
        for entry in events
    ]
    for event, expression in zip(events, watched, strict=True):
        check_not_constant(expression, f"the expression of the event {event.key!r}")

    def place(what: str, event: Event, expression: Any) -> int:
        what_for = f"the {what} of the event {event.key!r}"
        watched.append(read_expression(program, expression, what=what_for))
        return len(watched) - 1

    when = tuple(
        None if entry.when is None else place("condition", entry, _to_positive(entry.when))
        for entry in events
    )
    gaps = [
        _read_gap(program, entry, partial(place, "gap", entry))
        if isinstance(entry.action, Impact)
        else (None, None)
        for entry in events
    ]
    changes = tuple(
        _read_changes(program, entry, partial(place, "change", entry)) for entry in events
    )
    rates, slopes = (tuple(gap[k] for gap in gaps) for k in range(2))
    sizes = tuple(range(len(watched), len(watched) + len(events)))
    watched += [replace(observed, text=observed.size) for observed in watched[: len(events)]]
    return RunEvents(events, tuple(watched), when, rates, slopes, changes, sizes)


def _check_names(program: Program, events: Sequence[Event]) -> None:
    names = [event.key for event in events]
    for name in names:
        if names.count(name) > 1:
            reject(
                f"two events have the name {name!r}.",
                remedy="Give each event its own name: Event(..., name='floor').",
            )
        if name in program.names.coordinates.places and events[names.index(name)].name is not None:
            reject(
                f"the event name {name!r} is also a coordinate.",
                why=f"run.events({name!r}) would be ambiguous.",
                remedy="Choose another name for the event.",
            )


def _to_positive(condition: Any) -> Any:
    """Convert an inequality to an expression that is positive where it holds.

    Other expressions are returned unchanged. Raises InputError for an equation.
    """
    if not hasattr(condition, "rel_op"):
        return condition
    if condition.rel_op not in ("<", "<=", ">", ">="):
        reject(
            f"the condition when={condition} holds only at isolated points.",
            remedy="Pass an inequality, or an expression that is positive when the event may act.",
        )
    sign = 1 if condition.rel_op in (">", ">=") else -1
    return sign * (condition.lhs - condition.rhs)


def _event_expression(event: Event) -> Any:
    """Return the expression of an event; for the inequality of a gap, its positive form."""
    given = event.expression
    inequality = getattr(given, "rel_op", "==") not in ("==", "!=")
    return _to_positive(given) if inequality and isinstance(event.action, Impact) else given


def _check_restitution(program: Program, event: Event) -> None:
    """Reject a restitution with symbols other than parameters and the speed of approach."""
    from sympy import Derivative, Symbol  # SymPy is slow to import, but is loaded by now
    from sympy.core.function import AppliedUndef

    given: Any = getattr(event.action, "restitution", 1.0)
    if hasattr(given, "atoms"):  # name the coordinates and velocities, not the t in them
        for kind in (Derivative, AppliedUndef):
            given = given.xreplace({atom: Symbol(spelled(atom)) for atom in given.atoms(kind)})
    symbols = {*getattr(given, "free_symbols", ())} - {speed_of_approach()}
    strange = sorted(str(x) for x in symbols if program.names.parameters.place(x) is None)
    if strange:
        reject(
            f"the restitution {given} contains {', '.join(strange)}.",
            remedy="Use only parameters and the speed of approach, symsimpson.approach.",
        )


def _read_gap(program: Program, event: Event, place: Any) -> tuple[int, int]:
    """Differentiate a gap; return the indices of its rate and of its first derivative by q."""
    import sympy as sp  # slow to import, but loaded by now
    from sympy.core.function import AppliedUndef

    if program.header.canonical:
        reject(
            f"the event {event.key!r} is an impact, but the system is declared by its Hamiltonian.",
            why="Newton's law of restitution needs the mass matrix of a Lagrangian.",
            remedy="Write the jump of the momenta as a Change, or declare T and V.",
            error=ModelError,
        )
    gap = _event_expression(event)
    if hasattr(gap, "lhs") and hasattr(gap, "rhs"):
        gap = gap.lhs - gap.rhs
    if not hasattr(gap, "atoms"):
        reject(
            f"the gap {event.key!r} of an impact is not a SymPy expression.",
            why="The run needs its derivatives.",
            remedy="Write the gap as a SymPy expression in the coordinates of the system.",
        )
    if kinks := gap.atoms(sp.Max, sp.Min, sp.Heaviside, sp.Piecewise):
        reject(
            f"the gap {event.key!r} of an impact contains {min(map(str, kinks), key=len)}, which "
            "has a kink.",
            why="The run needs its derivatives.",
            remedy="Declare one event for each smooth gap.",
        )
    symbols = sorted(gap.free_symbols - {sp.Symbol("t")}, key=str)
    if strange := [x for x in symbols if program.names.parameters.place(x) is None]:
        reject(
            f"the gap {event.key!r} of an impact contains the symbol {strange[0]}.",
            why="The run differentiates a gap by coordinates and time.",
            remedy="Use coordinates from symsimpson.coordinates and the time symsimpson.time. Do "
            "not use velocities or momenta.",
        )
    places = {f: program.names.coordinates.place(f) for f in gap.atoms(AppliedUndef)}
    coordinates = {place: f for f, place in places.items() if place is not None}
    if not coordinates:
        reject(
            f"the gap {event.key!r} depends on no coordinate.",
            why="An impact changes velocities along the gradient of the gap.",
            remedy="Use Change with this expression of the time.",
        )
    ((t,),) = {f.args for f in coordinates.values()}
    moving = [q.diff(t) for q in coordinates.values() if gap.has(q.diff(t))]
    if moving:
        reject(
            f"the gap {event.key!r} of an impact contains the velocity of "
            f"{spelled(moving[0].expr)}.",
            why="A gap may depend only on positions and t.",
            remedy="Use Change instead of Impact for this event.",
        )
    real = {q: sp.Dummy(real=True) for q in coordinates.values()}  # so that |q| has a derivative
    flat, back = gap.xreplace(real), {x: q for q, x in real.items()}
    if flat.is_nonnegative or flat.is_nonpositive:
        reject(
            f"the gap {event.key!r} never changes its sign, and its gradient vanishes or jumps "
            "where it is zero.",
            remedy="Write the signed distance: x - 1 instead of its square or its absolute value.",
        )

    def slope(x: Any) -> Any:
        return flat.diff(x).replace(sp.sign, lambda a: a / sp.Abs(a)).xreplace(back)

    slopes = {k: slope(real[q]) for k, q in coordinates.items()}
    first, *_ = [place(slopes.get(k, 0 * t)) for k in range(program.n)]
    rate = slope(t) + sum(slopes[k] * q.diff(t) for k, q in coordinates.items())
    return place(rate), first


def _read_changes(program: Program, event: Event, place: Any) -> tuple[tuple[str, int, int], ...]:
    """Read the changes of an event; ``place`` stores an expression and returns its index."""
    if not isinstance(event.action, Change):
        return ()
    names = program.names.coordinates
    changes: list[tuple[str, int, int]] = []
    for what, block in CHANGED.items():
        for coordinate, expression in getattr(event.action, what).items():
            number = names.place(coordinate)
            if number is None and what == "velocities":
                number = names.place_of_velocity(coordinate)
            if number is None:
                reject(
                    f"Change contains {spelled(coordinate)!r}, which is not a coordinate.",
                    remedy=f"The coordinates of the system are {', '.join(names.shown)}.",
                )
            if (block, number) in {change[:2] for change in changes}:
                reject(
                    f"Change sets the {what} of {names.shown[number]} twice.",
                    remedy="Give it once.",
                )
            changes.append((block, number, place(expression)))
    return tuple(changes)
