"""A state and a step to begin with, where none is given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError, InputError, reject
from symsimpson.program.observed import evaluate
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import uninterrupted
from symsimpson.support.array_types import Floats, State
from symsimpson.support.calling import without_step_warnings
from symsimpson.support.names import shortened

#: The first step that is tried, unless the time scale of the motion is so many times as long, or as
#: short: units of time in which 4 means nothing.
FIRST, FAR = 4.0, 1e3
#: Largest swing of the energy of a step that is chosen, relative to the kinetic energy.
MOST_ENERGY_ERROR = 1e-4
#: Halving the step moves the path of eight steps by at most so much of its length.
CLOSE = 0.01
TRIES = 30
#: Most iterations a step, on average, of a step size that is chosen.
NEWTON_ITERATIONS, STAGE_ITERATIONS = 3.3, 9.0


def choose_state(
    stepper: Stepper, state: Mapping[str, Any] | None, parameters: Mapping[str, float]
) -> State:
    """Return (q, p) of the state asked for, the stepper's reference state, or one at random.

    A state is q0, and v0 or p0; what is None is not asked for. Raises InputError if the state makes
    no sense, or no random one can begin.
    """
    if not isinstance(state, Mapping | None):
        reject(
            f"state is {shortened(state)}, not a mapping.",
            remedy="Pass state={'q0': [...], 'v0': [...]}, or p0 for v0.",
        )
    given = {name: value for name, value in (state or {}).items() if value is not None}
    given = given or dict(stepper.reference_state or {})
    if "q0" in given:
        run = stepper.integrate(**given, h=1.0, steps=0, parameters=parameters)
        return run.q[0], run.p[0]
    if given:
        reject("a velocity or momentum without q0.", remedy="Pass q0 too, or neither.")
    for attempt in range(TRIES):
        random = np.random.default_rng(attempt)
        q, v = random.uniform(0.3, 1.2, stepper.n), random.uniform(-0.6, 0.6, stepper.n)
        declared = stepper.program.declared
        try:
            if declared is not None:
                q, v = declared.consistent(q, v, parameters=parameters)
            run = stepper.integrate(q, v0=v, h=1e-6, steps=2, parameters=parameters)
        except (InputError, ConvergenceError):
            continue
        return run.q[0], run.p[0]
    reject(
        f"{stepper.system}: none of {TRIES} random states could begin.",
        remedy="Pass q0 and v0 or p0, from which the system can move.",
    )


#: Motions that would go so many times around in the longest step are none.
ROUNDED = 1e-9


@without_step_warnings()
def choose_step(
    stepper: Stepper,
    q: Floats,
    p: Floats,
    parameters: Mapping[str, float],
    steps: int,
    longest: float = 0.0,
    first: float | None = None,
    **given: Any,
) -> float:
    """Choose a step size with small errors of energy and path, at which ``steps`` steps succeed.

    The search tries ``first``, if given, and then its halves. It tries longer steps only up to
    ``longest``, which is negative if the motion goes backwards. ``given`` has further arguments of
    the runs. Raises InputError if no step size is small enough.
    """
    first = first or math.copysign(_first_step(stepper, q, p, parameters, abs(longest)), longest)
    given |= {"q0": q, "p0": p, "parameters": parameters}
    for halvings in range(60):
        h = first / 2**halvings
        if follows(stepper, given, steps, h):
            longer = halvings == 0
            while longer and 2 * abs(h) <= abs(longest) and follows(stepper, given, steps, 2 * h):
                h *= 2
            return h
    reject(
        f"{stepper.system}: no step is small enough at this state.",
        remedy="Pass h, or another state: look where T or V are singular.",
    )


def _first_step(
    stepper: Stepper, q: Floats, p: Floats, parameters: Mapping[str, float], longest: float
) -> float:
    """Return a power of two, of which all parts are exact: 4, unless the motion is far from that.

    How far is told by the time in which v moves by q; without one, by the longest step.
    """
    values = stepper.program.values(parameters)
    state = np.zeros(1), q[None], p[None]
    v = evaluate(stepper.program, "energy", "VELOCITY", len(q), state, values)
    fastest, scale = float(np.abs(v).max()), longest
    if 0 < fastest < np.inf and q.any():
        scale = float(np.abs(q).max() / fastest)
        if scale < ROUNDED * longest:  # q is a rounding of zero
            scale = longest
    if not 0 < scale < np.inf or FIRST / FAR <= scale <= FIRST * FAR:
        return FIRST
    return float(2.0 ** np.round(np.log2(scale)))


@without_step_warnings()
def follows(stepper: Stepper, given: Mapping[str, Any], steps: int, h: float) -> bool:
    """Return whether steps of a size follow the motion, and so many of them succeed."""

    def run(h: float, steps: int, every: int | None = 1) -> Trajectory:
        return uninterrupted(
            stepper.integrate(**given, h=h, steps=steps, every=every, on_failure="return")
        )

    most = STAGE_ITERATIONS if stepper.program.header.by_stages else NEWTON_ITERATIONS
    coarse = run(h, 64)
    if coarse.steps < 64 or coarse.newton_iterations.sum() > most * 64:
        return False
    moved = np.diff(coarse.q, axis=0)
    kinetic = np.abs((coarse.p[1:] * moved).sum(axis=1) / (2 * h)).max()
    conservative = stepper.program.header.conservative
    if conservative and np.ptp(coarse.energy) > MOST_ENERGY_ERROR * kinetic:
        return False
    # some schemes keep the energy of some systems at any step: the path must be right, too
    finer = run(h / 2, 16, every=2)
    if finer.steps < 16:
        return False
    # all of it: friction brings every path to rest, so that ends alone say nothing
    path = coarse.q[:9]
    if np.abs(finer.q - path).max() > CLOSE * np.ptp(path, axis=0).max():
        return False
    return run(h, steps, every=None).success
