"""Chaotic motion: back to the start, and the same statistics whatever the scheme."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.api.stepper import Stepper
from symsimpson.support.array_types import Floats

__all__ = ["Mixing", "Reversal", "mixing", "reversal"]


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
