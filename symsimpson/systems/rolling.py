"""Bodies that roll or glide on blades: systems with velocity constraints."""

from __future__ import annotations

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["ball_on_turntable", "chaplygin_sleigh", "rolling_disc", "snakeboard"]


def chaplygin_sleigh() -> CatalogueSystem:
    """A body on ice with a blade, which is at (x, y); its centre of mass is a ahead of it."""
    x, y, th = coordinates("x y th")
    m, J, a = sp.symbols("m J a", positive=True)
    ahead = sp.Matrix([sp.cos(th), sp.sin(th)])
    aside = sp.Matrix([-sp.sin(th), sp.cos(th)])
    speed = sp.Matrix([x.diff(), y.diff()])
    centre = speed + a * th.diff() * aside
    return CatalogueSystem(
        "chaplygin_sleigh",
        coordinates=(x, y, th),
        kinetic=m * (centre.T * centre)[0] / 2 + J * th.diff() ** 2 / 2,
        potential=sp.S.Zero,
        velocity_constraints={"blade": (aside.T * speed)[0]},
        parameters={m: 1.0, J: 0.5, a: 0.2},
        positions={"blade": (x, y), "centre": (x + a * ahead[0], y + a * ahead[1])},
        reference_state={"q0": (0.0, 0.0, 0.0), "v0": (1.0, 0.0, 1.2)},
        source="S. A. Chaplygin, 1911; A. M. Bloch, Nonholonomic Mechanics and Control, 1.7",
    )


def rolling_disc() -> CatalogueSystem:
    """A thin disc that rolls on a plane and leans; it touches the plane at (x, y)."""
    x, y, yaw, lean, roll = coordinates("x y yaw lean roll")
    m, R, g, k = sp.symbols("m R g k", positive=True)
    heading = sp.Matrix([sp.cos(yaw), sp.sin(yaw), 0])
    side = sp.Matrix([-sp.sin(yaw), sp.cos(yaw), 0])
    up = sp.Matrix([0, 0, 1])
    centre = sp.Matrix([x, y, 0]) + R * (sp.cos(lean) * up - sp.sin(lean) * side)
    speed = centre.diff(sp.Symbol("t"))
    turning = (roll.diff() + yaw.diff() * sp.sin(lean)) ** 2
    leaning = lean.diff() ** 2 + (yaw.diff() * sp.cos(lean)) ** 2
    return CatalogueSystem(
        "rolling_disc",
        coordinates=(x, y, yaw, lean, roll),
        kinetic=m * (speed.T * speed)[0] / 2 + k * m * R**2 * (turning + leaning / 2),
        potential=m * g * R * sp.cos(lean),
        velocity_constraints={
            "rolls_x": x.diff() - R * heading[0] * roll.diff(),
            "rolls_y": y.diff() - R * heading[1] * roll.diff(),
        },
        parameters={m: 1.2, R: 0.5, g: 9.81, k: 0.25},
        positions={"contact": (x, y, 0), "centre": tuple(centre)},
        reference_state={
            "q0": (0.0, 0.0, 0.3, 0.25, 0.0),
            "v0": (3.0 * 0.955336489125606, 3.0 * 0.295520206661340, 0.6, -0.35, 6.0),
        },
        source="E. J. Routh, Dynamics of a System of Rigid Bodies II, 1905; k is 1/4 if it is full",
    )


def snakeboard() -> CatalogueSystem:
    """A board on two steered pairs of wheels, moved by a rotor and by its steering alone."""
    x, y, th, rotor, steer = coordinates("x y th rotor steer")
    m, l, J, Jr, Jw = sp.symbols("m l J Jr Jw", positive=True)
    t = sp.Symbol("t")
    turn = J * th.diff() ** 2 / 2 + Jr * (rotor.diff() + th.diff()) ** 2 / 2
    wheels = {
        name: -sp.sin(th + sign * steer) * x.diff()
        + sp.cos(th + sign * steer) * y.diff()
        + sign * l * sp.cos(steer) * th.diff()
        for name, sign in (("front", 1), ("back", -1))
    }
    along = l * sp.Matrix([sp.cos(th), sp.sin(th)])
    return CatalogueSystem(
        "snakeboard",
        coordinates=(x, y, th, rotor, steer),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2 + turn + Jw * steer.diff() ** 2,
        potential=sp.S.Zero,
        forces={
            rotor: sp.Rational(7, 10) * sp.sin(3 * t),
            steer: sp.Rational(3, 10) * sp.cos(2 * t) - steer,
        },
        velocity_constraints=wheels,
        parameters={m: 6.0, l: 0.5, J: 0.5, Jr: 1.0, Jw: 0.11},
        positions={
            "front": (x + along[0], y + along[1]),
            "back": (x - along[0], y - along[1]),
            "board": [(x + along[0], y + along[1]), (x - along[0], y - along[1])],
        },
        reference_state={"q0": (0.0, 0.0, 0.0, 0.0, 0.4), "v0": (0.0, 0.0, 0.0, 0.0, 0.0)},
        source="J. P. Ostrowski, A. Lewis, R. Murray, J. Burdick, Nonholonomic mechanics and "
        "locomotion: the snakeboard example, 1994",
    )


def ball_on_turntable() -> CatalogueSystem:
    """A ball that rolls on a turning table: its centre goes round on a circle."""
    x, y, *q = coordinates("x y q0 q1 q2 q3")
    m, R, k = sp.symbols("m R k", positive=True)
    rate = sp.Symbol("Omega", real=True)
    a, b, c, d = q
    da, db, dc, dd = (component.diff() for component in q)
    # the turning rate in space, 2 q' q^-1 of a unit quaternion
    w_x = 2 * (-da * b + db * a - dc * d + dd * c)
    w_y = 2 * (-da * c + db * d + dc * a - dd * b)
    square = sp.Add(*(component**2 for component in q))
    spin = 4 * square * sp.Add(*(component.diff() ** 2 for component in q))
    return CatalogueSystem(
        "ball_on_turntable",
        coordinates=(x, y, *q),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2 + k * m * R**2 * spin / 2,
        potential=sp.S.Zero,
        constraints={"norm": (square - 1) / 2},
        velocity_constraints={
            "rolls_x": x.diff() - R * w_y + rate * y,
            "rolls_y": y.diff() + R * w_x - rate * x,
        },
        parameters={m: 1.0, R: 0.4, rate: 1.1, k: 0.4},
        positions={"centre": (x, y, R)},
        reference_state={
            "q0": (0.6, -0.2, 0.6, 0.0, 0.8, 0.0),
            "v0": (0.62, 0.244, -0.4, 0.2, 0.3, 0.5),
        },
        source="J. Neimark, N. Fufaev, Dynamics of Nonholonomic Systems, 1972; k is 2/5 of a full "
        "ball, whose centre circles at k/(1 + k) of the table's rate",
    )
