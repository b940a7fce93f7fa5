"""Events of a run, read: expressions that are evaluated, and where they stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from symsimpson.errors import reject
from symsimpson.program.observed import Observed, read_expression, refuse_constant, watchers
from symsimpson.program.program import Program
from symsimpson.program.recorders import Recorder
from symsimpson.stepping.event import CHANGED, Change, Event, Impact
from symsimpson.stepping.inputs import STEP
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Reals
from symsimpson.support.names import speed_of_approach, spelled
from symsimpson.text.header import Header

#: Events that a program remembers: reading them takes SymPy milliseconds.
MOST_KNOWN = 64


@dataclass(frozen=True)
class RunEvents:
    """Events of a run, and where what they ask for stands among expressions that are evaluated."""

    events: tuple[Event, ...]
    watched: tuple[Observed, ...]  #: Expressions of events, in their order; then all others.
    when: tuple[int | None, ...]  #: Where the condition of each event stands.
    #: Where the rate of the gap of each impact stands, and the first of its derivatives by q.
    rate: tuple[int | None, ...]
    slopes: tuple[int | None, ...]
    #: What each event changes: a block of the state, a coordinate, and where its value stands.
    changes: tuple[tuple[tuple[str, int, int], ...], ...]
    sizes: tuple[int, ...]  #: Where the sizes of the terms of each expression stand.

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(event.key for event in self.events)

    def split_alone(self, events: Sequence[int] | None = None) -> bool:
        """Return whether these events split a step and do nothing else, or any event does."""
        alone = [not (isinstance(x.action, (Impact, Change)) or x.terminal) for x in self.events]
        return any(alone) if events is None else all(alone[k] for k in events)

    def last_of(self, records: Sequence[Any]) -> Any:
        """Return the record with which an event ends a run, if there is one."""
        for k, event in enumerate(self.events):
            if event.terminal:  # there may be many records
                acted = [record for record in records if record.event == k]
                if len(acted) >= int(event.terminal):
                    return acted[-1]
        return None

    def watchers(self, header: Header, first: int, *, values: bool = False) -> tuple[Recorder, ...]:
        """Return what looks for the events, with rows from the first free one on."""
        signs = [event.sign for event in self.events]
        gaps = [rate is not None for rate in self.rate]
        watched = self.watched[: len(self.events)]
        return watchers(header, watched, signs, gaps, first, values=values)


def read_run_events(program: Program, request: Request) -> RunEvents | None:
    """Read the events of a run, None without any; raise InputError if they do not fit."""
    given = request.events
    if isinstance(given, RunEvents):  # read for all members of an ensemble
        return given
    if given is None or (isinstance(given, Sequence) and not len(given)):
        return None
    why = ""
    if program.numbers.epsilon != 2.0**-52:
        why = "many digits"
    elif program.header.retimed:
        why = "a rate: the energy of a retimed run stays as it is"
    if why:
        reject(
            f"{program.system}: events that act do not go with {why}.",
            remedy="Leave one of them out; "
            "events without an action are found after a run, by run.events(expression).",
        )
    known, key = program.findings.events, tuple(given) if isinstance(given, list) else given
    try:
        events = known.get(key)
    except TypeError:  # mappings of a Change have no hash
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
    """Raise InputError where derivatives of a run with events are not known."""
    if program.declared is None:
        reject(
            f"{program.system}: derivatives of a run with events need the energies of the system, "
            "and a module has none.",
            remedy="Make the stepper with symsimpson.compile; a run in a "
            "checkpoint goes on by the call that began it, integrate(..., checkpoint=...).",
        )
    header = program.header
    of_steps = {*(header.varied_by or ())} & {*STEP} - {*header.parameters, *header.inputs}
    if of_steps:
        reject(
            f"{program.system}: derivatives of a run with events by {' and '.join(of_steps)} are "
            "not known, as events have times of their own.",
            remedy="Differentiate by the state, by "
            "parameters or by inputs, or a run without events.",
        )
    if inputs.size and inputs.shape[2] > 1:
        reject(
            f"{program.system}: derivatives of a run with events do not go with inputs that vary "
            "within a step.",
            remedy="Give one value for each step.",
        )


def read_events(program: Program, given: Any) -> RunEvents:
    """Read the events of a run; raises InputError if they are none, or do not fit the system."""
    if isinstance(given, Event):
        given = (given,)
    if not isinstance(given, Sequence) or isinstance(given, str):
        reject(
            f"events is {given!r}, no sequence.",
            remedy="Pass events=[symsimpson.Event(expression, action=...)].",
        )
    events = tuple(given)
    for candidate in events:
        if not isinstance(candidate, Event):
            reject(
                f"events contains {candidate!r}, which is not an Event.",
                remedy=f"Write symsimpson.Event({candidate}, action=...) in its place.",
            )
    _check_names(program, events)
    for event in events:
        _check_restitution(program, event)
    watched = [
        read_expression(program, _watched(entry), what=f"the expression of the event {entry.key!r}")
        for entry in events
    ]
    for event, expression in zip(events, watched, strict=True):
        refuse_constant(expression, f"the expression of the event {event.key!r}")

    def place(what: str, event: Event, expression: Any) -> int:
        what_for = f"the {what} of the event {event.key!r}"
        watched.append(read_expression(program, expression, what=what_for))
        return len(watched) - 1

    when = tuple(
        None if entry.when is None else place("condition", entry, _positive(entry.when))
        for entry in events
    )
    gaps = [
        _of_gap(program, entry, partial(place, "gap", entry))
        if isinstance(entry.action, Impact)
        else (None, None)
        for entry in events
    ]
    changes = tuple(_changes(program, entry, partial(place, "change", entry)) for entry in events)
    rates, slopes = (tuple(gap[k] for gap in gaps) for k in range(2))
    sizes = tuple(range(len(watched), len(watched) + len(events)))
    watched += [replace(observed, text=observed.size) for observed in watched[: len(events)]]
    return RunEvents(events, tuple(watched), when, rates, slopes, changes, sizes)


def _check_names(program: Program, events: Sequence[Event]) -> None:
    names = [event.key for event in events]
    for name in names:
        if names.count(name) > 1:
            reject(
                f"two events are called {name!r}.",
                remedy="Give them names: Event(..., name='floor').",
            )
        if name in program.names.coordinates.places and events[names.index(name)].name is not None:
            reject(
                f"{name!r} is a coordinate; run.events({name!r}) could not tell them apart.",
                remedy="Give the event another name.",
            )


def _positive(condition: Any) -> Any:
    """Return what is positive where an inequality holds; raise InputError for an equation."""
    if not hasattr(condition, "rel_op"):
        return condition
    if condition.rel_op not in ("<", "<=", ">", ">="):
        reject(
            f"the condition when={condition} holds nowhere but in points.",
            remedy="Give an expression that is to be positive, or an inequality.",
        )
    sign = 1 if condition.rel_op in (">", ">=") else -1
    return sign * (condition.lhs - condition.rhs)


def _watched(event: Event) -> Any:
    """Return the expression of an event; of a gap that is an inequality, what it keeps positive."""
    given = event.expression
    inequality = getattr(given, "rel_op", "==") not in ("==", "!=")
    return _positive(given) if inequality and isinstance(event.action, Impact) else given


def _check_restitution(program: Program, event: Event) -> None:
    """Raise InputError unless parameters and the speed of approach make up a restitution."""
    from sympy import Derivative, Symbol  # SymPy is slow to import, and is there by now
    from sympy.core.function import AppliedUndef

    given: Any = getattr(event.action, "restitution", 1.0)
    if hasattr(given, "atoms"):  # coordinates and velocities by their names, not by the t in them
        for kind in (Derivative, AppliedUndef):
            given = given.xreplace({atom: Symbol(spelled(atom)) for atom in given.atoms(kind)})
    symbols = {*getattr(given, "free_symbols", ())} - {speed_of_approach()}
    strange = sorted(str(x) for x in symbols if program.names.parameters.place(x) is None)
    if strange:
        reject(
            f"the restitution {given} contains {', '.join(strange)}.",
            remedy="It is made of parameters and of the speed of approach, symsimpson.approach.",
        )


def _of_gap(program: Program, event: Event, place: Any) -> tuple[int, int]:
    """Return where the rate of a gap stands, and the first of its slopes."""
    import sympy as sp  # it is slow to import, and is there by now
    from sympy.core.function import AppliedUndef

    gap = _watched(event)
    if hasattr(gap, "lhs") and hasattr(gap, "rhs"):
        gap = gap.lhs - gap.rhs
    if not hasattr(gap, "atoms"):
        reject(
            f"the gap of an impact, {event.key!r}, is differentiated.",
            remedy="Write it as a SymPy expression in the coordinates of the system.",
        )
    if kinks := gap.atoms(sp.Max, sp.Min, sp.Heaviside, sp.Piecewise):
        reject(
            f"the gap of an impact, {event.key!r}, contains {min(map(str, kinks), key=len)}, which "
            "has a kink, and a gap is differentiated.",
            remedy="Give one event for each of the gaps.",
        )
    symbols = sorted(gap.free_symbols - {sp.Symbol("t")}, key=str)
    if strange := [x for x in symbols if program.names.parameters.place(x) is None]:
        reject(
            f"the gap of an impact, {event.key!r}, contains the symbol {strange[0]}, and a gap is "
            "differentiated by coordinates and the time themselves.",
            remedy="Write coordinates as "
            "symsimpson.coordinates gives them, the time as symsimpson.time, and neither "
            "velocities nor momenta.",
        )
    places = {f: program.names.coordinates.place(f) for f in gap.atoms(AppliedUndef)}
    coordinates = {place: f for f, place in places.items() if place is not None}
    if not coordinates:
        reject(
            f"the gap {event.key!r} depends on no coordinate.",
            remedy="An impact changes velocities along "
            "its slope. Use Change, with this expression of the time.",
        )
    ((t,),) = {f.args for f in coordinates.values()}
    moving = [q.diff(t) for q in coordinates.values() if gap.has(q.diff(t))]
    if moving:
        reject(
            f"the gap of an impact is a function of positions and t, and {event.key!r} contains "
            f"the velocity of {spelled(moving[0].expr)}.",
            remedy="Use Change for what is to happen there.",
        )
    real = {q: sp.Dummy(real=True) for q in coordinates.values()}  # |q| has a slope then
    flat, back = gap.xreplace(real), {x: q for q, x in real.items()}
    if flat.is_nonnegative or flat.is_nonpositive:
        reject(
            f"the gap {event.key!r} never changes its sign, and has no slope where it is zero.",
            remedy="Write the distance itself, as x - 1 in place of its square or its modulus.",
        )

    def slope(x: Any) -> Any:
        return flat.diff(x).replace(sp.sign, lambda a: a / sp.Abs(a)).xreplace(back)

    slopes = {k: slope(real[q]) for k, q in coordinates.items()}
    first, *_ = [place(slopes.get(k, 0 * t)) for k in range(program.n)]
    rate = slope(t) + sum(slopes[k] * q.diff(t) for k, q in coordinates.items())
    return place(rate), first


def _changes(program: Program, event: Event, place: Any) -> tuple[tuple[str, int, int], ...]:
    """Return what an event changes."""
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
                    f"Change names {spelled(coordinate)!r}, which is no coordinate.",
                    remedy=f"The system has {', '.join(names.shown)}.",
                )
            if (block, number) in {change[:2] for change in changes}:
                reject(
                    f"Change gives the {what} of {names.shown[number]} twice.",
                    remedy="Give it once.",
                )
            changes.append((block, number, place(expression)))
    return tuple(changes)
