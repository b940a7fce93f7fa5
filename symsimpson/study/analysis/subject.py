"""Subjects of measurements: a stepper in many digits and compiled, with a state and a step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mpmath
import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError, SymsimpsonError
from symsimpson.program.input_values import read_number
from symsimpson.program.observed import evaluate
from symsimpson.program.program import Findings
from symsimpson.reference.extrapolation import extrapolate
from symsimpson.reference.first_order import canonical
from symsimpson.results.trajectory import Trajectory
from symsimpson.stepping.driving import read_driving
from symsimpson.study.analysis.precise import Precise
from symsimpson.study.analysis.symmetries import Symmetry, linear_symmetries
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.names import read_mapping

#: Steps that are taken in many digits, and those after which errors are measured.
SHORT, STEPS = 50, 8
DIGITS = 50
#: Errors that are not round-off: of compiled steps, and in many digits after very long steps.
SEEN, SEEN_FAR = 1e-11, 1e-25
#: Steps are doubled so often, one after the other, until errors are seen.
DOUBLINGS = range(0, 93, 4)
#: The local error of the exact motion, and the most steps that it is given.
LOCAL, MOST = mpmath.mpf("1e-30"), 100
#: An error of the exact motion is this part of those that are measured by it.
NEGLIGIBLE = mpmath.mpf("1e-5")
#: Digits of symmetries: what gravity pulls across a plane of orbits is 1e-24 of the whole there.
FINER = 90
#: Momenta that are so small a part of the largest have a size of their own, as those of a planet
#: beside two stars: its velocities are theirs, and a displacement must be small beside them.
LIGHT = 1e-3
#: Coordinates that are so small a part of the others, and have a share of the motion, stand in a
#: unit of their own, as metres in an atom beside radians.
TINY = 1e-6


def with_inputs(stepper: Stepper, given: Mapping[Any, float] | None) -> Stepper:
    """Return a stepper whose inputs have these values, 1 unless given, in all its runs.

    Raises InputError if one is unknown or no finite number.
    """
    if not stepper.inputs and given is None:
        return stepper
    held = dict.fromkeys(stepper.inputs, 1.0)
    names = stepper.program.names.inputs
    for place, value in names.by_place(read_mapping("inputs", given, "u")).items():
        name = stepper.inputs[place]
        held[name] = read_number(f"input {name}", value, stepper.program.numbers)
    fixed = replace(stepper.program, default_inputs=held, findings=Findings())
    read_driving(fixed, None, 1.0, 1, 0.0)
    return Stepper(fixed)


@dataclass(frozen=True)
class Subject:
    """A stepper in many digits and compiled, with a state and a step.

    Of a retimed system it takes steps of tau, and ``timed`` tells the time with them.
    """

    stepper: Stepper
    precise: Precise
    z: Reals
    h: float
    timed: Precise | None = None

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.stepper.n

    @cached_property
    def scale(self) -> Floats:
        """Sizes of the coordinates and the momenta, to measure errors by."""
        return self._scale_of(self.compiled(100, every=1))

    def _scale_of(self, run: Trajectory) -> Floats:
        q, p = (np.abs(x).max(axis=0) for x in (run.q, run.p))
        # a coordinate that hardly moves has no size of its own: that of others, in small units
        least = min(1.0, q.max() or 1.0)
        shares = np.abs(run.p * run.v).max(axis=0)
        moving = shares > LIGHT * shares.max()
        apart = moving & (q > 0) & (q < TINY * least)
        places, most = np.where(apart, q, np.maximum(q, least)), p.max() or 1.0
        if "PASSED" in run.program.header.layout:  # retimed: v is that of another time
            return np.concatenate([places, np.where(moving & (p < TINY * most), p, most)])
        fastest = (np.abs(run.v) / places).max()
        with np.errstate(all="ignore"):  # the mass of what cannot move has no bound
            each = np.maximum(p, _masses(run, most) * places * fastest)
        light = (each > 0) & (each < LIGHT * most)
        return np.concatenate([places, np.where(light, each, most)])

    @cached_property
    def sizes(self) -> Reals:
        """The same in many digits, as powers of two, by which nothing is rounded.

        Of a run that fails they are those of its states up to there.
        """
        context = self.precise.context
        try:
            scale = self.scale
        except ConvergenceError as error:
            scale = self._scale_of(error.trajectory)
        powers = np.round(np.log2(scale)).astype(int).tolist()
        return np.array([context.ldexp(1, power) for power in powers], dtype=object)

    @cached_property
    def path(self) -> Trajectory:
        """Some steps in many digits."""
        return self.precise.run(self.z, self.h, SHORT)

    @property
    def forced(self) -> bool:
        """Whether forces act beside those of L."""
        return bool(self.stepper.program.header.forces)

    @property
    def rolling(self) -> bool:
        """Whether there are velocity constraints."""
        return bool(self.stepper.program.header.velocity_constraints)

    @cached_property
    def symmetries(self) -> list[Symmetry]:
        """The linear symmetries of the system; none where forces may change their momenta."""
        conservative = self.stepper.program.header.conservative
        if not conservative:
            return []
        finer = Precise(self.precise.stepper, self.precise.parameters, FINER)
        finer.sizes = self.sizes
        return linear_symmetries(finer, self.z)

    def exact(self, end: Any, *, timed: bool = False, error: float = 0.0) -> list[Any]:
        """Return the state of the exact motion at a time, in many digits; ``timed``, with t.

        Of each step the error is much smaller than the one that is given.
        """
        local = max(LOCAL, mpmath.mpf(error) * NEGLIGIBLE)
        if timed:
            rates_and_t = self.precise.rates_and_time
            start = [*(mpmath.mpf(x) for x in self.z), mpmath.mpf(0)]
            return self._extrapolated(rates_and_t, start, end, local)
        start = [mpmath.mpf(x) for x in self.z]
        rates: Callable[[Any], list[Any]] = self.precise.rates
        declared = self.stepper.program.declared
        header = self.stepper.program.header
        if not header.conservative or header.velocity_constraints:  # H alone does not tell
            assert declared is not None
            equations = canonical(declared).function("mpmath")
            given = (
                *self.precise.parameters.values(),
                *(self.stepper.program.default_inputs or {}).values(),
            )
            values = [mpmath.mpf(x) for x in given]
            start += [] if header.autonomous else [mpmath.mpf(0)]

            def forced(y: Any) -> list[Any]:
                return list(equations(*y, *values))

            rates = forced
        # with constraints p has a part that has no effect, of which the last line gets rid
        state = self._extrapolated(rates, start, end, local)[: 2 * self.n]
        return list(self.precise.placed(state, end))

    def _extrapolated(
        self, rates: Callable[[Any], list[Any]], start: list[Any], end: Any, local: Any
    ) -> list[Any]:
        """Solve in units of the sizes of q and p, by which errors are judged; the time has none."""
        units = [mpmath.mpf(x) for x in self.sizes]
        units += [mpmath.mpf(1)] * (len(start) - len(units))

        def in_units(y: Any) -> list[Any]:
            slopes = rates([x * unit for x, unit in zip(y, units, strict=True)])
            return [x / unit for x, unit in zip(slopes, units, strict=True)]

        first = [x / unit for x, unit in zip(start, units, strict=True)]
        last = extrapolate(in_units, first, [end], local, MOST)[0]
        return [x * unit for x, unit in zip(last, units, strict=True)]

    @cached_property
    def doublings(self) -> int:
        """How often to double h until errors are seen; -1 where no step shows an error."""
        runs = (self.compiled(STEPS * parts, None, parts) for parts in (1, 2))
        if self.distance(*(np.concatenate([run.q[-1], run.p[-1]]) for run in runs)) > SEEN:
            return 0
        for doublings in DOUBLINGS:
            h = self.precise.context.ldexp(self.h, doublings)
            try:
                with mpmath.workdps(DIGITS):
                    end = self.precise.flow(self.z, h, STEPS)
                    exact = self.exact(STEPS * mpmath.mpf(h))
            except (SymsimpsonError, ArithmeticError):
                break
            if max(np.abs(end - exact) / np.maximum(self.scale, np.abs(exact))) > SEEN_FAR:
                return doublings
        return -1

    def compiled(self, steps: int, every: int | None, parts: int = 1) -> Trajectory:
        """Integrate in double precision, with h or a part of it."""
        z = self.z.astype(np.float64)
        return self.stepper.integrate(
            z[: self.n],
            p0=z[self.n :],
            h=self.h / parts,
            steps=steps,
            every=every,
            parameters=self.precise.parameters,
        )

    def distance(self, a: Any, b: Any) -> float:
        """Return the largest difference of two states in units of the scale."""
        return float(max(abs(x) for x in (np.asarray(a) - np.asarray(b)) / self.scale))


def _masses(run: Trajectory, push: float) -> Floats:
    """Return the masses of the coordinates, by what velocity a push of each gives it."""
    n = run.program.n
    p = run.p[0] + push * np.vstack([np.zeros(n), np.eye(n)])
    states = np.full(n + 1, run.t[0]), np.tile(run.q[0], (n + 1, 1)), p
    v = evaluate(run.program, "energy", "VELOCITY", n, states, run.parameter_values)
    masses: Floats = push / np.diagonal(v[1:] - v[0])
    return masses
