"""Stress tests of a stepper: long runs, large steps, chaotic motion, large angles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.api.stepper import Stepper
from symsimpson.errors import ConvergenceError
from symsimpson.run.ended import uninterrupted
from symsimpson.study.analysis.checks import shadow_is_testable
from symsimpson.study.analysis.pilot import choose_state, choose_step
from symsimpson.study.analysis.stability.standard_problems import (
    linear_limits,
    pole_sweep,
    theory_limits,
)
from symsimpson.study.analysis.variants import in_tau, oversolved
from symsimpson.support.array_types import Floats

#: Blocks of samples, and samples of a block; a run takes a multiple of their product as steps.
BLOCKS, SAMPLES = 32, 128


@dataclass(frozen=True)
class Drift:
    """How the energy of several trajectories moved.

    Attributes
    ----------
    scheme : str
    h : float
    steps : int
    t : ndarray, shape (blocks - 1,)
        Times between the first block of samples and the others.
    rms : ndarray, shape (blocks - 1,)
        Root mean square, over the members, of the relative change of a block's mean energy since
        the first block.
    noise : float
        Part of ``rms`` that comes from sampling an oscillation alone.
    exponent : float
        Exponent a of the fit rms ~ t^a; NaN if the last ``rms`` is at most three times the noise.
    bias : float
        Mean change of the energy of all members at the end, in units of its standard error:
        unbiased rounding stays below 3.
    truncation : float
        Rms oscillation within a block, relative to the energy.
    solver : float
        Rms change of the last block's mean if Newton's method is iterated until it stagnates, less
        twice the noise.
    momenta : float
        Largest relative change of a momentum that does not change in the first steps.
    failed : int
        Members that did not reach the end.
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
        grown = f"{self.exponent:.2f}" if self.exponent == self.exponent else "none seen"
        return (
            f"{self.scheme:<10} h = {self.h:<9.4g} {self.steps:.0e} steps: energy moved by "
            f"{self.rms[-1]:.1e} (noise {self.noise:.0e}, exponent {grown}, bias "
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
    """Integrate some nearby states for long and follow the mean energy of blocks of samples.

    Symplectic truncation makes the energy oscillate; its mean over a block stays. What remains is
    round-off, which should grow like the square root of time, without bias (Brouwer's law), and
    what Newton's method leaves unsolved, which grows linearly.

    Parameters
    ----------
    stepper : Stepper
    h : float
    steps : int
    state : mapping, optional
        q0, and v0 or p0; the reference state if left out.
    members : int
        Initial states: the state with positions moved by up to ``spread``.
    spread : float
    progress : bool, optional
        Whether to show a bar; None shows one after a second.

    Returns
    -------
    Drift
    """
    values = stepper.program.named_values()
    q, p = choose_state(stepper, state, values)
    moved = q + spread * np.random.default_rng(5).uniform(-1, 1, (members, stepper.n))
    energies, momenta, failed = _sampled(stepper, moved, p, h, steps, values, progress)
    blocks = energies.reshape(len(energies), BLOCKS, SAMPLES)
    means = blocks.mean(axis=2)
    change = means[:, 1:] - means[:, :1]
    rms = np.sqrt((change**2).mean(axis=0))
    within = float(np.sqrt(blocks.var(axis=2).mean()))
    solved, _, _ = _sampled(oversolved(stepper), moved, p, h, steps, values, progress)
    other = solved.reshape(blocks.shape).mean(axis=2)
    gap = float(np.sqrt(((other - means)[:, -1] ** 2).mean()))
    # the change of the mean between neighbouring blocks is what sampling makes of an oscillation
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
        _exponent(t, rms, noise),
        abs(float(last.mean())) / error,
        within,
        max(0.0, gap - 2 * noise),
        momenta,
        failed,
    )


def _sampled(
    stepper: Stepper,
    q: Floats,
    p: Floats,
    h: float,
    steps: int,
    values: Mapping[str, float],
    progress: bool | None,
) -> tuple[Floats, float, int]:
    """Return energies over the first one, the drift of conserved momenta, and how many failed."""
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
        kept = ps[:, :, constant]
        size = np.abs(kept).max() or 1.0
        momenta = float(np.abs(kept - kept[:, :1]).max() / size)
    scale = np.abs(energies[:, :1])
    return energies[:, 1:] / np.where(scale > 0, scale, 1.0), momenta, int((~good).sum())


def _exponent(t: Floats, rms: Floats, noise: float) -> float:
    """Fit the growth, where there is any to see."""
    if not rms[-1] > 3 * noise:
        return float("nan")
    return float(np.polyfit(np.log(t), np.log(rms), 1)[0])


