"""Candidate schemes for an error tolerance: the steps that each needs, and its error."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping, Sequence
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
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.stepping.driving import Samples, collect_inputs
from symsimpson.support.array_types import Floats

#: The search drops a scheme that would take this many times as long as the fastest one.
MAX_SLOWDOWN = 8.0
#: A run of more seconds than this is timed twice only.
SLOW_RUN = 0.05
#: Steps are chosen for the tolerance divided by this factor, because estimates are uncertain.
SAFETY = 2.0
#: Largest number of steps of a pilot run. The whole motion has at most half as many.
MAX_STEPS = 2_000_000
#: Largest number of values that a run stores for a comparison.
MAX_NUMBERS = 2**21
#: A whole motion of few steps is also compared with a run of this many steps, divided by the number
#: of coordinates. That run shows short forces, which act between the nodes of both others.
SCOUT_STEPS = 2**15
#: Smaller errors cannot be distinguished from round-off.
ROUND_OFF = 3e-14
ROUNDS, REPEATS = 8, 3
#: No step resolves a motion whose error does not fall in this many rounds.
STAGNATION_ROUNDS = 3
#: Another run is worthwhile only if it has less than this part of the steps.
WORTHWHILE = 0.85
#: If fewer steps take this many times as long, the step fell back on another solver. A busy
#: machine makes smaller differences, so that the number of iterations decides below this factor.
FALLBACK_SLOWDOWN = 2.0
#: Least number of steps of the whole motion, and largest number of refinements of its step.
MIN_STEPS, REFINEMENTS = 20, 6


@dataclass(frozen=True)
class Candidate:
    """A scheme with the number of steps at which it reaches the tolerance on the pilot run."""

    stepper: Stepper
    steps: int
    error: float = math.inf
    work: int = 0  # number of steps plus number of iterations
    seconds: float = math.inf


@dataclass(frozen=True)
class Motion:
    """A motion: its initial state, duration, parameters and inputs, with an error tolerance."""

    parameters: Mapping[str, float]
    t0: float
    duration: float
    error: float
    on: str  #: What ``error`` bounds: "state" or "energy".
    events: Any
    #: By name: a number, a function of t, or Samples.
    inputs: Mapping[str, Any] = field(default_factory=dict)
    #: The duration has this many equal parts, each with a whole number of steps.
    parts: int = 1
    #: The initial state, each of shape (n,).
    q: Floats = field(default_factory=partial(np.zeros, 0))
    p: Floats = field(default_factory=partial(np.zeros, 0))
    v: Floats = field(default_factory=partial(np.zeros, 0))
    #: The message of the last run if it failed, else empty.
    failures: list[str] = field(default_factory=list)
    #: The labels of the progress bar, the last of which it shows.
    labels: list[str] = field(default_factory=list)
    max_trials: int = 0

    def with_inputs(self, program: Program, signals: Any) -> Motion:
        """Return the motion with the inputs ``signals``, as a user passes them.

        Raises InputError if an input is not a number, a function of t, or a 1-D array.
        """
        inputs, parts, length = collect_inputs(program, signals), 1, abs(self.duration)
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
                    why="Its values must not depend on the step size, which is chosen here.",
                    remedy="Pass a number or a function of t. Or pass an array of K values, one "
                    "for each of K equal parts of the time from t0 to t_end.",
                )
            if shape:
                signal = value if isinstance(value, Samples) else Samples(values, length / shape[0])
                exact = length / float(signal.period)
                inputs[name], parts = signal, math.lcm(parts, max(1, round(exact)))
                if abs(exact - round(exact)) > 1e-9 * exact:
                    reject(
                        f"input {name}: the time {length:g} from t0 to t_end is not a whole "
                        f"number of periods of {signal.period!r}.",
                        remedy="Choose t_end at the end of a period.",
                    )
        return replace(self, inputs=inputs, parts=parts)

    @property
    def initial_inputs(self) -> dict[str, float]:
        """The value of each input at t0."""
        values = ((k, x(self.t0) if callable(x) else x) for k, x in self.inputs.items())
        return {k: float(np.ravel(getattr(x, "values", x))[0]) for k, x in values}

    def truncate(self, duration: float) -> Motion:
        """Return the beginning of the motion: ``duration``, rounded up to whole input periods."""
        fraction = min(1.0, duration / self.duration)
        parts = math.ceil(fraction * self.parts)
        fraction = parts / self.parts if self.parts > 1 else fraction
        return replace(self, duration=fraction * self.duration, parts=parts)

    def round_up(self, steps: float) -> int:
        """Return the next number of steps that input periods and ``every`` divide."""
        unit = self.parts * (64 if steps > MAX_NUMBERS / len(self.q) / 2 else 2)
        return math.ceil(steps / unit) * unit

    def run_arguments(self, stepper: Stepper, steps: int) -> dict[str, Any]:
        """Return the arguments of ``Stepper.integrate`` except for the initial state."""
        retimed = stepper.program.header.retimed
        return {
            "h": self.duration / steps,
            "parameters": self.parameters,
            "inputs": self.inputs or None,
            "events": self.events,
            "t0": self.t0,
            **({"t_end": self.t0 + self.duration} if retimed else {"steps": steps}),
        }

    def run(self, stepper: Stepper, steps: int) -> Trajectory:
        """Integrate the motion, and store at most ``MAX_NUMBERS`` values."""
        every = 1
        while steps % (2 * every) == 0 and steps * len(self.q) > MAX_NUMBERS * every:
            every *= 2
        options = {"every": every, "on_failure": "return"}
        arguments = self.run_arguments(stepper, steps) | options
        run = raise_if_interrupted(stepper.integrate(self.q, p0=self.p, **arguments))
        self.failures[:] = [] if run.success else [run.message]
        return run

    def measure_error(
        self, stepper: Stepper, steps: int, coarse: Trajectory, *, scout: bool = False
    ) -> tuple[PathError, Trajectory]:
        """Return the error of the run ``coarse``, and the finest run that measured it.

        ``scout`` adds a comparison with a run of ``SCOUT_STEPS`` steps.
        """
        if not coarse.success:
            return PathError(math.inf, float(coarse.t[-1])), coarse
        if self.on == "energy":
            errors = np.abs(coarse.energy_error)
            return PathError.from_differences(coarse.t, errors, self.error), coarse
        fine = self.run(stepper, 2 * steps)
        worst = compare_paths(coarse, fine, self.duration, self.error)
        ratio = SCOUT_STEPS // len(self.q) // steps
        if scout and worst.violation_time is None and ratio > 2:
            fine = self.run(stepper, 2 ** ratio.bit_length() * steps)
            other = compare_paths(coarse, fine, self.duration, self.error)
            worst = max(worst, other, key=lambda error: error.largest)
        return worst, fine

    def min_stable_steps(self, stepper: Stepper) -> int:
        """Return the least number of steps without a stability warning at the initial state."""
        program, steps = stepper.program, self.round_up(4)
        state = self.q, self.v, [*self.parameters.values(), *self.initial_inputs.values()]
        while steps < MAX_STEPS and program.tools and not program.header.retimed:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", StabilityWarning)
                h = self.duration / steps
                program.tools.check_step(program, program.declared, *state, h, self.t0)
            if not caught:
                break
            steps = self.round_up(1.25 * steps)
        return steps

    def count_trial(self) -> None:
        """Count one more trial, and show the number in the progress bar."""
        count = f"trial {len(self.labels)} of at most {self.max_trials}"
        self.labels.append(f"choosing a scheme and a step, {count}")

    def find_steps(
        self, stepper: Stepper, h0: float, tolerance: float, fastest: float
    ) -> Candidate | None:
        """Find the number of steps that reaches a tolerance; None if the search fails.

        The first step size is ``h0``, reduced for high orders. The search fails if it would take
        ``MAX_SLOWDOWN`` times as long as ``fastest``, in seconds. With a time transformation, the
        number of steps is the duration divided by the first step size.
        """
        min_steps, errors = self.min_stable_steps(stepper), [math.inf] * STAGNATION_ROUNDS
        steps = self.round_up(max(min_steps, abs(self.duration / h0) / math.sqrt(stepper.order)))
        best: Candidate | None = None
        for _ in range(ROUNDS):
            if steps > MAX_STEPS:
                break
            self.count_trial()
            trial = self._time_run(stepper, steps)
            change = (max(trial.error, ROUND_OFF) / tolerance) ** (1 / stepper.order)
            if trial.error > tolerance:
                errors.append(trial.error)
                factor = min(max(change, 1.1), 8.0)
                too_slow = factor * trial.seconds > MAX_SLOWDOWN * fastest
                stagnant = math.inf > errors[-1] > errors[-1 - STAGNATION_ROUNDS] / 2
                if best or tolerance < ROUND_OFF or too_slow or stagnant:
                    break
            else:
                slower = best and trial.seconds > FALLBACK_SLOWDOWN * best.seconds
                if best and (slower or trial.work > best.work):
                    break  # fewer steps need more iterations in total
                best, factor = trial, max(1.05 * change, 0.5, min_steps / steps)
                if self.round_up(factor * steps) > WORTHWHILE * steps:
                    break
            steps = self.round_up(factor * steps)
        return best

    def _time_run(self, stepper: Stepper, steps: int) -> Candidate:
        """Measure the error, the work and the seconds of a run; the best of some repetitions."""
        times: list[float] = []
        while len(times) < REPEATS and not (len(times) > 1 and times[-1] > SLOW_RUN):
            begin = time.perf_counter()
            coarse = self.run(stepper, steps)  # the first may compile
            times.append(time.perf_counter() - begin)
        worst, _ = self.measure_error(stepper, steps, coarse)
        work = coarse.steps + int(coarse.newton_iterations.sum())
        return Candidate(stepper, steps, worst.largest, work, min(times))


def verify(motion: Motion, stepper: Stepper, steps: float) -> tuple[int, PathError]:
    """Refine the step size until the whole motion meets its tolerance.

    Returns the number of steps and the error. The error exceeds the tolerance if the last of
    ``REFINEMENTS`` refinements does not meet it.
    """
    steps = motion.round_up(max(steps, MIN_STEPS, motion.min_stable_steps(stepper)))
    max_steps, coarse = max(MAX_STEPS // 2, 4 * steps), motion.run(stepper, steps)
    for refinement in range(REFINEMENTS + 1):
        motion.count_trial()
        worst, fine = motion.measure_error(stepper, steps, coarse, scout=True)
        change = (SAFETY * worst.largest / motion.error) ** (1 / stepper.order)
        factor = 2 if change <= 2 else 4
        if worst.violation_time is None or refinement == REFINEMENTS or factor * steps > max_steps:
            break
        steps *= factor
        coarse = fine if fine.h == motion.duration / steps else motion.run(stepper, steps)
    return steps, worst


def find_candidates(
    motion: Motion, pilot: Motion, steppers: Sequence[Stepper], h0: float
) -> list[Candidate]:
    """Return the steppers that reach the tolerance on the pilot run, beginning with step h0."""
    tolerance = motion.error / SAFETY
    if motion.on == "state":  # errors grow at least linearly with time
        tolerance *= pilot.duration / motion.duration
    candidates: list[Candidate] = []
    for stepper in reversed(steppers):  # high orders first: low orders may be far slower
        fastest = min((x.seconds for x in candidates), default=math.inf)
        if candidate := pilot.find_steps(stepper, h0, tolerance, fastest):
            candidates.append(candidate)
    return candidates


def describe_choice(
    motion: Motion, chosen: Candidate, steps: int, worst: PathError, candidates: list[Candidate]
) -> str:
    """Describe the choice in sentences: its error, and the run times of other schemes."""
    stepper, retimed = chosen.stepper, chosen.stepper.program.header.retimed
    count = "the first step; the step size then adapts" if retimed else f"{steps} steps"
    name = f"{stepper.scheme} with h = {motion.duration / steps:.6g} ({count})"
    tolerance = f"the tolerance is {motion.error:.1e}"
    if worst.violation_time is not None:
        return (
            f"The error is {worst.largest:.1e}; {tolerance}. The error exceeds it from "
            f"t = {worst.violation_time:g} on. The smallest step size that was tried is that of "
            f"{name}."
        )
    if motion.on == "energy":
        measured = f"The largest relative energy error is {worst.largest:.1e}"
    else:
        measured = (
            "Relative to its extent, the path differs from the path with half the step size by "
            f"{worst.largest:.1e}"
        )
    lines = [f"{name}. {measured}; {tolerance}."]
    if retimed:
        lines.append(f"The step size of {stepper.system} adapts to the motion.")
        fixed = [x.steps for x in candidates if not x.stepper.program.header.retimed]
        lines += [f"A fixed step size needs at least {min(fixed)} steps."] if fixed else []
    others = [
        f"{x.stepper.scheme}{' in tau' * x.stepper.program.header.retimed} "
        f"{x.seconds / chosen.seconds:.1f}"
        for x in sorted(candidates, key=lambda x: x.seconds)
        if x is not chosen
    ]
    lines += [f"Relative run times for the same error: {', '.join(others)}."] if others else []
    return " ".join(lines)


#: Number of equidistant times at which two paths are compared, the ends included.
EQUIDISTANT_TIMES = 21
#: Two paths are also compared at this many stored states, divided by the number of coordinates:
#: once spread over the run, and once at its beginning.
STORED_NUMBERS = 2**13
#: A variable is constant if it changes by this part of its size times the root of the steps.
ROUNDING = 2.0**-49


@dataclass(frozen=True)
class PathError:
    """The largest difference of two paths, and the first time at which it exceeds the bound."""

    largest: float
    violation_time: float | None = None

    @classmethod
    def from_differences(cls, t: Floats, differences: Floats, bound: float) -> PathError:
        """Return the path error for the differences at the times ``t``, shape (N,) each."""
        differences = np.where(np.isnan(differences), np.inf, differences)
        violations = np.flatnonzero(differences > bound)
        first = float(t[violations[0]]) if violations.size else None
        return cls(float(differences.max(initial=0.0)), first)


def compare_paths(coarse: Trajectory, fine: Trajectory, duration: float, bound: float) -> PathError:
    """Compare a run with one of smaller steps, relative to how far each variable moves.

    ``duration`` is the planned length of both runs, negative if they go backwards. A failed run
    has an infinite error.
    """
    for run in (coarse, fine):
        if not run.success:
            return PathError(np.inf, float(run.t[-1]))
    sign, t0, scale = np.sign(duration), float(coarse.t[0]), _scale(fine)
    ends = [float(run.t[-1]) for run in (coarse, fine)]
    end = sign * min(sign * t for t in ends)
    count = STORED_NUMBERS // coarse.program.n + 1
    stored = np.union1d(np.linspace(0, len(coarse) - 1, count).astype(int), np.arange(count))
    # the last equidistant time is the last stored one, which may be rounded differently
    equidistant = t0 + duration * np.linspace(0, 1, EQUIDISTANT_TIMES)[:-1]
    times = sign * np.union1d(sign * equidistant, sign * coarse.t[stored[stored < len(coarse)]])
    times = times[sign * (end - times) >= 0]
    try:
        differences = _compare_states(coarse.at(times), fine.at(times), scale)
    except ConvergenceError as error:
        return PathError(np.inf, error.time)
    # an event has two times, one in each run; only one run is past the event between them
    for first, second in zip_longest(coarse.records, fine.records):
        if first and second and first.event != second.event:
            break
        low, high = sorted(record.t if record else t0 + duration for record in (first, second))
        slack = 8 * np.finfo(float).eps * max(abs(low), abs(high), abs(duration))
        if high - low <= bound * abs(duration):
            differences[(times >= low - slack) & (times <= high + slack)] = 0.0
    if coarse.ended_by is not None or fine.ended_by is not None:
        at_end = abs(ends[0] - ends[1]) / abs(duration)
        if coarse.ended_by == fine.ended_by:
            at_end = max(at_end, *_compare_states(coarse[-1:], fine[-1:], scale))
        times, differences = np.append(times, end), np.append(differences, at_end)
    return PathError.from_differences(times, differences, bound)


def _compare_states(coarse: States, fine: States, scale: Floats) -> Floats:
    """Return the largest difference of each pair of states in units of ``scale``, shape (N,)."""
    first, second = (np.hstack([states.q, states.p]) for states in (coarse, fine))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative: Floats = np.where(first == second, 0.0, np.abs(first - second) / scale)
    return relative.max(axis=1)


def _scale(run: Trajectory) -> Floats:
    """Return how far the variables of each unit move from the initial state, shape (2 n,).

    The scale of a constant variable is its own size. If a coordinate does not move, its momentum
    is a round-off error, which is not compared: the scale is infinite.
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
