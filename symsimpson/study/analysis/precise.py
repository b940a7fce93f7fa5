"""A stepper in many digits, as functions of a state z = (q, p)."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.program.digits import Digits, read_precision
from symsimpson.program.numbers import workspace
from symsimpson.program.observed import evaluate
from symsimpson.program.program import new_program
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.driving import read_driving
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Reals
from symsimpson.text.quantity import slopes_of

#: States that are placed on constraints may miss them by so much.
NEARBY = 1e-3
#: What moves by a smaller part of what moves most is displaced as if it moved by so much.
UNMOVED = 1e-12
#: Large steps need some iterations before corrections shrink quadratically.
MOST_ITERATIONS = 32


class Precise:
    """The text of a stepper's module and of the driver, run in many digits."""

    def __init__(self, stepper: Stepper, parameters: Mapping[str, float], digits: int) -> None:
        arithmetic = "arb" if importlib.util.find_spec("flint") else "mpmath"
        numbers = read_precision(digits, arithmetic)
        program = stepper.program
        self.program = new_program(
            program.source,
            program.system,
            numbers=numbers,
            names=program.names,
            default_inputs=program.default_inputs,
        )
        self.stepper = Stepper(self.program)
        self.n, self.parameters = stepper.n, parameters
        assert isinstance(numbers, Digits)
        self._numbers, self.context = numbers, numbers.context
        #: A displacement whose square and whose inverse cost a third of the digits each.
        self.small = self.context.mpf(10) ** -(digits // 3)
        #: Sizes of q and p, of which displacements for differences are a small part.
        self.sizes: Reals = np.array([self.context.mpf(1)] * (2 * stepper.n), dtype=object)

    def run(
        self, z: Reals, h: Any, steps: int, *, every: int | None = 1, t0: Any = 0
    ) -> Trajectory:
        """Integrate from a state."""
        return self.stepper.integrate(
            z[: self.n],
            p0=z[self.n :],
            h=h,
            steps=steps,
            every=every,
            t0=t0,
            parameters=self.parameters,
        )

    def flow(self, z: Reals, h: Any, steps: int = 1, *, t0: Any = 0) -> Reals:
        """Return the state after some steps."""
        end = self.run(z, h, steps, every=None, t0=t0)
        return np.concatenate([end.q[0], end.p[0]])

    def placed(self, z: Iterable[Any], t: Any = 0) -> Reals:
        """Return a state without what constraints do not allow; as it is, where there are none.

        Those of velocities may ask for others at another time.
        """
        point = np.array([self.context.convert(x) for x in z], dtype=object)
        held, n = self.program.header.constraints, self.n
        if not held:
            return point
        q, p = point[:n], point[n:]
        values = self.program.values(self.parameters)[None]
        q = project_start(self.program, q[None], 0 * q[None], "", values, t, NEARBY)[0][0]
        taken = self._at("start", "MULTIPLIER", len(held), q, p, t)
        return np.concatenate([q, p - taken @ self.slopes(q, t)])

    def slopes(self, q: Reals, t: Any = 0) -> Reals:
        """Return dphi/dq of all constraints, shape (m, n), and behind them A of A v = b."""
        header = self.program.header
        rows = self._at("multipliers", "CONSTRAINT_QQ", header.layout["HELD_SIZE"], q, 0 * q, t)
        return slopes_of(header, rows)

    def _at(self, kernel: str, block: str, count: int, q: Reals, p: Reals, t: Any = 0) -> Reals:
        """Evaluate a kernel at a state."""
        values = self.program.values(self.parameters)
        return evaluate(self.program, kernel, block, count, (t, q, p), values)

    def tangent(self, z: Reals, h: Any, steps: int = 1) -> tuple[Reals, Reals]:
        """Differentiate the map of some steps by differences, Newton's method included.

        Returns the derivatives of the end and of the start by a displacement that is placed on the
        constraints; without any, the latter is the identity.
        """
        point = np.array([self.context.convert(x) for x in z], dtype=object)
        displacements = np.diag(self.small * self.sizes)
        starts = [(self.placed(point + d), self.placed(point - d)) for d in displacements]
        ends = [(self.flow(up, h, steps), self.flow(down, h, steps)) for up, down in starts]
        moves = 2 * self.small * self.sizes
        of_end, of_start = (
            np.array([up - down for up, down in pairs], dtype=object).T / moves
            for pairs in (ends, starts)
        )
        return of_end, of_start

    def gradient(self, z: Iterable[Any]) -> Reals:
        """Differentiate the energy: dH/dq by differences, and dH/dp, which is v.

        In a time of its own a system has no kernel of v; there both are differences.
        """
        numbers, at, n = self._numbers, self.program.header.layout, self.n
        energy, (unit, zero) = self.program.kernels.address("energy"), numbers.read([1.0, 0.0])
        point = [self.context.convert(x) for x in z]
        rows = [at[block] + a for block in ("POSITION", "MOMENTUM") for a in range(n)]
        with numbers.working():
            W = self._prepared
            here, up, down = (
                numbers.read([x + move * size for x, size in zip(point, self.sizes, strict=True)])
                for move in (0, self.small, -self.small)
            )
            W[rows, 0] = here
            slopes = numbers.zeros(2 * n)
            moved = rows
            if "PASSED" not in at:  # not retimed
                energy(unit, zero, W)
                slopes[n:] = W[at["VELOCITY"] : at["VELOCITY"] + n, 0]
                moved = rows[:n]
            halves = numbers.read([1 / (2 * self.small * size) for size in self.sizes])
            for k, row in enumerate(moved):
                for sign, there in ((halves[k], up), (-halves[k], down)):
                    W[row, 0] = there[k]
                    energy(unit, zero, W)
                    slopes[k] += sign * W[at["ENERGY"], 0]
                W[row, 0] = here[k]
            return numbers.result(slopes)

    @cached_property
    def _prepared(self) -> Reals:
        """A workspace in which kernels of a state may be called."""
        numbers, program = self._numbers, self.program
        W = workspace(program.header, numbers, numbers.read(program.values(self.parameters)))
        unit, zero = numbers.read([1.0, 0.0])
        program.kernels.address("prepare")(unit, zero, W)
        return W

    def rates(self, z: Iterable[Any]) -> list[Any]:
        """Return Hamilton's equations: q' = dH/dp, p' = -dH/dq."""
        gradient = self.gradient(z)
        return [*gradient[self.n :], *(-gradient[: self.n])]

    def rates_and_time(self, z: Iterable[Any]) -> list[Any]:
        """Return the same of a retimed system in tau, and of its time."""
        *point, _ = z
        at = np.array([self.context.convert(x) for x in point], dtype=object)
        rate = self._at("energy", "RATE", 1, at[: self.n], at[self.n :])
        return [*self.rates(at), rate[0]]

    def from_start(self, z: Reals) -> dict[str, Any]:
        """Return the parameters of a run from a state, with those that follow from it."""
        return dict(zip(self.stepper.parameters, self.run(z, 1, 0).parameter_values, strict=True))

    def corrections(self, z: Reals, h: Any, count: int) -> list[Any]:
        """Return the sizes of the first Newton corrections, relative to the increments."""
        ratios = []
        with self._numbers.working():
            run = self._begun(z, h)
            for _ in range(count):
                self._iterate(run)
                sizes = [
                    self._numbers.result(run.rows(f"{name}_SQUARED", 1))[0]
                    for name in ("CORRECTION", "INCREMENT")
                ]
                if not sizes[0] * sizes[1] >= 0:
                    raise ArithmeticError("a sum of squares is negative, or no number")
                ratios.append(self.context.sqrt(sizes[0] / sizes[1]))
                if not 0 < ratios[-1] < self.context.inf:
                    break
        return ratios

    def jacobian_defect(self, z: Reals, h: Any) -> float:
        """Measure how far an iteration from beside the solution misses it, relatively.

        With the exact Jacobian J it misses by a second-order term; with another one, K, by
        1 - K^-1 J.
        """
        with self._numbers.working():
            run = self._begun(z, h)
            rows = run.rows("INCREMENT", self.program.header.degree * self.n)
            for _ in range(MOST_ITERATIONS):
                before = rows.copy()
                self._iterate(run)
                if max(map(abs, rows - before)) <= self.small**2 * max(map(abs, rows)):
                    break
            solution = self._numbers.result(rows.copy())
            moves = abs(solution).reshape(-1, self.n).max(axis=0)
            # what turns little beside what moves far is displaced by as little
            steps = self.small * np.maximum(moves, UNMOVED * moves.max())
            # control points that follow from the others do so when these are known
            points = self.program.header.tables.get("SOLVE_COLUMNS", range(len(rows) + 1))
            unknown = [k for k in range(len(rows)) if k // self.n + 1 in points]
            worst = 0.0
            for k in unknown:
                beside, step = solution.copy(), steps[k % self.n]
                beside[k] += step
                rows[:] = self._numbers.read(list(beside))
                self._iterate(run)
                now = self._numbers.result(rows.copy())
                if now[k] != beside[k]:  # else it follows from the others, too
                    off = (now - solution)[unknown]
                    worst = max(worst, float(max(map(abs, off)) / step))
        return worst

    def decay(self, z: Reals, h: Any) -> Any:
        """Return exp(-2 gamma h), by which a step shrinks momenta that are damped alike."""
        nodes = self.program.header.layout["NODES"]
        with self._numbers.working():
            last = self._begun(z, h).rows("GROWTH", nodes + 1)[-1:]
            return 1 / self._numbers.result(last)[0]

    def step_by(self, kernels: str, z: Reals, h: Any) -> Reals | None:
        """Return the state after a step by some of the kernels that may; None if they do not."""
        with self._numbers.working():
            run = self._begun(z, h, kernels)
            run.advance(1)
            if not run.step:
                return None
            return self._numbers.result(np.concatenate(run.end(), axis=1)[0])

    def _begun(self, z: Reals, h: Any, kernels: str = "newton") -> Run:
        numbers, program = self._numbers, self.program
        values = program.values(self.parameters)
        step, start = numbers.read(h).item(), numbers.read(list(z))
        run = Run(program, values, step, 0 * step, 0, 1, (kernels,))
        run.begin(start[: self.n], start[self.n :], velocity=False)
        inputs = read_driving(program, None, step, 1, 0)
        numbers.driver("give")(run.W, program.header.driver_layout, inputs, 0)
        run.rows("RELATIVE", 1)[:] = numbers.read(float("inf"))
        return run

    def _iterate(self, run: Run) -> None:
        run.rows("ACTIVE", 1)[:] = self._numbers.read(1.0)
        self._numbers.driver("call")(
            self.program.kernels.address("newton"), run.h, 0 * run.h, run.W
        )
