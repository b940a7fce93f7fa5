"""The choice of a scheme and a step size for an error tolerance."""

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
from symsimpson.declare.hamiltonian import HamiltonianSystem
from symsimpson.declare.retimed import RetimedSystem, attracts, retime, retiming_obstacle
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import ResolutionWarning, StabilityWarning, reject
from symsimpson.program.cache import load_or_make
from symsimpson.program.input_values import read_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.program.status import Status
from symsimpson.results.sampled import Sampled, Saved
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.schemes.scheme import Scheme
from symsimpson.stepping.driving import Samples
from symsimpson.study.analysis.candidates import (
    REFINEMENTS,
    ROUNDS,
    Candidate,
    Motion,
    describe_choice,
    find_candidates,
    verify,
)
from symsimpson.study.analysis.pilot import choose_step
from symsimpson.study.analysis.variants import in_tau
from symsimpson.support.calling import explain_arguments, warn, without_step_warnings
from symsimpson.support.interpreter import compile_late
from symsimpson.support.markup import box, facts
from symsimpson.support.names import as_mapping, as_tuple, read_mapping
from symsimpson.support.progress import announce

if TYPE_CHECKING:
    from symsimpson.stepping.event import Event

#: The schemes to try, from low to high order; the second tuple if explicit steps are possible.
CANDIDATES = ("simpson", "gauss8", "gauss12", "gauss16")
FOR_HAMILTONIAN = ("gauss4", "gauss8", "gauss12", "gauss16")
WITH_EXPLICIT = ("simpson", "blanes_moan4", "blanes_moan6", "gauss12", "gauss16")
#: The schemes to try with a time transformation, if more than ``FEW_STEPS`` fixed steps are needed.
#: The search ends at the first one that takes ``MAX_RATIO`` times as long as fixed steps.
RETIMED_CANDIDATES, FEW_STEPS, MAX_RATIO = ("gauss12", "gauss8", "gauss16"), 1000, 2.0
#: Seconds to derive a module of n bodies that attract one another, divided by n**4. A derivation
#: that takes longer than ``LONG_DERIVATION`` is done only if fixed steps take longer or fail.
DERIVATION_SECONDS, LONG_DERIVATION = 3e-5, 10.0
#: Length of a pilot run, in steps with which Simpson's scheme follows the motion. With few
#: coordinates it is the second number divided by their number.
PILOT_STEPS, PILOT_COORDINATES = 1000, 20_000


