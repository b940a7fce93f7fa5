"""A cost and its derivatives, as optimisers take them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from symsimpson.support.array_types import Reals

__all__ = ["Gradient", "hessian_product"]

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