@dataclass(frozen=True)
class Reversal:
    """A run with h and back with -h.

    Attributes
    ----------
    steps : int
    error : float
        Distance from the start, relative to the state's size.
    growth : float
        By how much a displacement of 1e-9 grew on the way there.
    shadow : float
        Largest relative energy error on the way.
    """

    steps: int
    error: float
    growth: float
    shadow: float

    @property
    def rounding(self) -> float:
        """The error of a single step: error / (growth steps)."""
        return self.error / (max(self.growth, 1.0) * self.steps)


def reversal(stepper: Stepper, h: float, steps: int, *, state: Mapping[str, Any]) -> Reversal:
    """Integrate there and back; in chaos the error is that of rounding, grown by the motion."""
    there = stepper.integrate(**state, h=h, steps=steps)
    back = stepper.integrate(there.q[-1], p0=there.p[-1], h=-h, steps=steps, every=None)
    q_size, p_size = (max(1e-300, float(np.abs(x).max())) for x in (there.q, there.p))
    q_size = max(q_size, 1.0)
    moved = stepper.integrate(there.q[0] + 1e-9, p0=there.p[0], h=h, steps=steps, every=None)

    def distance(q: Floats, p: Floats, q2: Floats, p2: Floats) -> float:
        return float(max(np.abs(q - q2).max() / q_size, np.abs(p - p2).max() / p_size))

    growth = distance(moved.q[0], moved.p[0], there.q[-1], there.p[-1]) / (1e-9 / q_size)
    error = distance(back.q[0], back.p[0], there.q[0], there.p[0])
    return Reversal(steps, error, growth, float(np.abs(there.energy_error).max()))


@dataclass(frozen=True)
class Mixing:
    """Whether two steppers give a quantity the same distribution.

    Attributes
    ----------
    distance : float
        Largest distance of the two distribution functions (Kolmogorov and Smirnov).
    threshold : float
        Exceeded by chance once in a thousand.
    members : int
    """

    distance: float
    threshold: float
    members: int

    @property
    def agrees(self) -> bool:
        """Whether chance explains the difference."""
        return self.distance <= self.threshold


def mixing(
    steppers: tuple[Stepper, Stepper],
    steps: tuple[float, float],
    q0: ArrayLike,
    *,
    t_end: float,
    quantity: Any,
    **given: Any,
) -> Mixing:
    """Compare distributions over members whose trajectories themselves have parted.

    Parameters
    ----------
    steppers : two of Stepper
    steps : two of float
        Their steps; each is fitted to divide ``t_end``.
    q0 : array_like, shape (K, n)
        Initial positions; those of the second stepper are moved by 1e-6.
    t_end : float
    quantity : callable
        Gives an array of shape (K,) from q and p of shape (K, n).
    **given
        v0 or p0, and parameters, as for ``ensemble``.
    """
    samples = []
    start = np.asarray(q0, dtype=np.float64)
    for k, (stepper, h) in enumerate(zip(steppers, steps, strict=True)):
        count = round(t_end / h)
        ensemble = stepper.ensemble(start + 1e-6 * k, h=t_end / count, steps=count, **given)
        good = ensemble.status == 0
        samples.append(np.sort(quantity(ensemble.q[good], ensemble.p[good])))
    both = np.concatenate(samples)
    shares = [np.searchsorted(x, both, side="right") / x.size for x in samples]
    sizes = [x.size for x in samples]
    threshold = 1.95 * np.sqrt(sum(sizes) / np.prod(sizes, dtype=np.float64))
    return Mixing(float(np.abs(shares[0] - shares[1]).max()), float(threshold), min(sizes))


@dataclass(frozen=True)
class Turned:
    """A run from an angle that is some million radians away.

    Attributes
    ----------
    angle : float
        By how much the start is turned.
    difference : float
        Largest difference of the states, less the turn, to the run from the plain start.
    resolution : float
        Spacing of floating-point numbers at that angle.
    energy : float
        Difference of the largest relative energy errors.
    """

    angle: float
    difference: float
    resolution: float
    energy: float


def turned(
    stepper: Stepper, coordinate: int, turns: int, *, h: float, steps: int, state: Mapping[str, Any]
) -> Turned:
    """Integrate from a start and from the same start many turns away."""
    plain = stepper.integrate(**state, h=h, steps=steps)
    moved: dict[str, Any] = {key: np.array(value, dtype=np.float64) for key, value in state.items()}
    angle = 2 * np.pi * turns
    moved["q0"][coordinate] += angle
    far = stepper.integrate(**moved, h=h, steps=steps)
    turn = np.zeros(stepper.n)
    turn[coordinate] = far.q[0, coordinate] - plain.q[0, coordinate]
    energy = abs(np.abs(far.energy_error).max() - np.abs(plain.energy_error).max())
    difference = float(np.abs(far.q - turn - plain.q).max())
    resolution = float(np.spacing(abs(angle) + np.abs(plain.q).max()))
    return Turned(angle, difference, resolution, float(energy))


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
