"""Losses where terms cancel: in forces at rest, and in V where a motion is small."""

from __future__ import annotations

from collections.abc import Iterable

import mpmath
import numpy as np

from symsimpson.declare.system import MechanicalSystem
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluated, moduli
from symsimpson.support.array_types import Floats

#: The forces of larger systems have too many terms to be looked at when a step fails.
MOST_COORDINATES = 12
#: V is evaluated in so many digits, unless it has more nodes than this at all states together.
DIGITS, MOST_NODES = 50, 100_000


def force_terms(
    system: MechanicalSystem,
    q: Iterable[float],
    values: Iterable[float],
    t: float = 0.0,
    v: Iterable[float] | None = None,
) -> Floats:
    """Return the sums of the moduli of the terms of dL/dq + f at rest, one for each coordinate.

    At velocities, those of its derivatives by them. ``values`` are those of all parameters, in the
    order of the system, then those of inputs. Sums are NaN where they have no value, and zeros
    where the system is too large to be looked at.
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


def changes_of_potential(
    system: MechanicalSystem, t: Floats, q: Floats, values: Iterable[float]
) -> Floats | None:
    """Return V at some states less V at the first of them, as if it were not rounded.

    ``values`` are those of all parameters, in the order of the system. The result is NaN where V
    has no value, and None where V is too large to be evaluated so often.
    """
    plain = system.plain
    graph, (factor, node) = plain.graph, plain.V
    if len(t) * len(graph.reached([node])) > MOST_NODES:
        return None
    names = plain.numbers([*plain.q, *plain.parameters, plain.t])
    constants = list(values)
    with mpmath.workdps(DIGITS):
        scale = mpmath.mpf(factor.numerator) / factor.denominator
        levels = []
        for time, place in zip(t.tolist(), q.tolist(), strict=True):
            numbers = map(mpmath.mpf, (*place, *constants, time))
            given = dict(zip(names, numbers, strict=True))
            levels.append(scale * evaluated(graph, [node], given, mpmath.mp)[node])
        return np.array([float(level - levels[0]) for level in levels])
