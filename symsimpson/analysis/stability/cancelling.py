"""How large the terms of forces are that cancel where a system is at rest."""

from __future__ import annotations

from collections.abc import Iterable

import mpmath
import numpy as np
from numpy.typing import NDArray

from symsimpson.graph.evaluate import evaluated, moduli
from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["force_terms"]

#: The forces of larger systems have too many terms to be looked at when a step fails.
MOST_COORDINATES = 12


def force_terms(
    system: MechanicalSystem, q: Iterable[float], values: Iterable[float], t: float = 0.0
) -> NDArray[np.float64]:
    """Return the sums of the moduli of the terms of dL/dq + f at rest, one for each coordinate.

    Parameters
    ----------
    system : MechanicalSystem
    q : iterable of float, n of them
    values : iterable of float
        Values of all parameters, in the order of the system, then those of inputs.
    t : float

    Returns
    -------
    ndarray, shape (n,)
        NaN where they have no value; zeros where the system is too large to be looked at.
    """
    n, plain = system.n, system.plain
    if n > MOST_COORDINATES:
        return np.zeros(n)
    graph, forces = plain.graph, plain.right_sides
    names = plain.numbers([*plain.q, *plain.v, *plain.parameters, *plain.u, plain.t])
    given = dict(zip(names, map(float, (*q, *np.zeros(n), *values, t)), strict=True))
    roots = [m for _, m in forces]
    sizes = moduli(graph, roots, evaluated(graph, roots, given, mpmath.fp))
    return np.array([abs(float(c)) * sizes[m] for c, m in forces])
