"""The PUMA 560, an arm with six joints."""

from __future__ import annotations

import math

from symsimpson.errors import ModelError
from symsimpson.mechanics.arms import Link, arm_energies
from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["puma560"]

RIGHT = math.pi / 2
#: Links in the standard convention of Denavit and Hartenberg, metres, kilograms and radians.
LINKS = (
    Link(alpha=RIGHT, inertia=(0, 0.35, 0), rotor=200e-6 * 62.6111**2),
    Link(
        a=0.4318,
        mass=17.4,
        centre=(-0.3638, 0.006, 0.2275),
        inertia=(0.13, 0.524, 0.539),
        rotor=200e-6 * 107.815**2,
    ),
    Link(
        a=0.0203,
        alpha=-RIGHT,
        d=0.15005,
        mass=4.8,
        centre=(-0.0203, -0.0141, 0.070),
        inertia=(0.066, 0.086, 0.0125),
        rotor=200e-6 * 53.7063**2,
    ),
    Link(
        alpha=RIGHT,
        d=0.4318,
        mass=0.82,
        centre=(0, 0.019, 0),
        inertia=(1.8e-3, 1.3e-3, 1.8e-3),
        rotor=33e-6 * 76.0364**2,
    ),
    Link(alpha=-RIGHT, mass=0.34, inertia=(0.3e-3, 0.4e-3, 0.3e-3), rotor=33e-6 * 71.923**2),
    Link(
        mass=0.09,
        centre=(0, 0, 0.032),
        inertia=(0.15e-3, 0.15e-3, 0.04e-3),
        rotor=33e-6 * 76.686**2,
    ),
)


def puma560(joints: int = 6) -> CatalogueSystem:
    """The first joints of the PUMA 560 with its motors, swinging freely under gravity."""
    if isinstance(joints, bool) or joints not in range(1, 7):
        raise ModelError(f"the PUMA 560 has one to six joints, not {joints!r}.\nUse puma560(6).")
    name = "puma560" if joints == 6 else f"puma560_{joints}"
    q = coordinates(f"q1:{joints + 1}")
    kinetic, potential, positions = arm_energies(name, LINKS[:joints], q)
    return CatalogueSystem(
        name,
        coordinates=q,
        kinetic=kinetic,
        potential=potential,
        positions=positions,
        reference_state={
            "q0": (0.0, 0.8, -1.2, 0.3, 0.5, 0.1)[:joints],
            "v0": (0.5, 0.0, 0.0, 0.0, 0.0, 1.0)[:joints],
        },
        source="P. I. Corke, B. Armstrong-Helouvry, A search for consensus among model parameters "
        "reported for the PUMA 560 robot, Proc. IEEE Int. Conf. Robotics and Automation (1994)",
    )
