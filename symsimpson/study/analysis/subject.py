"""The subject of a certificate: a stepper, compiled and in many digits, with a state and step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mpmath
import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError, SymsimpsonError
from symsimpson.program.evaluation import evaluate
from symsimpson.program.input_values import read_number
from symsimpson.program.program import RunCache
from symsimpson.reference.extrapolation import extrapolate
from symsimpson.reference.first_order import canonical
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.driving import read_input_values
from symsimpson.study.analysis.discrete_flow import DiscreteFlow
from symsimpson.study.analysis.symmetries import Symmetry, linear_symmetries
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.names import read_mapping

#: Number of steps in many digits, and number of steps after which errors are measured.
SHORT, STEPS = 50, 8
DIGITS = 50
#: Least errors that are not round-off: of compiled steps, and of very long steps in many digits.
VISIBLE, VISIBLE_IN_DIGITS = 1e-11, 1e-25
#: The numbers of doublings of h to try until an error is visible.
DOUBLINGS = range(0, 93, 4)
#: The local error of the exact motion, and the largest number of steps to compute it.
LOCAL_ERROR, MAX_STEPS = mpmath.mpf("1e-30"), 100
#: The error of the exact motion, relative to the errors that it measures.
NEGLIGIBLE = mpmath.mpf("1e-5")
#: Digits of symmetries. Around a plane of orbits, gravity out of the plane is 1e-24 of the whole.
SYMMETRY_DIGITS = 90
#: Momenta below this part of the largest momentum have a size of their own. Example: a planet of
#: two stars has their velocities, and displacements must be small relative to its own momentum.
LIGHT = 1e-3
#: Moving coordinates below this part of the others have a unit of their own. Example: the metres
#: of an atom, next to radians.
TINY = 1e-6


def fix_inputs(stepper: Stepper, values: Mapping[Any, float] | None) -> Stepper:
    """Return a stepper with constant inputs: ``values`` by name, and 1 for inputs not in it.

    Raises InputError if a name is unknown, or a value is not a finite number.
    """
    if not stepper.inputs and values is None:
        return stepper
    inputs = dict.fromkeys(stepper.inputs, 1.0)
    names = stepper.program.names.inputs
    for place, value in names.values_by_place(read_mapping("inputs", values, "u")).items():
        name = stepper.inputs[place]
        inputs[name] = read_number(f"input {name}", value, stepper.program.numbers)
    fixed = replace(stepper.program, default_inputs=inputs, findings=RunCache())
    read_input_values(fixed, None, 1.0, 1, 0.0)
    return Stepper(fixed)


@dataclass(frozen=True)
class Subject:
    """A stepper, compiled and in many digits, with the state z and step size h to measure it at.

    For a time-transformed system, ``stepper`` and ``flow`` have the independent variable tau, and
    ``clock`` is the flow that also computes the time t. Otherwise ``clock`` is None.
    """

    stepper: Stepper
    flow: DiscreteFlow
    z: Reals
    h: float
    clock: DiscreteFlow | None = None

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.stepper.n

    @cached_property
    def scale(self) -> Floats:
        """Sizes of the coordinates and the momenta, the units of errors, shape (2 n,)."""
        return self._scale_of(self.integrate(100, every=1))

    def _scale_of(self, run: Trajectory) -> Floats:
        """Return the scale that the states of a run show, shape (2 n,)."""
        q, p = (np.abs(x).max(axis=0) for x in (run.q, run.p))
        # a coordinate that hardly moves has the size of the others, at most 1
        least = min(1.0, q.max() or 1.0)
        shares = np.abs(run.p * run.v).max(axis=0)
        moving = shares > LIGHT * shares.max()
        tiny = moving & (q > 0) & (q < TINY * least)
        lengths, largest = np.where(tiny, q, np.maximum(q, least)), p.max() or 1.0
        if "PASSED" in run.program.header.layout:  # time transformation: v is dq/dt, not dq/dtau
            return np.concatenate([lengths, np.where(moving & (p < TINY * largest), p, largest)])
        frequency = (np.abs(run.v) / lengths).max()
        with np.errstate(all="ignore"):  # a coordinate that cannot move has infinite mass
            momenta = np.maximum(p, _masses(run, largest) * lengths * frequency)
        light = (momenta > 0) & (momenta < LIGHT * largest)
        return np.concatenate([lengths, np.where(light, momenta, largest)])

    @cached_property
    def sizes(self) -> Reals:
        """The scale as powers of two in many digits, so that scaling rounds nothing.

        If the run of ``scale`` fails, its states before the failure give the sizes.
        """
        context = self.flow.context
        try:
            scale = self.scale
        except ConvergenceError as error:
            scale = self._scale_of(error.trajectory)
        powers = np.round(np.log2(scale)).astype(int).tolist()
        return np.array([context.ldexp(1, power) for power in powers], dtype=object)

    @cached_property
    def path(self) -> Trajectory:
        """The first ``SHORT`` steps in many digits."""
        return self.flow.run(self.z, self.h, SHORT)

    @property
    def has_forces(self) -> bool:
        """True if the system has forces that do not follow from L."""
        return bool(self.stepper.program.header.forces)

    @property
    def is_nonholonomic(self) -> bool:
        """True if there are velocity constraints."""
        return bool(self.stepper.program.header.velocity_constraints)

    @cached_property
    def symmetries(self) -> list[Symmetry]:
        """The linear symmetries of the system; none if forces may change their momenta."""
        if not self.stepper.program.header.conservative:
            return []
        finer = DiscreteFlow(self.flow.stepper, self.flow.parameters, SYMMETRY_DIGITS)
        finer.sizes = self.sizes
        return linear_symmetries(finer, self.z)

    def solve_exactly(self, end: Any, *, with_time: bool = False, error: float = 0.0) -> list[Any]:
        """Return the state of the exact motion at the time ``end``, in many digits.

        The local error is ``NEGLIGIBLE`` times ``error``, and at least ``LOCAL_ERROR``. With
        ``with_time`` the system is time-transformed, ``end`` is a value of tau, and t follows the
        state.
        """
        tolerance = max(LOCAL_ERROR, mpmath.mpf(error) * NEGLIGIBLE)
        start = [mpmath.mpf(x) for x in self.z]
        if with_time:
            start.append(mpmath.mpf(0))
            return self._extrapolate(self.flow.rates_and_time, start, end, tolerance)
        rates: Callable[[Any], list[Any]] = self.flow.rates
        program = self.stepper.program
        header = program.header
        if not header.conservative or header.velocity_constraints:  # H is not enough
            assert program.declared is not None
            equations = canonical(program.declared).function("mpmath")
            inputs = (program.default_inputs or {}).values()
            values = [mpmath.mpf(x) for x in (*self.flow.parameters.values(), *inputs)]
            start += [] if header.autonomous else [mpmath.mpf(0)]

            def canonical_rates(y: Any) -> list[Any]:
                return list(equations(*y, *values))

            rates = canonical_rates
        # with constraints p has a component without effect, which the projection removes
        state = self._extrapolate(rates, start, end, tolerance)[: 2 * self.n]
        return list(self.flow.project(state, end))

    def _extrapolate(
        self, rates: Callable[[Any], list[Any]], start: list[Any], end: Any, tolerance: Any
    ) -> list[Any]:
        """Solve z' = rates(z) in units of ``sizes``, which the tolerance refers to."""
        units = [mpmath.mpf(x) for x in self.sizes]
        units += [mpmath.mpf(1)] * (len(start) - len(units))

        def scaled_rates(y: Any) -> list[Any]:
            slopes = rates([x * unit for x, unit in zip(y, units, strict=True)])
            return [x / unit for x, unit in zip(slopes, units, strict=True)]

        first = [x / unit for x, unit in zip(start, units, strict=True)]
        last = extrapolate(scaled_rates, first, [end], tolerance, MAX_STEPS)[0]
        return [x * unit for x, unit in zip(last, units, strict=True)]

    @cached_property
    def doublings(self) -> int:
        """The number of doublings of h that makes an error visible; -1 if no step shows one."""
        runs = (self.integrate(STEPS * parts, None, parts) for parts in (1, 2))
        if self.distance(*(np.concatenate([run.q[-1], run.p[-1]]) for run in runs)) > VISIBLE:
            return 0
        for doublings in DOUBLINGS:
            h = self.flow.context.ldexp(self.h, doublings)
            try:
                with mpmath.workdps(DIGITS):
                    end = self.flow.advance(self.z, h, STEPS)
                    exact = self.solve_exactly(STEPS * mpmath.mpf(h))
            except (SymsimpsonError, ArithmeticError):
                break
            errors = np.abs(end - exact) / np.maximum(self.scale, np.abs(exact))
            if max(errors) > VISIBLE_IN_DIGITS:
                return doublings
        return -1

    def integrate(self, steps: int, every: int | None, parts: int = 1) -> Trajectory:
        """Integrate in double precision, with the step size h / parts."""
        z = self.z.astype(np.float64)
        return self.stepper.integrate(
            z[: self.n],
            p0=z[self.n :],
            h=self.h / parts,
            steps=steps,
            every=every,
            parameters=self.flow.parameters,
        )

    def distance(self, a: Any, b: Any) -> float:
        """Return the largest difference of two states in units of ``scale``."""
        return float(max(abs(x) for x in (np.asarray(a) - np.asarray(b)) / self.scale))


def _masses(run: Trajectory, push: float) -> Floats:
    """Return the mass of each coordinate, shape (n,): a change of p divided by the change of v."""
    n = run.program.n
    p = run.p[0] + push * np.vstack([np.zeros(n), np.eye(n)])
    states = np.full(n + 1, run.t[0]), np.tile(run.q[0], (n + 1, 1)), p
    v = evaluate(run.program, "energy", "VELOCITY", n, states, run.parameter_values)
    with np.errstate(all="ignore"):
        masses: Floats = push / np.diagonal(v[1:] - v[0])
    header = run.program.header
    if header.canonical or header.indefinite:  # they may vanish, or have any sign
        masses = np.where(np.isfinite(masses), abs(masses), 0.0)
    return masses
