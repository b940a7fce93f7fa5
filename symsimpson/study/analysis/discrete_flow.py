"""The discrete flow of a stepper in many digits, as functions of a state z = (q, p)."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.program.digits import Digits, read_precision
from symsimpson.program.evaluation import evaluate
from symsimpson.program.numbers import workspace
from symsimpson.program.program import new_program
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.constrained_start import project_start
from symsimpson.stepping.driving import read_input_values
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Reals
from symsimpson.text.quantity import slopes_of

#: Largest distance from the constraints of a state that :meth:`DiscreteFlow.project` accepts.
NEARBY = 1e-3
#: Least displacement of a coordinate, relative to that of the coordinate that moves most.
MIN_DISPLACEMENT = 1e-12
#: With large steps, corrections shrink quadratically only after some iterations.
MAX_ITERATIONS = 32


class DiscreteFlow:
    """The map z0 -> z1 of a stepper in many digits, and its energy and iterations.

    It executes the same source as the compiled stepper: the generated module and the driver. A
    state z has shape (2 n,), the positions first.
    """

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
        #: The relative displacement for differences. It leaves two thirds of the digits correct.
        self.small = self.context.mpf(10) ** -(digits // 3)
        #: Sizes of q and p, shape (2 n,). Displacements are ``small`` times these.
        self.sizes: Reals = np.array([self.context.mpf(1)] * (2 * stepper.n), dtype=object)

    def run(
        self, z: Reals, h: Any, steps: int, *, every: int | None = 1, t0: Any = 0
    ) -> Trajectory:
        """Integrate ``steps`` steps of size h from the state z."""
        return self.stepper.integrate(
            z[: self.n],
            p0=z[self.n :],
            h=h,
            steps=steps,
            every=every,
            t0=t0,
            parameters=self.parameters,
        )

    def advance(self, z: Reals, h: Any, steps: int = 1, *, t0: Any = 0) -> Reals:
        """Return the state after ``steps`` steps of size h, shape (2 n,)."""
        end = self.run(z, h, steps, every=None, t0=t0)
        return np.concatenate([end.q[0], end.p[0]])

    def project(self, z: Iterable[Any], t: Any = 0) -> Reals:
        """Project a state onto the constraints at the time t; without constraints, return it.

        The momentum is projected so that Phi v = 0, and A v = b for velocity constraints.
        """
        point = np.array([self.context.convert(x) for x in z], dtype=object)
        constraints, n = self.program.header.constraints, self.n
        if not constraints:
            return point
        q, p = point[:n], point[n:]
        values = self.program.values(self.parameters)[None]
        q = project_start(self.program, q[None], 0 * q[None], "", values, t, NEARBY)[0][0]
        multipliers = self._evaluate("start", "MULTIPLIER", len(constraints), q, p, t)
        return np.concatenate([q, p - multipliers @ self.constraint_jacobian(q, t)])

    def constraint_jacobian(self, q: Reals, t: Any = 0) -> Reals:
        """Return dphi/dq and then the matrix A of A v = b as rows, shape (m, n)."""
        header = self.program.header
        count = header.layout["HELD_SIZE"]
        return slopes_of(header, self._evaluate("multipliers", "CONSTRAINT_QQ", count, q, 0 * q, t))

    def _evaluate(
        self, kernel: str, block: str, count: int, q: Reals, p: Reals, t: Any = 0
    ) -> Reals:
        """Evaluate ``count`` rows of a block of the workspace by a kernel, at one state."""
        values = self.program.values(self.parameters)
        return evaluate(self.program, kernel, block, count, (t, q, p), values)

    def tangent(self, z: Reals, h: Any, steps: int = 1) -> tuple[Reals, Reals]:
        """Differentiate the map of some steps by differences, Newton's method included.

        Returns dz1/ds and dz0/ds, shape (2 n, 2 n) each, for displacements s that are projected
        onto the constraints. Without constraints dz0/ds is the identity.
        """
        point = np.array([self.context.convert(x) for x in z], dtype=object)
        displacements = np.diag(self.small * self.sizes)
        starts = [(self.project(point + d), self.project(point - d)) for d in displacements]
        ends = [(self.advance(up, h, steps), self.advance(down, h, steps)) for up, down in starts]
        moves = 2 * self.small * self.sizes
        of_end, of_start = (
            np.array([up - down for up, down in pairs], dtype=object).T / moves
            for pairs in (ends, starts)
        )
        return of_end, of_start

    def gradient(self, z: Iterable[Any]) -> Reals:
        """Return (dH/dq, dH/dp), shape (2 n,): dH/dq by differences, and dH/dp = v.

        A time-transformed system has no kernel for v, so that differences give dH/dp, too.
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
        """A workspace with the parameters, in which the energy can be evaluated."""
        numbers, program = self._numbers, self.program
        W = workspace(program.header, numbers, numbers.read(program.values(self.parameters)))
        unit, zero = numbers.read([1.0, 0.0])
        program.kernels.address("prepare")(unit, zero, W)
        return W

    def rates(self, z: Iterable[Any]) -> list[Any]:
        """Return Hamilton's equations (dH/dp, -dH/dq), length 2 n."""
        gradient = self.gradient(z)
        return [*gradient[self.n :], *(-gradient[: self.n])]

    def rates_and_time(self, z: Iterable[Any]) -> list[Any]:
        """Return dz/dtau and dt/dtau of a time-transformed system at (q, p, t), length 2 n + 1."""
        *point, _ = z
        at = np.array([self.context.convert(x) for x in point], dtype=object)
        rate = self._evaluate("energy", "RATE", 1, at[: self.n], at[self.n :])
        return [*self.rates(at), rate[0]]

    def parameters_at(self, z: Reals) -> dict[str, Any]:
        """Return all parameters by name, also E0 and dt/dtau, which depend on the initial state."""
        return dict(zip(self.stepper.parameters, self.run(z, 1, 0).parameter_values, strict=True))

    def corrections(self, z: Reals, h: Any, count: int) -> list[Any]:
        """Return the sizes of the first Newton corrections, relative to the increments."""
        ratios = []
        with self._numbers.working():
            run = self._begin_step(z, h)
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
        """Measure the relative error that an iteration leaves of a displaced solution.

        With the exact Jacobian J the error is of second order. With another matrix K it is
        1 - K^-1 J.
        """
        with self._numbers.working():
            run = self._begin_step(z, h)
            rows = run.rows("INCREMENT", self.program.header.degree * self.n)
            for _ in range(MAX_ITERATIONS):
                before = rows.copy()
                self._iterate(run)
                if max(map(abs, rows - before)) <= self.small**2 * max(map(abs, rows)):
                    break
            solution = self._numbers.result(rows.copy())
            moves = abs(solution).reshape(-1, self.n).max(axis=0)
            # an angle may move little beside a length, and its displacement must be as small
            displacements = self.small * np.maximum(moves, MIN_DISPLACEMENT * moves.max())
            # the other control points follow from those that the kernel solves for
            points = self.program.header.tables.get("SOLVE_COLUMNS", range(len(rows) + 1))
            unknown = [k for k in range(len(rows)) if k // self.n + 1 in points]
            worst = 0.0
            for k in unknown:
                displaced, displacement = solution.copy(), displacements[k % self.n]
                displaced[k] += displacement
                rows[:] = self._numbers.read(list(displaced))
                self._iterate(run)
                corrected = self._numbers.result(rows.copy())
                if corrected[k] != displaced[k]:  # else the iteration does not solve for it
                    errors = (corrected - solution)[unknown]
                    worst = max(worst, float(max(map(abs, errors)) / displacement))
        return worst

    def decay(self, z: Reals, h: Any) -> Any:
        """Return exp(-2 gamma h), the factor of all momenta in a step of a conformal system."""
        nodes = self.program.header.layout["NODES"]
        with self._numbers.working():
            last = self._begin_step(z, h).rows("GROWTH", nodes + 1)[-1:]
            return 1 / self._numbers.result(last)[0]

    def step_with(self, kernels: str, z: Reals, h: Any) -> Reals | None:
        """Return the state after a step by the named set of kernels; None if the step fails."""
        with self._numbers.working():
            run = self._begin_step(z, h, kernels)
            run.advance(1)
            if not run.step:
                return None
            return self._numbers.result(np.concatenate(run.end(), axis=1)[0])

    def _begin_step(self, z: Reals, h: Any, kernels: str = "newton") -> Run:
        """Return a run before the iterations of its first step."""
        numbers, program = self._numbers, self.program
        values = program.values(self.parameters)
        step, start = numbers.read(h).item(), numbers.read(list(z))
        run = Run(program, values, step, 0 * step, fallbacks=(kernels,))
        run.begin(start[: self.n], start[self.n :], velocity=False)
        inputs = read_input_values(program, None, step, 1, 0)
        numbers.driver("give")(run.W, program.header.driver_layout, inputs, 0)
        run.rows("RELATIVE", 1)[:] = numbers.read(float("inf"))
        return run

    def _iterate(self, run: Run) -> None:
        """Do one Newton iteration."""
        run.rows("ACTIVE", 1)[:] = self._numbers.read(1.0)
        self._numbers.driver("call")(
            self.program.kernels.address("newton"), run.h, 0 * run.h, run.W
        )
