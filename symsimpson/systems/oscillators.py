"""Oscillators with one or a few coordinates, free or driven."""

from __future__ import annotations

import sympy as sp

from symsimpson.declare.coordinates import coordinates, time
from symsimpson.systems.entry import CatalogueSystem


def harmonic_oscillator() -> CatalogueSystem:
    """A mass on a linear spring."""
    (x,) = coordinates("x")
    m, k = sp.symbols("m k", positive=True)
    return CatalogueSystem(
        "harmonic_oscillator",
        coordinates=(x,),
        kinetic=m * x.diff() ** 2 / 2,
        potential=k * x**2 / 2,
        parameters={m: 1.0, k: 1.0},
        positions={"mass": (x,)},
        reference_state={"q0": (1.0,), "v0": (0.0,)},
        source="V. I. Arnold, Mathematical Methods of Classical Mechanics, section 4",
    )


def henon_heiles() -> CatalogueSystem:
    """A star in a cubic potential of a galaxy, whose motion is bounded for energies below 1/6."""
    x, y = coordinates("x y")
    return CatalogueSystem(
        "henon_heiles",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3,
        parameters={},
        positions={"star": (x, y)},
        reference_state={"q0": (0.0, 0.1), "v0": (0.48, 0.0)},
        source="M. Henon, C. Heiles, Astron. J. 69 (1964), 73-79",
    )


def charged_particle() -> CatalogueSystem:
    """A charge in a uniform magnetic field, with the drag of its own radiation."""
    x, y, z = coordinates("x y z")
    m, e, B, k = sp.symbols("m e B k", positive=True)
    return CatalogueSystem(
        "charged_particle",
        coordinates=(x, y, z),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2,
        gyroscopic=e * B * (x * y.diff() - y * x.diff()) / 2,
        potential=sp.S.Zero,
        parameters={m: 1.0, e: 1.0, B: 1.0, k: 0.02},
        # the rate is e^2 B^2 2 e^2/(3 m^3 c^3), from the third derivative of x
        forces={"radiation": {x: -k * m * x.diff(), y: -k * m * y.diff()}},
        positions={"charge": (x, y, z)},
        reference_state={"q0": (0.0, 1.0, 0.0), "v0": (1.0, 0.0, 0.2)},
        source="L. D. Landau and E. M. Lifshitz, The Classical Theory of Fields, sections 21, 75",
    )


def damped_oscillator() -> CatalogueSystem:
    """A mass on a spring, with friction proportional to its velocity."""
    (x,) = coordinates("x")
    m, k, c = sp.symbols("m k c", positive=True)
    return CatalogueSystem(
        "damped_oscillator",
        coordinates=(x,),
        kinetic=m * x.diff() ** 2 / 2,
        potential=k * x**2 / 2,
        parameters={m: 1.0, k: 1.0, c: 0.1},
        dissipation=c * x.diff() ** 2 / 2,
        reference_state={"q0": (1.0,), "v0": (0.0,)},
        source="D. Tsang, C. R. Galley, L. C. Stein, A. Turner, Astrophys. J. Lett. 809 (2015) L9",
    )


def damped_pendulum() -> CatalogueSystem:
    """A pendulum with friction and a periodic torque in its joint."""
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
    """The Duffing oscillator: two potential wells, friction and a periodic force."""
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


def dust_grain() -> CatalogueSystem:
    """A grain of dust around the Sun, whose orbit shrinks by Poynting-Robertson drag."""
    x, y = coordinates("x y")
    mu, beta, light = sp.symbols("mu beta light", positive=True)
    r2 = x**2 + y**2
    along = (x * x.diff() + y * y.diff()) / r2
    drag = {q: -beta * mu / (light * r2) * (q.diff() + along * q) for q in (x, y)}
    return CatalogueSystem(
        "dust_grain",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-(1 - beta) * mu / sp.sqrt(r2),
        parameters={mu: 1.0, beta: 0.05, light: 100.0},
        forces={"radiation": drag},
        positions={"grain": (x, y)},
        reference_state={"q0": (1.0, 0.0), "v0": (0.0, 0.95)},
        source="J. A. Burns, P. L. Lamy, S. Soter, Icarus 40 (1979), 1-48",
    )


def kapitza() -> CatalogueSystem:
    """A pendulum whose pivot moves up and down; it is stable upright if (a w)^2 > 2 g l."""
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
        positions={"pivot": (sp.S.Zero, pivot), "bob": (x, y)},
        reference_state={"q0": (3.0,), "v0": (0.0,)},
        source="L. D. Landau and E. M. Lifshitz, Mechanics, section 30",
    )


def van_der_pol() -> CatalogueSystem:
    """The van der Pol oscillator, whose friction drives small motions and damps large ones."""
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
