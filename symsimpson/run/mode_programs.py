"""Programs and events of the modes of a system with contacts and dry friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.observed import ObservedExpression, Reduction, read_reductions
from symsimpson.program.program import Program
from symsimpson.stepping.event import Change, Event, Impact
from symsimpson.stepping.run_events import RunEvents, read_events
from symsimpson.support.array_types import Floats
from symsimpson.support.contact_values import Mode

#: Kinds of causes for the end of a mode.
GAP, LIFT, SLIP, STILL, MARGIN, USER = "gap", "lift", "slip", "still", "margin", "user"


class Cause(NamedTuple):
    """Why a mode ends: the kind, the number of a contact, an element or an event, and a sign."""

    kind: str
    number: int
    sign: int = 0


@dataclass(frozen=True)
class ModeProgram:
    """The program of a mode, its events, and the cause that each event has."""

    mode: Mode
    program: Program
    events: RunEvents
    causes: tuple[Cause, ...]
    reductions: tuple[Reduction, ...]

    def values(self, parameters: Floats) -> Floats:
        """Return the values of the system's parameters, then directions of sliding."""
        return values_of(self.mode, parameters)


def values_of(mode: Mode, parameters: Floats) -> Floats:
    """Return the values of the parameters of a mode: the user's, then directions of sliding."""
    return np.array([*parameters, *(float(x) for x in mode.elements if x)])


def program_of(program: Program, mode: Mode) -> Program:
    """Return the program of a mode, which is derived and compiled when it first occurs."""
    key, known = mode.key, program.findings.modes
    if key not in known:
        assert program.compile_for is not None
        alone = not any(key.contacts) and all(x is None for x in key.elements)
        known[key] = program if alone else program.compile_for(program.modes.system_of(key))
    of_mode: Program = known[key]
    return of_mode


class ModePrograms:
    """The programs of the modes of a run, with the events of the user."""

    def __init__(
        self, program: Program, events: Sequence[Event], reductions: Sequence[Reduction]
    ) -> None:
        self._program, self.modes, self._user = program, program.modes, tuple(events)
        self._reductions = reductions
        declared = program.declared
        self._gaps = [x.gap for x in declared.contacts.values()]
        taken = {*self.modes.names} & {event.key for event in self._user}
        if taken:
            reject(
                f"the event {min(taken)!r} has the name of a contact or a friction element.",
                where=program.system,
                remedy="Choose another name for the event.",
            )
        #: The gaps as impacts, then the events of the user, for the system without constraints.
        impacts = map(self._impact, range(len(self._gaps)))
        self.actions = _read_known(program, [*impacts, *events])
        #: Names of the records.
        self.names = (*self.modes.names, *(event.key for event in self._user))
        self._known: dict[Any, ModeProgram] = {}

    def _impact(self, contact: int) -> Event:
        name, e = self.modes.contacts[contact], self.modes.restitutions[contact]
        action = Impact(e if getattr(e, "free_symbols", ()) else float(e))
        return Event(self._gaps[contact], name=name, action=action)

    def __call__(
        self, mode: Mode, acted: Sequence[int], implied: frozenset[int] = frozenset()
    ) -> ModeProgram:
        """Return the program and the events of a mode.

        ``acted`` has how often each event of the user has acted. ``implied`` are open contacts
        whose gaps stay zero, because other contacts rest.
        """
        left = tuple(
            max(1, int(event.terminal) - count) if event.terminal else 0
            for event, count in zip(self._user, acted, strict=True)
        )
        key = mode.key, left, implied
        if key not in self._known:
            program = program_of(self._program, mode)
            pairs = [*self._events(mode, program, implied)]
            for j, (event, count) in enumerate(zip(self._user, left, strict=True)):
                acts = isinstance(event.action, (Impact, Change))
                pairs.append((replace(event, terminal=1 if acts else count), Cause(USER, j)))
            events, causes = zip(*pairs, strict=True) if pairs else ((), ())
            given = {x.name: (x.kind, x.expression) for x in self._reductions}
            kept = read_reductions(program, given or None, self.names)
            read = _read_known(program, events)
            self._known[key] = ModeProgram(mode, program, read, causes, kept)
        return replace(self._known[key], mode=mode)

    def _events(self, mode: Mode, program: Program, implied: frozenset[int]) -> Any:
        """Yield the events that end a mode, and their causes."""
        modes, texts = self.modes, getattr(program.declared, "texts", {})
        places = program.names.constraints.places

        def ends(name: str, text: str, cause: Cause, *, held: bool) -> tuple[Event, Cause]:
            energetic, driven = "v_" in text, held or "u_" in text
            watched = ObservedExpression(name, text, energetic, held=held, driven=driven)
            label = f"{cause.kind} of {name}{cause.sign or ''}"
            return Event(watched, name=label, direction=-1, terminal=True), cause

        for c, (name, rests) in enumerate(zip(modes.contacts, mode.contacts, strict=True)):
            if rests:
                yield ends(name, f"-l_{places[name]}", Cause(LIFT, c), held=True)
            elif c not in implied:
                gap = replace(self._impact(c), name=f"{GAP} of {name}", terminal=True)
                yield gap, Cause(GAP, c)
        for k, (name, state) in enumerate(zip(modes.elements, mode.elements, strict=True)):
            contact = modes.contact_of[k]
            if state == 0:
                load = "" if contact is None else f" * -l_{places[modes.contacts[contact]]}"
                for sign, before in ((1, "-"), (-1, "+")):
                    text = f"({texts[name]}){load} {before} l_{places[name]}"
                    yield ends(name, text, Cause(SLIP, k, sign), held=True)
            elif state:
                yield ends(name, texts[name], Cause(STILL, k), held=False)
        if "margin" in texts:
            yield ends("normal forces", texts["margin"], Cause(MARGIN, 0), held=False)


def _read_known(program: Program, events: Sequence[Event]) -> RunEvents:
    """Read the events of a mode, or return them if the program has read them before."""
    known, key = program.findings.events, ("mode", *events)
    try:
        events_read = known.get(key)
    except TypeError:  # the mappings of a Change are not hashable
        return read_events(program, events)
    if events_read is None:
        events_read = known[key] = read_events(program, events)
    read: RunEvents = events_read
    return read
