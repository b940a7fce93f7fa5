"""A scheme and a step for a wanted error, found by short runs."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.analysis.pilot import any_step, choose_state, choose_step
from symsimpson.analysis.stability.frequency import largest_frequency, largest_stable
from symsimpson.api import compile as compile_system
from symsimpson.errors import InputError
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.progress import waiting
from symsimpson.runtime.results.status import Status
from symsimpson.runtime.stepper import Stepper
from symsimpson.schemes.scheme import Scheme

__all__ = ["Choice", "choose"]

#: Schemes that are tried, from low to high order; and where explicit steps are possible.
CANDIDATES = ("simpson", "gauss8", "gauss12", "gauss16")
WITH_EXPLICIT = ("simpson", "blanes_moan4", "blanes_moan6", "gauss12", "gauss16")
#: A pilot run is at most so many of the steps long with which Simpson's scheme follows the motion.
PILOT = 1000
#: What is measured may be wrong by so much: steps are chosen for the error divided by this.
SAFETY = 2.0
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

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Choice:
    """A scheme and a step, and why.

    Attributes
    ----------
    stepper : Stepper
    h : float
        A whole number of steps makes up ``t_end``.
    reason : str
        What was measured, in sentences.

    Examples
    --------
    >>> import symsimpson as ss
    >>> choice = ss.choose(ss.systems.pendulum(), [1.0], v0=[0.0], t_end=5.0, error=1e-6)
    >>> choice.reason.startswith(f"{choice.stepper.scheme} with h = ")
    True
    """

    stepper: Stepper
    h: float
    reason: str

    def _repr_html_(self) -> str:
        from symsimpson.analysis.html import choice

        return choice(self)

    def __repr__(self) -> str:
        return "\n".join([f"Choice({self.stepper.scheme}, h={self.h:.6g})", *wrap(self.reason, 96)])


@dataclass(frozen=True)
class _Found:
    """How one scheme reaches the error on the pilot run."""

    stepper: Stepper
    steps: int
    error: float
    growth: float
    work: int  # steps and iterations
    seconds: float


@waiting("choosing a scheme and a step")
@any_step()
def choose(
    system: MechanicalSystem,
    q0: ArrayLike,
    v0: ArrayLike | None = None,
    *,
    p0: ArrayLike | None = None,
    t_end: float,
    error: float,
    on: Literal["state", "energy"] = "state",
    parameters: Mapping[Any, Any] | None = None,
    schemes: Sequence[str | Scheme] | None = None,
) -> Choice:
    """Choose scheme and step for a wanted error; both stay fixed then.

    Schemes of several orders run over the time asked for, or the beginning of it, with steps that
    halve; of those that reach the error, the fastest is taken. Steps stay where the scheme is
    stable for the fastest linear oscillation at the start.

    Parameters
    ----------
    system : MechanicalSystem
    q0, v0, p0 : array_like, shape (n,)
        The initial state: velocities or momenta.
    t_end : float
        End of the run, which begins at 0.
    error : float
        The largest error wanted.
    on : {"state", "energy"}
        Of q and p at the end, in units of 1 or the largest coordinate, and of the largest
        momentum; or of the energy at any time, relative to the first.
    parameters : mapping, optional
        As for :meth:`Stepper.integrate`.
    schemes : sequence of str or Scheme, optional
        What to choose from; schemes of orders 4 to 16, explicit ones among them where M is
        constant and forces depend on positions alone.

    Returns
    -------
    Choice

    Raises
    ------
    InputError
        If the input makes no sense, or no scheme reaches the error.

    Examples
    --------
    >>> import symsimpson as ss
    >>> pendulum = ss.systems.pendulum()
    >>> choice = ss.choose(pendulum, [1.0], v0=[0.0], t_end=20.0, error=1e-8)
    >>> run = choice.stepper.integrate([1.0], v0=[0.0], h=choice.h, t_end=20.0)
    >>> run.status.name
    'SUCCESS'
    """
    if on == "energy" and not system.plain.conservative:
        raise InputError(
            f"{system.name}: the energy is not constant, so that its change is no error.\n"
            "Ask for the error of the state: on='state'."
        )
    if system.inputs:
        raise InputError(
            f"{system.name} has inputs, and what is best depends on what they do.\n"
            "Declare them as parameters to choose for constant ones."
        )
    if on not in ("state", "energy"):
        raise InputError(f"on is {on!r}.\nChoose 'state' or 'energy'.")
    for name, value in (("t_end", t_end), ("error", error)):
        if not (isinstance(value, (int, float)) and 0 < value < math.inf):
            raise InputError(f"{name} is {value!r}.\nPass a positive number.")
    first = compile_system(system, "simpson")
    values = first._named_values(parameters)
    q, p = choose_state(first, {"q0": q0, "v0": v0, "p0": p0}, values)
    h0 = choose_step(first, q, p, values, 64)
    pilot = min(float(t_end), PILOT * h0)
    frequency = largest_frequency(system, q, values.values())
    problem = _Problem(q, p, values, pilot, float(t_end), float(error), on, h0, frequency, [])
    if schemes is None:
        straight = system.structure.separable and not system.constraints
        schemes = WITH_EXPLICIT if straight else CANDIDATES
    found = [one for scheme in schemes if (one := problem.solve(compile_system(system, scheme)))]
    if not found:
        raise InputError(
            f"none of {', '.join(map(str, schemes))} comes to an error of {error:g} at "
            f"t_end={t_end:g} from this state.\nErrors of double precision add up to more, or the "
            "motion is too sensitive to its start: ask for a larger error, or a shorter time."
            + (
                f"\nA run with small steps failed: {problem.failures[-1]}"
                if problem.failures
                else ""
            )
        )
    best = min(found, key=lambda one: one.seconds)
    steps = math.ceil(best.steps * t_end / pilot)
    return Choice(best.stepper, float(t_end) / steps, problem.reason(best, found, steps))


@dataclass(frozen=True)
class _Problem:
    """What is asked for, and the pilot run that answers it."""

    q: Floats
    p: Floats
    parameters: Mapping[str, float]
    pilot: float
    t_end: float
    error: float
    on: str
    h0: float
    frequency: float
    failures: list[str]

    def solve(self, stepper: Stepper) -> _Found | None:
        """Find the number of steps that reaches the error; None if there is none."""
        limit = largest_stable(stepper.scheme)
        least = math.ceil(max(4.0, self.pilot * self.frequency / limit))
        steps = max(least, math.ceil(self.pilot / (self.h0 * math.sqrt(stepper.order))))
        best: _Found | None = None
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
            error, growth, work, seconds = measured
            wanted = self._wanted(growth)
            change = (max(error, FLOOR) / wanted) ** (1 / stepper.order)
            if error <= wanted:
                if best and (work > best.work or seconds > SLOWER * best.seconds):
                    return best  # fewer steps that are solved with more effort
                best = _Found(stepper, steps, error, growth, work, seconds)
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
        """Return the error that the pilot run may have."""
        return self.error / SAFETY * (self.pilot / self.t_end) ** growth

    def _measure(self, stepper: Stepper, steps: int) -> tuple[float, float, int, float] | None:
        """Return the error, the exponent of its growth with time, the work, and the run time."""
        seconds = math.inf
        for _ in range(REPEATS):  # the first one may compile
            begin = time.perf_counter()
            coarse = self._run(stepper, steps, 1 if self.on == "energy" else steps // 2)
            seconds = min(seconds, time.perf_counter() - begin)
            if coarse is None:
                return None
        work = steps + int(coarse.newton_iterations.sum())
        if self.on == "energy":
            return float(np.abs(coarse.energy_error).max()), 0.0, work, seconds
        fine = self._run(stepper, 2 * steps, steps)
        if fine is None:
            return None
        share = 1 / (1 - 2.0**-stepper.order)
        middle, end = (self._distance(coarse, fine, k) * share for k in (1, 2))
        growth = math.log2(max(end, FLOOR) / max(middle, FLOOR))
        return end, min(max(growth, 1.0), 3.0), work, seconds

    def _run(self, stepper: Stepper, steps: int, every: int) -> Any:
        run = stepper.integrate(
            self.q, p0=self.p, h=self.pilot / steps, steps=steps, every=every,
            parameters=self.parameters, on_failure="return",
        )  # fmt: skip
        if run.status is not Status.SUCCESS:
            self.failures.append(run.message)
            return None
        return run

    def _distance(self, one: Any, other: Any, place: int) -> float:
        scale_q = np.maximum(np.abs(other.q).max(axis=0), 1.0)
        scale_p = np.abs(other.p).max() or 1.0
        gap_q = np.abs((one.q[place] - other.q[place]) / scale_q).max()
        return float(max(gap_q, np.abs(one.p[place] - other.p[place]).max() / scale_p))

    def reason(self, best: _Found, found: Sequence[_Found], steps: int) -> str:
        """Say what was chosen and why."""
        part = "" if self.pilot == self.t_end else f" until t = {self.pilot:g}"
        what = f"{self.on} error"
        lines = [
            f"{best.stepper.scheme} with h = {self.t_end / steps:.6g} ({steps} steps): the {what} "
            f"measured{part} is {best.error:.1e}, {self.error:.1e} is asked for."
        ]
        if part and self.on == "state":
            lines.append(
                f"It grew like t^{best.growth:.1f} there and is taken to go on so; chaotic motion "
                "would not."
            )
        if self.frequency > 0 and math.isfinite(largest_stable(best.stepper.scheme)):
            bound = largest_stable(best.stepper.scheme) / self.frequency
            lines.append(f"Linear stability at the start bounds h by {bound:.3g}.")
        others = sorted((x for x in found if x is not best), key=lambda x: x.seconds)
        if others:
            list_of = ", ".join(
                f"{x.stepper.scheme} {x.seconds / best.seconds:.1f} times its time" for x in others
            )
            lines.append(f"For the same error: {list_of}.")
        return " ".join(lines)
