"""Models with friction, drives and time from textbooks and other packages' examples.

Each is declared as people would, integrated with gauss12, and held against an explicit Runge-Kutta
method of order eight for Hamilton's equations; its energy less the work done must balance.
"""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.hamilton import truth
from sympy.physics import mechanics as me

import symsimpson as ss

t = ss.time
sin, cos = sp.sin, sp.cos


def damped_pendulum():
    """trep's example: a pendulum with a damper in its joint."""
    (theta,) = ss.coordinates("theta")
    m, l, g, c = sp.symbols("m l g c", positive=True)
    return (
        ss.MechanicalSystem(
            "damped",
            coordinates=(theta,),
            kinetic=m * l**2 * theta.diff() ** 2 / 2,
            potential=-m * g * l * cos(theta),
            parameters={m: 1.0, l: 1.0, g: 9.8, c: 0.1},
            dissipation=c * theta.diff() ** 2 / 2,
        ),
        [2.5],
        [0.0],
        0.02,
    )


def dual_pendulums():
    """trep's dual pendulums: two pendulums whose bobs a linear spring and a damper join."""
    a, b = ss.coordinates("a b")
    m, l, d, g, k, c, x0 = sp.symbols("m l d g k c x0", positive=True)
    first = sp.Matrix([l * sin(a), -l * cos(a)])
    second = sp.Matrix([d + l * sin(b), -l * cos(b)])
    length = sp.sqrt((second - first).dot(second - first))
    kinetic = m * l**2 * (a.diff() ** 2 + b.diff() ** 2) / 2
    return (
        ss.MechanicalSystem(
            "dual_pendulums",
            coordinates=(a, b),
            kinetic=kinetic,
            potential=-m * g * l * (cos(a) + cos(b)) + k * (length - x0) ** 2 / 2,
            parameters={m: 1.0, l: 1.5, d: 1.0, g: 9.8, k: 20.0, c: 1.0, x0: 1.0},
            dissipation=c * length.diff(t) ** 2 / 2,
        ),
        [-0.6, 0.2],
        [0.0, 0.0],
        0.02,
    )


def configuration_spring():
    """trep's ConfigSpring: springs on angles of a chain of links, with a torque at the base."""
    q = ss.coordinates("q:3")
    k, c, g, torque = sp.symbols("k c g torque", positive=True)
    x, y, kinetic, potential, angle = 0, 0, 0, 0, 0
    for x_i in q:
        angle += x_i
        x, y = x + sin(angle), y - cos(angle)
        kinetic += (x.diff(t) ** 2 + y.diff(t) ** 2) / 2
        potential += g * y + k * x_i**2 / 2
    return (
        ss.MechanicalSystem(
            "springs",
            coordinates=q,
            kinetic=kinetic,
            potential=potential,
            parameters={k: 15.0, c: 0.5, g: 9.8, torque: 2.0},
            forces={q[0]: torque * sin(3 * t)},
            dissipation=c * sum(x_i.diff() ** 2 for x_i in q) / 2,
        ),
        [0.5, -0.3, 0.4],
        [0.0, 0.0, 0.0],
        0.01,
    )


def slimplectic_oscillator():
    """slimplectic's damped oscillator."""
    (x,) = ss.coordinates("x")
    m, k, lam = sp.symbols("m k lam", positive=True)
    return (
        ss.MechanicalSystem(
            "slimplectic",
            coordinates=(x,),
            kinetic=m * x.diff() ** 2 / 2,
            potential=k * x**2 / 2,
            parameters={m: 1.0, k: 100.0, lam: 0.1 / 3},
            forces={x: -lam * x.diff()},
        ),
        [1.0],
        [0.0],
        0.05,
    )


def poynting_robertson():
    """slimplectic's dust grain: radiation pressure and Poynting and Robertson's drag."""
    x, y = ss.coordinates("x y")
    beta, light = sp.symbols("beta light", positive=True)
    r2 = x**2 + y**2
    radial = (x * x.diff() + y * y.diff()) / r2
    drag = {q: -beta / (light * r2) * (q.diff() + radial * q) for q in (x, y)}
    return (
        ss.MechanicalSystem(
            "dust",
            coordinates=(x, y),
            kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
            potential=-(1 - beta) / sp.sqrt(r2),
            parameters={beta: 0.1, light: 50.0},
            forces={"radiation": drag},
        ),
        [1.0, 0.0],
        [0.0, 0.9],
        0.05,
    )


def driven_pendulum():
    """heyoka's tutorial on time: a pendulum with damping and a periodic drive."""
    (x,) = ss.coordinates("x")
    return (
        ss.MechanicalSystem(
            "driven",
            coordinates=(x,),
            kinetic=x.diff() ** 2 / 2,
            potential=-cos(x),
            forces={"damping": {x: -x.diff() / 10}, "drive": {x: cos(t)}},
        ),
        [0.0],
        [1.85],
        0.05,
    )


