"""Continuation of orbits in arclength."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, NoReturn

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count
from symsimpson.study.orbits.boundary_path import ENERGY, PERIOD
from symsimpson.study.orbits.conditions import Condition
from symsimpson.study.orbits.find import read_search
from symsimpson.study.orbits.orbit import Family, Orbit
from symsimpson.study.orbits.outcome import FamilyStatus
from symsimpson.study.orbits.search import Search
from symsimpson.study.orbits.shooting import OrbitUnknowns, Solution, Sweep
from symsimpson.support.array_types import Floats
from symsimpson.support.interpreter import catch_interrupts
from symsimpson.support.names import did_you_mean, spelled
from symsimpson.support.progress import Progress

#: Numbers of Newton iterations at which the step keeps its length, and the most.
USUAL_ITERATIONS, MOST_ITERATIONS = 4, 10
#: Largest turn of the tangent between neighbours, and largest distance from the prediction.
LARGEST_TURN, FROM_PREDICTION = np.cos(np.radians(30)), 0.3
#: Singular values of the equations below this part of the largest one are zeros.
RANK = 1e-8
#: The number of steps is doubled if unfolding or trivial multipliers exceed this, or the period
#: grew by this factor, up to this number.
UNFOLDED, TRIVIAL, LONGER, MOST_STEPS = 1e-11, 1e-6, 1.5, 2**14
#: The scale follows the orbits if their size changed by this factor.
GREW = 1.3
#: An orbit that is this much smaller than the largest one of the family is an equilibrium.
VANISHING = 1e-3
#: A symmetry is free if the conditions leave this part of its direction.
FREE = 1e-6
#: The shortest step.
SHORTEST = 1e-8


class Course(NamedTuple):
    """The orbits along a family, the directions there, and why the family ended."""

    orbits: tuple[Orbit, ...]
    tangents: tuple[Floats, ...]
    status: FamilyStatus
    search: Search


def _extent(orbit: Orbit) -> float:
    """Return the largest range of a coordinate over an orbit."""
    return float(np.ptp(orbit.trajectory.q, axis=0).max())


def _passed_equilibrium(before: Orbit, after: Orbit) -> bool:
    """Return whether an orbit lies on the other side of an equilibrium, half a period later."""
    starts = []
    for orbit in (before, after):
        run = orbit.trajectory
        states = np.concatenate([run.q, run.p], axis=1) / orbit.search.shooting.scale
        starts.append(states[0] - states[:-1].mean(axis=0))
    return bool(starts[0] @ starts[1] < 0)


class Continuation:
    """The steps of a family along one quantity, from an orbit."""

    def __init__(self, search: Search, parameter: str, orbit: Orbit) -> None:
        stepper, given = search.stepper, search.given
        self.name = parameter
        fixed = {k: v for k, v in (given.fixed or {}).items() if spelled(k) != parameter}
        unknowns = (
            given.unknowns if isinstance(given.unknowns, (tuple, list)) else (given.unknowns,)
        )
        if parameter in stepper.parameters:
            if parameter not in map(spelled, unknowns):
                unknowns = (*unknowns, parameter)
        elif parameter not in (ENERGY, PERIOD):
            known = (ENERGY, PERIOD, *stepper.parameters)
            reject(
                f"a family along {parameter!r} is unknown.{did_you_mean(parameter, known)}",
                where=stepper.system,
                remedy=f"Choose from {', '.join(known)}.",
            )
        period = given.period if search.flow.period_of is not None else orbit.period
        arguments = replace(
            given,
            q0=orbit.q0,
            v0=None,
            p0=orbit.p0,
            guess=None,
            mode=None,
            error=None,
            period=period,
        )
        arguments = replace(
            arguments,
            steps=orbit.steps,
            fixed=fixed,
            unknowns=tuple(unknowns),
            parameters=search.free_parameters(orbit),
        )
        self.arguments = arguments
        self.search, self.start = read_search(
            stepper, arguments, search.tools, search.shooting.integrals
        )
        names = self.search.shooting.closing.symbols if self.search.shooting.closing else ()
        extra = np.array([orbit.unknowns[str(x)] for x in names], dtype=np.float64)
        self.start = replace(self.start, extra=extra)
        self._resolved_period = orbit.period
        self.first = self.search.shooting.sweep(self.start)
        #: Number of unknowns that the rows leave free; conditions may follow from one another.
        self.freedom = self.search.shooting.columns - self._rank(self.first)
        if self.freedom < 1:
            reject(
                f"the conditions leave no family along {parameter}.",
                where=stepper.system,
                remedy="Search with fewer conditions in fixed=, or with an unknown more.",
            )
        self._target = Condition(parameter, 0.0) if parameter in (ENERGY, PERIOD) else None

    # -- geometry

    def at(self, orbit: Orbit) -> Continuation:
        """Return the continuation with the scale and the steps of an orbit."""
        line = copy.copy(self)
        flow = replace(self.search.flow, steps=orbit.search.flow.steps)
        line.search = replace(self.search, shooting=self.search.shooting.with_flow(flow)).scaled_to(
            orbit
        )
        return line

    def _rank(self, sweep: Sweep) -> int:
        """Return the rank of the equations."""
        sizes = np.linalg.svd(sweep.matrix, compute_uv=False)
        return int(np.count_nonzero(sizes > RANK * sizes[0]))

    def value(self, point: OrbitUnknowns) -> float:
        """Return the quantity that changes."""
        flow = self.search.flow
        if self.name == ENERGY:
            return float(flow.energy(point.states[:1], point.values)[0])
        if self.name == PERIOD:
            return point.period * (2 if self.search.mirror is not None else 1)
        return float(point.values[self.search.stepper.parameters.index(self.name)])

    def scaled(self, point: OrbitUnknowns) -> Floats:
        """Return the unknowns in scaled units."""
        shooting = self.search.shooting
        return shooting.pack(point) / shooting.units

    def distance(self, first: Orbit, second: Orbit) -> float:
        """Return the distance of two orbits of the family."""
        ends = [self.scaled(self.search.point_of(x)) for x in (first, second)]
        return float(np.linalg.norm(ends[1] - ends[0]))

    def phases(self, sweep: Sweep) -> Floats:
        """Return as many rows along symmetries as are missing beside the row of the family."""
        shooting = self.search.shooting
        rows, missing = shooting.phases(sweep), self.freedom - 1
        if missing == 0:
            return rows[:0]
        null = np.linalg.svd(sweep.matrix)[2][len(rows[0]) - self.freedom :]
        left, chosen = rows @ null.T, list[int]()
        for _ in range(missing):  # those that the conditions restrict least
            sizes = np.linalg.norm(left, axis=1)
            place = int(np.argmax(sizes)) if len(sizes) else 0
            if not len(sizes) or sizes[place] < FREE:
                self._reject_freedom(missing - len(chosen))
            unit = left[place] / sizes[place]
            left = left - np.outer(left @ unit, unit)
            chosen.append(place)
        return np.asarray(rows[chosen])

    def _reject_freedom(self, count: int) -> NoReturn:
        reject(
            f"the conditions leave {count} more quantities free than {self.name}.",
            where=self.search.stepper.system,
            remedy="Search with more conditions in fixed=, which hold for the whole family.",
        )

    def unit(self, direction: Floats) -> Floats:
        """Return a direction in scaled units, of unit length."""
        scaled = direction / self.search.shooting.units
        return np.asarray(scaled / (np.linalg.norm(scaled) or 1.0))

    def tangent(self, sweep: Sweep, before: Floats | None) -> Floats:
        """Return the direction of the family in scaled units, of unit length."""
        matrix = np.concatenate([sweep.matrix, self.phases(sweep)])
        _, _, basis = np.linalg.svd(matrix)
        direction = basis[-1]
        if before is not None:
            return np.asarray(direction if direction @ before >= 0 else -direction)
        return np.asarray(direction)

    def ahead(self, point: OrbitUnknowns, tangent: Floats, length: float) -> OrbitUnknowns:
        """Return the point at a distance along the tangent."""
        shooting = self.search.shooting
        return shooting.moved(point, length * tangent * shooting.units)

    def correct(self, sweep: Sweep, tangent: Floats, length: float) -> Solution:
        """Solve the equations beside a prediction, at a distance along the tangent."""
        guess = self.ahead(sweep.point, tangent, length)
        rows = np.concatenate([self.phases(sweep), tangent[None]])
        at = self.scaled(guess)

        def more(y: Floats) -> tuple[Floats, Floats]:
            return rows @ (y - at), rows

        return self.search.shooting.solve(guess, more, MOST_ITERATIONS)

    def at_value(self, start: OrbitUnknowns, value: float) -> Solution:
        """Solve the equations where the quantity has a value."""
        shooting, place = self.search.shooting, None
        if self._target is not None:
            condition = replace(self._target, value=value)
            with_value = replace(shooting, conditions=(*shooting.conditions, condition))
            return replace(self.search, shooting=with_value).shooting.solve(start)
        places = self.search.flow.places
        place = [self.search.stepper.parameters.index(self.name) == k for k in places].index(True)
        column = shooting.flow.segments * 2 * shooting.flow.n + shooting.flow.free_period + place
        row = np.zeros((1, shooting.columns))
        row[0, column] = 1.0
        unit = shooting.units[column]
        return shooting.solve(start, lambda y: (row @ y - value / unit, row))

    def rate(self, orbit: Orbit, change: Floats) -> float:
        """Return the derivative of the quantity that changes along a direction."""
        flow = self.search.flow
        if self.name == ENERGY:
            z = np.concatenate([orbit.q0, orbit.p0])
            return float(flow.energy_gradient(z, orbit.values) @ change[: 2 * flow.n])
        column = flow.segments * 2 * flow.n
        if self.name == PERIOD:
            return float(change[column])
        places = [self.search.stepper.parameters.index(self.name) == k for k in flow.places]
        return float(change[column + flow.free_period + places.index(True)])

    # -- the family

    def run(
        self,
        to: float | None,
        count: int,
        step: float,
        largest: float,
        tangent: Floats | None,
        progress: bool | None,
    ) -> Course:
        """Take up to ``count`` steps along the family."""
        first = self.search.shooting.solve(self.start)
        sweep, orbit = first.sweep, self.search.orbit(first)
        if not orbit.success:
            return Course((orbit,), (np.zeros(0),), FamilyStatus.STEP_FAILED, self.search)
        begun = self.value(sweep.point)
        direction = self.tangent(sweep, None if tangent is None else self.unit(tangent))
        if tangent is None:
            rate = self.value(self.ahead(sweep.point, direction, 1e-6)) - begun
            forward = np.sign(to - begun) if to is not None else np.sign(step)
            direction = direction if rate * forward >= 0 else -direction
        orbits, length, largest_orbit = [orbit], abs(step), _extent(orbit)
        tangents = [direction * self.search.shooting.units]
        status = FamilyStatus.COUNT
        with Progress(count, progress, "orbit") as bar, catch_interrupts() as stopped:
            while len(orbits) <= count:
                bar.say(f"{self.name} = {self.value(sweep.point):.6g}")
                bar.add(1)
                length, solution, following = self._step(sweep, direction, length)
                if stopped:
                    status = FamilyStatus.INTERRUPTED
                    break
                if solution is None or following is None:
                    status = self._end(sweep)
                    break
                value, before = self.value(solution.sweep.point), self.value(sweep.point)
                if to is not None and (value - to) * (before - to) <= 0:
                    last = self.at_value(solution.sweep.point, to)
                    orbits.append(self.search.orbit(last if last.converged else solution))
                    tangents.append(following * self.search.shooting.units)
                    status = FamilyStatus.REACHED
                    break
                sweep, direction = solution.sweep, following
                latest = self.search.orbit(solution)
                largest_orbit = max(largest_orbit, _extent(latest))
                small = _extent(latest) < VANISHING * largest_orbit
                if small or _passed_equilibrium(orbits[-1], latest):
                    status = FamilyStatus.EQUILIBRIUM
                    break
                orbits.append(latest)
                tangents.append(direction * self.search.shooting.units)
                sweep = self._refine(sweep, orbits)
                direction = self.unit(tangents[-1])
                if self._returned(first.sweep, sweep, tangents, length):
                    status = FamilyStatus.CLOSED
                    break
                length = self._next_length(solution, length, largest)
        return Course(tuple(orbits), tuple(tangents), status, self.search)

    def _refine(self, sweep: Sweep, orbits: list[Orbit]) -> Sweep:
        """Take the scale of the last orbit, and double its steps if needed; solve it again."""
        orbit, flow = orbits[-1], self.search.flow
        coarse = orbit.unfolding > UNFOLDED or not orbit.trivial < TRIVIAL
        longer = flow.free_period and orbit.period > LONGER * self._resolved_period
        finer_steps = (coarse or longer) and flow.steps <= MOST_STEPS // 2 and not flow.to_event
        scaled = self.search.scaled_to(orbit)
        change = np.log(scaled.shooting.scale / self.search.shooting.scale)
        if not finer_steps and abs(change).max() < np.log(GREW):
            return sweep
        self.search = scaled
        if finer_steps:
            self.search, self._resolved_period = self.search.refined(2), orbit.period
        finer = self.search.shooting.solve(sweep.point)
        if not finer.converged:
            return sweep
        orbits[-1] = self.search.orbit(finer)
        return finer.sweep

    def _step(
        self, sweep: Sweep, tangent: Floats, length: float
    ) -> tuple[float, Solution | None, Floats | None]:
        """Take one step, shorter if necessary; return its length, solution and new tangent."""
        while length >= SHORTEST:
            solution = self.correct(sweep, tangent, length)
            if solution.interrupted:
                return length, None, None
            if solution.converged:
                moved = self.scaled(solution.sweep.point) - self.scaled(sweep.point)
                beside = np.linalg.norm(moved - length * tangent)
                following = self.tangent(solution.sweep, tangent)
                if beside <= FROM_PREDICTION * length and following @ tangent >= LARGEST_TURN:
                    return length, solution, following
            length /= 2
        return length, None, None

    def _next_length(self, solution: Solution, length: float, largest: float) -> float:
        faster = 2.0 ** ((USUAL_ITERATIONS - len(solution.corrections)) / 3)
        return float(min(length * min(2.0, faster), largest))

    def _end(self, sweep: Sweep) -> FamilyStatus:
        """Return why no further orbit was found."""
        failed = sweep.failure is not None
        return FamilyStatus.STEP_FAILED if failed else FamilyStatus.STEP_TOO_SMALL

    def _returned(
        self, first: Sweep, sweep: Sweep, tangents: Sequence[Floats], length: float
    ) -> bool:
        """Return whether the family passes its first orbit in the same direction."""
        gap = self.scaled(first.point) - self.scaled(sweep.point)
        close = np.linalg.norm(gap) < length and len(tangents) > 4
        return bool(close and self.unit(tangents[0]) @ self.unit(tangents[-1]) > LARGEST_TURN)


def follow(
    orbit: Orbit,
    parameter: Any,
    to: float | None,
    count: Any,
    step: float,
    largest: float,
    progress: bool | None,
) -> Family:
    """Follow a family from an orbit; see :meth:`Orbit.family`."""
    if not orbit.success:
        reject(
            f"this orbit was not found: {orbit.status.name}.",
            where=orbit.search.stepper.system,
            remedy="A family begins at an orbit whose success is True.",
        )
    continuation = Continuation(orbit.search, spelled(parameter), orbit)
    count = read_count("count", count, least=1)
    course = continuation.run(to, count, step, largest, None, progress)
    return Family(course.orbits, continuation.name, course.status, course.tangents, course.search)


def extend(family: Family, to: float | None, count: int) -> Family:
    """Continue a family beyond its last orbit; see :meth:`Family.extend`."""
    last = Continuation(family.search, family.parameter, family.orbits[-1])
    step = 0.01
    if len(family) > 1:
        step = last.distance(family.orbits[-2], family.orbits[-1])
    tangent = family.tangents[-1] if len(family) > 1 else None
    course = last.run(to, count, step, 10 * step, tangent, None)
    return Family(
        (*family.orbits, *course.orbits[1:]),
        family.parameter,
        course.status,
        (*family.tangents, *course.tangents[1:]),
        course.search,
    )
