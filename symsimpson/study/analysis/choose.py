"""Runs to a wanted error, whose scheme and step are found by short runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

import symsimpson
from symsimpson.api.compiling import check_system
from symsimpson.api.compiling import compile as compile_system
from symsimpson.api.stepper import Stepper
from symsimpson.declare.retimed import RetimedSystem, attracts, not_retimed, retimed
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import ResolutionWarning, StabilityWarning, reject
from symsimpson.program.cache import kept
from symsimpson.program.input_values import read_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.program.status import Status
from symsimpson.results.sampled import Sampled, Saved
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import uninterrupted
from symsimpson.schemes.scheme import Scheme
from symsimpson.stepping.driving import Samples
from symsimpson.study.analysis.candidates import (
    REFINEMENTS,
    ROUNDS,
    SAFETY,
    Candidate,
    Motion,
    PathError,
    verify,
)
from symsimpson.study.analysis.pilot import choose_step
from symsimpson.study.analysis.variants import in_tau
from symsimpson.support.calling import explained, warn, without_step_warnings
from symsimpson.support.interpreter import late
from symsimpson.support.markup import box, facts
from symsimpson.support.names import by_name, in_a_row, read_mapping
from symsimpson.support.progress import waiting

if TYPE_CHECKING:
    from symsimpson.stepping.event import Event

#: Schemes that are tried, from low to high order; and where explicit steps are possible.
CANDIDATES = ("simpson", "gauss8", "gauss12", "gauss16")
WITH_EXPLICIT = ("simpson", "blanes_moan4", "blanes_moan6", "gauss12", "gauss16")
#: Those that are tried in the time of a retimed system, unless so few fixed steps do; where one
#: takes so many times as long as fixed steps, no others are.
ADAPTING, FEW_STEPS, FAR_SLOWER = ("gauss12", "gauss8", "gauss16"), 1000, 2.0
#: Seconds that it takes to derive one of them, divided by n**4, where all coordinates attract each
#: other. Where that is long, they are tried only if fixed steps take longer, or do not do.
DERIVING, LONG = 3e-5, 10.0
#: A pilot run is so many of the steps long with which Simpson's scheme follows the motion, with
#: fewer coordinates so many of them.
PILOT, PILOT_COORDINATES = 1000, 20_000


@dataclass(frozen=True)
class Choice:
    """A scheme and a step, and why.

    Attributes
    ----------
    stepper : Stepper
    h : float
        The step size; it divides the time from ``t0`` to ``t_end``, and is negative if the run
        goes backwards. For a retimed system, the first step.
    reason : str
        What was measured, in sentences.
    error_estimate : float
        The largest difference, along the whole path, from a run with half the step size. For
        ``on="energy"``, the largest relative energy error.

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
    error_estimate: float

    def _repr_html_(self) -> str:
        scheme = f"{self.stepper.scheme}, order {self.stepper.order}"
        rows = [("scheme", scheme), ("h", f"{self.h:.6g}"), ("why", self.reason)]
        return box(f"Choice for {self.stepper.system}", facts(rows))

    def __repr__(self) -> str:
        return "\n".join([f"Choice({self.stepper.scheme}, h={self.h:.6g})", *wrap(self.reason, 96)])