@dataclass(frozen=True)
class Choice:
    """A scheme and a step size, with the measurements that led to them.

    :func:`symsimpson.choose` returns it.

    Attributes
    ----------
    stepper : Stepper
        The compiled stepper of the chosen scheme.
    h : float
        The step size. It divides the time from ``t0`` to ``t_end``, and is negative if the run
        goes backwards. For a time transformation it is the first step size.
    reason : str
        A summary of the measurements: the error, the tolerance and the run times of other schemes.
    error_estimate : float
        The largest difference, along the whole path, from a run with half the step size. For
        ``on="energy"`` it is the largest relative energy error.

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


@explain_arguments()
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
    """Choose a scheme and a step size for a given error tolerance.

    ``choose`` runs schemes of several orders over the beginning of the motion with various step
    sizes. It takes the fastest scheme that reaches the tolerance. It then verifies the step size on
    the whole path, and refines it up to six times.

    Parameters
    ----------
    system : MechanicalSystem
        The system to integrate. If V is a sum of attracting inverse distances and needs many fixed
        steps, ``choose`` also tries ``retimed(system, "encounters")``. The step size of this system
        adapts to close encounters. Its derivation takes minutes for many bodies, and is then done
        only if fixed steps take longer.
    q0, v0, p0 : array_like, shape (n,)
        The initial state: positions, and either velocities or momenta.
    t_end : float
        The final time. It may lie before ``t0``.
    error : float
        The error tolerance, from 2.3e-16 to 1. It is relative.
    on : {"state", "energy"}, default "state"
        The quantity that ``error`` bounds. "state" is the difference from a run with half the step
        size, at 21 equidistant times from ``t0`` to ``t_end`` and at stored steps. Positions are
        compared relative to the largest change q - q(0) of the coordinates with the same unit.
        Momenta are compared relative to the largest change p - p(0) of the momenta with the same
        unit. Coordinates without a unit count as one unit. A constant variable is compared
        relative to its own size. "energy" is the largest :attr:`Trajectory.energy_error`, which is
        relative to :attr:`Trajectory.energy_scale`.
    parameters : mapping, optional
        Values of parameters that differ from the defaults of the system, as for
        :meth:`Stepper.integrate`.
    schemes : str, Scheme or sequence of them, optional
        The schemes to choose from. The default is a list of schemes of orders 4 to 16. It contains
        explicit schemes if M is constant and forces depend on positions only.
    t0 : float, default 0.0
        The initial time.
    inputs : mapping, optional
        For each input a number, a function of t, or an array of K values. Each value is constant
        over one K-th of the time from ``t0`` to ``t_end``. The number of steps is a multiple of K.
    events : sequence of Event, optional
        Events that act on the run. If an event ends the run, the tolerance applies to the path
        before it. It also applies to the error of the final time, relative to the time from ``t0``
        to ``t_end``. States between the two times of the same event are not compared.

    Returns
    -------
    Choice
        The stepper, the step size, and the measurements that led to them.

    Raises
    ------
    InputError
        If an argument is invalid, or no scheme reaches the tolerance.

    Examples
    --------
    >>> import symsimpson as ss
    >>> pendulum = ss.systems.pendulum()
    >>> choice = ss.choose(pendulum, [1.0], v0=[0.0], t_end=20.0, error=1e-8)
    >>> run = choice.stepper.integrate([1.0], v0=[0.0], h=choice.h, t_end=20.0)
    >>> run.status.name
    'SUCCESS'
    """
    arguments: dict[str, Any]
    arguments = {"q0": q0, "v0": v0, "p0": p0, "t0": t0, "t_end": t_end, "error": error, "on": on}
    arguments |= {"parameters": parameters, "inputs": inputs, "events": events, "schemes": schemes}
    choice = select(system, arguments, strict=True)
    if choice.error_estimate > error:
        reject(
            f"{system.name}: no scheme reaches error={error:g} up to t_end={t_end:g} from this "
            "initial state.",
            why=choice.reason,
            remedy="Pass a larger error, or an earlier t_end.",
        )
    return choice


def select(system: MechanicalSystem, arguments: Mapping[str, Any], *, strict: bool) -> Choice:
    """Choose a scheme and a step size for the arguments of :func:`choose`, by name.

    Raises InputError if a run with small steps fails. With ``strict``, it also raises InputError
    if no scheme reaches the tolerance on a pilot run.
    """
    with (
        announce("choosing a scheme and a step") as labels,
        compile_late(),
        without_step_warnings(),
    ):
        return _select(system, arguments, labels, strict=strict)


def _select(
    system: MechanicalSystem, arguments: Mapping[str, Any], labels: list[str], *, strict: bool
) -> Choice:
    """Choose as :func:`select` does, with the labels of a progress bar."""
    check_system(system)
    schemes = None if arguments["schemes"] is None else as_tuple(arguments["schemes"])
    retimed, adaptive_schemes = _transform_time(system, schemes)
    fixed_schemes = schemes
    if schemes is None:
        explicit = system.structure.separable and not system.plain.constraint_names
        fixed_schemes = WITH_EXPLICIT if explicit else CANDIDATES
        if isinstance(system, HamiltonianSystem):
            fixed_schemes = FOR_HAMILTONIAN
    fixed_schemes = () if retimed is system else fixed_schemes or ()
    runs = len(fixed_schemes) * (1 + bool(adaptive_schemes)) + len(adaptive_schemes)
    max_trials = ROUNDS * runs + 2 * (1 + REFINEMENTS)
    motion, h0 = _read_motion(system, arguments, schemes)
    motion = replace(motion, labels=labels, max_trials=max_trials)
    pilot = motion.truncate(max(PILOT_STEPS, PILOT_COORDINATES // system.n) * h0)
    steppers = [compile_system(system, scheme) for scheme in fixed_schemes]
    candidates = find_candidates(motion, pilot, steppers, h0)
    ratio = motion.duration / pilot.duration
    min_steps = min((x.steps for x in candidates), default=math.inf) * ratio
    seconds = min((x.seconds for x in candidates), default=math.inf) * ratio
    derivation = DERIVATION_SECONDS * system.n**4
    affordable = derivation < LONG_DERIVATION or seconds > derivation
    if retimed is not None and min_steps > FEW_STEPS and affordable:
        h0, reached = _choose_retimed_step(retimed, motion)
        if abs(reached) > abs(pilot.duration):  # both kinds of steps have the same pilot run
            pilot = motion.truncate(reached)
            candidates = find_candidates(motion, pilot, steppers, h0)
        limit = MAX_RATIO * min((x.seconds for x in candidates), default=math.inf)
        for scheme in adaptive_schemes:
            steppers = [*steppers, compile_system(retimed, scheme)]
            others = find_candidates(motion, pilot, steppers[-1:], h0)
            candidates += others
            if any(x.seconds > limit for x in others):
                break  # the next scheme gains less than this, and takes long to compile
    if not candidates and (strict or motion.failures):
        names = dict.fromkeys(stepper.scheme for stepper in steppers)
        reject(
            f"{system.name}: none of {', '.join(names)} reaches error={motion.error:g} at "
            f"t_end={motion.t0 + motion.duration:g} from this initial state.",
            why="Round-off in double precision is larger, or the motion is too sensitive to its "
            "initial state."
            + "".join(f" A run with small steps failed: {x}" for x in motion.failures[-1:]),
            remedy="Pass a larger error, or an earlier t_end.",
        )
    ratio = motion.duration / pilot.duration
    highest = max(steppers, key=lambda stepper: stepper.order)
    candidates = candidates or [Candidate(highest, round(pilot.duration / h0))]
    fastest = min(candidates, key=lambda candidate: candidate.seconds)
    exact = max(candidates, key=lambda candidate: candidate.stepper.order)
    for chosen in dict.fromkeys((fastest, exact)):
        steps, worst = verify(motion, chosen.stepper, chosen.steps * ratio)
        if worst.violation_time is None:
            break
    reason = describe_choice(motion, chosen, steps, worst, candidates)
    return Choice(chosen.stepper, motion.duration / steps, reason, worst.largest)


def _read_motion(
    system: MechanicalSystem, arguments: Mapping[str, Any], schemes: Sequence[str | Scheme] | None
) -> tuple[Motion, float]:
    """Read the motion, and find a step size of Simpson's scheme in t that follows it."""
    t0, t_end = (read_number(name, arguments[name], FLOAT64) for name in ("t0", "t_end"))
    error = _read_error(arguments["error"], arguments["on"], schemes, system)
    if not t_end - t0:
        reject(f"t_end is {t_end!r}, the same as t0.", remedy="Pass a later time.")
    original = system.original if isinstance(system, RetimedSystem) else system
    scheme = "gauss4" if isinstance(system, HamiltonianSystem) else "simpson"
    stepper = compile_system(original, scheme)
    parameters = compile_system(system, scheme).program.free_values(arguments["parameters"])
    values = {name: parameters[name] for name in stepper.parameters}
    motion = Motion(parameters, t0, t_end - t0, error, arguments["on"], arguments["events"])
    motion = motion.with_inputs(stepper.program, arguments["inputs"])
    begin = {"t0": t0, "inputs": motion.initial_inputs or None, "parameters": values}
    q0, v0, p0 = (arguments[name] for name in ("q0", "v0", "p0"))
    start = stepper.integrate(q0, v0, p0=p0, h=1.0, steps=0, **begin)
    motion = replace(motion, q=start.q[0], p=start.p[0], v=start.v[0])
    # with longer steps a pilot run would end after t_end
    longest = motion.duration / PILOT_STEPS
    return motion, choose_step(stepper, motion.q, motion.p, steps=64, longest=longest, **begin)


