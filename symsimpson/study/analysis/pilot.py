"""The initial state and the step size of a measurement for which the user passes none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError, InputError, reject
from symsimpson.program.evaluation import evaluate
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.support.array_types import Floats, State
from symsimpson.support.calling import without_step_warnings
from symsimpson.support.contact_values import reject_contacts
from symsimpson.support.names import shortened

#: The first step size to try. If the time scale of the motion is longer or shorter by a factor of
#: ``FAR``, the first step size is the time scale instead.
FIRST, FAR = 4.0, 1e3
#: Largest oscillation of the energy with the chosen step, relative to the kinetic energy.
MAX_ENERGY_ERROR = 1e-4
#: Half the step size moves the path of eight steps by at most this part of its length.
MAX_PATH_ERROR = 0.01
TRIES = 30
#: Largest average number of iterations of a step with the chosen step size.
NEWTON_ITERATIONS, STAGE_ITERATIONS = 3.3, 9.0


def choose_state(
    stepper: Stepper, state: Mapping[str, Any] | None, parameters: Mapping[str, float]
) -> State:
    """Return (q, p) of ``state``, else of the stepper's reference state, else of a random state.

    ``state`` has the keys q0, and v0 or p0; a value None counts as missing. Raises InputError if
    the state is invalid, or if no random state can begin a run.
    """
    reject_contacts(stepper.program.modes, stepper.system, "certificates and comparisons")
    if not isinstance(state, Mapping | None):
        reject(
            f"state is {shortened(state)}, not a mapping.",
            remedy="Pass state={'q0': [...], 'v0': [...]}, or p0 in place of v0.",
        )
    given = {name: value for name, value in (state or {}).items() if value is not None}
    given = given or dict(stepper.reference_state or {})
    if "q0" in given:
        run = stepper.integrate(**given, h=1.0, steps=0, parameters=parameters)
        return run.q[0], run.p[0]
    if given:
        reject(f"the state has {', '.join(given)} without q0.", remedy="Pass q0 too, or no state.")
    for attempt in range(TRIES):
        random = np.random.default_rng(attempt)
        q, v = random.uniform(0.3, 1.2, stepper.n), random.uniform(-0.6, 0.6, stepper.n)
        declared = stepper.program.declared
        canonical = stepper.program.header.canonical
        try:
            if declared is not None and not canonical:
                q, v = declared.consistent(q, v, parameters=parameters)
            start: dict[str, Any] = {"p0" if canonical else "v0": v, "parameters": parameters}
            run = stepper.integrate(q, **start, h=1e-6, steps=2)
        except (InputError, ConvergenceError):
            continue
        return run.q[0], run.p[0]
    reject(
        f"{stepper.system}: none of {TRIES} random states can begin a run.",
        remedy="Pass q0, and v0 or p0, of a state from which the system can move.",
    )


#: A time scale below this part of the longest step comes from a round-off error in q.
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
    **options: Any,
) -> float:
    """Choose a step size with small errors of energy and path, at which ``steps`` steps succeed.

    The search halves the step size, beginning with ``first``. Its default is the time scale of the
    motion. The search tries longer steps only up to ``longest``, which is negative for a motion
    backwards in time. ``options`` are passed to ``Stepper.integrate``. Raises InputError if no step
    size is small enough.
    """
    reject_contacts(stepper.program.modes, stepper.system, "the choice of a step size")
    first = first or math.copysign(_first_step(stepper, q, p, parameters, abs(longest)), longest)
    begin = {**options, "q0": q, "p0": p, "parameters": parameters}
    for halvings in range(60):
        h = first / 2**halvings
        if follows_motion(stepper, begin, steps, h):
            while (
                halvings == 0
                and 2 * abs(h) <= abs(longest)
                and follows_motion(stepper, begin, steps, 2 * h)
            ):
                h *= 2
            return h
    reject(
        f"{stepper.system}: no step size is small enough at this initial state.",
        remedy="Pass h. Or pass another state, where T and V are not singular.",
    )


def _first_step(
    stepper: Stepper, q: Floats, p: Floats, parameters: Mapping[str, float], longest: float
) -> float:
    """Return 4, or the power of two next to the time scale of a far slower or faster motion.

    The time scale is max|q| / max|v|, or ``longest`` if q or v is zero. Halves of a power of two
    are exact.
    """
    values = stepper.program.values(parameters)
    state = np.zeros(1), q[None], p[None]
    v = evaluate(stepper.program, "energy", "VELOCITY", len(q), state, values)
    fastest, scale = float(np.abs(v).max()), longest
    if 0 < fastest < np.inf and q.any():
        scale = float(np.abs(q).max() / fastest)
        if scale < ROUNDED * longest:  # q is the round-off error of a zero
            scale = longest
    if not 0 < scale < np.inf or FIRST / FAR <= scale <= FIRST * FAR:
        return FIRST
    return float(2.0 ** np.round(np.log2(scale)))


@without_step_warnings()
def follows_motion(stepper: Stepper, begin: Mapping[str, Any], steps: int, h: float) -> bool:
    """Return whether steps of size h have small errors, and ``steps`` of them succeed.

    ``begin`` has the initial state and other arguments of ``Stepper.integrate``.
    """

    def run(h: float, steps: int, every: int | None = 1) -> Trajectory:
        return raise_if_interrupted(
            stepper.integrate(**begin, h=h, steps=steps, every=every, on_failure="return")
        )

    limit = STAGE_ITERATIONS if stepper.program.header.by_stages else NEWTON_ITERATIONS
    coarse = run(h, 64)
    if coarse.steps < 64 or coarse.newton_iterations.sum() > limit * 64:
        return False
    moves = np.diff(coarse.q, axis=0)
    kinetic = np.abs((coarse.p[1:] * moves).sum(axis=1) / (2 * h)).max()
    conservative = stepper.program.header.conservative
    if conservative and np.ptp(coarse.energy) > MAX_ENERGY_ERROR * kinetic:
        return False
    # some schemes conserve the energy of some systems with any step: the path must be right, too
    finer = run(h / 2, 16, every=2)
    if finer.steps < 16:
        return False
    # the whole path: friction brings every path to rest, so that ends are equal with any step
    path = coarse.q[:9]
    if np.abs(finer.q - path).max() > MAX_PATH_ERROR * np.ptp(path, axis=0).max():
        return False
    return run(h, steps, every=None).success
