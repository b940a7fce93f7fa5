"""Recorders: kernels that run after each step and store rows with the states."""

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
    """A kernel that runs after each step, and the rows that it stores with the states."""

    kernel: str
    first: int = 0  #: The first row to store with the states.
    rows: int = 0  #: Number of rows to store.
    room: int = 0  #: Rows of the workspace that the kernel needs in addition to the module's.
    text: str = ""  #: The text of the kernel, if the module does not contain it.
    #: Whether the kernel gets the time of the state, not the time at the start of the step.
    of_states: bool = False
    #: Whether the kernel detects events. It runs before all others, and may stop the run.
    of_events: bool = False
    #: Number of variations to orthonormalise, and number of steps between two times.
    renewed: int = 0
    renewal: int = 1
    name: str = ""  #: The user's name of the rows, as in ``run.recorded[name]``.


def clock(header: Header) -> Recorder:
    """Return the recorder of physical time, for steps of a time transformation."""
    return Recorder("clock", header.layout["TIME"], rows=1)


def tangents(header: Header, count: int) -> Recorder:
    """Return the recorder of ``count`` variations, the columns of the state's derivative."""
    room = count * (3 * header.n + header.layout["UNKNOWNS"])
    return Recorder("tangent", header.rows, 2 * header.n * count, room)


def growth(header: Header, count: int, every: int) -> Recorder:
    """Return the recorder of Lyapunov exponents, which orthonormalises variations periodically.

    ``every`` is the number of steps between two QR factorisations. The rows are the number of
    factorisations, MEGNO, SALI, the sums of ln R_jj, and GALI of two and more variations.
    """
    room, rows = tangents(header, count).room, 2 * count + 2
    whole = room + rows + 2 + 2 * count**2 + 2 * header.n
    return Recorder("tangent", header.rows + room, rows, whole, renewed=count, renewal=every)


def tape(header: Header) -> Recorder:
    """Return the recorder of states and control points of each step, for the adjoint."""
    rows = 4 * header.n + header.layout["UNKNOWNS"]
    return Recorder("record", header.rows, rows, rows)


def work(header: Header) -> Recorder | None:
    """Return the recorder of the work of forces; None for a conservative system.

    Raises InputError if the scheme is explicit, because its steps have no nodes.
    """
    if header.conservative:
        return None
    if "work" not in header.functions:
        reject(
            f"{header.scheme} is explicit: its steps have no nodes at which forces do work.",
            remedy="Integrate with a scheme of the family, such as 'simpson' or 'gauss8'.",
        )
    return Recorder("work", header.layout["WORK"], header.powers, name="work")


#: Recorders by the names of the user. All rows are 0 at the start. They contain sums, and then the
#: round-off error of each sum.
RECORDERS: dict[str, Callable[[Header], Recorder | None]] = {"work": work}


def with_clock(header: Header, recorders: Sequence[Recorder]) -> tuple[Recorder, ...]:
    """Return the recorders in the order of their calls, with the clock of a time transformation.

    Recorders of events come first, and recorders of states last.
    """
    first = (clock(header),) if header.retimed else ()
    return tuple(
        sorted((*first, *recorders), key=lambda recorder: recorder.of_states - recorder.of_events)
    )


def split(
    recorders: Sequence[Recorder], recorded: Reals, n: int
) -> tuple[Reals | None, dict[str, Reals]]:
    """Split the recorded rows into variations, shape (..., 2 n, k), and rows by name.

    The variations are None unless the recorder :func:`tangents` was active. Rows without a name are
    not returned.
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
    """Return the layout of the workspace for the driver, with the recorders of a run.

    The entries of DRIVER_LAYOUT come first. The first row and the number of rows of each recorder
    follow.
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
