"""Runs of several schemes for the same error, along the whole path."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError, StabilityWarning, reject
from symsimpson.program.input_values import read_array
from symsimpson.program.numbers import FLOAT64
from symsimpson.program.program import Program
from symsimpson.results.states import States
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import uninterrupted
from symsimpson.stepping.driving import Samples, given_inputs
from symsimpson.support.array_types import Floats

#: Schemes that would take so many times as long as another are not tried further.
HOPELESS = 8.0
#: A run that takes this long is timed twice.
LONG = 0.05
#: What is measured may be wrong by so much: steps are chosen for the error divided by this.
SAFETY = 2.0
#: More steps than this are not tried on a pilot run, nor half as many for the whole motion.
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
    error: float = math.inf
    work: int = 0  # steps and iterations
    seconds: float = math.inf


@dataclass(frozen=True)
class Motion:
    """A motion from a state to a time, and the error that is allowed."""

    parameters: Mapping[str, float]
    t0: float
    duration: float
    error: float
    on: str
    events: Any
    #: By name: a number, a function of t, or samples.
    inputs: Mapping[str, Any] = field(default_factory=dict)
    parts: int = 1  #: Each of these parts of the duration has a whole number of steps.
    #: The initial state, each of shape (n,).
    q: Floats = field(default_factory=partial(np.zeros, 0))
    p: Floats = field(default_factory=partial(np.zeros, 0))
    v: Floats = field(default_factory=partial(np.zeros, 0))
    #: Why the last run failed, if it did.
    failures: list[str] = field(default_factory=list)
    #: What a progress bar shows of it.
    shown: list[str] = field(default_factory=list)
    most_trials: int = 0

    def driven(self, program: Program, given: Any) -> Motion:
        """Return the motion with inputs as a user gives them.

        Raises InputError if one is no number, function of t, or array of values for equal parts.
        """
        inputs, parts, length = given_inputs(program, given), 1, abs(self.duration)
        for name in program.inputs:
            value = inputs.get(name)
            if callable(value):
                continue
            values = np.zeros(0) if value is None else getattr(value, "values", value)
            shape = read_array(f"input {name}", values, FLOAT64).shape
            if len(shape) > 1 or 0 in shape:
                has = "no values" if value is None else f"an array of shape {shape}"
                reject(
                    f"{program.system}: input {name} has {has}.",
                    remedy="The step size is chosen: pass a number, a function of t, or "
                    "an array of K "
                    "values, each for the K-th part of the time from t0 to t_end.",
                )
            if shape:
                held = value if isinstance(value, Samples) else Samples(values, length / shape[0])
                exact = length / float(held.period)
                inputs[name], parts = held, math.lcm(parts, max(1, round(exact)))
                if abs(exact - round(exact)) > 1e-9 * exact:
                    reject(
                        f"input {name}: {length:g} from t0 to t_end is no whole number of periods "
                        f"of {held.period!r}.",
                        remedy="End the run with the last of them.",
                    )
        return replace(self, inputs=inputs, parts=parts)

    @property
    def inputs_at_start(self) -> dict[str, float]:
        """The value of each input at the start."""
        values = ((k, x(self.t0) if callable(x) else x) for k, x in self.inputs.items())
        return {k: float(np.ravel(getattr(x, "values", x))[0]) for k, x in values}

    def until(self, duration: float) -> Motion:
        """Return the first part of a motion."""
        share = min(1.0, duration / self.duration)
        parts = math.ceil(share * self.parts)
        share = parts / self.parts if self.parts > 1 else share
        return replace(self, duration=share * self.duration, parts=parts)

    def whole(self, steps: float) -> int:
        """Return a number of steps, not less than this one, that the motion may have."""
        unit = self.parts * (64 if steps > MOST_NUMBERS / len(self.q) / 2 else 2)
        return math.ceil(steps / unit) * unit

    def arguments(self, stepper: Stepper, steps: int) -> dict[str, Any]:
        """Return what a run is given beside the initial state."""
        retimed = stepper.program.header.retimed
        length = {"t_end": self.t0 + self.duration} if retimed else {"steps": steps}
        given = {"inputs": self.inputs or None, "events": self.events, "t0": self.t0, **length}
        return {"h": self.duration / steps, "parameters": self.parameters, **given}

    def run(self, stepper: Stepper, steps: int) -> Trajectory:
        """Run, and store as many states as a comparison needs."""
        every = 1
        while steps % (2 * every) == 0 and steps * len(self.q) > MOST_NUMBERS * every:
            every *= 2
        given = self.arguments(stepper, steps) | {"every": every, "on_failure": "return"}
        run = uninterrupted(stepper.integrate(self.q, p0=self.p, **given))
        self.failures[:] = [] if run.success else [run.message]
        return run

    def measure(
        self, stepper: Stepper, steps: int, coarse: Trajectory, *, scout: bool = False
    ) -> tuple[PathError, Trajectory]:
        """Return the error of a run with this number of steps, and the finest run."""
        if not coarse.success:
            return PathError(math.inf, float(coarse.t[-1])), coarse
        if self.on == "energy":
            return PathError.of(coarse.t, np.abs(coarse.energy_error), self.error), coarse
        fine = self.run(stepper, 2 * steps)
        worst = path_error(coarse, fine, self.duration, self.error)
        few = SCOUT // len(self.q) // steps
        if scout and worst.since is None and few > 2:
            fine = self.run(stepper, 2 ** few.bit_length() * steps)
            other = path_error(coarse, fine, self.duration, self.error)
            worst = max(worst, other, key=lambda error: error.largest)
        return worst, fine

    def least(self, stepper: Stepper) -> int:
        """Return the fewest steps for which no stability warning appears at the start."""
        program, steps = stepper.program, self.whole(4)
        state = self.q, self.v, [*self.parameters.values(), *self.inputs_at_start.values()]
        while steps < MOST_STEPS and program.tools and not program.header.retimed:
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always", StabilityWarning)
                h = self.duration / steps
                program.tools.check_step(program, program.declared, *state, h, self.t0)
            if not warned:
                break
            steps = self.whole(1.25 * steps)
        return steps

    def show(self) -> None:
        """Count a trial for the progress bar."""
        count = f"trial {len(self.shown)} of at most {self.most_trials}"
        self.shown.append(f"choosing a scheme and a step, {count}")

    def solve(
        self, stepper: Stepper, h0: float, allowed: float, quickest: float
    ) -> Candidate | None:
        """Find the number of steps that reaches an error; None if there is none.

        The search ends where it would take much longer than ``quickest``. With a time
        transformation, the number counts steps as long as the first.
        """
        least, errors = self.least(stepper), [math.inf] * STAGNANT
        steps = self.whole(max(least, abs(self.duration / h0) / math.sqrt(stepper.order)))
        best: Candidate | None = None
        for _ in range(ROUNDS):
            if steps > MOST_STEPS:
                break
            self.show()
            measured = self._timed(stepper, steps)
            change = (max(measured.error, FLOOR) / allowed) ** (1 / stepper.order)
            if measured.error > allowed:
                errors.append(measured.error)
                factor = min(max(change, 1.1), 8.0)
                hopeless = factor * measured.seconds > HOPELESS * quickest
                stagnant = math.inf > errors[-1] > errors[-1 - STAGNANT] / 2
                if best or allowed < FLOOR or hopeless or stagnant:
                    break
            else:
                slower = best and measured.seconds > SLOWER * best.seconds
                if best and (slower or measured.work > best.work):
                    break  # fewer steps that are solved with more effort
                best, factor = measured, max(1.05 * change, 0.5, least / steps)
                if self.whole(factor * steps) > FEWER * steps:
                    break
            steps = self.whole(factor * steps)
        return best

    def _timed(self, stepper: Stepper, steps: int) -> Candidate:
        """Measure the error, the work and the time of a run with this number of steps."""
        times: list[float] = []
        while len(times) < REPEATS and not (len(times) > 1 and times[-1] > LONG):
            begin = time.perf_counter()
            coarse = self.run(stepper, steps)  # the first may compile
            times.append(time.perf_counter() - begin)
        worst, _ = self.measure(stepper, steps, coarse)
        work = coarse.steps + int(coarse.newton_iterations.sum())
        return Candidate(stepper, steps, worst.largest, work, min(times))


def verify(motion: Motion, stepper: Stepper, steps: float) -> tuple[int, PathError]:
    """Refine the step until the error of the whole motion is small enough; return that error."""
    steps = motion.whole(max(steps, LEAST, motion.least(stepper)))
    most, coarse = max(MOST_STEPS // 2, 4 * steps), motion.run(stepper, steps)
    for refinement in range(REFINEMENTS + 1):
        motion.show()
        worst, fine = motion.measure(stepper, steps, coarse, scout=True)
        wanted = (SAFETY * worst.largest / motion.error) ** (1 / stepper.order)
        factor = 2 if wanted <= 2 else 4
        if worst.since is None or refinement == REFINEMENTS or factor * steps > most:
            break
        steps *= factor
        coarse = fine if fine.h == motion.duration / steps else motion.run(stepper, steps)
    return steps, worst


#: The path is compared at so many equidistant times, the ends included.
EQUIDISTANT = 21
#: It is also compared at so many stored states, divided by the number of coordinates, and at as
#: many of the first ones.
STORED = 2**13
#: A variable is constant if it changes by this part of its size times the root of the steps.
ROUNDING = 2.0**-49


@dataclass(frozen=True)
class PathError:
    """The largest difference, and the time from which differences exceed the bound."""

    largest: float
    since: float | None = None

    @classmethod
    def of(cls, t: Floats, off: Floats, bound: float) -> PathError:
        """Return the path error for the differences ``off`` at the times ``t``."""
        off = np.where(np.isnan(off), np.inf, off)
        beyond = np.flatnonzero(off > bound)
        return cls(float(off.max(initial=0.0)), float(t[beyond[0]]) if beyond.size else None)


def path_error(coarse: Trajectory, fine: Trajectory, duration: float, bound: float) -> PathError:
    """Compare a run with one of smaller steps, relative to how far each variable moves.

    ``duration`` is the planned length of both runs, negative if they go backwards.
    """
    for run in (coarse, fine):
        if not run.success:
            return PathError(np.inf, float(run.t[-1]))
    sign, t0, scale = np.sign(duration), float(coarse.t[0]), _scale(fine)
    ends = [float(run.t[-1]) for run in (coarse, fine)]
    end = sign * min(sign * t for t in ends)
    count = STORED // coarse.program.n + 1
    stored = np.union1d(np.linspace(0, len(coarse) - 1, count).astype(int), np.arange(count))
    # the last of equidistant times is the last stored one, however it was rounded
    equidistant = t0 + duration * np.linspace(0, 1, EQUIDISTANT)[:-1]
    times = sign * np.union1d(sign * equidistant, sign * coarse.t[stored[stored < len(coarse)]])
    times = times[sign * (end - times) >= 0]
    try:
        off = _difference(coarse.at(times), fine.at(times), scale)
    except ConvergenceError as error:
        return PathError(np.inf, error.time)
    # between the times of an event one run is before it, and the other after
    for first, second in zip_longest(coarse.records, fine.records):
        if first and second and first.event != second.event:
            break
        low, high = sorted(record.t if record else t0 + duration for record in (first, second))
        slack = 8 * np.finfo(float).eps * max(abs(low), abs(high), abs(duration))
        if high - low <= bound * abs(duration):
            off[(times >= low - slack) & (times <= high + slack)] = 0.0
    if coarse.ended_by is not None or fine.ended_by is not None:
        late = abs(ends[0] - ends[1]) / abs(duration)
        if coarse.ended_by == fine.ended_by:
            late = max(late, *_difference(coarse[-1:], fine[-1:], scale))
        times, off = np.append(times, end), np.append(off, late)
    return PathError.of(times, off, bound)


def _difference(coarse: States, fine: States, scale: Floats) -> Floats:
    """Return the largest difference of each pair of states, in units of ``scale``."""
    first, second = (np.hstack([states.q, states.p]) for states in (coarse, fine))
    with np.errstate(divide="ignore", invalid="ignore"):
        off: Floats = np.where(first == second, 0.0, np.abs(first - second) / scale)
    return off.max(axis=1)


def _scale(run: Trajectory) -> Floats:
    """Return how far variables of each unit move from the start, shape (2 n,).

    A variable that stays constant has its own size as its scale. Momenta of coordinates at rest
    are rounding errors, and are not compared: their scale is infinite.
    """
    units, names, n = run.program.units, run.program.coordinates, run.program.n
    kinds: list[tuple[str, str | None, str | None]]
    kinds = [("q", units.get(name), None) for name in names]
    kinds += [("p", units.get(name), units.get(f"p_{name}")) for name in names]
    numbers = {kind: k for k, kind in enumerate(dict.fromkeys(kinds))}
    group = np.array([numbers[kind] for kind in kinds])
    same = group[:, None] == group
    states = np.hstack([run.q, run.p])
    moved, size = (
        np.where(same, np.abs(x).max(axis=0), 0.0).max(axis=1) for x in (states - states[0], states)
    )
    still = moved <= ROUNDING * np.sqrt(max(run.steps, 1)) * size
    scale = np.where(still, size, moved)
    scale[n:][(same[n:, n:] <= still[:n]).all(axis=1)] = np.inf
    return scale
