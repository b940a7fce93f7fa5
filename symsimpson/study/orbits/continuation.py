"""Continuation of orbits in arclength."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np

from symsimpson.errors import reject
from symsimpson.program.input_values import read_count
from symsimpson.run.state_costs import StateCost
from symsimpson.study.orbits.boundary_path import ENERGY, PERIOD
from symsimpson.study.orbits.conditions import Condition
from symsimpson.study.orbits.find import read_search
from symsimpson.study.orbits.orbit import Family, Orbit
from symsimpson.study.orbits.outcome import FamilyStatus
from symsimpson.study.orbits.search import Search
from symsimpson.study.orbits.shooting import OrbitUnknowns, Solution, Sweep
from symsimpson.support.array_types import Floats
from symsimpson.support.interpreter import catch_interrupts
from symsimpson.support.names import as_tuple, did_you_mean, spelled
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
#: Change of the size at which the scale follows, and size of an equilibrium beside the largest.
GREW, VANISHING = 1.3, 1e-3
#: A symmetry is free if the conditions leave this part of its direction; the shortest step.
FREE, SHORTEST = 1e-6, 1e-8


def _extent(orbit: Orbit) -> float:
    """Return the largest range of a coordinate over an orbit."""
    return float(np.ptp(orbit.trajectory.q, axis=0).max())


def _passed_equilibrium(before: Orbit, after: Orbit) -> bool:
    """Return whether an orbit lies on the other side of an equilibrium, half a period later."""
    first, last = (
        (x.states[0] - x.states[:-1].mean(axis=0)) / x.search.shooting.scale
        for x in (before, after)
    )
    return bool(first @ last < 0)


class Continuation:
    """The steps of a family along one quantity, from an orbit."""

    def __init__(self, search: Search, parameter: str, orbit: Orbit) -> None:
        stepper, given, unknowns = search.stepper, search.given, as_tuple(search.given.unknowns)
        known = (ENERGY, PERIOD, *stepper.parameters)
        if parameter not in known:
            reject(
                f"a family along {parameter!r} is unknown.{did_you_mean(parameter, known)}",
                where=stepper.system,
                remedy=f"Choose from {', '.join(known)}.",
            )
        varied = parameter in stepper.parameters
        if varied and parameter not in map(spelled, unknowns):
            unknowns = (*unknowns, parameter)
        self.name = parameter
        self.arguments = replace(
            given,
            **{"q0": orbit.q0, "v0": None, "p0": orbit.p0, "guess": None, "mode": None},
            period=given.period if search.flow.period_of is not None else orbit.period,
            steps=orbit.steps,
            fixed={k: v for k, v in (given.fixed or {}).items() if spelled(k) != parameter},
            unknowns=unknowns,
            parameters=search.free_parameters(orbit),
            error=None,
        )
        self.search, start = read_search(
            stepper, self.arguments, search.tools, search.shooting.integrals
        )
        self.start = replace(start, extra=self.search.extra(orbit))
        self._resolved_period = orbit.period
        sizes = np.linalg.svd(self.search.shooting.sweep(self.start).matrix, compute_uv=False)
        #: Number of unknowns that the rows leave free; conditions may follow from one another.
        self.freedom = self.search.shooting.columns - int((sizes > RANK * sizes[0]).sum())
        if self.freedom < 1:
            reject(
                f"the conditions leave no family along {parameter}.",
                where=stepper.system,
                remedy="Search with fewer conditions in fixed=, or with an unknown more.",
            )
        program = self.search.flow.program
        cost = StateCost(program, parameter, parameter) if varied else None
        self._quantity = Condition(parameter, 0.0, cost)

    # -- geometry

    def at(self, orbit: Orbit) -> Continuation:
        """Return the continuation with the scale and the steps of an orbit."""
        line = copy.copy(self)
        flow = replace(self.search.flow, steps=orbit.search.flow.steps)
        line.search = self.search.with_flow(flow).scaled_to(orbit)
        return line

    def _row(self, point: OrbitUnknowns) -> tuple[float, Floats]:
        """Return the quantity that changes, and its derivatives."""
        return self._quantity.row(self.search.flow, point.states[0], point.period, point.values)

    def value(self, point: OrbitUnknowns) -> float:
        """Return the quantity that changes."""
        return float(self._row(point)[0])

    def rate(self, point: OrbitUnknowns, change: Floats) -> float:
        """Return the derivative of the quantity that changes along a direction."""
        rows = self.search.shooting.spread(point.values, 0, self._row(point)[1])
        return float(rows[0] @ change)

    def at_value(self, start: OrbitUnknowns, value: float) -> Solution:
        """Solve the equations where the quantity has a value."""
        shooting, condition = self.search.shooting, replace(self._quantity, value=value)
        return replace(shooting, conditions=(*shooting.conditions, condition)).solve(start)

    def phases(self, sweep: Sweep) -> Floats:
        """Return as many rows along symmetries as are missing beside the row of the family."""
        shooting, missing = self.search.shooting, self.freedom - 1
        rows = shooting.phases(sweep)
        if missing == 0:
            return rows[:0]
        null = np.linalg.svd(sweep.matrix)[2][shooting.columns - self.freedom :]
        # those that the conditions restrict least
        weights, sizes, _ = np.linalg.svd(rows @ null.T)
        free = int((sizes[:missing] > FREE).sum())
        if free < missing:
            reject(
                f"the conditions leave {missing - free} of the quantities free beside {self.name}.",
                where=self.search.stepper.system,
                remedy="Search with more conditions in fixed=, which hold for the whole family.",
            )
        return np.asarray(weights[:, :missing].T @ rows)

    def between(self, first: OrbitUnknowns, last: OrbitUnknowns) -> Floats:
        """Return the way from one point to another, in scaled units."""
        scaled = self.search.shooting.scaled
        return scaled(last) - scaled(first)

    def unit(self, direction: Floats) -> Floats:
        """Return a direction in scaled units, of unit length."""
        scaled = direction / self.search.shooting.units
        return np.asarray(scaled / (np.linalg.norm(scaled) or 1.0))

    def tangent(self, sweep: Sweep, before: Floats | None) -> Floats:
        """Return the direction of the family in scaled units, of unit length."""
        direction = np.linalg.svd(np.concatenate([sweep.matrix, self.phases(sweep)]))[2][-1]
        back = before is not None and direction @ before < 0
        return np.asarray(-direction if back else direction)

    def correct(self, sweep: Sweep, tangent: Floats, length: float) -> Solution:
        """Solve the equations beside a prediction, at a distance along the tangent."""
        guess = self.search.shooting.moved(sweep.point, length * tangent)
        across = np.concatenate([self.phases(sweep), tangent[None]])
        return self.search.shooting.solve(guess, across, MOST_ITERATIONS)

    # -- the family

    def run(
        self,
        to: float | None,
        count: Any,
        step: float,
        largest_step: float,
        progress: bool | None = None,
        tangent: Floats | None = None,
    ) -> Family:
        """Take up to ``count`` steps along the family."""
        count = read_count("count", count, least=1)
        first = self.search.shooting.solve(self.start)
        sweep, orbit, status = first.sweep, self.search.orbit(first), FamilyStatus.COUNT
        if not orbit.success:
            status = FamilyStatus.STEP_FAILED
            return Family((orbit,), self.name, status, (np.zeros(0),), self.search)
        value, units = self.value(sweep.point), self.search.shooting.units
        direction = self.tangent(sweep, None if tangent is None else self.unit(tangent))
        if tangent is None:
            forward = step if to is None else to - value
            if self.rate(sweep.point, direction * units) * forward < 0:
                direction = -direction
        orbits, tangents = [orbit], [direction * units]
        length, largest_orbit = abs(step), _extent(orbit)
        with Progress(count, progress, "orbit") as bar, catch_interrupts() as stopped:
            while len(orbits) <= count:
                bar.say(f"{self.name} = {value:.6g}")
                bar.add(1)
                length, solution, following = self._step(sweep, direction, length)
                if stopped or solution is None or following is None:
                    status = FamilyStatus.INTERRUPTED if stopped else FamilyStatus.STEP_TOO_SMALL
                    break
                before, value = value, self.value(solution.sweep.point)
                reached = to is not None and (value - to) * (before - to) <= 0
                if to is not None and reached:
                    last = self.at_value(solution.sweep.point, to)
                    solution = last if last.converged else solution
                latest = self.search.orbit(solution)
                largest_orbit = max(largest_orbit, _extent(latest))
                small = _extent(latest) < VANISHING * largest_orbit
                if not reached and (small or _passed_equilibrium(orbits[-1], latest)):
                    status = FamilyStatus.EQUILIBRIUM
                    break
                orbits.append(latest)
                tangents.append(following * self.search.shooting.units)
                if reached:
                    status = FamilyStatus.REACHED
                    break
                sweep = self._refine(solution.sweep, orbits)
                direction = self.unit(tangents[-1])
                near = np.linalg.norm(self.between(first.sweep.point, sweep.point)) < length
                ahead = self.unit(tangents[0]) @ direction > LARGEST_TURN
                if near and ahead and len(tangents) > 4:  # in the same direction
                    status = FamilyStatus.CLOSED
                    break
                faster = 2.0 ** ((USUAL_ITERATIONS - len(solution.corrections)) / 3)
                length = min(length * min(2.0, faster), largest_step)
        return Family(tuple(orbits), self.name, status, tuple(tangents), self.search)

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
                break
            if solution.converged:
                moved = self.between(sweep.point, solution.sweep.point)
                beside = np.linalg.norm(moved - length * tangent)
                following = self.tangent(solution.sweep, tangent)
                if beside <= FROM_PREDICTION * length and following @ tangent >= LARGEST_TURN:
                    return length, solution, following
            length /= 2
        return length, None, None


def follow(orbit: Orbit, parameter: Any, **course: Any) -> Family:
    """Follow a family from an orbit; see :meth:`Orbit.family`."""
    if not orbit.success:
        reject(
            f"this orbit was not found: {orbit.status.name}.",
            where=orbit.search.stepper.system,
            remedy="A family begins at an orbit whose success is True.",
        )
    return Continuation(orbit.search, spelled(parameter), orbit).run(**course)


def extend(family: Family, to: float | None, count: int) -> Family:
    """Continue a family beyond its last orbit; see :meth:`Family.extend`."""
    line, step, tangent = Continuation(family.search, family.parameter, family[-1]), 0.01, None
    if len(family) > 1:
        step = float(np.linalg.norm(line.between(*map(line.search.point_of, family.orbits[-2:]))))
        tangent = family.tangents[-1]
    course = line.run(to, count, step, 10 * step, tangent=tangent)
    orbits, tangents = family.orbits + course.orbits[1:], family.tangents + course.tangents[1:]
    return replace(course, orbits=orbits, tangents=tangents)
