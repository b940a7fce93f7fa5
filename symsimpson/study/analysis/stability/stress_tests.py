"""Stress tests of a stepper: long runs, large steps, reversed runs and large angles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError
from symsimpson.run.ended import raise_if_interrupted
from symsimpson.study.analysis.checks import shadow_is_testable
from symsimpson.study.analysis.pilot import choose_state, choose_step
from symsimpson.study.analysis.stability.run_comparisons import compare_turns, reversal
from symsimpson.study.analysis.stability.standard_problems import (
    linear_limits,
    pole_sweep,
    theory_limits,
)
from symsimpson.study.analysis.variants import in_tau, iterate_to_round_off
from symsimpson.support.array_types import Floats

#: Number of blocks, and of samples in a block. The number of steps is a multiple of their product.
BLOCKS, SAMPLES = 32, 128


@dataclass(frozen=True)
class Drift:
    """The drift of the energy of several trajectories.

    :func:`energy_drift` returns it.

    Attributes
    ----------
    scheme : str
        The name of the scheme.
    h : float
        The step size.
    steps : int
        The number of steps of each trajectory.
    t : ndarray, shape (blocks - 1,)
        The times from the first block of samples to the other blocks.
    rms : ndarray, shape (blocks - 1,)
        The relative change of a block's mean energy since the first block, as root mean square
        over the trajectories.
    noise : float
        The part of ``rms`` that comes from sampling an oscillation.
    exponent : float
        The exponent a of the fit rms ~ t^a. It is NaN if the last ``rms`` is at most three times
        the noise.
    bias : float
        The mean change of the energy of all trajectories at the end, in units of its standard
        error. It is below 3 if round-off is unbiased.
    truncation : float
        The oscillation within a block, as root mean square relative to the energy.
    solver : float
        The change of the last block's mean if Newton's method is iterated to round-off, as root
        mean square, minus twice the noise. It is at least 0.
    momenta : float
        The largest relative change of a momentum that is constant in the first steps.
    failed : int
        The number of trajectories that did not reach the end.

    Examples
    --------
    >>> import symsimpson as ss
    >>> from symsimpson.study.analysis.stability import energy_drift
    >>> drift = energy_drift(ss.compile(ss.systems.pendulum()), 0.02, 20_000)
    >>> drift.failed, bool(drift.rms[-1] < 1e-6)
    (0, True)
    """

    scheme: str
    h: float
    steps: int
    t: Floats
    rms: Floats
    noise: float
    exponent: float
    bias: float
    truncation: float
    solver: float
    momenta: float
    failed: int

    def __repr__(self) -> str:
        exponent = f"{self.exponent:.2f}" if self.exponent == self.exponent else "none"
        return (
            f"{self.scheme:<10} h = {self.h:<9.4g} {self.steps:.0e} steps: energy changed by "
            f"{self.rms[-1]:.1e} (noise {self.noise:.0e}, exponent {exponent}, bias "
            f"{self.bias:.1f} sigma), truncation {self.truncation:.1e}, solver {self.solver:.1e}, "
            f"momenta {self.momenta:.0e}" + (f", {self.failed} FAILED" if self.failed else "")
        )


def energy_drift(
    stepper: Stepper,
    h: float,
    steps: int = 10_000_000,
    *,
    state: Mapping[str, Any] | None = None,
    members: int = 12,
    spread: float = 0.1,
    progress: bool | None = None,
) -> Drift:
    """Measure the drift of the mean energy over long runs from several nearby states.

    The truncation error of a symplectic scheme makes the energy oscillate, but its mean over a
    block of samples is nearly constant. The mean changes by round-off, and by the error of Newton's
    method. Round-off should grow like the square root of time, without bias (Brouwer's law). The
    error of Newton's method grows linearly.

    Parameters
    ----------
    stepper : Stepper
        The stepper to test.
    h : float
        The step size.
    steps : int, default 10_000_000
        The number of steps of each trajectory, rounded down to a multiple of 4096, and
        at least 4096.
    state : mapping, optional
        The central initial state: q0, and v0 or p0. The default is the reference state.
    members : int, default 12
        The number of trajectories. Their initial positions are random.
    spread : float, default 0.1
        The largest distance of an initial coordinate from the central state.
    progress : bool, optional
        Whether to show a progress bar. By default it appears after a second.

    Returns
    -------
    Drift
        The change of the mean energy, and its parts.
    """
    values = stepper.program.named_values()
    q, p = choose_state(stepper, state, values)
    starts = q + spread * np.random.default_rng(5).uniform(-1, 1, (members, stepper.n))
    energies, momenta, failed = _sample_energies(stepper, starts, p, h, steps, values, progress)
    blocks = energies.reshape(len(energies), BLOCKS, SAMPLES)
    means = blocks.mean(axis=2)
    change = means[:, 1:] - means[:, :1]
    rms = np.sqrt((change**2).mean(axis=0))
    within = float(np.sqrt(blocks.var(axis=2).mean()))
    exact = iterate_to_round_off(stepper)
    solved, _, _ = _sample_energies(exact, starts, p, h, steps, values, progress)
    other = solved.reshape(blocks.shape).mean(axis=2)
    gap = float(np.sqrt(((other - means)[:, -1] ** 2).mean()))
    # sampling an oscillation makes the means of adjacent blocks differ
    noise = float(np.sqrt(np.median((np.diff(means, axis=1) ** 2).mean(axis=0))))
    t: Floats = abs(h) * steps / BLOCKS * np.arange(1.0, BLOCKS)
    last = change[:, -1]
    error = max(float(last.std(ddof=1)), noise, 1e-300) / np.sqrt(len(last))
    return Drift(
        stepper.scheme,
        h,
        steps,
        t,
        rms,
        noise,
        _fit_exponent(t, rms, noise),
        abs(float(last.mean())) / error,
        within,
        max(0.0, gap - 2 * noise),
        momenta,
        failed,
    )


def _sample_energies(
    stepper: Stepper,
    q: Floats,
    p: Floats,
    h: float,
    steps: int,
    values: Mapping[str, float],
    progress: bool | None,
) -> tuple[Floats, float, int]:
    """Return relative energies, shape (members, samples), the momentum drift, and the failures.

    Energies are relative to the initial energy. The momentum drift is the largest relative change
    of a momentum that is constant in the first steps.
    """
    every = max(1, steps // (BLOCKS * SAMPLES))
    ensemble = stepper.ensemble(
        q,
        p0=p,
        h=h,
        steps=every * BLOCKS * SAMPLES,
        every=every,
        parameters=values,
        progress=progress,
    )
    good = ensemble.status == 0
    if not good.any():
        return np.full((1, BLOCKS * SAMPLES), np.nan), float("nan"), len(good)
    qs, ps = ensemble.q[good], ensemble.p[good]
    flat = stepper.energy(qs.reshape(-1, stepper.n), ps.reshape(-1, stepper.n), parameters=values)
    energies = flat.reshape(qs.shape[0], -1)
    constant = (ps[:, :2] == ps[:, :1]).all(axis=(0, 1))
    momenta = 0.0
    if constant.any():
        conserved = ps[:, :, constant]
        size = np.abs(conserved).max() or 1.0
        momenta = float(np.abs(conserved - conserved[:, :1]).max() / size)
    scale = np.abs(energies[:, :1])
    return energies[:, 1:] / np.where(scale > 0, scale, 1.0), momenta, int((~good).sum())


def _fit_exponent(t: Floats, rms: Floats, noise: float) -> float:
    """Fit the exponent of the growth; NaN if the noise hides it."""
    if not rms[-1] > 3 * noise:
        return float("nan")
    return float(np.polyfit(np.log(t), np.log(rms), 1)[0])


#: Number of steps of the run whose shadow energy is reported.
SHORT = 200


def stress(stepper: Stepper, *, h: float | None = None, steps: int = 1_000_000) -> Iterator[str]:
    """Test a stepper with long runs, large steps, reversed runs and large angles.

    The runs begin at the reference state of the stepper, or, without one, at a random state.

    Parameters
    ----------
    stepper : Stepper
        The stepper to test.
    h : float, optional
        The step size. By default, trial runs choose it.
    steps : int, default 1_000_000
        The number of steps of the long run.

    Yields
    ------
    str
        The lines of the report.
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
        energy, shadow = (np.ptp(x) / run.energy_scale for x in (run.energy, run.shadow_energy))
        yield (
            f"  in {SHORT} steps the energy oscillates by {energy:.1e}, the shadow energy by "
            f"{shadow:.1e}"
        )
    yield "increasing step sizes, to the same time: energy error, iterations, status"
    for factor in (0.25, 0.5, 1, 2, 4, 8, 16):
        count = max(1, round(4000 / factor))
        run = raise_if_interrupted(
            stepper.integrate(q, p0=p, h=step * factor, steps=count, on_failure="return")
        )
        error = float(np.abs(run.energy_error).max())
        mean = run.newton_iterations.sum() / max(1, run.steps)
        yield f"  h = {step * factor:<10.4g} {error:9.1e} {mean:6.2f}  {run.status.name}"
    if stepper.program.header.constraints:
        return  # a displaced or rotated state violates the constraints
    yield "forward with h and back with -h"
    for count in (100, 1000, 10_000):
        back = reversal(stepper, step, count, state=state)
        yield (
            f"  {count:>6} steps: error {back.error:.1e}; divided by the growth of errors, "
            f"{back.growth:.1e}, {back.rounding:.1e} a step; energy error {back.shadow:.1e}"
        )
    yield "large angles (coordinates in which the motion is periodic)"
    for k, name in enumerate(stepper.coordinates):
        try:
            far = compare_turns(stepper, k, 159_155, h=step, steps=100, state=state)
        except ConvergenceError:  # not an angle: the step may be too large at the other position
            continue
        if far.energy < 1e-6:
            yield (
                f"  {name} + {far.angle:.0f} rad: states differ by {far.difference:.1e}; the "
                f"spacing of numbers is {far.resolution:.1e}"
            )


def stress_standard(scheme: str) -> Iterator[str]:
    """Test a scheme on the linear oscillator and on runs past poles; yield a report by lines."""
    yield f"{scheme}: limits of stability of the linear oscillator, h omega"
    for limit, theory in zip(linear_limits(scheme), theory_limits(scheme), strict=False):
        yield f"  {limit:.4f}, in theory {theory:.4f}"
    yield "past a pole of spherical angles: distance, status, error of the axis, warning"
    for run in pole_sweep(scheme):
        warned = "warned" if run.warned else ""
        yield (
            f"  {run.system:<20} {run.distance:.0e} {run.status.name:<24} {run.error:8.1e} {warned}"
        )
