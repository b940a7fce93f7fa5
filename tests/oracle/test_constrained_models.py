"""Models with constraints that others have posed, against reductions and a solver for index one."""

import numpy as np
import pytest
import sympy as sp
from support.index_one import motion
from sympy.physics import mechanics as me

import symsimpson as ss

g = 9.81


def apart(system, q0, v0, h, steps, scheme="gauss8"):
    """How far a run is from the index-1 equations at its end, and the run."""
    run = ss.compile(system, scheme).integrate(q0, v0, h=h, steps=steps)
    exact = motion(system, run.q[0], run.v[0], [run.t[-1]])[0]
    return np.abs(np.concatenate([run.q[-1], run.v[-1]]) - exact).max(), run


@pytest.mark.slow
def test_the_pendulum_of_sympy_in_x_and_y():
    """L with a multiplier, as its documentation poses it, against the angle."""
    x, y = me.dynamicsymbols("x y")
    m, l = sp.symbols("m l", positive=True)
    N = me.ReferenceFrame("N")
    O = me.Point("O")
    O.set_vel(N, 0)
    bob = O.locatenew("P", x * N.x + y * N.y)
    bob.set_vel(N, x.diff() * N.x + y.diff() * N.y)
    particle = me.Particle("bob", bob, m)
    particle.potential_energy = m * g * y
    method = me.LagrangesMethod(
        me.Lagrangian(N, particle), [x, y], hol_coneqs=[x**2 + y**2 - l**2], frame=N
    )
    method.form_lagranges_equations()
    system = ss.MechanicalSystem.from_lagranges_method(
        "sympy_pendulum", method, parameters={m: 1.0, l: 1.0}
    )
    run = ss.compile(system, "gauss8").integrate([0.6, -0.8], [0.0, 0.0], h=0.01, steps=100)
    theta = ss.coordinates("theta")[0]
    angle = ss.MechanicalSystem(
        "angle", coordinates=(theta,), kinetic=theta.diff() ** 2 / 2, potential=-g * sp.cos(theta)
    )
    exact = ss.compile(angle, "gauss8").integrate([np.arcsin(0.6)], [0.0], h=0.01, steps=100)
    assert np.abs(run.q[:, 0] - np.sin(exact.q[:, 0])).max() < 1e-12
    # what the rod bears, and what SymPy's own equations say of its multiplier
    tension = g * np.cos(exact.q[:, 0]) + exact.v[:, 0] ** 2
    assert np.abs(2 * run.multipliers[:, 0] - tension).max() < 1e-10


def scissor_lift(levels, start):
    """A scissor lift of trep's examples: angles of joints, and the slider."""
    m, I, L = 1.0, 1.0, 5.0
    left, right = ss.coordinates(f"left1:{levels + 1}"), ss.coordinates(f"right1:{levels + 1}")
    (slider,) = ss.coordinates("slider")
    ends = [(sp.S.Zero, sp.S.Zero, sp.S.Zero), (slider, sp.S.Zero, sp.S.Zero)]  # x, z, angle
    kinetic, potential, constraints = slider.diff() ** 2 / 2, sp.S.Zero, {}
    t = ss.time
    for level in range(levels):
        middles, tips = [], []
        for (x, z, turned), joint in zip(ends, (left[level], right[level]), strict=True):
            angle = turned + joint
            middle = (x + L / 2 * sp.cos(angle), z + L / 2 * sp.sin(angle))
            kinetic += m * sum(c.diff(t) ** 2 for c in middle) / 2 + I * angle.diff(t) ** 2 / 2
            potential += m * g * middle[1]
            middles.append(middle)
            tips.append((x + L * sp.cos(angle), z + L * sp.sin(angle), angle))
        constraints[f"x{level + 1}"] = middles[0][0] - middles[1][0]
        constraints[f"z{level + 1}"] = middles[0][1] - middles[1][1]
        ends = tips[::-1]
    system = ss.MechanicalSystem(
        f"scissor_lift_{levels}",
        coordinates=(*left, *right, slider),
        kinetic=kinetic,
        potential=potential,
        constraints=constraints,
    )
    turns = [start, *[np.pi - 2 * start] * (levels - 1)]
    others = [np.pi - start, *[-np.pi + 2 * start] * (levels - 1)]
    # a tip's frame becomes the base of the other side, one level up
    for level in range(1, levels):
        turns[level], others[level] = (2 * start - np.pi, np.pi - 2 * start)
    return system, np.array([*turns, *others, L * np.cos(start)])


