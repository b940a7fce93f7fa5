"""Systems posed by Kane's method of SymPy, and their accelerations by Kane and by Lagrange."""

import itertools

import numpy as np
import sympy as sp
import sympy.physics.mechanics as me

import symsimpson as ss

t = ss.time
sin, cos = sp.sin, sp.cos


def kane_accelerations(kane, values, rng):
    """A random state that the constraints allow, and what Kane's equations say of it.

    Coordinates, speeds, and the rates of both; second derivatives of coordinates.
    """
    q, u = list(kane.q), list(kane.u)
    qdot, udot = [x.diff(t) for x in q], [x.diff(t) for x in u]
    own = {x: sp.Dummy() for x in (*qdot, *udot, *q, *u)}

    def number(expressions, arguments, *given):
        plain = sp.Matrix(expressions).xreplace(values).xreplace(own)
        return np.array(sp.lambdify([own[x] for x in arguments], plain, cse=True)(*given))

    Q, U = rng.uniform(0.2, 0.9, len(q)), rng.uniform(-1, 1, len(u))
    slopes = kane._f_h.jacobian(q) if kane._f_h else None
    for _ in range(30 if kane._f_h else 0):
        Q -= np.linalg.pinv(number(slopes, q, *Q)) @ number(kane._f_h, q, *Q).ravel()
    free = len(u) - len(kane._udep)
    if free < len(u):
        A, b = number(kane._k_nh, q, *Q), number(kane._f_nh, q, *Q).ravel()
        U[free:] = np.linalg.solve(A[:, free:], -b - A[:, :free] @ U[:free])
    kane.explicit_kinematics = False  # whose matrices have no divisions
    kin, rest = kane.mass_matrix_kin, kane.forcing_kin
    K = number(kin, q, *Q)
    V = np.linalg.solve(K, number(rest, [*q, *u], *Q, *U).ravel())
    M, f = number(kane.mass_matrix, q, *Q), number(kane.forcing, [*q, *u], *Q, *U).ravel()
    W = np.linalg.solve(M, f)
    gap = (rest.diff(t) - kin.diff(t) * sp.Matrix(qdot)).xreplace(
        dict.fromkeys((x.diff(t) for x in qdot), 0)
    )
    a = np.linalg.solve(K, number(gap, [*q, *u, *qdot, *udot], *Q, *U, *V, *W).ravel())
    return Q, U, V, W, a


def accelerations(system, q, v, values):
    """Second derivatives of the coordinates by Lagrange's equations with multipliers."""
    n, given = system.n, {a: sp.sympify(value) for a, value in values.items()}
    x, w = sp.symbols(f"x:{n}"), sp.symbols(f"w:{n}")
    put = dict(zip((c.diff(t) for c in system.coordinates), w, strict=True))
    put |= dict(zip(system.coordinates, x, strict=True))

    def own(expression):
        return sp.sympify(expression).xreplace(given).xreplace(put)

    def along(expression):
        return sum(expression.diff(y) * z for y, z in zip(x, w, strict=True))

    L = own(system.lagrangian)
    p = [L.diff(z) for z in w]
    rows = [along(own(phi)) for phi in system.constraints.values()]
    rows += [own(row) for row in system.velocity_constraints.values()]
    forces = [
        sum(own(force.get(c, 0)) for force in system.forces.values()) for c in system.coordinates
    ]
    J = sp.Matrix(len(rows), n, [row.diff(z) for row in rows for z in w])
    M = sp.Matrix(n, n, [y.diff(z) for y in p for z in w])
    K = sp.Matrix([[M, J.T], [J, sp.zeros(len(rows))]]) if rows else M
    right = [L.diff(y) + f - along(m) for y, f, m in zip(x, forces, p, strict=True)]
    right += [-along(row) for row in rows]
    K, right = sp.lambdify([*x, *w], (K, sp.Matrix(right)), cse=True)(*q, *v)
    return np.linalg.solve(np.array(K), np.array(right).ravel())[:n]


def formed(frame, q, u, kinematics, bodies, loads, **more):
    """Kane's equations, all of whose parts are given."""
    kane = me.KanesMethod(frame, q, u, kinematics, **more)
    kane.kanes_equations(bodies, loads)
    return kane


def spring_and_damper():
    """That of the docstring of KanesMethod."""
    q, u = me.dynamicsymbols("q u")
    m, c, k = sp.symbols("m c k")
    N, P = me.ReferenceFrame("N"), me.Point("P")
    P.set_vel(N, u * N.x)
    return formed(
        N, [q], [u], [q.diff() - u], [me.Particle("pa", P, m)], [(P, (-k * q - c * u) * N.x)]
    )


