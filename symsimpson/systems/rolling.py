"""Rolling bodies and blades: systems with velocity constraints."""

from __future__ import annotations

from typing import Any

import sympy as sp

from symsimpson.declare.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem, read_numbers


def chaplygin_sleigh() -> CatalogueSystem:
    """A body on ice with a blade at (x, y), and its centre of mass at the distance a ahead."""
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
    """A thin disc that rolls and leans on a plane, with its contact point at (x, y)."""
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
    """A board on two steered pairs of wheels, which moves by a rotor and by steering only."""
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
    """A ball that rolls on a turntable, on which its centre moves along a circle."""
    x, y, *q = coordinates("x y q0 q1 q2 q3")
    m, R, k = sp.symbols("m R k", positive=True)
    rate = sp.Symbol("Omega", real=True)
    a, b, c, d = q
    da, db, dc, dd = (component.diff() for component in q)
    # the angular velocity in space, 2 q' q^-1 of a unit quaternion
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


#: Table 1 of the benchmark, in SI units: R, B, H and F are the rear wheel, the rear frame with its
#: rider, the front frame with the handlebar, and the front wheel.
_TABLE = read_numbers("""
    w 1.02  c 0.08  lambda 0.3141592653589793  g 9.81
    rR 0.3  mR 2.0  IRxx 0.0603  IRyy 0.12
    xB 0.3  zB -0.9  mB 85.0  IBxx 9.2  IByy 11.0  IBzz 2.8  IBxz 2.4
    xH 0.9  zH -0.7  mH 4.0  IHxx 0.05892  IHyy 0.06  IHzz 0.00708  IHxz -0.00756
    rF 0.35  mF 3.0  IFxx 0.1405  IFyy 0.28
    """)
#: The speed in m/s. The bicycle is stable without control between 4.3 and 6.0 m/s.
_SPEED = 4.6


def whipple_bicycle() -> CatalogueSystem:
    """A bicycle of two frames and two rolling wheels, which is stable in a range of speeds.

    The rear wheel touches the plane at (x, y). The axes are as in the benchmark: x forward, y to
    the right, z down. Positions to draw have y to the left and z up. The angle of a wheel that
    rolls forward decreases. Multipliers of constraints are forces on the ground.
    """
    x, y, yaw, lean, pitch, steer, rear, front = coordinates("x y yaw lean pitch steer rear front")
    a = {name: sp.Symbol(name, real=True) for name in _TABLE}
    tilt, rR, rF = a["lambda"], a["rR"], a["rF"]
    mR, mB, mH, mF = (a[f"m{part}"] for part in "RBHF")
    sideways, down = sp.Matrix([0, 1, 0]), sp.Matrix([0, 0, 1])
    # points of the upright bicycle relative to the rear contact: hubs, masses, steering axis
    hub, wheel = sp.Matrix([0, 0, -rR]), sp.Matrix([a["w"], 0, -rF])
    body, fork = (sp.Matrix([a[f"x{part}"], 0, a[f"z{part}"]]) for part in "BH")
    end, axis = sp.Matrix([a["w"] + a["c"], 0, 0]), sp.Matrix([sp.sin(tilt), 0, sp.cos(tilt)])
    # each matrix converts components of a vector from one frame to the next
    turned, leant, pitched = sp.rot_axis3(yaw), sp.rot_axis1(lean), sp.rot_axis2(pitch)
    steered = sp.rot_axis2(-tilt) * sp.rot_axis3(steer) * sp.rot_axis2(tilt)
    # rates, speeds of points and the direction down, with components in each frame
    contact = turned * sp.Matrix([x.diff(), y.diff(), 0])
    rate = leant * (yaw.diff() * down) + sp.Matrix([lean.diff(), 0, 0])
    rate_R = rate + (pitch.diff() + rear.diff()) * sideways
    speed_R = leant * contact + rate.cross(hub)
    rate_B = pitched * rate + pitch.diff() * sideways
    speed_B = pitched * speed_R + rate_B.cross(body - hub)
    rate_H = steered * rate_B + steer.diff() * axis
    speed_end = steered * (pitched * speed_R + rate_B.cross(end - hub))
    speed_H = speed_end + rate_H.cross(fork - end)
    rate_F = rate_H + front.diff() * sideways
    speed_F = speed_end + rate_H.cross(wheel - end)
    down_B = pitched * leant * down
    down_H = steered * down_B
    depth_R = -rR * sp.cos(lean)
    depth_end = depth_R + down_B.dot(end - hub)
    depth_F = depth_end + down_H.dot(wheel - end)
    # the lowest point of the front wheel, in the direction of steepest descent of its plane
    slope = sp.sqrt(down_H[0] ** 2 + down_H[2] ** 2)
    ahead = sideways.cross(down_H) / slope
    slip = speed_F + rF * rate_F.cross(ahead.cross(sideways))

    def energy(m: Any, part: str, speed: sp.Matrix, rate: sp.Matrix) -> sp.Expr:
        xx, yy = a[f"I{part}xx"], a[f"I{part}yy"]
        zz, xz = a.get(f"I{part}zz", xx), a.get(f"I{part}xz", 0)
        inertia = sp.Matrix([[xx, 0, xz], [0, yy, 0], [xz, 0, zz]])
        return (m * speed.dot(speed) + rate.dot(inertia * rate)) / 2

    def seen(point: sp.Matrix) -> tuple[Any, ...]:
        place = sp.Matrix([x, y, 0]) + turned.T * leant.T * (hub + pitched.T * (point - hub))
        return (place[0], -place[1], -place[2])

    places = {"rear hub": seen(hub), "rider": seen(body)}
    places["handlebar"] = seen(end + steered.T * (fork - end))
    places["front hub"] = seen(end + steered.T * (wheel - end))
    return CatalogueSystem(
        "whipple_bicycle",
        coordinates=(x, y, yaw, lean, pitch, steer, rear, front),
        kinetic=energy(mR, "R", speed_R, rate_R)
        + energy(mB, "B", speed_B, rate_B)
        + energy(mH, "H", speed_H, rate_H)
        + energy(mF, "F", speed_F, rate_F),
        potential=-a["g"]
        * (
            mR * depth_R
            + mB * (depth_R + down_B.dot(body - hub))
            + mH * (depth_end + down_H.dot(fork - end))
            + mF * depth_F
        ),
        constraints={"front_contact": depth_F + rF * slope},
        velocity_constraints={
            "rear_rolls": contact[0] + rR * (pitch.diff() + rear.diff()),
            "rear_side": contact[1],
            "front_rolls": slip.dot(ahead),
            "front_side": slip.dot(down_H.cross(ahead)),
        },
        parameters={a[name]: value for name, value in _TABLE.items()},
        positions={**places, "frame": list(places.values())},
        reference_state={
            "q0": (0.0,) * 8,
            "v0": (_SPEED, 0.0, 0.0, 0.5, 0.0, 0.0, -_SPEED / 0.3, -_SPEED / 0.35),
        },
        source="J. P. Meijaard, J. M. Papadopoulos, A. Ruina, A. L. Schwab, Proc. R. Soc. A 463 "
        "(2007) 1955; upright, at a speed at which it is stable, and about to lean",
    )