def lifted(levels):
    """The same lift in one angle."""
    (a,) = ss.coordinates("a")
    m, I, L, t = 1.0, 1.0, 5.0, ss.time
    kinetic, potential = (L * sp.cos(a)).diff(t) ** 2 / 2, sp.S.Zero
    for level in range(levels):
        x, z = L / 2 * sp.cos(a), L * sp.sin(a) * (level + sp.Rational(1, 2))
        kinetic += m * (x.diff(t) ** 2 + z.diff(t) ** 2) + I * a.diff(t) ** 2
        potential += 2 * m * g * z
    return ss.MechanicalSystem("lift", coordinates=(a,), kinetic=kinetic, potential=potential)


@pytest.mark.slow
@pytest.mark.parametrize("levels", [2, 5])
def test_the_scissor_lift_of_trep(levels):
    start = 0.3 * np.pi
    system, q0 = scissor_lift(levels, start)
    assert system.degrees_of_freedom == 1
    q0, v0 = system.consistent(q0, 0 * q0)
    run = ss.compile(system, "gauss8").integrate(q0, v0, h=0.005, steps=100)
    exact = ss.compile(lifted(levels), "gauss8").integrate([start], [0.0], h=0.005, steps=100)
    assert np.abs(run["slider"] - 5.0 * np.cos(exact.q[:, 0])).max() < 1e-8
    assert np.abs(run.energy - run.energy[0]).max() < 1e-8 * np.abs(run.energy[0])


@pytest.mark.slow
def test_the_closed_chain_of_trep():
    """Nakamura and Yamane's planar device: seven angles, two loops; friction left out."""
    angles = J, H, K, M, A, C, E = ss.coordinates("J H K M A C E")

    def arm(base, *parts):
        """Return what gives points on an open chain of (length, angle), in the plane y, z."""
        y, z, turned, frames = sp.sympify(base), sp.S.Zero, sp.S.Zero, []
        for length, joint in parts:
            turned += joint
            frames.append((y, z, turned))
            y, z = y + length * sp.sin(turned), z - length * sp.cos(turned)
        return lambda k, along: sp.Matrix(
            [
                frames[k][0] + along * sp.sin(frames[k][2]),
                frames[k][1] - along * sp.cos(frames[k][2]),
            ]
        )

    middle = arm(0, (1, J), (2, H))
    right = arm(sp.Rational(3, 2), (2, K), (1, M))
    left = arm(-sp.Rational(3, 2), (2, A), (0.75, C), (1, E))
    masses = [
        middle(0, 0.5),
        middle(1, 1),
        right(0, 1),
        right(1, 0.5),
        left(0, 1),
        left(1, 0.375),
        left(2, 0.5),
    ]
    speeds = [x.diff(ss.time) for x in masses]
    loops = [*(right(1, 1) - middle(1, 2)), *(middle(1, 1) - left(2, 1))]
    system = ss.MechanicalSystem(
        "closed_chain",
        coordinates=angles,
        kinetic=sum((v.T * v)[0] for v in speeds) / 2,
        potential=9.8 * sum(x[1] for x in masses),
        constraints=loops,
    )
    near = [-0.523599, 1.21009, 0.523599, -1.34537, -0.523599, 1.5385, 1.22497]
    q0, v0 = system.consistent(near, np.zeros(7))
    error, run = apart(system, q0, v0, 0.005, 100)
    assert error < 1e-8
    assert np.ptp(run.energy) < 1e-8