def pendulum():
    """SymPy's simple pendulum, whose bob has a velocity and no place."""
    q, u = me.dynamicsymbols("q u")
    m, l, g = sp.symbols("m l g")
    N, P = me.ReferenceFrame("N"), me.Point("P")
    P.set_vel(N, -l * u * sin(q) * N.x + l * u * cos(q) * N.y)
    return formed(N, [q], [u], [q.diff() - u], [me.Particle("pa", P, m)], [(P, m * g * N.x)])


def pendulums_with_a_joint():
    """Kane and Levinson's double pendulum, with speeds that are sums of rates."""
    q1, q2, u1, u2 = me.dynamicsymbols("q1 q2 u1 u2")
    l, m, sigma, delta = sp.symbols("l m sigma delta")
    N, O = me.ReferenceFrame("N"), me.Point("O")
    A, B = N.orientnew("A", "Axis", (q1, N.z)), N.orientnew("B", "Axis", (q2, N.z))
    O.set_vel(N, 0)
    P = O.locatenew("P", l * A.x)
    P.v2pt_theory(O, N, A)
    Q = P.locatenew("Q", l * B.x)
    Q.v2pt_theory(P, N, B)
    torque = (sigma * (q2 - q1) + delta * (q2.diff() - q1.diff())) * N.z
    bodies = [me.Particle("Ap", P, m), me.Particle("Bp", Q, m)]
    kinematics = [u1 - q1.diff(), u2 - (q1.diff() + q2.diff())]
    return formed(N, [q1, q2], [u1, u2], kinematics, bodies, [(A, torque), (B, -torque)])


def rolling_disc():
    """SymPy's documentation: the velocity is that of rolling, and the place no coordinate."""
    q, u = me.dynamicsymbols("q1:4"), me.dynamicsymbols("u1:4")
    r, m, g = sp.symbols("r m g")
    N = me.ReferenceFrame("N")
    Y = N.orientnew("Y", "Axis", [q[0], N.z])
    L = Y.orientnew("L", "Axis", [q[1], Y.x])
    R = L.orientnew("R", "Axis", [q[2], L.y])
    turning = R.ang_vel_in(N)
    R.set_ang_vel(N, u[0] * L.x + u[1] * L.y + u[2] * L.z)
    C = me.Point("C")
    C.set_vel(N, 0)
    centre = C.locatenew("Dmc", r * L.z)
    centre.v2pt_theory(C, N, R)
    inertia = me.inertia(L, m / 4 * r**2, m / 2 * r**2, m / 4 * r**2)
    body = me.RigidBody("disc", centre, R, m, (inertia, centre))
    kinematics = [(R.ang_vel_in(N) - turning).dot(axis) for axis in L]
    return formed(N, q, u, kinematics, [body], [(centre, -m * g * Y.z)])


def disc_with_its_place():
    """The same with the point of contact as coordinates, whose speeds depend on the others."""
    q, u = me.dynamicsymbols("q1:6"), me.dynamicsymbols("u1:6")
    g, r, m = sp.symbols("g r m")
    N, lean, O = me.ReferenceFrame("N"), me.ReferenceFrame("lean"), me.Point("O")
    lean.orient_body_fixed(N, (q[0], q[1], 0), "zxy")
    D = lean.orientnew("D", "Axis", (q[2], lean.y))
    turning = D.ang_vel_in(N)
    D.set_ang_vel(N, u[0] * D.x + u[1] * D.y + u[2] * D.z)
    O.set_vel(N, 0)
    contact = O.locatenew("contact", q[3] * N.x + q[4] * N.y)
    contact.set_vel(N, u[3] * N.x + u[4] * N.y)
    centre = contact.locatenew("centre", r * lean.z)
    centre.set_vel(N, contact.vel(N) + lean.ang_vel_in(N).cross(r * lean.z))
    kinematics = [turning.dot(D.x) - u[0], turning.dot(D.y) - u[1], turning.dot(D.z) - u[2]]
    kinematics += [q[3].diff() - u[3], q[4].diff() - u[4]]
    slip = centre.vel(N) + D.ang_vel_in(N).cross(-r * lean.z)
    body = me.RigidBody("disc", centre, D, m, (m * r**2 / 4 * me.inertia(D, 1, 2, 1), centre))
    return formed(
        N,
        q,
        u[:3],
        kinematics,
        [body],
        [(centre, -m * g * N.z)],
        u_dependent=u[3:],
        velocity_constraints=[slip.dot(N.x), slip.dot(N.y)],
    )


