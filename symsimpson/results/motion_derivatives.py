"""Derivatives of motions: of a cost, of single steps, of motions that part."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.results.trajectory import Trajectory
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.names import counted

#: A central difference of exact gradients loses the fewest digits at this part of the point.
DIFFERENCE = np.finfo(np.float64).eps ** (1 / 3)


class Gradient(tuple[Any, Reals]):
    """The pair (value, gradient) that ``scipy.optimize`` takes with ``jac=True``.

    Attributes
    ----------
    value : number
        The cost.
    gradient : ndarray, shape (k,)
        Its derivatives by all that was asked for, one after the other.
    parts : dict from str to ndarray
        The same by name, each in the shape of what was given.

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.pendulum())
    >>> found = stepper.gradient([1.0], v0=[0.0], h=0.01, steps=100, cost="theta**2",
    ...                          wrt=("q", "l"))
    >>> value, gradient = found
    >>> gradient.shape, list(found.parts), found.parts["q"].shape
    ((2,), ['q', 'l'], (1,))
    """

    parts: dict[str, Reals]

    def __new__(cls, value: Any, parts: Mapping[str, Reals]) -> Gradient:
        """Join the parts."""
        flat = [np.ravel(part) for part in parts.values()]
        gradient = super().__new__(cls, (value, np.concatenate(flat) if flat else np.zeros(0)))
        gradient.parts = dict(parts)
        return gradient

    def __getnewargs__(self) -> tuple[Any, dict[str, Reals]]:
        return self.value, self.parts

    @property
    def value(self) -> Any:
        """The cost."""
        return self[0]

    @property
    def gradient(self) -> Reals:
        """Its derivatives, one after the other."""
        return self[1]

    def __repr__(self) -> str:
        sizes = ", ".join(f"{name} {part.shape or 1}" for name, part in self.parts.items())
        return f"Gradient(value {float(self.value):.9g}, by {sizes})"


def hessian_product(
    objective: Callable[[ArrayLike], tuple[float, ArrayLike]],
) -> Callable[[ArrayLike, ArrayLike], NDArray[np.float64]]:
    """Return products of the Hessian matrix with vectors, as optimisers of SciPy take ``hessp``.

    Each is a central difference of two exact gradients: some ten digits.

    Parameters
    ----------
    objective : callable
        From a point to (value, gradient).

    Returns
    -------
    callable
        From a point and a direction, each of shape (k,), to their product.

    Examples
    --------
    >>> import symsimpson as ss
    >>> product = ss.hessian_product(lambda x: (x[0]**4, [4 * x[0]**3]))
    >>> round(float(product([1.0], [2.0])[0]), 8)  # 12 x^2 = 12, times 2
    24.0
    """

    def product(x: ArrayLike, direction: ArrayLike) -> NDArray[np.float64]:
        point, along = (np.asarray(a, dtype=np.float64) for a in (x, direction))
        size = float(np.abs(along).max(initial=0.0))
        if size == 0:
            return np.zeros_like(point)
        part = DIFFERENCE * max(1.0, float(np.abs(point).max())) / size
        ahead, behind = (
            np.asarray(objective(point + sign * part * along)[1], dtype=np.float64)
            for sign in (1, -1)
        )
        return (ahead - behind) / (2 * part)

    return product


@dataclass(frozen=True)
class Linearisation:
    """Derivatives of the steps of a run, each of its end (q, p).

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
    q, p : ndarray, shape (N + 1, n)
        The states between which the steps are.
    by_state : ndarray, shape (N, 2 n, 2 n)
        By (q, p) at the start of each step.
    by_parameter : mapping from name to ndarray, shape (N, 2 n)
        By a parameter, at a given state.
    by_input : mapping from name to ndarray, shape (N, 2 n, s)
        By the values that an input has at the s nodes of each step.

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.cart_pole())
    >>> run = stepper.linearise([0.0, 0.1], p0=[0.0, 0.0], h=0.01, steps=5, wrt="l")
    >>> run.by_state.shape, run.by_parameter["l"].shape
    ((5, 4, 4), (5, 4))
    """

    t: Reals
    q: Reals
    p: Reals
    by_state: Reals
    by_parameter: Mapping[str, Reals]
    by_input: Mapping[str, Reals]

    def __repr__(self) -> str:
        names = ", ".join((*self.by_parameter, *self.by_input))
        steps = counted(len(self.by_state), "step")
        return f"Linearisation({steps}, by the state{', ' * bool(names)}{names})"


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
