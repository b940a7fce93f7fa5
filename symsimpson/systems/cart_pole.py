"""The cart with a pole."""

from __future__ import annotations

from dataclasses import replace

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["cart_pole", "driven_cart_pole"]


def cart_pole() -> CatalogueSystem:
    """A cart free to roll that carries a pendulum, theta = 0 hanging down."""
    x, theta = coordinates("x theta")
    cart, pole, l, g = sp.symbols("m_cart m_pole l g", positive=True)
    coupling = pole * l * x.diff() * theta.diff() * sp.cos(theta)
    return CatalogueSystem(
        "cart_pole",
        coordinates=(x, theta),
        kinetic=(cart + pole) * x.diff() ** 2 / 2 + pole * l**2 * theta.diff() ** 2 / 2 + coupling,
        potential=-pole * g * l * sp.cos(theta),
        parameters={cart: 1.0, pole: 0.3, l: 0.5, g: 9.81},
        positions={"cart": (x, sp.S.Zero), "bob": (x + l * sp.sin(theta), -l * sp.cos(theta))},
        invariants={"p_x": (cart + pole) * x.diff() + pole * l * theta.diff() * sp.cos(theta)},
        reference_state={"q0": (0.0, 2.0), "v0": (0.1, 0.0)},
        source="R. Tedrake, Underactuated Robotics, chapter 3",
    )


def driven_cart_pole() -> CatalogueSystem:
    """The cart with a pole, a motor of force u at its wheels and friction in wheels and joint."""
    free = cart_pole()
    x, theta = free.coordinates
    u = sp.Symbol("u", real=True)
    c, b = sp.symbols("c b", positive=True)
    return replace(
        free,
        name="driven_cart_pole",
        parameters={**free.parameters, c: 0.1, b: 0.01},
        forces={"motor": {x: u}},
        dissipation=c * x.diff() ** 2 / 2 + b * theta.diff() ** 2 / 2,
        inputs=(u,),
        invariants=None,
        reference_state={"q0": (0.0, 0.1), "v0": (0.0, 0.0)},
    )