@explained()
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
    schemes: str | Scheme | Sequence[str | Scheme] | None = None,
    t0: float = 0.0,
    inputs: Mapping[Any, Any] | None = None,
    events: Sequence[Event] | None = None,
) -> Choice:
    """Choose a scheme and a fixed step, in t or in tau, for a given error tolerance.

    Schemes of several orders run over the beginning of the motion with various steps, and the
    fastest one that reaches the tolerance is chosen. The step size is then verified on the whole
    path, and refined up to six times if the tolerance is not reached.

    Parameters
    ----------
    system : MechanicalSystem
        If V is a sum of attracting inverse distances, ``retimed(system, "encounters")`` is tried
        where many fixed steps are needed: its steps in t adapt to close encounters. That of many
        bodies takes minutes to derive, and is tried only if fixed steps take longer.
    q0, v0, p0 : array_like, shape (n,)
        The initial state: velocities or momenta.
    t_end : float
        End of the run; it may lie before ``t0``.
    error : float
        The largest error wanted, at most 1: it is relative.
    on : {"state", "energy"}
        What ``error`` bounds. "state": the difference from a run with half the step size, at 21
        equidistant times from ``t0`` to ``t_end`` and at stored steps. Positions are compared
        relative to the largest change q - q(0) of the coordinates with the same unit, momenta
        relative to the largest change p - p(0) of the momenta with the same unit. Coordinates
        without a unit count as one unit. A variable that stays constant is compared relative to
        its own size. "energy": the largest :attr:`Trajectory.energy_error`, which is relative to
        :attr:`Trajectory.energy_scale`.
    parameters : mapping, optional
        As for :meth:`Stepper.integrate`.
    schemes : str, Scheme or sequence of them, optional
        What to choose from; schemes of orders 4 to 16, explicit ones among them where M is
        constant and forces depend on positions alone.
    t0 : float
        Time at the start, 0 by default.
    inputs : mapping, optional
        For each input a number, a function of t, or an array of K values. Each value is constant
        over one K-th of the time from ``t0`` to ``t_end``. The number of steps is a multiple of K.
    events : sequence of Event, optional
        Events that act on the run. If one ends the run, the bound holds up to there, and also for
        the time of the end relative to the time from ``t0`` to ``t_end``. Between the times at
        which the two runs meet the same event, states are not compared.

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
    asked: dict[str, Any]
    asked = {"q0": q0, "v0": v0, "p0": p0, "t0": t0, "t_end": t_end, "error": error, "on": on}
    asked |= {"parameters": parameters, "inputs": inputs, "events": events, "schemes": schemes}
    choice = select(system, asked, strict=True)
    if choice.error_estimate > error:
        reject(
            f"no scheme that was tried comes to an error of {error:g} until t_end={t_end:g} from "
            f"this state: {choice.reason}",
            remedy="Ask for a larger error, or a shorter time.",
        )
    return choice


def select(system: MechanicalSystem, asked: Mapping[str, Any], *, strict: bool) -> Choice:
    """Choose as :func:`choose`; unless ``strict``, also where no scheme reaches the error.

    ``asked`` has its arguments. Raises InputError if a run with small steps does not reach the end.
    """
    with waiting("choosing a scheme and a step") as shown, late(), without_step_warnings():
        return _select(system, asked, shown, strict=strict)


def _select(
    system: MechanicalSystem, asked: Mapping[str, Any], shown: list[str], *, strict: bool
) -> Choice:
    check_system(system)
    schemes = None if asked["schemes"] is None else in_a_row(asked["schemes"])
    t0, t_end = (read_number(name, asked[name], FLOAT64) for name in ("t0", "t_end"))
    error = _read_error(asked["error"], asked["on"], schemes, system)
    if not t_end - t0:
        reject(f"t_end is {t_end!r}, and the run begins there.", remedy="Pass a later time.")
    retimed, adapting = _in_other_time(system, schemes)
    original = system.original if isinstance(system, RetimedSystem) else system
    first = compile_system(original, "simpson")
    known = compile_system(system, "simpson").program.free_values(asked["parameters"])
    values = {name: known[name] for name in first.parameters}
    motion = Motion(known, t0, t_end - t0, error, asked["on"], asked["events"])
    motion = motion.driven(first.program, asked["inputs"])
    begin = {"t0": t0, "inputs": motion.inputs_at_start or None}
    start = first.integrate(
        asked["q0"], asked["v0"], p0=asked["p0"], h=1.0, steps=0, parameters=values, **begin
    )
    q, p = start.q[0], start.p[0]
    fixed = schemes
    if schemes is None:
        straight = system.structure.separable and not system.plain.held
        fixed = WITH_EXPLICIT if straight else CANDIDATES
    fixed = () if original is not system else fixed or ()
    most = ROUNDS * (len(fixed) * (1 + bool(adapting)) + len(adapting)) + 2 * (1 + REFINEMENTS)
    motion = replace(motion, q=q, p=p, v=start.v[0], shown=shown, most_trials=most)
    # of longer ones a pilot run would go beyond the end
    h0 = choose_step(first, q, p, values, 64, (t_end - t0) / PILOT, **begin)
    pilot = motion.until(max(PILOT, PILOT_COORDINATES // system.n) * h0)
    steppers = [compile_system(system, scheme) for scheme in fixed]
    candidates = _solved(motion, pilot, steppers, h0)
    ratio = motion.duration / pilot.duration
    fewest = min((x.steps for x in candidates), default=math.inf) * ratio
    quickest = min((x.seconds for x in candidates), default=math.inf) * ratio
    deriving = DERIVING * system.n**4
    if retimed is not None and fewest > FEW_STEPS and (deriving < LONG or quickest > deriving):
        h0, reached = _first_step(retimed, motion)
        if abs(reached) > abs(pilot.duration):  # as long a part of the motion for both
            pilot = motion.until(reached)
            candidates = _solved(motion, pilot, steppers, h0)
        limit = FAR_SLOWER * min((x.seconds for x in candidates), default=math.inf)
        for scheme in adapting:
            steppers = [*steppers, compile_system(retimed, scheme)]
            others = _solved(motion, pilot, steppers[-1:], h0)
            candidates += others
            if any(x.seconds > limit for x in others):
                break  # the next would not be faster by so much, and take long to compile
    names = dict.fromkeys(stepper.scheme for stepper in steppers)
    if not candidates and (strict or motion.failures):
        reject(
            f"none of {', '.join(names)} comes to "
            f"an error of {error:g} at t_end={t_end:g} from this state.\n"
            "Rounding errors in double precision are larger, or the motion is too sensitive to its "
            "initial state: ask for a larger error, or a shorter time."
            + "".join(f"\nA run with small steps failed: {x}" for x in motion.failures[-1:])
        )
    ratio = motion.duration / pilot.duration
    highest = max(steppers, key=lambda stepper: stepper.order)
    candidates = candidates or [Candidate(highest, round(pilot.duration / h0))]
    best = min(candidates, key=lambda candidate: candidate.seconds)
    exact = max(candidates, key=lambda candidate: candidate.stepper.order)
    for chosen in dict.fromkeys((best, exact)):
        steps, worst = verify(motion, chosen.stepper, chosen.steps * ratio)
        if worst.since is None:
            break
    reason = _reason(motion, chosen, steps, worst, candidates)
    return Choice(chosen.stepper, motion.duration / steps, reason, worst.largest)


def _read_error(
    error: Any, on: str, schemes: Sequence[str | Scheme] | None, system: MechanicalSystem
) -> float:
    """Read the error that is allowed, and check what it is about; raises InputError."""
    if schemes == ():
        reject("schemes is empty.", remedy="Name some, or leave it out.")
    if on not in ("state", "energy"):
        reject(f"on is {on!r}.", remedy="Choose 'state' or 'energy'.")
    if on == "energy" and not system.plain.conservative:
        reject(
            f"{system.name}: the energy is not constant, so its change measures no error.",
            remedy="Ask for the error of the state: on='state'.",
        )
    error = read_number("error", error, FLOAT64)
    if error <= 0:
        reject(f"error is {error!r}.", remedy="Pass a positive number.")
    if error < FLOAT64.epsilon:
        reject(
            f"error is {error:g}, and double precision rounds each number by more: 2e-16.",
            remedy="Ask for a larger error; ss.compile(..., precision=30) computes with "
            "more digits.",
        )
    if error > 1:
        what = "the energy's scale" if on == "energy" else "the largest change along the path"
        reject(
            f"error is {error:g}, relative to {what}: above 1 there is nothing left of what is "
            "asked for.",
            remedy="Pass a part of it, as error=1e-6.",
        )
    return float(error)


def _solved(
    motion: Motion, pilot: Motion, steppers: Sequence[Stepper], h: float
) -> list[Candidate]:
    """Return what comes to the error, of these steppers from steps of this size on."""
    allowed = motion.error / SAFETY
    if motion.on == "state":  # errors grow with time at least
        allowed *= pilot.duration / motion.duration
    candidates: list[Candidate] = []
    for stepper in reversed(steppers):  # of high order first: others may be far slower
        quickest = min((x.seconds for x in candidates), default=math.inf)
        if candidate := pilot.solve(stepper, h, allowed, quickest):
            candidates.append(candidate)
    return candidates


def _reason(
    motion: Motion, chosen: Candidate, steps: int, worst: PathError, candidates: list[Candidate]
) -> str:
    """Say what was chosen, how large its error is, and what others take."""
    stepper, retimed = chosen.stepper, chosen.stepper.program.header.retimed
    count = "the first step; then they adapt" if retimed else f"{steps} steps"
    name = f"{stepper.scheme} with h = {motion.duration / steps:.6g} ({count})"
    figures = f"{worst.largest:.1e}, {motion.error:.1e} is asked for."
    if worst.since is not None:
        since = f"The bound fails from t = {worst.since:g} on."
        return f"the error is {figures} {since} The smallest step was taken: {name}."
    what = "the largest relative energy error is"
    if motion.on == "state":
        what = "relative to its extent, the path differs from that with half the step by"
    lines = [f"{name}: {what} {figures}"]
    fixed = [x.steps for x in candidates if not x.stepper.program.header.retimed]
    if retimed:
        beside = f": the fewest of fixed size are {min(fixed)}" if fixed else ""
        lines.append(f"Steps of {stepper.system} adapt{beside}.")
    others = [
        f"{x.stepper.scheme}{' in tau' * x.stepper.program.header.retimed} "
        f"{x.seconds / chosen.seconds:.1f} times its time"
        for x in sorted(candidates, key=lambda x: x.seconds)
        if x is not chosen
    ]
    return " ".join([*lines, *([f"For the same error: {', '.join(others)}."] if others else ())])


def _in_other_time(
    system: MechanicalSystem, schemes: Sequence[str | Scheme] | None
) -> tuple[RetimedSystem | None, Sequence[str | Scheme]]:
    """Return the system in a time in which its steps adapt, if there is one, and schemes for it."""
    if isinstance(system, RetimedSystem):
        return system, ADAPTING if schemes is None else schemes
    if schemes is None and not not_retimed(system) and attracts(system):
        return retimed(system, "encounters"), ADAPTING
    return None, ()


def _first_step(retimed: RetimedSystem, motion: Motion) -> tuple[float, float]:
    """Find a step in tau that follows the motion, and the time that a pilot run of them takes."""
    stepper = compile_system(retimed, "simpson")
    begin: dict[str, Any]
    begin = {"q0": motion.q, "p0": motion.p, "t0": motion.t0, "parameters": motion.parameters}
    given = stepper.integrate(**begin, h=1.0, steps=0).parameter_values
    known = dict(zip(stepper.parameters, given, strict=True))
    h = choose_step(in_tau(stepper), motion.q, motion.p, known, 64)
    h = math.copysign(h, motion.duration)
    run = stepper.integrate(**begin, h=h, steps=PILOT, every=None, on_failure="return")
    return h, float(uninterrupted(run).t[-1]) - motion.t0


@explained()
def integrate(
    system: MechanicalSystem,
    q0: ArrayLike,
    v0: ArrayLike | None = None,
    *,
    p0: ArrayLike | None = None,
    t_end: float,
    error: float = 1e-6,
    on: Literal["state", "energy"] = "state",
    t0: float = 0.0,
    parameters: Mapping[Any, Any] | None = None,
    inputs: Mapping[Any, Any] | None = None,
    events: Sequence[Event] | None = None,
    schemes: str | Scheme | Sequence[str | Scheme] | None = None,
    every: int | None = 1,
    t_eval: ArrayLike | None = None,
    save: Any = None,
    progress: bool | None = None,
    on_failure: Literal["raise", "return"] = "raise",
) -> Trajectory | Sampled | Saved:
    """Integrate with a given error tolerance: scheme and step size are chosen for it.

    :func:`symsimpson.choose` chooses them, which takes some seconds. The choice is stored on disk,
    unless events or functions of t act on the run: the same call runs at once the next time. For
    many runs of a system, choose once and take the stepper.

    Parameters
    ----------
    system : MechanicalSystem
    q0, v0, p0, t_end, error, on, t0, parameters, inputs, events, schemes
        As for :func:`symsimpson.choose`. ``error`` bounds the difference from a run with half the
        step size along the whole path; ``run.error_estimate`` is that difference.
    every, t_eval, save, progress, on_failure
        As for :meth:`Stepper.integrate`.

    Returns
    -------
    Trajectory, or a Sampled or Saved
        Its ``message`` states what was chosen, and why. If six refinements do not reach the error,
        its ``status`` is ``TOLERANCE_NOT_MET``.

    Raises
    ------
    InputError
        If the input makes no sense, or runs with small steps fail.
    ConvergenceError, Interrupted
        As :meth:`Stepper.integrate`.

    Warns
    -----
    ResolutionWarning
        If the error is not reached: with the time from which the bound fails.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.integrate(ss.systems.pendulum(), [1.0], v0=[0.0], t_end=20.0, error=1e-8)
    >>> run.success, " with h = " in run.message, run.error_estimate <= 1e-8
    (True, True, True)
    """
    check_system(system)
    parameters = read_mapping("parameters", parameters, "m")
    asked: dict[str, Any]
    asked = {"q0": q0, "v0": v0, "p0": p0, "t0": t0, "t_end": t_end, "error": error, "on": on}
    asked |= {"parameters": parameters, "inputs": inputs, "events": events, "schemes": schemes}
    given = getattr(inputs, "functions", inputs)  # as a result of optimal control has them
    values = given.values() if isinstance(given, Mapping) else (given,)
    if events is not None or any(map(callable, values)):  # what these do is not known
        choice = select(system, asked, strict=False)
    else:
        choice = _stored_choice(system, asked)
    more: dict[str, Any] = {"every": every, "t_eval": t_eval, "save": save}
    more |= _arguments(choice, asked) | {"progress": progress, "on_failure": on_failure}
    with without_step_warnings(StabilityWarning, ResolutionWarning):
        run: Trajectory | Sampled | Saved = choice.stepper.integrate(q0, v0, p0=p0, **more)
    message, status = f"{run.message} {choice.reason}", run.status
    if choice.error_estimate > error and run.success:
        status = Status.TOLERANCE_NOT_MET
        message = f"{system.name}: {choice.reason} {status.message}"
        warn(message, ResolutionWarning)
    return replace(run, status=status, message=message, error_estimate=choice.error_estimate)


def _arguments(choice: Choice, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of the chosen run, beside its initial state."""
    t0, duration = float(asked["t0"]), float(asked["t_end"]) - float(asked["t0"])
    motion = Motion(asked["parameters"], t0, duration, 0.0, "", asked["events"])
    motion = motion.driven(choice.stepper.program, asked["inputs"])
    return motion.arguments(choice.stepper, round(duration / choice.h))


