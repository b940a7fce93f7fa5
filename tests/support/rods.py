"""A bob on a rod that has weight, in Cartesian coordinates."""

import sympy as sp

import symsimpson as ss

x, y = ss.coordinates("x y")
ROD = ss.MechanicalSystem(
    "rod",
    coordinates=(x, y),
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
    potential=10 * y,
    constraints={"length": (x**2 + y**2 - 1) / 2},
)


def rod_of(unit):
    """A rod as long as a unit, with the gravity that makes it swing as one of a metre."""
    G, r = sp.symbols("G r", positive=True)
    return ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=ROD.kinetic,
        potential=G * y,
        constraints={"rod": x**2 + y**2 - r**2},
        parameters={r: unit, G: 9.81 * unit},
    )
