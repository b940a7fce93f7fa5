"""A scheme and a step for a wanted error, found by short runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Any, Literal

from numpy.typing import ArrayLike

from symsimpson.analysis.candidates import Found, Wanted
from symsimpson.analysis.pilot import choose_state, choose_step
from symsimpson.analysis.stability.frequency import largest_frequency
from symsimpson.analysis.variants import in_tau
from symsimpson.api.compiling import check_system
from symsimpson.api.compiling import compile as compile_system
from symsimpson.api.stepper import Stepper
from symsimpson.errors import InputError
from symsimpson.mechanics.retimed import RetimedSystem, attracts, not_retimed, retimed
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.program.input_values import read_number
from symsimpson.program.numbers import FLOAT64
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.ahead import late
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explained, without_step_warnings
from symsimpson.support.names import in_a_row
from symsimpson.support.progress import waiting

__all__ = ["Choice", "choose"]

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
        The step; it divides ``t_end`` exactly. For a retimed system, the first step.
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


@waiting("choosing a scheme and a step")
@late()
@without_step_warnings()
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
) -> Choice:
    """Choose a scheme and a fixed step, in t or in tau, for a given error tolerance.

    Schemes of several orders are tried in pilot runs, over the whole time or its beginning, with
    various steps. Of those that reach the tolerance, the fastest is chosen. Steps stay within the
    limit of linear stability for the fastest oscillation at the start.

    Parameters
    ----------
    system : MechanicalSystem
        If V is a sum of attracting inverse distances, ``retimed(system, "encounters")`` is tried
        where many fixed steps are needed: its steps in t adapt to close encounters. That of many
        bodies takes minutes to derive, and is tried only if fixed steps take longer.
    q0, v0, p0 : array_like, shape (n,)
        The initial state: velocities or momenta.
    t_end : float
        End of the run, which begins at 0.
    error : float
        The largest error wanted, at most 1: it is relative.
    on : {"state", "energy"}
        Which error. "state": of q and p at ``t_end``, relative to the largest coordinate (at least
        1) and the largest momentum. "energy": the largest :attr:`Trajectory.energy_error`, which is
        relative to :attr:`Trajectory.energy_scale`.
    parameters : mapping, optional
        As for :meth:`Stepper.integrate`.
    schemes : str, Scheme or sequence of them, optional
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
    check_system(system)
    schemes = None if schemes is None else in_a_row(schemes)
    if schemes == ():
        raise InputError("schemes is empty.\nName some, or leave it out.")
    if on == "energy" and not system.plain.conservative:
        raise InputError(
            f"{system.name}: the energy is not constant, so its change measures no error.\n"
            "Ask for the error of the state: on='state'."
        )
    if system.inputs:
        raise InputError(
            f"{system.name} has inputs, and what is best depends on what they do.\n"
            "To choose for constant inputs, declare them as parameters."
        )
    if on not in ("state", "energy"):
        raise InputError(f"on is {on!r}.\nChoose 'state' or 'energy'.")
    t_end, error = (
        read_number(name, value, FLOAT64) for name, value in (("t_end", t_end), ("error", error))
    )
    for name, value in (("t_end", t_end), ("error", error)):
        if value <= 0:
            raise InputError(f"{name} is {value!r}.\nPass a positive number.")
    if error < FLOAT64.epsilon:
        raise InputError(
            f"error is {error:g}, and double precision rounds each number by more: 2e-16.\n"
            "Ask for a larger error; ss.compile(..., precision=30) computes with more digits."
        )
    if error > 1:
        what = "the energy's scale" if on == "energy" else "the largest coordinate and momentum"
        raise InputError(
            f"error is {error:g}, relative to {what}: above 1 there is nothing left of what is "
            "asked for.\nPass a part of it, as error=1e-6."
        )
    retimed, adapting = _in_other_time(system, schemes)
    original = system.original if isinstance(system, RetimedSystem) else system
    first = compile_system(original, "simpson")
    known = compile_system(system, "simpson").program.free_values(parameters)
    values = {name: known[name] for name in first.parameters}
    q, p = choose_state(first, {"q0": q0, "v0": v0, "p0": p0}, values)
    # of longer ones a pilot run would go beyond the end
    h0 = choose_step(first, q, p, values, 64, longest=t_end / PILOT)
    pilot = min(float(t_end), max(PILOT, PILOT_COORDINATES // system.n) * h0)
    frequency = largest_frequency(original, q, values.values())
    fixed = schemes
    if schemes is None:
        straight = system.structure.separable and not system.plain.held
        fixed = WITH_EXPLICIT if straight else CANDIDATES
    fixed = () if original is not system else fixed or ()
    problem = Wanted(q, p, known, pilot, float(t_end), float(error), on, frequency, bool(fixed), [])
    steppers = [compile_system(system, scheme) for scheme in fixed]
    candidates = _solved(problem, steppers, h0)
    fewest = min((x.steps for x in candidates), default=math.inf) * t_end / pilot
    quickest = min((x.seconds for x in candidates), default=math.inf) * t_end / pilot
    deriving = DERIVING * system.n**4
    if retimed is not None and fewest > FEW_STEPS and (deriving < LONG or quickest > deriving):
        tau0, reached = _first_step(retimed, q, p, known)
        if reached > pilot < t_end:  # as long a part of the motion for both
            problem = replace(problem, pilot=min(float(t_end), reached))
            candidates = _solved(problem, steppers, h0)
        limit = FAR_SLOWER * min((x.seconds for x in candidates), default=math.inf)
        for scheme in adapting:
            others = _solved(problem, [compile_system(retimed, scheme)], tau0)
            candidates += others
            if any(x.seconds > limit for x in others):
                break  # the next would not be faster by so much, and take long to compile
    if not candidates:
        names = [getattr(scheme, "name", str(scheme)) for scheme in (*fixed, *adapting)]
        raise InputError(
            f"none of {', '.join(dict.fromkeys(names))} comes to "
            f"an error of {error:g} at t_end={t_end:g} from this state.\n"
            "Rounding errors in double precision are larger, or the motion is too sensitive to its "
            "initial state: ask for a larger error, or a shorter time."
            + "".join(f"\nA run with small steps failed: {x}" for x in problem.failures[-1:])
        )
    best = min(candidates, key=lambda candidate: candidate.seconds)
    steps = math.ceil(best.steps * t_end / problem.pilot)
    return Choice(best.stepper, float(t_end) / steps, problem.reason(best, candidates, steps))


def _solved(problem: Wanted, steppers: Iterable[Stepper], h: float) -> list[Found]:
    """Return what comes to the error, of these steppers from steps of this size on."""
    return [met for stepper in steppers if (met := problem.solve(stepper, h))]


def _in_other_time(
    system: MechanicalSystem, schemes: Sequence[str | Scheme] | None
) -> tuple[RetimedSystem | None, Sequence[str | Scheme]]:
    """Return the system in a time in which its steps adapt, if there is one, and schemes for it."""
    if isinstance(system, RetimedSystem):
        return system, ADAPTING if schemes is None else schemes
    if schemes is None and not not_retimed(system) and attracts(system):
        return retimed(system, "encounters"), ADAPTING
    return None, ()


def _first_step(
    retimed: RetimedSystem, q: Floats, p: Floats, values: Mapping[str, float]
) -> tuple[float, float]:
    """Find a step in tau that follows the motion, and the time that a pilot run of them takes."""
    stepper = compile_system(retimed, "simpson")
    given = stepper.integrate(q, p0=p, h=1.0, steps=0, parameters=values).parameter_values
    known = dict(zip(stepper.parameters, given, strict=True))
    h = choose_step(in_tau(stepper), q, p, known, 64)
    run = stepper.integrate(
        q, p0=p, h=h, steps=PILOT, parameters=values, every=None, on_failure="return"
    )
    return h, float(run.t[-1])
