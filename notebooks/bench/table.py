"""The table of run times of the README: this package and heyoka, in turns in one process.

The first argument selects rows by a part of their name; without it, all rows are measured.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator

import numpy as np
import throughput

import symsimpson as ss

STAGES = ("gauss8", "gauss12", "gauss16")


def kepler() -> tuple[ss.MechanicalSystem, dict[str, object], float]:
    """Return Kepler's problem with e = 0.9 from the apocentre, for ten orbits."""
    e = 0.9
    state = {"q0": (1 + e, 0.0), "v0": (0.0, math.sqrt((1 - e) / (1 + e)))}
    return ss.systems.kepler_plane(), state, 20 * math.pi


def planets(count: int = 9) -> tuple[ss.MechanicalSystem, dict[str, object], float]:
    """Return a sun and planets in space, for ten turns of the innermost one.

    Each planet has a thousandth of the mass of the sun, and an orbit 35 % larger than the one
    before.
    """
    system = ss.systems.n_body(count + 1)
    masses = dict(zip(system.parameters, [1.0, *[1e-3] * count, 1.0], strict=False))
    masses |= {x: 1.0 for x in system.parameters if x not in masses}
    q, v = np.zeros((2, count + 1, 3))
    for k in range(count):
        radius, angle, tilt = 1.35**k, 2.4 * k, 0.02 * math.sin(k)
        speed = 1 / math.sqrt(radius)
        q[k + 1] = radius * np.array([math.cos(angle), math.sin(angle), 0])
        v[k + 1] = speed * np.array([-math.sin(angle), math.cos(angle), tilt])
    mass = np.array([1.0, *[1e-3] * count])
    q -= mass @ q / mass.sum()
    v -= mass @ v / mass.sum()
    declared = ss.MechanicalSystem(
        "sun_and_planets",
        coordinates=system.coordinates,
        kinetic=system.kinetic,
        potential=system.potential,
        parameters=masses,
    )
    return declared, {"q0": q.ravel(), "v0": v.ravel()}, 20 * math.pi


def rows() -> Iterator[tuple[str, object]]:
    """Yield the name of each row, and a function that measures it."""
    errors = (1e-3, 1e-6, 1e-9)
    pendulum, top = ss.systems.double_pendulum(), ss.systems.lagrange_top()
    schemes = ("simpson", "lobatto6", *STAGES)

    def measure(system, schemes, errors, t_end, state=None):
        given = {"peers": "heyoka", "state": state, "t_end": t_end, "repeats": 10}
        return lambda: ss.work_precision(system, schemes, errors=errors, **given)

    yield "double pendulum, 10 s", measure(pendulum, schemes, errors, 10.0)
    yield "double pendulum, 100 s", measure(pendulum, STAGES, (1e-6, 1e-9, 1e-11), 100.0)
    yield "Lagrange top, 1 s", measure(top, schemes, errors, 1.0)
    system, state, end = kepler()
    retimed = ss.MechanicalSystem.retimed(system, "encounters")
    yield "Kepler, e = 0.9, ten orbits", measure(retimed, ("gauss16", "kahan_li8"), errors, end, state)
    system, state, end = planets()
    yield "sun and nine planets", measure(system, ("gauss16", "kahan_li8"), errors[1:], end, state)
    three = ss.systems.pythagorean().retimed("encounters")
    yield "Pythagorean three bodies", measure(three, ("gauss16",), (1e-5,), 70.0)
    yield "ensembles", lambda: "\n".join(throughput.report())


if __name__ == "__main__":
    wanted = sys.argv[1] if len(sys.argv) > 1 else ""
    for name, job in rows():
        if wanted in name:
            print(f"{name}\n{job()}\n", flush=True)