def four_bars():
    """SymPy's four-bar linkage, of joints in a System, which is closed by two equations."""
    q, u, g, rho = me.dynamicsymbols("q1:4"), me.dynamicsymbols("u1:4"), *sp.symbols("g rho")
    lengths = sp.symbols("l1:5")
    links = [me.RigidBody(f"L{k}", mass=rho * l) for k, l in enumerate(lengths, 1)]
    for link, l in zip(links, lengths, strict=True):
        inertia = me.inertia(link.frame, 0, 0, rho * l**3 / 12)
        link.inertia = (inertia, link.masscenter)
    system = me.System.from_newtonian(links[0])
    for k, (one, other) in enumerate(itertools.pairwise(links)):
        places = {
            "parent_point": lengths[k] / 2 * one.x,
            "child_point": -lengths[k + 1] / 2 * other.x,
        }
        system.add_joints(me.PinJoint(f"J{k}", one, other, q[k], u[k], joint_axis=one.z, **places))
    loop = links[3].masscenter.pos_from(links[0].masscenter)
    loop += lengths[0] / 2 * links[0].x + lengths[3] / 2 * links[3].x
    system.add_holonomic_constraints(loop.dot(links[0].x), loop.dot(links[0].y))
    system.q_ind, system.q_dep, system.u_ind, system.u_dep = q[:1], q[1:], u[:1], u[1:]
    system.apply_uniform_gravity(-g * system.y)
    system.form_eoms()
    return system.eom_method


def flying_body():
    """A body that is turned by a quaternion, whose length is held by an equation without speeds."""
    q, x = me.dynamicsymbols("e0:4"), me.dynamicsymbols("x y z")
    u = me.dynamicsymbols("P Q R U V W")
    m, g, *J = sp.symbols("m g Jx Jy Jz")
    T = me.dynamicsymbols("T")
    N, O = me.ReferenceFrame("N"), me.Point("O")
    B = N.orientnew("B", "Quaternion", q)
    turning = B.ang_vel_in(N)
    B.set_ang_vel(N, u[0] * B.x + u[1] * B.y + u[2] * B.z)
    centre = O.locatenew("centre", x[0] * N.x + x[1] * N.y + x[2] * N.z)
    centre.set_vel(N, u[3] * N.x + u[4] * N.y + u[5] * N.z)
    body = me.RigidBody("body", centre, B, m, (me.inertia(B, *J), centre))
    kinematics = [turning.dot(axis) - w for axis, w in zip(B, u, strict=False)]
    kinematics += [y.diff() - w for y, w in zip(x, u[3:], strict=True)]
    kinematics.append(sum(e * e.diff() for e in q))
    return formed(
        N,
        [*q[1:], *x],
        u,
        kinematics,
        [body],
        [(centre, -m * g * N.z), (B, T * B.z)],
        q_dependent=q[:1],
        configuration_constraints=[sum(e**2 for e in q) - 1],
        explicit_kinematics=False,
    )


