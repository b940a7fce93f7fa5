"""Cancellation: sizes of the terms of forces, and changes of V without round-off."""

from __future__ import annotations

from collections.abc import Iterable

import mpmath
import numpy as np

from symsimpson.declare.system import MechanicalSystem
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluate_nodes, moduli
from symsimpson.support.array_types import Floats

#: The forces of systems with more coordinates have too many terms to evaluate after a failed step.
MAX_COORDINATES = 12
#: Digits of V, and largest number of evaluations of nodes over all states.
DIGITS, MAX_EVALUATIONS = 50, 100_000


def force_terms(
    system: MechanicalSystem,
    q: Iterable[float],
    values: Iterable[float],
    t: float = 0.0,
    v: Iterable[float] | None = None,
) -> Floats:
    """Return the sums of the absolute values of the terms of dL/dq + f at v = 0, shape (n,).

    With ``v``, return the sums for the derivatives of dL/dq + f by v, at v. ``values`` are the
    values of all parameters, in the order of the system, and then of the inputs. A sum is NaN if it
    is undefined. All sums are 0 for a system with more than ``MAX_COORDINATES`` coordinates.
    """
    n, plain = system.n, system.plain
    if n > MAX_COORDINATES:
        return np.zeros(n)
    graph, forces = plain.graph, plain.right_sides
    names = plain.numbers([*plain.q, *plain.v, *plain.parameters, *plain.u, plain.t])
    speeds = np.zeros(n) if v is None else v
    given = dict(zip(names, map(float, (*q, *speeds, *values, t)), strict=True))
    rows = [[force] for force in forces]
    if v is not None:
        rows = [gradient(graph, force, plain.numbers(plain.v)) for force in forces]
    roots = [m for row in rows for _, m in row]
    sizes = moduli(graph, roots, evaluate_nodes(graph, roots, given, mpmath.fp))
    return np.array([sum(abs(float(c)) * sizes[m] for c, m in row if c) for row in rows])


def changes_of_potential(
    system: MechanicalSystem, t: Floats, q: Floats, values: Iterable[float]
) -> Floats | None:
    """Return V at each state minus V at the first state, without round-off, shape (N,).

    ``t`` and ``q`` are the states, of shape (N,) and (N, n). ``values`` are the values of all
    parameters, in the order of the system. The result is NaN where V is undefined, and None if it
    takes more than ``MAX_EVALUATIONS`` evaluations.
    """
    plain = system.plain
    graph, (factor, node) = plain.graph, plain.V
    if len(t) * len(graph.descendants([node])) > MAX_EVALUATIONS:
        return None
    names = plain.numbers([*plain.q, *plain.parameters, plain.t])
    constants = list(values)
    with mpmath.workdps(DIGITS):
        scale = mpmath.mpf(factor.numerator) / factor.denominator
        levels = []
        for time, position in zip(t.tolist(), q.tolist(), strict=True):
            numbers = map(mpmath.mpf, (*position, *constants, time))
            given = dict(zip(names, numbers, strict=True))
            levels.append(scale * evaluate_nodes(graph, [node], given, mpmath.mp)[node])
        return np.array([float(level - levels[0]) for level in levels])