def _stored_choice(system: MechanicalSystem, asked: Mapping[str, Any]) -> Choice:
    """Return the choice that was stored for the same arguments, or make it and store it."""
    t_end, t0 = (read_number(name, asked[name], FLOAT64) for name in ("t_end", "t0"))
    values = sorted((symbol.name, value) for symbol, value in system.parameters.items())
    question = sorted((name, _key(x)) for name, x in asked.items())

    def read(record: Any) -> Choice:
        h, error = float(record["h"]), float(record["error"])
        if not (0 < h / (t_end - t0) < math.inf and error >= 0):
            raise ValueError("no step, or no error")
        whole = system.retimed("encounters") if record["adapting"] is True else system
        return Choice(compile_system(whole, str(record["scheme"])), h, str(record["reason"]), error)

    def content(choice: Choice) -> dict[str, Any]:
        declared = choice.stepper.program.declared
        return {
            "scheme": choice.stepper.scheme,
            "h": choice.h,
            "reason": choice.reason,
            "error": choice.error_estimate,
            "adapting": isinstance(declared, RetimedSystem) and declared is not system,
        }

    key = repr(["whole path", symsimpson.__version__, system.digest, values, question])
    return kept("choices", key, read, lambda: select(system, asked, strict=False), content)


def _key(value: Any) -> Any:
    """Return the text of an argument, for the key of a stored choice."""
    value = by_name(value)
    if isinstance(value, Mapping):
        return sorted((str(name), _key(x)) for name, x in value.items())
    if isinstance(value, Samples):
        return [_key(value.values), repr(value.period)]
    try:
        return repr(np.asarray(value).tolist())
    except ValueError:  # ragged rows, which the run refuses
        return repr(value)
