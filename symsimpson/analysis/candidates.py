"""Runs of several schemes for the same error: how many steps each needs, and how long they take."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.analysis.stability.frequency import largest_stable
from symsimpson.api.stepper import Stepper
from symsimpson.program.status import Status
from symsimpson.support.array_types import Floats

__all__ = ["Found", "Wanted"]

#: What is measured may be wrong by so much: steps are chosen for the error divided by this.
SAFETY = 2.0
#: An error that grew like a higher power of time grew exponentially.
POWER = 3.0
#: More steps than this are not tried on a pilot run.
MOST_STEPS = 2_000_000
#: Errors closer to rounding than this cannot be told from it.
FLOOR = 3e-14
ROUNDS, REPEATS = 8, 3
#: A smaller gain in steps is not worth another run.
FEWER = 0.85
#: Fewer steps that take this many times as long fell back on another solver. Smaller differences
#: are those of a busy machine: iterations are counted instead.
SLOWER = 2.0


@dataclass(frozen=True)
class Found:
    """How one scheme reaches the error on the pilot run."""

    stepper: Stepper
    steps: int
    error: float
    growth: float
    work: int  # steps and iterations
    taken: int  # steps
    seconds: float


@dataclass(frozen=True)
class Seen:
    """States of a run at the start, in the middle and at the end."""

    q: Floats
    p: Floats
    steps: int
    iterations: int
    energy_error: float


@dataclass(frozen=True)
class Wanted:
    """The error that is asked for, and the pilot run against which it is measured."""

    q: Floats
    p: Floats
    parameters: Mapping[str, float]
    pilot: float
    t_end: float
    error: float
    on: str
    frequency: float
    compared: bool
    failures: list[str]

    def solve(self, stepper: Stepper, h0: float) -> Found | None:
        """Find the number of steps that reaches the error; None if there is none.

        In another time it is that of steps as long as the first.
        """
        limit = largest_stable(stepper.scheme)
        least = math.ceil(max(4.0, self.pilot * self.frequency / limit))
        steps = max(least, math.ceil(self.pilot / (h0 * math.sqrt(stepper.order))))
        best: Found | None = None
        for _ in range(ROUNDS):
            steps += steps % 2  # the middle of the run is looked at, too
            measured = self._measure(stepper, steps) if steps <= MOST_STEPS else None
            if measured is None:
                if steps > MOST_STEPS:
                    return best
                steps = 2 * steps if best is None else math.ceil(math.sqrt(steps * best.steps))
                if best and steps > FEWER * best.steps:
                    return best
                continue
            error, growth, work, taken, seconds = measured
            wanted = self._wanted(growth)
            change = (max(error, FLOOR) / wanted) ** (1 / stepper.order)
            if error <= wanted:
                if best and (work > best.work or seconds > SLOWER * best.seconds):
                    return best  # fewer steps that are solved with more effort
                best = Found(stepper, steps, error, growth, work, taken, seconds)
                fewer = max(least, math.ceil(steps * max(1.05 * change, 0.5)))
                if fewer > FEWER * steps:
                    return best
                steps = fewer
            elif best is not None or wanted < FLOOR:
                return best
            else:
                steps = math.ceil(steps * min(max(change, 1.1), 8.0))
        return best

    def _wanted(self, growth: float) -> float:
        """Return the error that the pilot run may have, which grew like this power of time there.

        Above POWER it doubled in equal times, as in chaotic motion, and is assumed to go on so.
        """
        allowed, rest = self.error / SAFETY, self.t_end / self.pilot - 1
        if growth > POWER:
            return allowed * 2.0 ** (-2 * growth * rest)
        return allowed * (1 + rest) ** -growth

    def _measure(self, stepper: Stepper, steps: int) -> tuple[float, float, int, int, float] | None:
        """Return the error, the exponent of its growth with time, work, steps, and the run time."""
        seconds = math.inf
        for _ in range(REPEATS):  # the first one may compile
            begin = time.perf_counter()
            run = self._run(stepper, steps, None)
            seconds = min(seconds, time.perf_counter() - begin)
            if run is None:
                return None
        coarse = self._seen(stepper, steps)
        if coarse is None:
            return None
        work = coarse.steps + coarse.iterations
        if self.on == "energy":
            return coarse.energy_error, 0.0, work, coarse.steps, seconds
        fine = self._seen(stepper, 2 * steps)
        if fine is None:
            return None
        share = 1 / (1 - 2.0**-stepper.order)
        middle, end = (self._distance(coarse, fine, k) * share for k in (1, 2))
        growth = math.log2(max(end, FLOOR) / max(middle, FLOOR))
        return end, max(growth, 1.0), work, coarse.steps, seconds

    def _run(self, stepper: Stepper, steps: int, every: int | None) -> Any:
        length = {"t_end": self.pilot} if stepper.program.header.retimed else {"steps": steps}
        run = stepper.integrate(
            self.q,
            p0=self.p,
            h=self.pilot / steps,
            **length,
            every=every,
            parameters=self.parameters,
            on_failure="return",
        )
        if run.status is not Status.SUCCESS:
            self.failures.append(run.message)
            return None
        return run

    def _seen(self, stepper: Stepper, steps: int) -> Seen | None:
        whole = self.on == "energy" or stepper.program.header.retimed
        run = self._run(stepper, steps, 1 if whole else steps // 2)
        if run is None:
            return None
        q, p, largest = run.q, run.p, 0.0
        if self.on == "energy":
            largest = float(np.abs(run.energy_error).max())
        elif whole:
            states = run.at([0.0, self.pilot / 2, self.pilot])
            q, p = states.q, states.p
        return Seen(q, p, run.steps, int(run.newton_iterations.sum()), largest)

    def _distance(self, run: Seen, other: Seen, place: int) -> float:
        scale_q = np.maximum(np.abs(other.q).max(axis=0), 1.0)
        scale_p = np.abs(other.p).max() or 1.0
        gap_q = np.abs((run.q[place] - other.q[place]) / scale_q).max()
        return float(max(gap_q, np.abs(run.p[place] - other.p[place]).max() / scale_p))

    def reason(self, best: Found, candidates: Sequence[Found], steps: int) -> str:
        """Say what was chosen and why."""
        part = "" if self.pilot == self.t_end else f" until t = {self.pilot:g}"
        what, retimed = f"{self.on} error", best.stepper.program.header.retimed
        count = "the first step; then they adapt" if retimed else f"{steps} steps"
        lines = [
            f"{best.stepper.scheme} with h = {self.t_end / steps:.6g} ({count}): the relative "
            f"{what} measured{part} is {best.error:.1e}, {self.error:.1e} is asked for."
        ]
        fixed = [
            candidate for candidate in candidates if not candidate.stepper.program.header.retimed
        ]
        if retimed:
            taken = f"{best.stepper.system} takes {best.taken} steps{part}"
            fewest = min((candidate.taken for candidate in fixed), default=0)
            beside = f", the fewest of fixed size are {fewest}" if fixed else ""
            if self.compared and not fixed:
                beside = "; no fixed steps that were tried come to that error"
            lines.append(f"{taken}{beside}.")
        if part and self.on == "state":
            grew = f"grew like t^{best.growth:.1f}"
            if best.growth > POWER:
                grew = f"doubled in each {self.pilot / 2 / best.growth:.3g} of time"
            lines.append(
                f"It {grew} there, and is assumed to go on so; chaotic motion may be worse."
            )
        if self.frequency > 0 and math.isfinite(largest_stable(best.stepper.scheme)):
            bound = largest_stable(best.stepper.scheme) / self.frequency
            lines.append(f"Linear stability at the start bounds h by {bound:.3g}.")
        others = sorted((x for x in candidates if x is not best), key=lambda x: x.seconds)
        if others:
            list_of = ", ".join(
                f"{_name(x.stepper)} {x.seconds / best.seconds:.1f} times its time" for x in others
            )
            lines.append(f"For the same error: {list_of}.")
        return " ".join(lines)


def _name(stepper: Stepper) -> str:
    return stepper.scheme + (" in tau" if stepper.program.header.retimed else "")
