"""Results of derivatives: gradients of a cost, linearised steps, and indicators of chaos."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.results.trajectory import Trajectory
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.names import counted

#: Relative increment with the smallest error of a central difference of exact gradients.
DIFFERENCE = np.finfo(np.float64).eps ** (1 / 3)


class Gradient(tuple[Any, Reals]):
    """The pair (value, gradient) that ``scipy.optimize`` takes with ``jac=True``.

    Attributes
    ----------
    value : number
        The cost.
    gradient : ndarray, shape (k,)
        The derivatives of the cost by all variables of ``wrt``, in their order.
    parts : dict from str to ndarray
        The derivatives by name. Each array has the shape of the value that you pass.

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
        """Join the derivatives of all variables into one gradient."""
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
        """The derivatives of the cost by all variables, in their order, shape (k,)."""
        return self[1]

    def __repr__(self) -> str:
        sizes = ", ".join(f"{name} {part.shape or 1}" for name, part in self.parts.items())
        return f"Gradient(value {float(self.value):.9g}, by {sizes})"


def hessian_product(
    objective: Callable[[ArrayLike], tuple[float, ArrayLike]],
) -> Callable[[ArrayLike, ArrayLike], NDArray[np.float64]]:
    """Return a function that multiplies the Hessian matrix by a vector.

    The optimisers of SciPy take this function as ``hessp``. A product is a central difference of
    two exact gradients, and has about ten correct digits.

    Parameters
    ----------
    objective : callable
        The function to differentiate. It takes a point of shape (k,), and returns the pair
        (value, gradient).

    Returns
    -------
    callable
        A function of a point and a vector, each of shape (k,). It returns the product of the
        Hessian matrix and the vector, shape (k,).

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
    """Derivatives of the N steps of a run: of the state (q, p) at the end of each step.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Times of the states.
    q, p : ndarray, shape (N + 1, n)
        Positions and conjugate momenta before and after the steps.
    by_state : ndarray, shape (N, 2 n, 2 n)
        Derivatives by the state (q, p) at the start of each step.
    by_parameter : mapping from str to ndarray, shape (N, 2 n)
        Derivatives by a parameter, at a fixed state at the start of each step.
    by_input : mapping from str to ndarray, shape (N, 2 n, s)
        Derivatives by the values of an input at the s nodes of each step.

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
    """Lyapunov exponents and other indicators of chaos; :meth:`Stepper.lyapunov` returns them.

    Attributes
    ----------
    t : ndarray, shape (M,)
        Times at which the run orthonormalised the variations.
    exponents : ndarray, shape (k,)
        Lyapunov exponents, in 1 / time, averaged over the whole run. The largest is first, if the
        run is long enough to separate them. Without forces and constraints, the 2 n exponents are
        pairs of opposite sign: the first and the last, and so on.
    history : ndarray, shape (M, k)
        Lyapunov exponents, in 1 / time, averaged up to each time.
    megno : ndarray, shape (M,)
        Mean exponential growth factor of nearby orbits. It tends to 2 on quasiperiodic motions and
        to 0 on periodic ones. On chaotic motions it grows like t times half the largest exponent.
    sali : ndarray, shape (M,)
        Smaller alignment index of two variations. It decays exponentially on chaotic motions.
    gali : ndarray, shape (M, k - 1)
        Generalised alignment indices of the first two, three, ... variations.
    trajectory : Trajectory
        The states at the initial time and at these times.

    Notes
    -----
    The squared length of a variation is the sum of (m_i/T) dq_i^2 + (T/m_i) dp_i^2. 1/m_i is the
    diagonal of M^-1 at the initial state, and T is the time scale of the linearised equations
    there. The indicators therefore do not depend on your units. Only the exponents have a unit,
    1 / time.

    References
    ----------
    .. [1] G. Benettin, L. Galgani, A. Giorgilli, J.-M. Strelcyn, Meccanica 15 (1980).
    .. [2] P. M. Cincotta, C. Simo, Astron. Astrophys. Suppl. 147 (2000).
    .. [3] C. Skokos, T. Bountis, C. Antonopoulos, Physica D 231 (2007).

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.double_pendulum())
    >>> chaos = stepper.lyapunov([2.0, 2.5], p0=[0, 0], h=0.01, t_end=20)
    >>> chaos.history.shape, chaos.gali.shape, bool(chaos.megno[-1] > 4)
    ((100, 4), (100, 3), True)
    """

    t: Floats
    history: Floats
    megno: Floats
    sali: Floats
    gali: Floats
    trajectory: Trajectory = field(repr=False)

    @property
    def exponents(self) -> Floats:
        """Lyapunov exponents averaged over the whole run, in 1 / time, shape (k,)."""
        return np.asarray(self.history[-1])

    def plot(self, *, ax: Any = None) -> Any:
        """Draw the Lyapunov exponents over time.

        Parameters
        ----------
        ax : matplotlib axes, optional
            Axes to draw in. By default, the method creates new axes.

        Returns
        -------
        matplotlib axes
            The axes of the figure.

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


def read_chaos(rows: Floats, trajectory: Trajectory, count: int) -> Chaos:
    """Read the rows that the driver recorded for ``count`` variations, one for each time."""
    t = trajectory.t[1:]
    elapsed = (t - trajectory.t[0])[:, None]
    sums, gali = rows[:, 3 : 3 + count], rows[:, 3 + count : 2 + 2 * count]
    return Chaos(t, sums / np.abs(elapsed), rows[:, 1], rows[:, 2], gali, trajectory)
