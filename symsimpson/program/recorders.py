"""Recorders: kernels that are called behind each step, rows that they leave beside states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from symsimpson.errors import reject
from symsimpson.support.array_types import Ints, Reals
from symsimpson.text.header import Header
from symsimpson.text.workspace_layout import DRIVER_LAYOUT


@dataclass(frozen=True)
class Recorder:
    """A kernel that is called behind each step."""

    kernel: str
    first: int = 0  #: The first row that it leaves to be stored with states.
    rows: int = 0  #: Number of these rows.
    room: int = 0  #: Rows of the workspace that it needs behind those of the module.
    text: str = ""  #: The text of the kernel, where it is none of the module's.
    #: Whether it gets the time of the state, not that of the step that led there.
    of_states: bool = False
    #: Whether it looks for events before all others are called, and may stop the run.
    of_events: bool = False
    #: How many variations are made orthonormal, and after how many steps.
    renewed: int = 0
    renewal: int = 1
    name: str = ""  #: What users call what it leaves, as in ``run.recorded[name]``.


def clock(header: Header) -> Recorder:
    """Return the recorder of the physical time, for steps that are uniform in another time."""
    return Recorder("clock", header.layout["TIME"], rows=1)


def tangents(header: Header, count: int) -> Recorder:
    """Return the recorder of so many variations, columns of the derivative of the state."""
    room = count * (3 * header.n + header.layout["UNKNOWNS"])
    return Recorder("tangent", header.rows, 2 * header.n * count, room)


def growth(header: Header, count: int, every: int) -> Recorder:
    """Return the recorder of Lyapunov exponents: variations made orthonormal after ``every`` steps.

    It leaves how often that was done, MEGNO, SALI, the sums of ln R_jj, and GALI of two and more.
    """
    room, rows = tangents(header, count).room, 2 * count + 2
    whole = room + rows + 2 + 2 * count**2 + 2 * header.n
    return Recorder("tangent", header.rows + room, rows, whole, renewed=count, renewal=every)


def tape(header: Header) -> Recorder:
    """Return the recorder of whole steps, states and control points, for the adjoint."""
    rows = 4 * header.n + header.layout["UNKNOWNS"]
    return Recorder("record", header.rows, rows, rows)


def work(header: Header, first: int = 0) -> Recorder | None:
    """Return the recorder of the work of forces; None for a conservative system.

    The module has rows for it: the ``first`` free row is not used. Raises InputError if the scheme
    is explicit: its steps have no nodes.
    """
    if header.conservative:
        return None
    if "work" not in header.functions:
        reject(
            f"{header.scheme} is explicit: its steps have no nodes at which forces do work.",
            remedy="Integrate with a scheme of the family, as 'simpson' or 'gauss8'.",
        )
    return Recorder("work", header.layout["WORK"], header.powers, name="work")


#: What users may ask for by name; made of a header and the first row that is free. All rows are 0
#: at the start: they hold sums, and behind them what rounding has taken from each sum.
NAMED: dict[str, Callable[[Header, int], Recorder | None]] = {"work": work}


def with_clock(header: Header, recorders: Sequence[Recorder]) -> tuple[Recorder, ...]:
    """Add the clock of retimed steps, and return all in their order: first events, last states."""
    first = (clock(header),) if header.retimed else ()
    return tuple(
        sorted((*first, *recorders), key=lambda recorder: recorder.of_states - recorder.of_events)
    )


def split(
    recorders: Sequence[Recorder], recorded: Reals, n: int
) -> tuple[Reals | None, dict[str, Reals]]:
    """Split what was recorded at states: variations, shape (..., 2 n, k), and rows by their names.

    The variations are None unless :func:`tangents` recorded them; rows without a name are left out.
    """
    variations, named, first = None, dict[str, Reals](), 0
    for recorder in recorders:
        rows = recorded[..., first : first + recorder.rows]
        first += recorder.rows
        if recorder.kernel == "tangent" and not recorder.renewed:
            variations = rows.reshape(*rows.shape[:-1], -1, 2 * n).swapaxes(-1, -2)
        elif recorder.name:
            named[recorder.name] = rows
    return variations, named


def driver_layout(header: Header, recorders: Sequence[Recorder]) -> Ints:
    """Return the layout for the driver, of a module and of the recorders of a run.

    Behind the places of DRIVER_LAYOUT stand the first row and the number of rows of each recorder.
    """
    numbers = header.driver_layout.copy()
    numbers[DRIVER_LAYOUT["OF_EVENTS"]] = sum(recorder.of_events for recorder in recorders)
    numbers[DRIVER_LAYOUT["OF_STATES"]] = sum(recorder.of_states for recorder in recorders)
    for entry in recorders:
        if entry.renewed:
            numbers[DRIVER_LAYOUT["GROWN"]] = entry.first
            numbers[DRIVER_LAYOUT["RENEWED"]] = entry.renewed
            numbers[DRIVER_LAYOUT["RENEWAL"]] = entry.renewal
    stored = [number for x in recorders if x.rows for number in (x.first, x.rows)]
    return np.array([*numbers, *stored], dtype=np.int64)
