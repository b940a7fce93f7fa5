"""The order at which errors fall with the step."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.support.array_types import Floats

__all__ = ["observed_orders"]


def observed_orders(errors: ArrayLike, ratio: float = 2.0) -> Floats:
    """Return the observed order between each error and the next.

    Parameters
    ----------
    errors : array_like, shape (k,)
        Errors at steps that fall by a constant ratio.
    ratio : float
        The ratio of a step to the next.

    Returns
    -------
    ndarray, shape (k - 1,)
        Infinite where the next error is 0, NaN between two errors of 0.

    Examples
    --------
    >>> observed_orders([1.6e-3, 1e-4, 6.25e-6]).tolist()
    [4.0, 4.0]
    """
    values = np.asarray(errors, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(values[:-1] / values[1:]) / np.log(ratio))
