"""The stress tests of one system, and those of the standard problems, as lines of text."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from symsimpson.analysis.energy_checks import shadow_is_testable
from symsimpson.analysis.pilot import choose_state, choose_step
from symsimpson.analysis.stability.chaotic_motion import reversal
from symsimpson.analysis.stability.drift import energy_drift
from symsimpson.analysis.stability.large_angles import turned
from symsimpson.analysis.stability.limits import linear_limits, theory_limits
from symsimpson.analysis.stability.poles import pole_sweep
from symsimpson.analysis.variants import in_tau
from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError
from symsimpson.run.ended import uninterrupted

__all__ = ["stress", "stress_standard"]

#: Steps of the run whose shadow energy is reported.
SHORT = 200


def stress(stepper: Stepper, *, h: float | None = None, steps: int = 1_000_000) -> Iterator[str]:
    """Put a stepper under stress, from its reference state or a random one.

    Parameters
    ----------
    stepper : Stepper
    h : float, optional
        The step; found by trial if left out.
    steps : int
        Of the long run.

    Yields
    ------
    str
        Lines.
    """
    q, p = choose_state(stepper, None, stepper.program.free_values())
    if stepper.program.header.retimed:
        stepper = in_tau(stepper, stepper.integrate(q, p0=p, h=1.0, steps=0).parameter_values)
    values = stepper.program.named_values()
    step = choose_step(stepper, q, p, values, 10_000) if h is None else h
    state = {"q0": q, "p0": p}
    yield f"{stepper.system}, {stepper.scheme}: from q0 = {q.tolist()}, p0 = {p.tolist()}"
    yield "long run"
    yield f"  {energy_drift(stepper, step, steps, state=state)}"
    if shadow_is_testable(stepper):
        run = stepper.integrate(q, p0=p, h=step, steps=SHORT)
        swing, kept = (np.ptp(x) / run.energy_scale for x in (run.energy, run.shadow_energy))
        yield (
            f"  in {SHORT} steps the energy swings by {swing:.1e}, what the scheme keeps by "
            f"{kept:.1e}"
        )
    yield "larger and larger steps, to the same time: energy error, iterations, outcome"
    for factor in (0.25, 0.5, 1, 2, 4, 8, 16):
        count = max(1, round(4000 / factor))
        run = uninterrupted(
            stepper.integrate(q, p0=p, h=step * factor, steps=count, on_failure="return")
        )
        error = float(np.abs(run.energy_error).max())
        mean = run.newton_iterations.sum() / max(1, run.steps)
        yield f"  h = {step * factor:<10.4g} {error:9.1e} {mean:6.2f}  {run.status.name}"
    if stepper.program.header.constraints:
        return  # states beside another one, or turned by themselves, leave the constraints
    yield "there with h and back with -h"
    for count in (100, 1000, 10_000):
        back = reversal(stepper, step, count, state=state)
        yield (
            f"  {count:>6} steps: error {back.error:.1e}, {back.rounding:.1e} a step without the "
            f"growth of {back.growth:.1e}; energy within {back.shadow:.1e}"
        )
    yield "many turns away (coordinates in which the motion is periodic)"
    for k, name in enumerate(stepper.coordinates):
        try:
            far = turned(stepper, k, 159_155, h=step, steps=100, state=state)
        except ConvergenceError:  # far away the same step may be too large
            continue
        if far.energy < 1e-6:
            yield (
                f"  {name} + {far.angle:.0f} rad: states differ by {far.difference:.1e}, where "
                f"numbers are {far.resolution:.1e} apart"
            )


def stress_standard(scheme: str) -> Iterator[str]:
    """Report limits of stability of the linear oscillator, and runs past poles, line by line."""
    yield f"{scheme}: where the linear oscillator turns unstable or stable again, h omega"
    for limit, theory in zip(linear_limits(scheme), theory_limits(scheme), strict=False):
        yield f"  {limit:.4f}, by theory {theory:.4f}"
    yield "past a pole of spherical angles: distance, outcome, error of the axis, warning"
    for run in pole_sweep(scheme):
        warned = "warned" if run.warned else ""
        yield (
            f"  {run.system:<20} {run.distance:.0e} {run.status.name:<24} {run.error:8.1e} {warned}"
        )
