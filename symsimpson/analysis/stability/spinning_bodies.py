"""How fast bodies turn whose quaternions are held to length one, and the steps this allows."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache

import sympy as sp

from symsimpson.errors import StabilityWarning
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.program.program import Program
from symsimpson.support.calling import warn

__all__ = ["LARGEST_TURN", "fastest_turn", "warn_of_turning"]

#: A path of a few control points does not resolve a larger turn in a step, in radians.
LARGEST_TURN = 1.5


@lru_cache(maxsize=64)
def _quaternions(system: MechanicalSystem) -> tuple[tuple[int, ...], ...]:
    """Return the places of four coordinates whose squares a constraint adds up to a number."""
    plain, groups = system.plain, []
    place = {x: i for i, x in enumerate(plain.numbers(plain.q))}
    for value in plain.constraints.values():
        symbols = plain.graph.nodes[value[1]].symbols
        if len(symbols) != 4 or not symbols <= place.keys():
            continue  # before SymPy is asked, which takes long for many constraints
        group = sorted(place[x] for x in symbols)
        phi = plain.written(value)
        squares = sum((plain.q[i] ** 2 for i in group), sp.S.Zero)
        scale = sp.diff(phi, plain.q[group[0]], 2) / 2
        if scale.is_number and scale != 0 and sp.expand(phi / scale - squares + 1) == 0:
            groups.append(tuple(group))
    return tuple(groups)


def fastest_turn(system: MechanicalSystem, v: Iterable[float]) -> float:
    """Return the largest angular velocity of bodies turned by unit quaternions, 0 without any.

    It is twice the length of the velocity of the quaternion.
    """
    rates = list(map(float, v))
    speeds = [2 * math.hypot(*(rates[i] for i in group)) for group in _quaternions(system)]
    return max(speeds, default=0.0)


def warn_of_turning(
    program: Program, system: MechanicalSystem, v: Iterable[float], h: float
) -> None:
    """Warn of a step in which a body turns too far."""
    speed = fastest_turn(system, v)
    if speed * abs(h) > LARGEST_TURN:
        warn(
            f"{program.system}, {program.scheme}: a step of h={h:g} turns a body by "
            f"{speed * abs(h):.3g} rad, at {speed:.4g} rad/s; with quaternions a step "
            f"resolves about {LARGEST_TURN} rad.\nTake h below {LARGEST_TURN / speed:.3g}; or use "
            "Euler angles, where the spin of a symmetric body is cyclic and any step resolves it.",
            StabilityWarning,
        )
