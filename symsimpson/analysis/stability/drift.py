"""Energy over many steps: what is truncation, what the solver leaves, what is round-off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.analysis.pilot import choose_state
from symsimpson.analysis.variants import oversolved
from symsimpson.api.stepper import Stepper

__all__ = ["Drift", "energy_drift"]

#: Blocks of samples, and samples of a block; a run takes a multiple of their product as steps.
BLOCKS, SAMPLES = 32, 128

Floats = NDArray[np.floating[Any]]


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
    t = abs(h) * steps / BLOCKS * np.arange(1, BLOCKS)
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
