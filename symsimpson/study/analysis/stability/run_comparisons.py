"""Comparisons of runs: forward and back, in chaotic motion, and with large angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.api.stepper import Stepper
from symsimpson.support.array_types import Floats


@dataclass(frozen=True)
class Reversal:
    """A run with step size h, and back with -h.

    :func:`reversal` returns it.

    Attributes
    ----------
    steps : int
        The number of steps in each direction.
    error : float
        The distance of the final state from the initial state, relative to the size of the state.
    growth : float
        The factor by which a displacement of 1e-9 grows on the forward run.
    shadow : float
        The largest relative energy error on the forward run.

    Examples
    --------
    >>> import symsimpson as ss
    >>> from symsimpson.study.analysis.stability import reversal
    >>> stepper = ss.compile(ss.systems.pendulum())
    >>> back = reversal(stepper, 0.02, 100, state={"q0": [1.0], "v0": [0.0]})
    >>> back.error < 1e-12, back.rounding < 1e-14
    (True, True)
    """

    steps: int
    error: float
    growth: float
    shadow: float

    @property
    def rounding(self) -> float:
        """The round-off error of a single step: ``error / (growth * steps)``."""
        return self.error / (max(self.growth, 1.0) * self.steps)


def reversal(stepper: Stepper, h: float, steps: int, *, state: Mapping[str, Any]) -> Reversal:
    """Integrate forward with h and back with -h, and measure the distance from the initial state.

    In chaotic motion the error is the round-off error times the growth of displacements.

    Parameters
    ----------
    stepper : Stepper
        The stepper to test.
    h : float
        The step size.
    steps : int
        The number of steps in each direction.
    state : mapping
        The initial state: q0, and v0 or p0.

    Returns
    -------
    Reversal
        The error, and the growth of a displacement.
    """
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
    """A comparison of the distributions of a quantity that two steppers give.

    :func:`mixing` returns it.

    Attributes
    ----------
    distance : float
        The largest distance of the two distribution functions (Kolmogorov and Smirnov).
    threshold : float
        The distance that equal distributions exceed with a probability of 0.001.
    members : int
        The number of members of the smaller sample.

    Examples
    --------
    >>> from symsimpson.study.analysis.stability import Mixing
    >>> Mixing(distance=0.03, threshold=0.1, members=800).agrees
    True
    """

    distance: float
    threshold: float
    members: int

    @property
    def agrees(self) -> bool:
        """True if the distance is at most the threshold, so that chance explains it."""
        return self.distance <= self.threshold


def mixing(
    steppers: tuple[Stepper, Stepper],
    steps: tuple[float, float],
    q0: ArrayLike,
    *,
    t_end: float,
    quantity: Any,
    **options: Any,
) -> Mixing:
    """Compare the distributions of a quantity in chaotic motion, where trajectories diverge.

    Parameters
    ----------
    steppers : tuple of two Steppers
        The steppers to compare.
    steps : tuple of two floats
        Their step sizes. Each is changed to the nearest one that divides ``t_end``.
    q0 : array_like, shape (K, n)
        The initial positions. The second stepper begins at ``q0 + 1e-6``.
    t_end : float
        The final time, in the unit of the system.
    quantity : callable
        A function of the final q and p, shape (K, n) each, that returns an array of shape (K,).
    **options
        v0 or p0, and parameters, as for :meth:`Stepper.ensemble`.

    Returns
    -------
    Mixing
        The distance of the distributions at ``t_end``, and its threshold.
    """
    samples = []
    start = np.asarray(q0, dtype=np.float64)
    for k, (stepper, h) in enumerate(zip(steppers, steps, strict=True)):
        count = round(t_end / h)
        ensemble = stepper.ensemble(start + 1e-6 * k, h=t_end / count, steps=count, **options)
        good = ensemble.status == 0
        samples.append(np.sort(quantity(ensemble.q[good], ensemble.p[good])))
    both = np.concatenate(samples)
    shares = [np.searchsorted(x, both, side="right") / x.size for x in samples]
    sizes = [x.size for x in samples]
    threshold = 1.95 * np.sqrt(sum(sizes) / np.prod(sizes, dtype=np.float64))
    return Mixing(float(np.abs(shares[0] - shares[1]).max()), float(threshold), min(sizes))


@dataclass(frozen=True)
class TurnComparison:
    """A comparison of two runs whose initial angles differ by many whole turns.

    :func:`compare_turns` returns it.

    Attributes
    ----------
    angle : float
        The difference of the initial angles, in rad.
    difference : float
        The largest difference of the positions, minus the difference of the initial angles.
    resolution : float
        The spacing of floating-point numbers at that angle, in rad.
    energy : float
        The difference of the largest relative energy errors.

    Examples
    --------
    >>> import symsimpson as ss
    >>> from symsimpson.study.analysis.stability import compare_turns
    >>> stepper = ss.compile(ss.systems.pendulum())
    >>> state = {"q0": [1.0], "v0": [0.0]}
    >>> far = compare_turns(stepper, 0, 1000, h=0.02, steps=100, state=state)
    >>> far.difference < 100 * far.resolution
    True
    """

    angle: float
    difference: float
    resolution: float
    energy: float


def compare_turns(
    stepper: Stepper, coordinate: int, turns: int, *, h: float, steps: int, state: Mapping[str, Any]
) -> TurnComparison:
    """Compare a run with the run from an initial angle that is larger by many whole turns.

    Parameters
    ----------
    stepper : Stepper
        The stepper to test. The motion must be periodic in the coordinate.
    coordinate : int
        The index of the angle.
    turns : int
        The number of whole turns that are added to its initial value.
    h : float
        The step size.
    steps : int
        The number of steps.
    state : mapping
        The initial state: q0, and v0 or p0.

    Returns
    -------
    TurnComparison
        The differences of positions and energy errors.
    """
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
    return TurnComparison(angle, difference, resolution, float(energy))
