"""Requests for what a run records besides states: derivatives, work, observed values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from symsimpson.errors import InputError
from symsimpson.program.observed import Reduction, observers
from symsimpson.program.program import Program
from symsimpson.program.recorders import NAMED, Recorder, tangents
from symsimpson.support.names import did_you_mean
from symsimpson.text.header import Header


def read_record(program: Program, given: Any) -> tuple[str, ...]:
    """Read names of what is to be recorded.

    Raises InputError if there is no such thing, or the scheme does not tell it.
    """
    names = tuple(given) if isinstance(given, (list, tuple, set)) else (given,)
    names = () if given is None else names
    for name in names:
        if not isinstance(name, str) or name not in NAMED:
            raise InputError(
                f"record={name!r} is nothing that a run adds up over its steps."
                f"{did_you_mean(str(name), NAMED)}\nPass record='work', or reduce= for values of "
                "states."
            )
    header = program.header
    return tuple(name for name in dict.fromkeys(names) if NAMED[name](header, header.rows))


def recorders_of(
    header: Header,
    variations: int | None,
    record: Sequence[str],
    reductions: Sequence[Reduction],
    more: Sequence[Recorder] = (),
) -> tuple[Recorder, ...]:
    """Return the recorders of a run that carries so many variations along, or none."""
    carried = (*more, *(() if variations is None else (tangents(header, variations),)))
    first, named = header.rows + sum(carrier.room for carrier in carried), list[Recorder]()
    for name in record:
        if (recorder := NAMED[name](header, first)) is not None:
            named.append(recorder)
            first += recorder.room
    return *carried, *named, *observers(header, reductions, first)
