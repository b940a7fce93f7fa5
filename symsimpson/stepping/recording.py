"""Requests for what a run records besides states: derivatives, work, observed values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from symsimpson.errors import InputError
from symsimpson.program.observed import Reduction, observers
from symsimpson.program.recorders import Recorder, tangents, work
from symsimpson.support.names import did_you_mean

if TYPE_CHECKING:
    from symsimpson.module.header import Header
    from symsimpson.program.program import Program

__all__ = ["check_work", "read_record", "recorders_of"]

#: What may be recorded by name.
NAMES = ("work",)


def read_record(program: Program, given: Any) -> tuple[str, ...]:
    """Read names of what is to be recorded.

    Raises
    ------
    InputError
        If there is no such thing, or the scheme does not tell it.
    """
    names = () if given is None else (given,) if isinstance(given, str) else tuple(given)
    for name in names:
        if name not in NAMES:
            raise InputError(
                f"record={name!r} is nothing that a run adds up over its steps."
                f"{did_you_mean(str(name), NAMES)}\nPass record='work', or reduce= for values of "
                "states."
            )
    if program.header.conservative:  # no force does work
        return ()
    if names:
        check_work(program)
    return tuple(dict.fromkeys(names))


def check_work(program: Program) -> None:
    """Refuse the work of forces over steps that have no nodes.

    Raises
    ------
    InputError
    """
    if "work" not in program.header.functions:
        raise InputError(
            f"{program.scheme} is explicit: its steps have no nodes at which forces do work.\n"
            "Integrate with a scheme of the family, as 'simpson' or 'gauss8'."
        )


def recorders_of(
    header: Header,
    variations: int | None,
    record: Sequence[str],
    reductions: Sequence[Reduction],
    more: Sequence[Recorder] = (),
) -> tuple[Recorder, ...]:
    """Return the recorders of a run that carries so many variations along, or none."""
    carried = (*more, *(() if variations is None else (tangents(header, variations),)))
    named = tuple(work(header) for _ in record)
    first = header.rows + sum(one.room for one in (*carried, *named))
    return *carried, *named, *observers(header, reductions, first)
