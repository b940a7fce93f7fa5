"""Searches for paths between two boundaries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import SymsimpsonError, reject
from symsimpson.program.input_values import read_count
from symsimpson.study.orbits.boundary_path import Path
from symsimpson.study.orbits.conditions import read_conditions
from symsimpson.study.orbits.find import (
    SEGMENTS,
    OrbitArguments,
    check_freedom,
    check_system,
    make_flow,
    read_number,
)
from symsimpson.study.orbits.integrals import Integrals
from symsimpson.study.orbits.search import Search
from symsimpson.study.orbits.shooting import OrbitUnknowns, Shooting
from symsimpson.support.array_types import Floats


def find_path(
    stepper: Stepper, tools: Any, ends: tuple[Any, Any], duration: Any, steps: Any, run: Any
) -> Path:
    """Search for a path between two boundaries; see :meth:`Stepper.boundary`."""
    check_system(stepper)
    if stepper.program.header.retimed:
        reject(
            "boundaries of retimed systems are not available.",
            where=stepper.system,
            remedy="Use the system without the time transformation.",
        )
    (parameters, t0), n = run, stepper.n
    values = [_end_values(stepper, f"q{k}", x) for k, x in enumerate(ends)]
    free = duration is None
    steps = read_count("steps", 64 if steps is None else steps, least=1)
    segments = SEGMENTS if steps % SEGMENTS == 0 else 1
    places = [np.array([x.get(k, 0.0) for k in range(n)]) for x in values]
    period = _time_scale(stepper, places[0], run) if free else read_number("duration", duration)
    parts = np.arange(SEGMENTS)[:, None] / SEGMENTS
    line = places[0] + parts * (places[1] - places[0])
    slope = (places[1] - places[0]) / period
    options = {"h": 1.0, "steps": 0, "parameters": parameters, "t0": t0}
    p = np.array([stepper.integrate(q, v0=slope, **options).p[0] for q in line])
    states = np.concatenate([line, p], axis=1)
    given = OrbitArguments(line[0], None, p[0], parameters=parameters, t0=t0)
    constant = None if free else (lambda _: (period, np.zeros(0)))
    flow = make_flow(stepper, given, None, (), steps, constant, period)
    flow = replace(flow, segments=segments)
    conditions = [
        read_conditions(flow, f"q{k}", _as_mapping(stepper, x)) for k, x in enumerate(ends)
    ]
    scale = np.repeat([abs(states[:, :n]).max() or 1.0, abs(states[:, n:]).max() or 1.0], n)
    none = Integrals(False, (), timeless=False)
    shooting = Shooting(flow, None, conditions[0], none, scale, period, last=conditions[1])
    check_freedom(stepper, shooting)
    search = Search(stepper, shooting, (), given, symplectic=False, tools=tools)
    table = states if segments > 1 else states[:1]
    point = OrbitUnknowns(table, period, flow.spec.parameters, np.zeros(0), np.zeros(0))
    return search.path(shooting.solve(point))


def _time_scale(stepper: Stepper, q: Floats, run: Any) -> float:
    """Return 1 over the fastest rate of the motion near a position at rest."""
    (parameters, t0), system = run, stepper.program.declared
    assert system is not None
    try:
        A, _ = system.linearise(q, np.zeros(stepper.n), parameters=parameters, t=float(t0))
        rate = float(abs(np.linalg.eigvals(A)).max())
    except SymsimpsonError:
        rate = 0.0
    if not rate > 0:
        reject(
            "nothing determines a guess of the duration.",
            where=stepper.system,
            remedy="Pass duration=, and vary it.",
        )
    return 1 / rate


def _as_mapping(stepper: Stepper, given: Any) -> Mapping[Any, Any]:
    """Return conditions on positions as a mapping."""
    if isinstance(given, Mapping):
        return given
    numbers = np.asarray(given, dtype=np.float64)
    if numbers.shape != (stepper.n,):
        reject(
            f"a boundary has shape {numbers.shape}, expected ({stepper.n},).",
            where=stepper.system,
            remedy="Pass a number for each coordinate, or a mapping.",
        )
    return dict(zip(stepper.coordinates, numbers.tolist(), strict=True))


def _end_values(stepper: Stepper, what: str, given: Any) -> dict[int, float]:
    """Return the numbers that are given for coordinates, by place."""
    names = stepper.program.names.coordinates
    pairs = ((names.place(key), x) for key, x in _as_mapping(stepper, given).items())
    return {k: float(x) for k, x in pairs if k is not None and isinstance(x, Real)}