def _read_error(
    error: Any, on: str, schemes: Sequence[str | Scheme] | None, system: MechanicalSystem
) -> float:
    """Read the tolerance ``error``; raises InputError if it, ``on`` or ``schemes`` is invalid."""
    if schemes == ():
        reject("schemes is empty.", remedy="Name at least one scheme, or omit the argument.")
    if on not in ("state", "energy"):
        reject(f"on is {on!r}.", remedy="Choose 'state' or 'energy'.")
    if on == "energy" and not system.plain.conservative:
        reject(
            f"{system.name}: on='energy' needs a conservative system.",
            why="The energy of this system is not constant, so its change does not measure the "
            "error.",
            remedy="Pass on='state'.",
        )
    error = read_number("error", error, FLOAT64)
    if error <= 0:
        reject(f"error is {error!r}.", remedy="Pass a positive number.")
    if error < FLOAT64.epsilon:
        reject(
            f"error is {error:g}.",
            why="Double precision rounds each number by more: 2e-16.",
            remedy="Pass a larger error. Or use ss.compile(..., precision=30), which computes "
            "with more digits.",
        )
    if error > 1:
        scale = "the energy's scale" if on == "energy" else "the largest change along the path"
        reject(
            f"error is {error:g}, relative to {scale}.",
            why="Above 1, the result has no correct digit.",
            remedy="Pass a number below 1, for example error=1e-6.",
        )
    return float(error)


