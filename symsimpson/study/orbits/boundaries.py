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
    momenta,
    read_number,
    scale_of,
)
from symsimpson.study.orbits.integrals import Integrals
from symsimpson.study.orbits.search import Search
from symsimpson.study.orbits.shooting import OrbitUnknowns, Shooting
from symsimpson.support.array_types import Floats


def find_path(
    tools: Any, stepper: Stepper, ends: tuple[Any, Any], duration: Any, steps: Any, run: Any
) -> Path:
    """Search for a path between two boundaries; see :meth:`Stepper.boundary`."""
    check_system(stepper)
    if stepper.program.header.retimed:
        reject(
            "boundaries of retimed systems are not available.",
            where=stepper.system,
            remedy="Use the system without the time transformation.",
        )
    given, none = OrbitArguments(parameters=run[0], t0=run[1]), np.zeros(0)
    steps = read_count("steps", 64 if steps is None else steps, least=1)
    both = [_as_mapping(stepper, x) for x in ends]
    first, final = (_end_values(stepper, x) for x in both)
    free = duration is None
    period = _time_scale(stepper, first, given) if free else read_number("duration", duration)
    segments = SEGMENTS if steps % SEGMENTS == 0 else 1
    q = first + np.arange(SEGMENTS)[:, None] / SEGMENTS * (final - first)
    p = momenta(stepper, q, np.tile((final - first) / period, (SEGMENTS, 1)), given)
    given, states = replace(given, q0=q[0], p0=p[0]), np.concatenate([q, p], axis=1)
    constant = None if free else (lambda _: (period, none))
    flow = replace(make_flow(stepper, given, (), steps, constant, period), segments=segments)
    conditions = [read_conditions(flow, f"q{k}", x) for k, x in enumerate(both)]
    integrals, scale = Integrals(False, (), timeless=False), scale_of(states)
    shooting = Shooting(flow, None, conditions[0], integrals, scale, period, none, conditions[1])
    check_freedom(stepper, shooting)
    search = Search(stepper, shooting, given, symplectic=False, tools=tools)
    start = OrbitUnknowns(states[:segments], period, flow.spec.parameters, none, none)
    return search.path(shooting.solve(start))


def _time_scale(stepper: Stepper, q: Floats, given: OrbitArguments) -> float:
    """Return 1 over the fastest rate of the motion near a position at rest."""
    system, at_rest = stepper.program.declared, np.zeros(stepper.n)
    assert system is not None
    try:
        A, _ = system.linearise(q, at_rest, parameters=given.parameters, t=float(given.t0))
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


def _end_values(stepper: Stepper, given: Mapping[Any, Any]) -> Floats:
    """Return the numbers that are given for coordinates; others are 0."""
    names, values = stepper.program.names.coordinates, np.zeros(stepper.n)
    for key, x in given.items():
        if isinstance(x, Real) and names.place(key) is not None:
            values[names.place(key)] = x
    return values