def puma():
    """Three joints of a PUMA 560 with viscous and smoothed Coulomb friction, and torques."""
    arm = ss.systems.puma560(3)
    q = arm.coordinates
    viscous = (1.5e-3, 8.2e-4, 1.4e-3)
    forces = {}
    for k, (x, b) in enumerate(zip(q, viscous, strict=True)):
        coulomb = sp.Rational(2, 5) * sp.tanh(x.diff() / sp.Rational(1, 5))
        forces[x] = -1000 * b * x.diff() - coulomb + 5 * cos((k + 2) * t)
    return (
        ss.MechanicalSystem(
            "puma_with_friction",
            coordinates=q,
            kinetic=arm.kinetic,
            potential=arm.potential,
            parameters=arm.parameters,
            forces=forces,
        ),
        [0.3, -0.4, 0.5],
        [0.1, 0.2, -0.1],
        0.01,
    )


def kapitza():
    system = ss.systems.kapitza()
    return system, [3.0], [0.0], 0.002


def foucault():
    """Foucault's pendulum in the frame of the earth, small swings, with the drag of air."""
    x, y = ss.coordinates("x y")
    W, g, l, c = sp.symbols("W g l c", positive=True)
    vx, vy = x.diff() - W * y, y.diff() + W * x
    speed = sp.sqrt(x.diff() ** 2 + y.diff() ** 2 + sp.Float(1e-6))
    return (
        ss.MechanicalSystem.from_lagrangian(
            "foucault",
            (vx**2 + vy**2) / 2 - g / l * (x**2 + y**2) / 2,
            (x, y),
            {W: 0.05, g: 9.81, l: 67.0, c: 0.02},
            forces={x: -c * speed * x.diff(), y: -c * speed * y.diff()},
        ),
        [2.0, 0.0],
        [0.0, 0.0],
        0.1,
    )


def quarter_car():
    """A wheel and a quarter of a car on springs and a damper, over a road of waves."""
    wheel, body = ss.coordinates("wheel body")
    m, M, k, K, c, a, w = sp.symbols("m M k K c a w", positive=True)
    road = a * sin(w * t)
    return (
        ss.MechanicalSystem(
            "quarter_car",
            coordinates=(wheel, body),
            kinetic=(m * wheel.diff() ** 2 + M * body.diff() ** 2) / 2,
            potential=K * (wheel - road) ** 2 / 2 + k * (body - wheel) ** 2 / 2,
            parameters={m: 40.0, M: 320.0, k: 1.8e4, K: 2.0e5, c: 1.0e3, a: 0.02, w: 12.0},
            dissipation=c * (body.diff() - wheel.diff()) ** 2 / 2,
        ),
        [0.0, 0.0],
        [0.0, 0.1],
        0.005,
    )


def rolling_disc():
    """SymPy's LagrangesMethod with a forcelist: a disc on a slope, pulled and braked."""
    (s,) = ss.coordinates("s")
    m, r, g, slope, c = sp.symbols("m r g slope c", positive=True)
    frame, origin = me.ReferenceFrame("N"), me.Point("O")
    origin.set_vel(frame, 0)
    turned = frame.orientnew("A", "Axis", (s / r, frame.z))
    centre = origin.locatenew("C", s * frame.x)
    centre.set_vel(frame, s.diff() * frame.x)
    inertia = me.inertia(turned, 0, 0, m * r**2 / 2)
    disc = me.RigidBody("disc", centre, turned, m, (inertia, centre))
    pull = -m * g * sin(slope) * frame.x + cos(2 * t) * frame.x
    loads = [(centre, pull), (turned, -c * s.diff() * frame.z)]
    method = me.LagrangesMethod(me.Lagrangian(frame, disc), [s], forcelist=loads, frame=frame)
    return (
        ss.MechanicalSystem.from_lagranges_method(
            "disc", method, {m: 2.0, r: 0.3, g: 9.81, slope: 0.1, c: 0.4}
        ),
        [0.0],
        [1.0],
        0.05,
    )


MODELS = {
    make.__name__: make
    for make in (
        rolling_disc,
        dual_pendulums,
        damped_pendulum,
        configuration_spring,
        slimplectic_oscillator,
        poynting_robertson,
        driven_pendulum,
        puma,
        kapitza,
        foucault,
        quarter_car,
    )
}


@pytest.mark.parametrize("name", sweep(MODELS, 0))
def test_real_model(name):
    system, q, v, h = MODELS[name]()
    run = ss.compile(system, "gauss12").integrate(q, v, h=h, steps=100)
    exact = truth(system, q, run.p[0], 100 * h)
    found = np.concatenate([run.q[-1], run.p[-1]])
    assert np.abs(found - exact).max() < 1e-10 * max(1.0, np.abs(exact).max())
    assert np.abs(run.energy_balance).max() < 1e-9 * run.energy_scale
