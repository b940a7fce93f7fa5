"""Oscillators that lose energy, and are driven."""

from __future__ import annotations

import sympy as sp

from symsimpson.mechanics.coordinates import coordinates, time
from symsimpson.systems.entry import CatalogueSystem

__all__ = ["damped_pendulum", "duffing", "kapitza", "van_der_pol"]


def damped_pendulum() -> CatalogueSystem:
    """A pendulum with friction in its joint, and a torque there that swings."""
    (theta,) = coordinates("theta")
    m, l, g, c, a, w = sp.symbols("m l g c a w", positive=True)
    return CatalogueSystem(
        "damped_pendulum",
        coordinates=(theta,),
        kinetic=m * l**2 * theta.diff() ** 2 / 2,
        potential=-m * g * l * sp.cos(theta),
        parameters={m: 1.0, l: 1.0, g: 1.0, c: 0.5, a: 1.15, w: 2 / 3},
        forces={"motor": {theta: a * sp.cos(w * time)}},
        dissipation=c * theta.diff() ** 2 / 2,
        positions={"bob": (l * sp.sin(theta), -l * sp.cos(theta))},
        reference_state={"q0": (0.2,), "v0": (0.0,)},
        source="G. L. Baker and J. P. Gollub, Chaotic Dynamics, section 3.1",
    )


def duffing() -> CatalogueSystem:
    """Duffing's oscillator between two wells, with friction and a drive."""
    (x,) = coordinates("x")
    alpha, beta, delta, gamma, w = sp.symbols("alpha beta delta gamma w", positive=True)
    return CatalogueSystem(
        "duffing",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=beta * x**4 / 4 - alpha * x**2 / 2,
        parameters={alpha: 1.0, beta: 1.0, delta: 0.3, gamma: 0.5, w: 1.2},
        forces={"drive": {x: gamma * sp.cos(w * time)}},
        dissipation=delta * x.diff() ** 2 / 2,
        reference_state={"q0": (1.0,), "v0": (0.0,)},
        source="J. Guckenheimer and P. Holmes, Nonlinear Oscillations, section 2.2",
    )


def kapitza() -> CatalogueSystem:
    """A pendulum whose pivot shakes up and down: it stands if (a w)^2 > 2 g l."""
    (theta,) = coordinates("theta")
    m, l, g, a, w = sp.symbols("m l g a w", positive=True)
    pivot = a * sp.cos(w * time)
    x, y = l * sp.sin(theta), pivot - l * sp.cos(theta)
    return CatalogueSystem(
        "kapitza",
        coordinates=(theta,),
        kinetic=m * (x.diff(time) ** 2 + y.diff(time) ** 2) / 2,
        potential=m * g * y,
        parameters={m: 1.0, l: 1.0, g: 9.81, a: 0.1, w: 80.0},
        reference_state={"q0": (3.0,), "v0": (0.0,)},
        source="L. D. Landau and E. M. Lifshitz, Mechanics, section 30",
    )


def van_der_pol() -> CatalogueSystem:
    """Van der Pol's oscillator: friction that drives small motions and damps large ones."""
    (x,) = coordinates("x")
    mu = sp.Symbol("mu", positive=True)
    return CatalogueSystem(
        "van_der_pol",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=x**2 / 2,
        parameters={mu: 1.5},
        forces={"valve": {x: mu * (1 - x**2) * x.diff()}},
        reference_state={"q0": (2.0,), "v0": (0.0,)},
        source="B. van der Pol, Philosophical Magazine 2 (1926), 978-992",
    )
