"""Retimed systems with E0 as a coordinate, of which the time is the momentum.

Derivatives of retimed runs are taken of these: their steps are the same, and the time is a state as
any other (Marsden and West 2001, section 1.2.3, of discrete time that is a coordinate).
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.mechanics.retimed import RetimedSystem, energy, first_rate
from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["E_BY", "MOMENTUM_BY", "RATE_BY", "extended"]

#: What names of the derivatives of E0, of the rate and of p at given velocities begin with.
E_BY, RATE_BY, MOMENTUM_BY = "E by ", "rate by ", "p by "
#: So heavy is E0 that it does not move, by less than any rounding.
HEAVY = sp.Integer(2) ** 200


def extended(
    system: RetimedSystem, varied: Sequence[sp.Symbol]
) -> tuple[MechanicalSystem, tuple[str, ...]]:
    """Return a retimed system with E0 as its last coordinate, and what to differentiate it by.

    L = T/g - g (V - e) + M e'^2/2 with so large an M that e stays what it is; then p_e' = g, and
    each scheme of the family adds up the time as the retimed system does. Its invariants are the
    derivatives of H and of the rate, and of p at given velocities, by what may change at the start.
    """
    original, parameters = system.original, dict(system.parameters)
    (e,) = coordinates("E0_of_run")
    pace = system.rate / first_rate
    in_rate = system.rate.has(energy)
    parameters = {a: value for a, value in parameters.items() if a != energy or in_rate}
    in_tau = {q.diff(): q.diff() / pace for q in original.coordinates}
    L, watched = original.lagrangian, {}
    for i, q in enumerate(original.coordinates):
        watched[f"{E_BY}q{i}"] = -L.diff(q)
        watched[f"{E_BY}p{i}"] = q.diff()
        watched[f"{RATE_BY}q{i}"] = system.rate.diff(q)
    for j, a in enumerate(varied):
        watched[f"{E_BY}a{j}"] = -L.diff(a)
        watched[f"{RATE_BY}a{j}"] = system.rate.diff(a)
        for i, q in enumerate(original.coordinates):
            watched[f"{MOMENTUM_BY}{i} a{j}"] = L.diff(q.diff()).diff(a)
    watched[f"{RATE_BY}E"] = system.rate.diff(energy)
    watched["rate"] = system.rate
    augmented = MechanicalSystem(
        f"{original.name[:50]}_extended",
        coordinates=(*original.coordinates, e),
        kinetic=original.kinetic / pace + HEAVY * e.diff() ** 2 / 2,
        potential=pace * (original.potential - e),
        gyroscopic=original.gyroscopic,
        parameters=parameters,
        invariants={name: sp.sympify(x).xreplace(in_tau) for name, x in watched.items()},
    )
    more = (energy, first_rate) if in_rate else (first_rate,)
    return augmented, tuple(map(str, (*varied, *more)))