@pytest.mark.slow
def test_two_bodies_on_strings():
    """A marionette's body on two strings of fixed length, and a limb on two more below it."""
    bodies = [
        ss.RigidBody(name, inertia=inertia, mass=mass)
        for name, inertia, mass in (
            ("body", (0.3, 0.2, 0.4), 1.5),
            ("limb", (0.1, 0.15, 0.05), 0.6),
        )
    ]
    body, limb = bodies
    hooks = [sp.Matrix(x) for x in ((-0.5, 0, 2), (0.5, 0.1, 2))]
    eyes = [body.point(x) for x in ((-0.4, 0, 0.2), (0.4, 0, 0.2))]
    low = [body.point(x) for x in ((-0.3, 0.1, -0.3), (0.3, 0, -0.3))]
    ears = [limb.point(x) for x in ((-0.2, 0, 0.1), (0.2, 0.1, 0.1))]
    strings = {
        f"string {k}": sum((sp.Matrix(a) - sp.Matrix(b)).applyfunc(lambda c: c**2)) - length**2
        for k, (a, b, length) in enumerate(
            [
                (hooks[0], eyes[0], 1.8),
                (hooks[1], eyes[1], 1.9),
                (low[0], ears[0], 1.0),
                (low[1], ears[1], 0.9),
            ],
            1,
        )
    }
    lengths = {f"{b.coordinates[0]}": c for b in bodies for c in b.constraints}
    system = ss.MechanicalSystem(
        "marionette",
        coordinates=[q for b in bodies for q in b.coordinates],
        kinetic=sum(b.kinetic for b in bodies),
        potential=g * sum(b.mass * b.point((0, 0, 0))[2] for b in bodies),
        constraints={**lengths, **strings},
    )
    starts = [
        body.state(angles=(0.1, 0.2, -0.1), position=(0, 0, 0), angular_velocity=(0.5, 1, 0)),
        limb.state(angles=(0.0, 0.3, 0.2), position=(0, 0.1, -1.3), velocity=(0.3, 0, 0)),
    ]
    q0, v0 = system.consistent(*map(np.concatenate, zip(*starts, strict=True)))
    assert system.degrees_of_freedom == 8
    error, run = apart(system, q0, v0, 0.005, 100, "gauss4")
    assert error < 1e-8
    assert np.abs(run.constraint_error).max() < 1e-14


@pytest.mark.slow
def test_a_loop_of_sympy_bodies():
    """SymPy's four-bar linkage of rigid bodies in frames, closed by two of its equations."""
    q = me.dynamicsymbols("q1:4")
    N = me.ReferenceFrame("N")
    lengths, masses = (1.0, 2.2, 1.6), (1.2, 1.5, 0.9)
    pin = me.Point("O")
    pin.set_vel(N, 0)
    frame, loop, bodies = N, sp.S.Zero * N.x, []
    for k, (angle, length, mass) in enumerate(zip(q, lengths, masses, strict=True)):
        frame = frame.orientnew(f"F{k}", "Axis", (angle, N.z))
        middle = pin.locatenew(f"G{k}", length / 2 * frame.x)
        middle.v2pt_theory(pin, N, frame)
        inertia = me.inertia(frame, 0, 0, mass * length**2 / 12)
        bodies.append(me.RigidBody(f"B{k}", middle, frame, mass, (inertia, middle)))
        tip = pin.locatenew(f"P{k}", length * frame.x)
        tip.v2pt_theory(pin, N, frame)
        bodies[-1].potential_energy = mass * g * (loop + length / 2 * frame.x).dot(N.y)
        loop += length * frame.x
        pin = tip
    closed = [loop.dot(N.x) - 2.5, loop.dot(N.y)]
    method = me.LagrangesMethod(me.Lagrangian(N, *bodies), q, hol_coneqs=closed, frame=N)
    method.form_lagranges_equations()
    system = ss.MechanicalSystem.from_lagranges_method("loop", method)
    q0, v0 = system.consistent([1.2, -0.9, -1.6], [0.5, 0.0, 0.0])
    error, run = apart(system, q0, v0, 0.01, 100)
    assert error < 1e-8
    assert np.ptp(run.energy) < 1e-8
