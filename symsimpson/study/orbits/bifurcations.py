"""Bifurcations along a family, and the first orbit of the family that branches off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.study.orbits.continuation import Continuation
from symsimpson.study.orbits.find import read_search
from symsimpson.study.orbits.orbit import Bifurcation, Family, Orbit
from symsimpson.study.orbits.outcome import FamilyStatus
from symsimpson.study.orbits.search import Search
from symsimpson.study.orbits.shooting import Solution, Sweep
from symsimpson.support.array_types import Floats
from symsimpson.support.extras import import_library
from symsimpson.support.names import as_tuple

#: Tolerance of a bifurcation, and distance of another family's first orbit, in scaled units.
PLACE, BESIDE = 1e-13, 0.004

FOLD, BRANCH, DOUBLING = "fold", "branch point", "period doubling"
KREIN, TORUS, RESONANCE = "Krein collision", "torus", "resonance"


def find_bifurcations(family: Family) -> tuple[Bifurcation, ...]:
    """Find all bifurcations between neighbouring orbits of a family."""
    return _crossings(family, _tests(family)) if len(family) > 1 else ()


def find_resonances(family: Family, a: int, b: int) -> tuple[Bifurcation, ...]:
    """Find the orbits with a multiplier exp(2 pi i a/b)."""
    return _crossings(family, {RESONANCE: _passes(float(np.cos(2 * np.pi * a / b)))})


#: A function of an orbit and the rate of the quantity that changes.
Test = Callable[[Orbit, float], float]


def _tests(family: Family) -> dict[str, Test]:
    """Return the test functions by kind; folds come first."""
    tests: dict[str, Test] = {FOLD: lambda orbit, rate: rate}
    if family.search.symplectic:
        tests |= {BRANCH: _passes(1.0), DOUBLING: _passes(-1.0)}
        if len(family[0].stability_indices) > 1:
            # negative if a pair is complex
            tests[KREIN] = _of_pairs("stability_indices", lambda a, b: (a - b) ** 2)
        return tests
    size = len(family[0].derivative)
    tests[DOUBLING] = lambda orbit, rate: float(np.linalg.det(orbit.derivative + np.eye(size)))
    if not family.search.shooting.integrals.timeless:
        tests[BRANCH] = lambda orbit, rate: float(np.linalg.det(orbit.derivative - np.eye(size)))
    tests[TORUS] = _of_pairs("multipliers", lambda a, b: a * b - 1)  # 0 for a pair on the circle
    return tests


def _passes(value: float) -> Test:
    """Return the product of the distances of all stability indices from a value."""
    return lambda orbit, rate: float(np.prod(orbit.stability_indices - value).real)


def _of_pairs(values: str, term: Callable[[Any, Any], Any]) -> Test:
    """Return the product of a term over all pairs of stability indices, or of multipliers."""
    return lambda orbit, rate: float(
        np.prod([term(a, b) for a, b in combinations(getattr(orbit, values), 2)]).real
    )


def _crossings(family: Family, tests: dict[str, Test]) -> tuple[Bifurcation, ...]:
    """Locate the zeros of test functions between neighbours."""
    line, places = Continuation(family.search, family.parameter, family[0]), list[Bifurcation]()
    pairs = [*zip(family.orbits, family.tangents, strict=True)]
    rates = [line.rate(line.search.point_of(x), tangent) for x, tangent in pairs]
    for kind, test in tests.items():
        values = [test(x, rate) for x, rate in zip(family.orbits, rates, strict=True)]
        for k in range(len(family) - 1):
            turns = rates[k] * rates[k + 1] < 0
            if not values[k] * values[k + 1] < 0 or (kind == BRANCH and turns):
                continue
            here = line.at(family[k])
            if (place := _locate(family, here, k, test)) is not None:
                solution, tangent = place
                orbit = here.search.orbit(solution)
                direction = _direction(here, solution.sweep, tangent, kind, orbit)
                value = here.value(solution.sweep.point)
                places.append(Bifurcation(kind, value, orbit, direction, k))
    return tuple(places)


def _locate(
    family: Family, line: Continuation, k: int, test: Test
) -> tuple[Solution, Floats] | None:
    """Find the zero of a test function beyond the orbit k."""
    point, shooting = line.search.point_of(family[k]), line.search.shooting
    sweep, before = shooting.sweep(point), line.unit(family.tangents[k])

    def at(length: float) -> tuple[Solution, Floats]:
        solution = line.correct(sweep, before, length)
        return solution, line.tangent(solution.sweep, before)

    def tested(length: float) -> float:
        solution, tangent = at(length)
        orbit = line.search.orbit(solution, examined=False)
        return test(orbit, line.rate(solution.sweep.point, tangent * shooting.units))

    brentq = import_library("scipy.optimize", "locating bifurcations", "control").brentq
    whole = float(line.between(point, line.search.point_of(family[k + 1])) @ before)
    try:
        return at(float(brentq(tested, 0.0, whole, xtol=PLACE * max(1.0, whole))))
    except ValueError:  # the test function changes its sign at a failure
        return None


def _direction(
    line: Continuation, sweep: Sweep, tangent: Floats, kind: str, orbit: Orbit
) -> Floats:
    """Return the direction of the initial state in which other orbits lie."""
    n = 2 * line.search.flow.n
    if kind == BRANCH:
        matrix = np.concatenate([sweep.matrix, line.phases(sweep), tangent[None]])
        return np.asarray(np.linalg.svd(matrix)[2][-1, :n] * line.search.shooting.scale)
    values, vectors = np.linalg.eig(orbit.derivative)
    target = -1.0 if kind == DOUBLING else 1.0
    return np.asarray(vectors[:, np.argmin(abs(values - target))].real)


def other_orbit(family: Family, bifurcation: Bifurcation) -> Orbit:
    """Return an orbit beside a bifurcation, on the family that branches off."""
    if bifurcation.kind not in (BRANCH, DOUBLING):
        reject(
            f"no family branches off at a {bifurcation.kind}.",
            where=family.search.stepper.system,
            remedy="Switch at a branch point or a period doubling.",
        )
    orbit = bifurcation.orbit
    line = Continuation(family.search, family.parameter, family[0]).at(orbit)
    search = line.search if bifurcation.kind == BRANCH else _doubled(line)
    shooting = search.shooting
    start = search.point_of(orbit)
    if shooting.flow.free_period and bifurcation.kind == DOUBLING:
        start = replace(start, period=2 * start.period)
    unit = bifurcation.direction / np.linalg.norm(bifurcation.direction / shooting.scale)
    row = np.zeros((1, shooting.columns))
    row[0, : len(unit)] = unit / shooting.scale
    for side in (BESIDE, -BESIDE):
        states = start.states.copy()
        states[0] += side * unit
        solution = shooting.solve(replace(start, states=states), row)
        if solution.converged:
            break
    return search.orbit(solution)


def _doubled(line: Continuation) -> Search:
    """Return the search for orbits of two periods."""
    given, search = line.arguments, line.search
    if given.events is not None:
        twice = [
            replace(x, terminal=2 * int(x.terminal)) if x.terminal else x
            for x in as_tuple(given.events)
        ]
        given = replace(given, events=twice)
    else:
        given = replace(given, period=2 * given.period, steps=2 * given.steps)
    return read_search(search.stepper, given, search.tools, search.shooting.integrals)[0]


def switch(family: Family, bifurcation: Bifurcation, count: int, options: Any) -> Family:
    """Follow the other family at a bifurcation; see :meth:`Family.switch`."""
    first = other_orbit(family, bifurcation)
    states = np.array([[*x.q0, *x.p0] for x in (first, *family)])
    near = abs(np.diff(states[1:], axis=0)).max(axis=1, initial=0.0)  # empty for a single orbit
    gaps = abs(states[1:] - states[0]).max(axis=1)
    same = gaps.min() < 1e-12 * near[min(bifurcation.place, len(near) - 1)] if len(near) else False
    if same or not first.success:
        status = FamilyStatus.SAME_FAMILY if same else FamilyStatus.STEP_TOO_SMALL
        return Family((first,), family.parameter, status, (np.zeros(0),), first.search)
    return first.family(family.parameter, count=count, **options)
