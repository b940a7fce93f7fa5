"""A bicycle that nobody steers: the benchmark of bicycle dynamics."""

from __future__ import annotations

import math
from typing import Any

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["whipple_bicycle"]

#: Table 1 of the benchmark, in SI units: R, B, H and F are the rear wheel, the rear frame with its
#: rider, the front frame with the handlebar, and the front wheel.
_TABLE = {
    "w": 1.02,
    "c": 0.08,
    "lambda": math.pi / 10,
    "g": 9.81,
    "rR": 0.3,
    "mR": 2.0,
    "IRxx": 0.0603,
    "IRyy": 0.12,
    "xB": 0.3,
    "zB": -0.9,
    "mB": 85.0,
    "IBxx": 9.2,
    "IByy": 11.0,
    "IBzz": 2.8,
    "IBxz": 2.4,
    "xH": 0.9,
    "zH": -0.7,
    "mH": 4.0,
    "IHxx": 0.05892,
    "IHyy": 0.06,
    "IHzz": 0.00708,
    "IHxz": -0.00756,
    "rF": 0.35,
    "mF": 3.0,
    "IFxx": 0.1405,
    "IFyy": 0.28,
}
#: The speed of the ride: without a rider's help it is stable between 4.3 and 6.0 m/s.
_SPEED = 4.6


def whipple_bicycle() -> CatalogueSystem:
    """Two frames and two wheels that roll on a plane: it balances itself in a range of speeds.

    The rear wheel touches the plane at (x, y). Axes are those of the benchmark: x is ahead, y to
    the right and z down; positions are given with y to the left and z up. Of a wheel that rolls
    ahead the angle falls. Multipliers of constraints are forces on the ground.
    """
    x, y, yaw, lean, pitch, steer, rear, front = coordinates("x y yaw lean pitch steer rear front")
    a = {name: sp.Symbol(name, real=True) for name in _TABLE}
    tilt, rR, rF = a["lambda"], a["rR"], a["rF"]
    mR, mB, mH, mF = (a[f"m{part}"] for part in "RBHF")
    sideways, down = sp.Matrix([0, 1, 0]), sp.Matrix([0, 0, 1])
    # points of the upright bicycle, from the rear contact: hubs, masses, the steering axis' end
    hub, wheel = sp.Matrix([0, 0, -rR]), sp.Matrix([a["w"], 0, -rF])
    body, fork = (sp.Matrix([a[f"x{part}"], 0, a[f"z{part}"]]) for part in "BH")
    end, axis = sp.Matrix([a["w"] + a["c"], 0, 0]), sp.Matrix([sp.sin(tilt), 0, sp.cos(tilt)])
    # components of a vector, from each frame to the next: each is turned in that before it
    turned, leant, pitched = sp.rot_axis3(yaw), sp.rot_axis1(lean), sp.rot_axis2(pitch)
    steered = sp.rot_axis2(-tilt) * sp.rot_axis3(steer) * sp.rot_axis2(tilt)
    # each frame's own components of its rate, of speeds of its points, and of the direction down
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
    # the lowest point of the front wheel is where its plane goes down most steeply
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