def bicycle():
    """Whipple's, from SymPy's documentation: the wheels turn by speeds that no coordinate has."""
    q1, q2, q4, q5 = me.dynamicsymbols("q1 q2 q4 q5")
    u1, u2, u3, u4, u5, u6 = me.dynamicsymbols("u1:7")
    front, rear, angle, offset = sp.symbols("WFrad WRrad htangle forkoffset")
    fork, frame, fork1, fork3 = sp.symbols("forklength framelength forkcg1 forkcg3")
    frame1, frame3, g = sp.symbols("framecg1 framecg3 g")
    masses = sp.symbols("mframe mfork mwf mwr")
    N = me.ReferenceFrame("N")
    Y = N.orientnew("Y", "Axis", [q1, N.z])
    R = Y.orientnew("R", "Axis", [q2, Y.x])
    F = R.orientnew("Frame", "Axis", [q4 + angle, R.y])
    G = F.orientnew("Fork", "Axis", [q5, F.x])
    straight = [x.orientnew(f"Temp{x}", "Axis", [-angle, x.y]) for x in (F, G)]
    WR, WF = me.ReferenceFrame("WR"), me.ReferenceFrame("WF")
    rear_contact = me.Point("WR_cont")
    rear_centre = rear_contact.locatenew("WR_mc", rear * R.z)
    steer = rear_centre.locatenew("Steer", frame * F.z)
    frame_centre = rear_centre.locatenew("Frame_mc", -frame1 * F.x + frame3 * F.z)
    fork_centre = steer.locatenew("Fork_mc", -fork1 * G.x + fork3 * G.z)
    front_centre = steer.locatenew("WF_mc", fork * G.x + offset * G.z)
    down = (G.y.dot(Y.z) * G.y - Y.z).normalize()
    front_contact = front_centre.locatenew("WF_cont", front * down)
    for one, other, w in (
        (Y, N, u1 * Y.z),
        (R, Y, u2 * R.x),
        (WR, F, u3 * F.y),
        (F, R, u4 * F.y),
        (G, F, u5 * F.x),
        (WF, G, u6 * G.y),
    ):
        one.set_ang_vel(other, w)
    rear_contact.set_vel(N, 0)
    for point, base, body in (
        (rear_centre, rear_contact, WR),
        (steer, rear_centre, F),
        (frame_centre, rear_centre, F),
        (fork_centre, steer, G),
        (front_centre, steer, G),
        (front_contact, front_centre, WF),
    ):
        point.v2pt_theory(base, N, body)
    inertias = [
        me.inertia(straight[0], *sp.symbols("Iframe11 Iframe22 Iframe33"), 0, 0, sp.Symbol("I31")),
        me.inertia(straight[1], *sp.symbols("Ifork11 Ifork22 Ifork33"), 0, 0, sp.Symbol("J31")),
        me.inertia(G, *sp.symbols("Iwf11 Iwf22 Iwf11")),
        me.inertia(F, *sp.symbols("Iwr11 Iwr22 Iwr11")),
    ]
    centres = [frame_centre, fork_centre, front_centre, rear_centre]
    bodies = [
        me.RigidBody(f"body{k}", centre, turned, m, (inertia, centre))
        for k, (centre, turned, m, inertia) in enumerate(
            zip(centres, (F, G, WF, WR), masses, inertias, strict=True)
        )
    ]
    slip = front_contact.vel(N)
    return formed(
        N,
        [q1, q2, q5],
        [u2, u3, u5],
        [q1.diff() - u1, q2.diff() - u2, q4.diff() - u4, q5.diff() - u5],
        bodies,
        [(centre, -m * g * Y.z) for centre, m in zip(centres, masses, strict=True)],
        q_dependent=[q4],
        configuration_constraints=[front_contact.pos_from(rear_contact).dot(Y.z)],
        u_dependent=[u1, u4, u6],
        velocity_constraints=[slip.dot(Y.x), slip.dot(Y.y), slip.dot(Y.z)],
        constraint_solver="CRAMER",
    )


def n_pendulum_on_a_cart(n=2):
    """PyDy's, with a force on the cart and torques in the joints."""
    q, u = me.dynamicsymbols(f"q:{n + 1}"), me.dynamicsymbols(f"u:{n + 1}")
    torques, F = me.dynamicsymbols(f"T1:{n + 1}"), me.dynamicsymbols("F")
    m, l, g = sp.symbols(f"m:{n + 1}"), sp.symbols(f"l:{n}"), sp.Symbol("g")
    N, O, point = me.ReferenceFrame("I"), me.Point("O"), me.Point("P0")
    O.set_vel(N, 0)
    point.set_pos(O, q[0] * N.x)
    point.set_vel(N, u[0] * N.x)
    bodies = [me.Particle("Pa0", point, m[0])]
    loads = [(point, -m[0] * g * N.y), (point, F * N.x), (N, -torques[0] * N.z)]
    for i in range(n):
        B = N.orientnew(f"B{i}", "Axis", [q[i + 1], N.z])
        B.set_ang_vel(N, u[i + 1] * N.z)
        tip = point.locatenew(f"P{i + 1}", l[i] * B.x)
        tip.v2pt_theory(point, N, B)
        point = tip
        bodies.append(me.Particle(f"Pa{i + 1}", point, m[i + 1]))
        loads.append((point, -m[i + 1] * g * N.y))
        above = torques[i + 1] if i + 1 < n else 0
        loads.append((B, (torques[i] - above) * N.z))
    kinematics = [x.diff() - y for x, y in zip(q, u, strict=True)]
    return formed(N, q, u, kinematics, bodies, loads)


def masses_on_springs(n=3):
    """PyDy's chain of masses, springs and dampers, which hangs."""
    m, k, c = (sp.symbols(f"{x}:{n}") for x in "mkc")
    g = sp.Symbol("g")
    q, u = me.dynamicsymbols(f"x:{n}"), me.dynamicsymbols(f"v:{n}")
    N, point = me.ReferenceFrame("N"), me.Point("origin")
    point.set_vel(N, 0)
    bodies, loads = [], []
    for i in range(n):
        below = point.locatenew(f"centre{i}", q[i] * N.x)
        below.set_vel(N, point.vel(N) + u[i] * N.x)
        point = below
        bodies.append(me.Particle(f"block{i}", point, m[i]))
        total = m[i] * g - k[i] * q[i] - c[i] * u[i]
        if i + 1 < n:
            total += k[i + 1] * q[i + 1] + c[i + 1] * u[i + 1]
        loads.append((point, total * N.x))
    return formed(N, q, u, [y - x.diff() for x, y in zip(q, u, strict=True)], bodies, loads)
