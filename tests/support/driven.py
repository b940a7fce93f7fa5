"""Systems with forces, friction and time on which orders are measured: (system, q, v, end)."""

import sympy as sp

import symsimpson as ss

t = ss.time
a, c, g, k, w = sp.symbols("a c g k w", positive=True)


def double_pendulum():
    """Friction in the joints, not linear, a follower force and a drive."""
    q1, q2 = ss.coordinates("q1 q2")
    u1, u2 = q1.diff(), q2.diff()
    kinetic = 1.1 * u1**2 / 16 + 0.054 * u2**2 + 0.09 * u1 * u2 * sp.cos(q1 - q2)
    potential = -g * (0.55 * sp.cos(q1) + 0.36 * sp.cos(q2))
    drive = {q1: a * sp.cos(w * t) * sp.cos(q1) - k * u1**3, q2: k * sp.sin(q1 - q2) * u1}
    return (
        ss.MechanicalSystem(
            "forced_double_pendulum",
            coordinates=(q1, q2),
            kinetic=kinetic,
            potential=potential,
            parameters={g: 9.81, c: 0.03, k: 0.01, a: 0.4, w: 5.0},
            forces={"drive": drive},
            dissipation=c * (u1**2 + (u1 - u2) ** 2) / 2,
        ),
        [0.8, 1.0],
        [0.1, -0.2],
        1.0,
    )


def van_der_pol():
    (x,) = ss.coordinates("x")
    force = {x: k * (1 - x**2) * x.diff() + a * sp.cos(w * t)}
    return (
        ss.MechanicalSystem(
            "driven_van_der_pol",
            coordinates=(x,),
            kinetic=x.diff() ** 2 / 2,
            potential=x**2 / 2,
            parameters={k: 1.5, a: 0.5, w: 2.0},
            forces=force,
        ),
        [1.0],
        [0.5],
        2.0,
    )


def growing_mass():
    (x,) = ss.coordinates("x")
    return (
        ss.MechanicalSystem(
            "growing_mass",
            coordinates=(x,),
            kinetic=(1 + sp.sin(w * t) / 3) * x.diff() ** 2 / 2,
            potential=-g * sp.cos(x),
            parameters={g: 9.81, w: 3.0},
        ),
        [0.7],
        [0.2],
        2.0,
    )


def kepler_with_drag():
    x, y = ss.coordinates("x y")
    speed = sp.sqrt(x.diff() ** 2 + y.diff() ** 2)
    swirl = w / (x**2 + y**2)
    drag = {x: -c * speed * x.diff() - swirl * y, y: -c * speed * y.diff() + swirl * x}
    return (
        ss.MechanicalSystem(
            "kepler_with_drag",
            coordinates=(x, y),
            kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
            potential=-1 / sp.sqrt(x**2 + y**2),
            parameters={c: 0.05, w: 0.02},
            forces={"drag": drag},
        ),
        [1.0, 0.0],
        [0.0, 1.1],
        3.0,
    )


PROBLEMS = {
    make.__name__: make for make in (double_pendulum, van_der_pol, growing_mass, kepler_with_drag)
}
