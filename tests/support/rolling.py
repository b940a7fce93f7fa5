"""Systems with velocity constraints that have all that such a system can have."""

import numpy as np
import sympy as sp

import symsimpson as ss


def carried_by_time():
    """Two rows, of which one moves with the time and with positions; M(q), gyroscopic, forced."""
    x, y, z, w = q = ss.coordinates("x y z w")
    a, b = sp.symbols("a b", positive=True)
    t = ss.time
    kinetic = (1 + a * x**2) * x.diff() ** 2 / 2 + (2 + sp.sin(z)) * y.diff() ** 2 / 2
    kinetic += z.diff() ** 2 / 2 + w.diff() ** 2 + x.diff() * z.diff() / 8
    return ss.MechanicalSystem.from_lagrangian(
        "carried",
        kinetic - x**2 - sp.cos(y) - z**2 / 2 - w**2 / 3 + x * y.diff() / 3,
        q,
        {a: 0.3, b: 0.2},
        velocity_constraints={
            "belt": -sp.sin(y) * x.diff() + z.diff() + x * w.diff() / 3 - b * sp.cos(2 * t) - y / 7,
            "wheel": sp.cos(w + t / 3) * y.diff() + z * z.diff() / 2 - (1 + b * x**2) * w.diff(),
        },
        forces={x: -x.diff() / 5, z: sp.sin(3 * t) / 10},
    )


def moved_by_time(rolling=False):
    """Constraints of positions that move, one with a parameter; perhaps a wheel that moves, too."""
    x, y, z, w = q = ss.coordinates("x y z w")
    a, b = sp.symbols("a b", positive=True)
    t = ss.time
    kinetic = (1 + a * x**2) * x.diff() ** 2 / 2 + (2 + sp.sin(z)) * y.diff() ** 2 / 2
    kinetic += z.diff() ** 2 / 2 + w.diff() ** 2 + x.diff() * z.diff() / 8
    wheel = sp.cos(w + t / 3) * y.diff() + z * z.diff() / 2 - (1 + b * x**2) * w.diff() - t * x / 5
    return ss.MechanicalSystem.from_lagrangian(
        "moved",
        kinetic - x**2 - sp.cos(y) - z**2 / 2 - w**2 / 3 + x * y.diff() / 3,
        q,
        {a: 0.3, b: 0.2},
        constraints={"rod": (x - b * sp.sin(2 * t)) ** 2 + y**2 - (1 + t / 9) ** 2 + x * z * t / 7},
        velocity_constraints={"wheel": wheel} if rolling else {},
        forces={x: -x.diff() / 5, z: sp.sin(3 * t) / 10},
    )


def allowed_state(system):
    q0 = 0.3 + 0.2 * np.arange(system.n)
    q0, v0 = system.consistent(q0, np.full(system.n, 0.4))
    return {"q0": q0, "v0": v0}
