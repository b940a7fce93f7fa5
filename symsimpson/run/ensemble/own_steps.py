"""Ensembles whose members have step sizes and initial times of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import FLOAT64
from symsimpson.program.program import Program
from symsimpson.run.ensemble.ensemble import Ensemble
from symsimpson.run.ensemble.members import EnsembleSpec
from symsimpson.stepping.request import Request
from symsimpson.support.array_types import Floats, Ints

#: Fields of an ensemble with a row for each member, and mappings to such arrays.
ROWS = (
    *("q", "p", "status", "steps", "newton_iterations"),
    *("variations", "tau", "ended_at", "small_pivots"),
)
MAPPINGS = ("parameters", "reduced", "initial", "recorded")


def has_own_steps(request: Request) -> bool:
    """Return whether a request has a step size or an initial time for each member."""
    return np.ndim(request.h) > 0 or np.ndim(request.t0) > 0


def read_own_steps(program: Program, request: Request) -> tuple[Floats, Floats, Request]:
    """Read h and t0 of the members, and return them with a request for the first member's steps.

    Raises InputError if their shapes differ, or if the request has what needs common steps.
    """
    for name in ("t_end", "inputs"):
        if getattr(request, name) is not None:
            reject(
                f"{name} cannot be combined with a step size or an initial time for each member.",
                where=program.system,
                remedy="Pass steps=, and run members with inputs one by one.",
            )
    if program.header.retimed or program.header.carried:
        reject(
            "members of this system need a common step size and initial time.",
            where=program.system,
            remedy="Pass numbers for h and t0, or run the members one by one.",
        )
    h, t0 = (np.atleast_1d(read_array(x, getattr(request, x), FLOAT64)) for x in ("h", "t0"))
    count = max(h.size, t0.size)
    if not all(x.shape in ((1,), (count,)) for x in (h, t0)):
        reject(
            f"h has shape {h.shape} and t0 has shape {t0.shape}.",
            where=program.system,
            remedy="Pass a number, or an array with one number for each member.",
        )
    h, t0 = np.broadcast_arrays(h, t0)
    return h, t0, request._replace(h=h.item(0), t0=t0.item(0))


def run_groups(
    program: Program, task: EnsembleSpec, steps: tuple[Floats, Floats], run: Callable[..., Ensemble]
) -> Ensemble:
    """Run members with equal steps together, and merge the results in the order of the members."""
    h, t0 = steps
    count = max(task.members, len(h))
    if {task.members, len(h)} - {1, count}:
        reject(
            f"h and t0 have {len(h)} members, but another argument has {task.members}.",
            where=program.system,
            remedy="Pass one number for each member, or one for all.",
        )
    if task.members < count:
        task = task.part(np.zeros(count, dtype=np.int64))
    pairs = np.broadcast_to(np.stack([h, t0], axis=1), (count, 2))
    kinds, place = np.unique(pairs, axis=0, return_inverse=True)
    groups = [np.flatnonzero(place.ravel() == k) for k in range(len(kinds))]
    tasks = [
        replace(task.part(group), h=h, t0=t0)
        for group, (h, t0) in zip(groups, kinds.tolist(), strict=True)
    ]
    return _merge([run(x) for x in tasks], groups)


def _merge(parts: Sequence[Ensemble], groups: Sequence[Ints]) -> Ensemble:
    """Return one ensemble with the members ``groups`` of several ones."""
    first, order = parts[0], np.argsort(np.concatenate(groups))

    def rows(several: Sequence[Any]) -> Any:
        return np.concatenate(several)[order]

    known = [name for name in ROWS if getattr(first, name) is not None]
    fields = {name: rows([getattr(x, name) for x in parts]) for name in known}
    for name in MAPPINGS:
        several = [getattr(x, name) for x in parts]
        fields[name] = {key: rows([x[key] for x in several]) for key in several[0]}
    times = first.q.shape[1:-1]
    fields["t"] = rows([np.broadcast_to(np.squeeze(x.t), (len(x), *times)) for x in parts])
    records = {
        int(group[k]): record
        for x, group in zip(parts, groups, strict=True)
        for k, record in x.records.items()
    }
    return replace(first, records=records, driven=None, **fields)
