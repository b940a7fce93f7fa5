"""A bob on a rod that has weight, in Cartesian coordinates."""

import symsimpson as ss

x, y = ss.coordinates("x y")
ROD = ss.MechanicalSystem(
    "rod",
    coordinates=(x, y),
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
    potential=10 * y,
    constraints={"length": (x**2 + y**2 - 1) / 2},
)
