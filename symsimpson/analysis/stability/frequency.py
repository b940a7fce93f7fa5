"""The fastest linear oscillation at a state, and the steps that a scheme takes of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.analysis.stability.limits import theory_limits
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.schemes.named import read_scheme

__all__ = ["largest_frequency", "largest_stable"]

#: Limits beyond this are as good as none.
LARGEST = 12.0


def largest_frequency(
    system: MechanicalSystem, q: NDArray[np.float64], parameters: Mapping[str, float]
) -> float:
    """Give the largest omega of K x = omega^2 M x, K the Hessian of V at q; 0 if none is positive.

    Parameters
    ----------
    system : MechanicalSystem
    q : ndarray, shape (n,)
    parameters : mapping from str to float
        Values of all parameters, by name.
    """
    plain = system.plain
    known = dict(zip(plain.parameters, parameters.values(), strict=True))
    known |= dict(zip(plain.q, map(float, q), strict=True))

    def numbers(matrix: sp.MatrixBase) -> NDArray[np.float64]:
        return np.array(matrix.xreplace(known).evalf().tolist(), dtype=np.float64)

    stiffness = numbers(sp.hessian(plain.potential, plain.q))
    squares = np.linalg.eigvals(np.linalg.solve(numbers(plain.mass), stiffness)).real
    return math.sqrt(max(0.0, float(squares.max())))


@cache
def largest_stable(scheme: str) -> float:
    """Give h omega up to which a scheme is stable for a linear oscillator; infinity if for all."""
    if read_scheme(scheme).unbounded:
        return math.inf
    edges = theory_limits(scheme, LARGEST)
    return edges[0] if edges else math.inf
