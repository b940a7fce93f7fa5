"""A ball that falls on a floor, and what moves freely in a plane: systems of events that act."""

import numpy as np
import sympy as sp

import symsimpson as ss

(z,) = ss.coordinates("z")
x, y = ss.coordinates("x y")
g, k = sp.symbols("g k", positive=True)
BALL = ss.MechanicalSystem(
    "ball", coordinates=(z,), kinetic=z.diff() ** 2 / 2, potential=g * z, parameters={g: 9.81}
)
PLANE = ss.MechanicalSystem(
    "plane",
    coordinates=(x, y),
    kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
    potential=0 * x,
    parameters={k: 0.5},
)
#: How long the ball falls from a height of one.
FALL = np.sqrt(2 / 9.81)


def floor(restitution=0.8, **more):
    return ss.Event(z, name="floor", action=ss.Impact(restitution), **more)


def drop(*events, h=0.01, t_end=2.0, **more):
    return ss.compile(BALL).integrate([1.0], v0=[0.0], h=h, t_end=t_end, events=events, **more)
