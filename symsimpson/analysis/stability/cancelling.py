"""How large the terms of forces are that cancel where a system is at rest."""

from __future__ import annotations

from collections.abc import Iterable

import mpmath
import numpy as np
from numpy.typing import NDArray

from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluated, moduli
from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["force_terms"]

#: The forces of larger systems have too many terms to be looked at when a step fails.
MOST_COORDINATES = 12


def force_terms(
    system: MechanicalSystem,
    q: Iterable[float],
    values: Iterable[float],
    t: float = 0.0,
    v: Iterable[float] | None = None,
) -> NDArray[np.float64]:
    """Return the sums of the moduli of the terms of dL/dq + f at rest, one for each coordinate.

    At velocities, those of its derivatives by them.

    Parameters
    ----------
    system : MechanicalSystem
    q : iterable of float, n of them
    values : iterable of float
        Values of all parameters, in the order of the system, then those of inputs.
    t : float
    v : iterable of float, optional

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
    speeds = np.zeros(n) if v is None else v
    given = dict(zip(names, map(float, (*q, *speeds, *values, t)), strict=True))
    rows = [[force] for force in forces]
    if v is not None:
        rows = [gradient(graph, force, plain.numbers(plain.v)) for force in forces]
    roots = [m for row in rows for _, m in row]
    sizes = moduli(graph, roots, evaluated(graph, roots, given, mpmath.fp))
    return np.array([sum(abs(float(c)) * sizes[m] for c, m in row if c) for row in rows])