def _transform_time(
    system: MechanicalSystem, schemes: Sequence[str | Scheme] | None
) -> tuple[RetimedSystem | None, Sequence[str | Scheme]]:
    """Return the retimed system, if there is one or V attracts, and its schemes; else None, ()."""
    if isinstance(system, RetimedSystem):
        return system, RETIMED_CANDIDATES if schemes is None else schemes
    if schemes is None and not retiming_obstacle(system) and attracts(system):
        return retime(system, "encounters"), RETIMED_CANDIDATES
    return None, ()


def _choose_retimed_step(retimed: RetimedSystem, motion: Motion) -> tuple[float, float]:
    """Return a step in tau that follows the motion, and the time t that a pilot run covers."""
    stepper = compile_system(retimed, "simpson")
    begin: dict[str, Any]
    begin = {"q0": motion.q, "p0": motion.p, "t0": motion.t0, "parameters": motion.parameters}
    numbers = stepper.integrate(**begin, h=1.0, steps=0).parameter_values
    values = dict(zip(stepper.parameters, numbers, strict=True))
    h = choose_step(in_tau(stepper), motion.q, motion.p, values, 64)
    h = math.copysign(h, motion.duration)
    run = stepper.integrate(**begin, h=h, steps=PILOT_STEPS, every=None, on_failure="return")
    return h, float(raise_if_interrupted(run).t[-1]) - motion.t0


