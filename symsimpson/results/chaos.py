"""Whether neighbouring motions part: Lyapunov exponents and other indicators of chaos."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from symsimpson.results.trajectory import Trajectory
from symsimpson.support.array_types import Floats

__all__ = ["Chaos", "chaos_of"]


@dataclass(frozen=True, repr=False, eq=False)
class Chaos:
    """How variations of a motion grow and align; made by :meth:`Stepper.lyapunov`.

    Attributes
    ----------
    t : ndarray, shape (M,)
        Times at which variations were made orthonormal again.
    exponents : ndarray, shape (k,)
        Lyapunov exponents in 1 / time, means up to the last of these times: the largest first, if
        the run is long enough to tell them apart. Without forces and constraints, the first and the
        last of all 2 n exponents are opposite, and so on.
    history : ndarray, shape (M, k)
        Means up to each of these times.
    megno : ndarray, shape (M,)
        Mean exponential growth of nearby orbits, averaged over time: goes to 2 on regular motions
        (0 on periodic ones), grows as half the largest exponent times t on chaotic ones.
    sali : ndarray, shape (M,)
        Smaller alignment index of two variations: falls to 0 exponentially on chaotic motions.
    gali : ndarray, shape (M, k - 1)
        Generalized alignment indices of the first two, three, ... variations.
    trajectory : Trajectory
        The motion at these times, and at the start.

    Notes
    -----
    The squared length of a variation is the sum of (m_i/T) dq_i^2 + (T/m_i) dp_i^2. 1/m_i is the
    diagonal of M^-1 at the start, and T is the time scale of the linearised equations there. So no
    value depends on your units, except that exponents have the unit 1 / time.

    References
    ----------
    .. [1] G. Benettin, L. Galgani, A. Giorgilli, J.-M. Strelcyn, Meccanica 15 (1980).
    .. [2] P. M. Cincotta, C. Simo, Astron. Astrophys. Suppl. 147 (2000).
    .. [3] C. Skokos, T. Bountis, C. Antonopoulos, Physica D 231 (2007).
    """

    t: Floats
    history: Floats
    megno: Floats
    sali: Floats
    gali: Floats
    trajectory: Trajectory = field(repr=False)

    @property
    def exponents(self) -> Floats:
        """Lyapunov exponents up to the last time, in the order of ``history``."""
        return np.asarray(self.history[-1])

    def plot(self, *, ax: Any = None) -> Any:
        """Draw the exponents over time, into ``ax`` if given; returns the axes.

        Raises
        ------
        InputError
            If matplotlib is not installed.
        """
        from symsimpson.plotting.run_figures import plot_exponents

        return plot_exponents(self, ax=ax)

    def _repr_html_(self) -> str:
        from symsimpson.results.html import chaos

        return chaos(self)

    def __repr__(self) -> str:
        exponents = ", ".join(f"{x:.4g}" for x in self.exponents)
        return f"Chaos(exponents {exponents}; t = {self.t[-1]:g}, megno {self.megno[-1]:.4g})"


def chaos_of(kept: Floats, trajectory: Trajectory, count: int) -> Chaos:
    """Read what the driver kept of so many variations, one row for each time."""
    t = trajectory.t[1:]
    past = (t - trajectory.t[0])[:, None]
    sums, aligned = kept[:, 3 : 3 + count], kept[:, 3 + count : 2 + 2 * count]
    return Chaos(t, sums / np.abs(past), kept[:, 1], kept[:, 2], aligned, trajectory)
