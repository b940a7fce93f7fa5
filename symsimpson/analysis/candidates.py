"""Runs of several schemes for the same error: how many steps each needs, and how long they take."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from symsimpson.analysis.path_error import PathError, path_error
from symsimpson.analysis.stability.frequency import largest_stable
from symsimpson.api.stepper import Stepper
from symsimpson.errors import InputError, StabilityWarning
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import uninterrupted
from symsimpson.stepping.driving import Samples
from symsimpson.support.array_types import Floats

__all__ = ["SAFETY", "Candidate", "Motion", "Verified", "name_of", "read_inputs", "verify"]

#: What is measured may be wrong by so much: steps are chosen for the error divided by this.
SAFETY = 2.0
#: More steps than this are not tried on a pilot run, nor for the whole motion unless it needs
#: nearly as many at first.
MOST_STEPS = 2_000_000
#: A run stores at most so many numbers for a comparison.
MOST_NUMBERS = 2**21
#: A whole motion of few steps is also compared with a run of so many steps, divided by the number
#: of coordinates. It shows forces that act for a short time, between the nodes of both others.
SCOUT = 2**15
#: Errors closer to rounding than this cannot be told from it.
FLOOR = 3e-14
ROUNDS, REPEATS = 8, 3
#: A motion whose error does not fall in so many rounds is not resolved by any step.
STAGNANT = 3
#: A smaller gain in steps is not worth another run.
FEWER = 0.85
#: Fewer steps that take this many times as long fell back on another solver. Smaller differences
#: are those of a busy machine: iterations are counted instead.
SLOWER = 2.0
#: The whole motion has at least so many steps, and its step is refined so many times at most.
LEAST, REFINEMENTS = 20, 6


@dataclass(frozen=True)
class Candidate:
    """How one scheme reaches the error on the pilot run."""

    stepper: Stepper
    steps: int
    error: float
    work: int  # steps and iterations
    taken: int  # steps
    seconds: float


@dataclass(frozen=True)
class Verified:
    """A number of steps for the whole motion, and its error as measured."""

    stepper: Stepper
    steps: int
    error: PathError


@dataclass(frozen=True)
class Motion:
    """A motion from a state to a time, and the error that is allowed."""

    parameters: Mapping[str, float]
    t0: float
    duration: float
    error: float
    on: str
    #: By name: a number, a function of t, or an array of values for equal parts of the duration.
    inputs: Mapping[str, Any] | None = None
    events: Any = None
    parts: int = 1  #: Each of them has a whole number of steps.
    #: The initial state, each of shape (n,), and the fastest linear oscillation there.
    q: Floats = field(default_factory=partial(np.zeros, 0))
    p: Floats = field(default_factory=partial(np.zeros, 0))
    v: Floats = field(default_factory=partial(np.zeros, 0))
    frequency: float = 0.0
    #: Why the last run failed, if it did.
    failures: list[str] = field(default_factory=list)
    #: Trials begun by now.
    tried: list[str] = field(default_factory=list)

    @property
    def inputs_at_start(self) -> dict[str, float]:
        """The value of each input at the start."""
        return {
            name: float(at_times(x, np.array([self.t0]))[0]) if callable(x) else np.ravel(x)[0]
            for name, x in (self.inputs or {}).items()
        }

    def until(self, duration: float) -> Motion:
        """Return the first part of a motion."""
        share = min(1.0, duration / self.duration)
        parts = math.ceil(share * self.parts)
        inputs = self.inputs and {
            name: x[: max(1, len(x) * parts // self.parts)] if isinstance(x, np.ndarray) else x
            for name, x in self.inputs.items()
        }
        if self.parts > 1:
            share = parts / self.parts
        return replace(self, duration=share * self.duration, parts=parts, inputs=inputs)

    def whole(self, steps: float) -> int:
        """Return a number of steps, not less than this one, that the motion may have."""
        unit = self.parts * (64 if steps > MOST_NUMBERS / len(self.q) / 2 else 2)
        return math.ceil(steps / unit) * unit

    def arguments(self, stepper: Stepper, steps: int) -> dict[str, Any]:
        """Return what a run is given beside the initial state."""
        h = self.duration / steps
        length = {"t_end": self.t0 + self.duration}
        if not stepper.program.header.retimed:
            length = {"steps": steps}
        inputs = self.inputs and {
            name: self._at_steps(value, stepper, h, steps) for name, value in self.inputs.items()
        }
        given = {"parameters": self.parameters, "inputs": inputs, "events": self.events}
        return {"h": h, "t0": self.t0, **length, **given}

    def _at_steps(self, value: Any, stepper: Stepper, h: float, steps: int) -> Any:
        if isinstance(value, np.ndarray):
            return np.repeat(value, steps // len(value))
        return at_times(value, stepper.node_times(h, steps, self.t0)) if callable(value) else value

    def run(self, stepper: Stepper, steps: int, *, every: int | None = 1) -> Trajectory:
        """Run, storing as many states as a comparison needs; with ``every=None``, the last."""
        stride = 1
        while every and steps % (2 * stride) == 0 and steps * len(self.q) > MOST_NUMBERS * stride:
            stride *= 2
        run = uninterrupted(
            stepper.integrate(
                self.q,
                p0=self.p,
                **self.arguments(stepper, steps),
                every=every and stride,
                on_failure="return",
            )
        )
        self.failures[:] = [] if run.success else [run.message]
        return run

    def measure(
        self, stepper: Stepper, steps: int, coarse: Trajectory | None = None, *, scout: bool = True
    ) -> tuple[PathError, Trajectory, Trajectory | None]:
        """Return the error of so many steps, their run, and that with half the step."""
        coarse = coarse or self.run(stepper, steps)
        if not coarse.success:
            return PathError(math.inf, float(coarse.t[-1])), coarse, None
        if self.on == "energy":
            off = np.abs(coarse.energy_error)
            return PathError.of(coarse.t, off, self.error), coarse, None
        fine = self.run(stepper, 2 * steps)
        found = path_error(coarse, fine, self.duration, self.error)
        few = SCOUT // len(self.q) // steps
        if scout and found.since is None and few > 2:
            finest = self.run(stepper, 2 ** few.bit_length() * steps)
            other = path_error(coarse, finest, self.duration, self.error)
            found = max(found, other, key=lambda error: error.largest)
        return found, coarse, fine

    def least(self, stepper: Stepper) -> int:
        """Return the fewest steps, of which none is warned of at the start."""
        omega = abs(self.duration) * self.frequency
        steps = self.whole(max(4.0, omega / largest_stable(stepper.scheme)))
        tools, system = stepper.program.tools, stepper.program.declared
        if tools is None or system is None or stepper.program.header.retimed:
            return steps
        values = [*map(float, (*self.parameters.values(), *self.inputs_at_start.values()))]
        while True:
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always", StabilityWarning)
                h = self.duration / steps
                tools.check_step(stepper.program, system, self.q, self.v, values, h, self.t0)
            if not any(issubclass(x.category, StabilityWarning) for x in warned):
                return steps
            if steps > MOST_STEPS:
                return steps
            steps = self.whole(1.25 * steps)

    def solve(self, stepper: Stepper, h0: float, allowed: float) -> Candidate | None:
        """Find the number of steps that reaches an error; None if there is none.

        In another time it is that of steps as long as the first.
        """
        least = self.least(stepper)
        steps = max(least, math.ceil(abs(self.duration / h0) / math.sqrt(stepper.order)))
        best: Candidate | None = None
        before, stagnant = math.inf, 0
        for _ in range(ROUNDS):
            self.tried.append(stepper.scheme)
            steps = self.whole(steps)
            measured = self._timed(stepper, steps) if steps <= MOST_STEPS else None
            if measured is None:
                if steps > MOST_STEPS:
                    return best
                steps = 2 * steps if best is None else math.ceil(math.sqrt(steps * best.steps))
                if best and steps > FEWER * best.steps:
                    return best
                continue
            error, work = measured.error, measured.work
            change = (max(error, FLOOR) / allowed) ** (1 / stepper.order)
            if error <= allowed:
                if best and (work > best.work or measured.seconds > SLOWER * best.seconds):
                    return best  # fewer steps that are solved with more effort
                best = measured
                fewer = max(least, math.ceil(steps * max(1.05 * change, 0.5)))
                if self.whole(fewer) > FEWER * steps:
                    return best
                steps = fewer
            elif best is not None or allowed < FLOOR:
                return best
            else:
                stagnant = stagnant + 1 if error > before / 2 else 0
                if stagnant == STAGNANT:
                    return None
                before, steps = error, math.ceil(steps * min(max(change, 1.1), 8.0))
        return best

    def _timed(self, stepper: Stepper, steps: int) -> Candidate | None:
        """Measure the error of so many steps, their work and time; None if they fail."""
        seconds = math.inf
        for _ in range(REPEATS):  # the first one may compile
            begin = time.perf_counter()
            run = self.run(stepper, steps, every=None)
            seconds = min(seconds, time.perf_counter() - begin)
            if not run.success:
                return None
        found, coarse, fine = self.measure(stepper, steps, scout=False)
        if not coarse.success or not (fine is None or fine.success):
            return None
        share = 1.0 if self.on == "energy" else 1 / (1 - 2.0**-stepper.order)
        work = coarse.steps + int(coarse.newton_iterations.sum())
        return Candidate(stepper, steps, share * found.largest, work, coarse.steps, seconds)


def verify(motion: Motion, stepper: Stepper, steps: float) -> Verified:
    """Measure the error of the whole motion, and refine the step until it is small enough."""
    steps = motion.whole(max(steps, LEAST, motion.least(stepper)))
    most, coarse = max(MOST_STEPS // 2, 4 * steps), None
    for refinement in range(REFINEMENTS + 1):
        motion.tried.append(stepper.scheme)
        found, _, fine = motion.measure(stepper, steps, coarse)
        wanted = (SAFETY * found.largest / motion.error) ** (1 / stepper.order)
        factor = 2 if wanted <= 2 else 4
        last = refinement == REFINEMENTS or factor * steps > most
        if found.largest <= motion.error or last:
            break
        steps, coarse = factor * steps, fine if factor == 2 else None
    return Verified(stepper, steps, found)


def at_times(function: Any, times: Floats) -> Floats:
    """Return the values of a function of t, which may take arrays or not."""
    try:
        values = np.asarray(function(times), dtype=float)
        if values.shape in ((), times.shape):
            return np.broadcast_to(values, times.shape)
    except (TypeError, ValueError):
        pass
    return np.vectorize(function, otypes=[float])(times)


def read_inputs(given: Mapping[str, Any], duration: float) -> tuple[dict[str, Any], int]:
    """Read inputs of a run whose step is chosen, and in how many equal parts they divide it.

    Raises InputError if one is no number, function of t, or array of values for equal parts.
    """
    inputs, parts = dict[str, Any](), 1
    for name, value in given.items():
        values = value
        if isinstance(value, Samples):
            exact = abs(duration) / float(value.period)
            values = np.asarray(value.values, dtype=float)[: round(exact)]
            if len(values) != round(exact) or abs(exact - len(values)) > 1e-9 * exact:
                raise InputError(
                    f"input {name}: {len(values)} periods of {value.period!r} do not fill the "
                    f"{abs(duration):g} from t0 to t_end.\nEnd the run with the last period."
                )
        if not callable(values):
            values = np.asarray(values, dtype=float)
            if values.ndim > 1 or not values.size or not np.isfinite(values).all():
                raise InputError(
                    f"input {name} has shape {values.shape}, or is not finite.\nThe step is chosen "
                    "for you: pass a number, a function of t, or an array of K finite values, each "
                    "of which is held for the K-th part of the time from t0 to t_end."
                )
            parts = math.lcm(parts, max(values.size, 1))
            values = values if values.ndim else float(values)
        inputs[name] = values
    return inputs, parts


def name_of(stepper: Stepper) -> str:
    """Return the name of a scheme, and whether its steps are fixed in another time."""
    return stepper.scheme + (" in tau" if stepper.program.header.retimed else "")