@explain_arguments()
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
    """Integrate to a given error tolerance: the scheme and the step size are chosen for you.

    :func:`symsimpson.choose` chooses them, which takes some seconds. The choice is stored on disk,
    so that the same call runs at once the next time. With events or with functions of t it is not
    stored. For many runs of one system, call :func:`symsimpson.choose` once and use its stepper.

    Parameters
    ----------
    system : MechanicalSystem
        The system to integrate.
    q0, v0, p0 : array_like, shape (n,)
        The initial state: positions, and either velocities or momenta.
    t_end : float
        The final time. It may lie before ``t0``.
    error : float, default 1e-6
        The error tolerance, from 2.3e-16 to 1. It bounds the difference from a run with half the
        step size along the whole path. ``run.error_estimate`` is this difference.
    on : {"state", "energy"}, default "state"
        The quantity that ``error`` bounds, as for :func:`symsimpson.choose`.
    t0 : float, default 0.0
        The initial time.
    parameters, inputs, events, schemes
        Optional arguments with the same meaning as for :func:`symsimpson.choose`.
    every, t_eval, save, progress, on_failure
        Optional arguments with the same meaning as for :meth:`Stepper.integrate`.

    Returns
    -------
    Trajectory, Sampled or Saved
        The run. Its ``message`` describes the choice. If six refinements do not reach the
        tolerance, its ``status`` is ``TOLERANCE_NOT_MET``.

    Raises
    ------
    InputError
        If an argument is invalid, or runs with small steps fail.
    ConvergenceError, Interrupted
        Under the same conditions as :meth:`Stepper.integrate`.

    Warns
    -----
    ResolutionWarning
        If the tolerance is not reached. The warning names the time from which it is violated.

    Examples
    --------
    >>> import symsimpson as ss
    >>> run = ss.integrate(ss.systems.pendulum(), [1.0], v0=[0.0], t_end=20.0, error=1e-8)
    >>> run.success, " with h = " in run.message, run.error_estimate <= 1e-8
    (True, True, True)
    """
    check_system(system)
    parameters = read_mapping("parameters", parameters, "m")
    arguments: dict[str, Any]
    arguments = {"q0": q0, "v0": v0, "p0": p0, "t0": t0, "t_end": t_end, "error": error, "on": on}
    arguments |= {"parameters": parameters, "inputs": inputs, "events": events, "schemes": schemes}
    signals = getattr(inputs, "functions", inputs)  # a result of optimal control has functions
    values = signals.values() if isinstance(signals, Mapping) else (signals,)
    if events is not None or any(map(callable, values)):  # a stored choice cannot identify these
        choice = select(system, arguments, strict=False)
    else:
        choice = _load_choice(system, arguments)
    options: dict[str, Any] = {"every": every, "t_eval": t_eval, "save": save}
    options |= _run_arguments(choice, arguments) | {"progress": progress, "on_failure": on_failure}
    with without_step_warnings(StabilityWarning, ResolutionWarning):
        run: Trajectory | Sampled | Saved = choice.stepper.integrate(q0, v0, p0=p0, **options)
    message, status = f"{run.message} {choice.reason}", run.status
    if choice.error_estimate > error and run.success:
        status = Status.TOLERANCE_NOT_MET
        message = f"{system.name}: {choice.reason} {status.message}"
        warn(message, ResolutionWarning)
    return replace(run, status=status, message=message, error_estimate=choice.error_estimate)


def _run_arguments(choice: Choice, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return step size, length, parameters, inputs and events of the chosen run."""
    t0, duration = float(arguments["t0"]), float(arguments["t_end"]) - float(arguments["t0"])
    motion = Motion(arguments["parameters"], t0, duration, 0.0, "", arguments["events"])
    motion = motion.with_inputs(choice.stepper.program, arguments["inputs"])
    return motion.run_arguments(choice.stepper, round(duration / choice.h))


def _load_choice(system: MechanicalSystem, arguments: Mapping[str, Any]) -> Choice:
    """Return the choice stored on disk for the same arguments; without one, make and store it."""
    t_end, t0 = (read_number(name, arguments[name], FLOAT64) for name in ("t_end", "t0"))
    values = sorted((symbol.name, value) for symbol, value in system.parameters.items())
    question = sorted((name, _key(x)) for name, x in arguments.items())

    def read(record: Any) -> Choice:
        h, error = float(record["h"]), float(record["error"])
        if not (0 < h / (t_end - t0) < math.inf and error >= 0):
            raise ValueError("h or the error is out of range")
        chosen = system.retimed("encounters") if record["adapting"] is True else system
        stepper = compile_system(chosen, str(record["scheme"]))
        return Choice(stepper, h, str(record["reason"]), error)

    def write(choice: Choice) -> dict[str, Any]:
        declared = choice.stepper.program.declared
        return {
            "scheme": choice.stepper.scheme,
            "h": choice.h,
            "reason": choice.reason,
            "error": choice.error_estimate,
            "adapting": isinstance(declared, RetimedSystem) and declared is not system,
        }

    key = repr(["whole path", symsimpson.__version__, system.digest, values, question])
    return load_or_make(
        "choices", key, read, lambda: select(system, arguments, strict=False), write
    )


def _key(value: Any) -> Any:
    """Return the text of an argument in the key of a stored choice."""
    value = as_mapping(value)
    if isinstance(value, Mapping):
        return sorted((str(name), _key(x)) for name, x in value.items())
    if isinstance(value, Samples):
        return [_key(value.values), repr(value.period)]
    try:
        return repr(np.asarray(value).tolist())
    except ValueError:  # ragged rows, which the run rejects
        return repr(value)
