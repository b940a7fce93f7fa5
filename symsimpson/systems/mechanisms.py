"""Mechanisms: linkages, a robot arm, and a cart with a pole."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import accumulate

import mpmath
import sympy as sp

from symsimpson.declare.arms import Link, arm_energies
from symsimpson.declare.coordinates import coordinates
from symsimpson.systems.entry import CatalogueSystem, check_count, read_numbers


def hanging_chain(n: int = 8) -> CatalogueSystem:
    """A chain of n point masses on rods, in the Cartesian coordinates of each mass."""
    check_count("hanging_chain", "links", n, 1)
    x, y = coordinates(f"x1:{n + 1}"), coordinates(f"y1:{n + 1}")
    m, l, g = sp.symbols("m l g", positive=True)
    points = list(zip(x, y, strict=True))
    rods = [
        ((a - b) ** 2 + (c - d) ** 2 - l**2) / 2
        for (a, c), (b, d) in zip(points, [(0, 0), *points[:-1]], strict=True)
    ]
    with mpmath.workdps(30):
        angles = [mpmath.mpf(4) / 5 - mpmath.mpf(3 * i) / (10 * n) for i in range(n)]
        down = zip(
            accumulate(map(mpmath.sin, angles)), accumulate(map(mpmath.cos, angles)), strict=True
        )
        hanging = tuple(place for x, y in down for place in (float(x), -float(y)))
    return CatalogueSystem(
        f"hanging_chain_{n}",
        coordinates=tuple(q for point in points for q in point),
        kinetic=sp.Add(*(m * q.diff() ** 2 / 2 for q in (*x, *y))),
        potential=sp.Add(*(m * g * q for q in y)),
        constraints={f"rod {i + 1}": rod for i, rod in enumerate(rods)},
        parameters={m: 1.0, l: 1.0, g: 9.81},
        positions={
            "chain": [(0, 0), *points, *points[-2::-1]]
        },  # back again, because outlines are closed
        reference_state={"q0": hanging, "v0": (0.0,) * (2 * n)},
        source="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section VII.1.3",
    )


def four_bar() -> CatalogueSystem:
    """A crank, a coupler and a rocker that form a loop with the ground, in their angles."""
    t1, t2, t3 = coordinates("t1 t2 t3")
    l1, l2, l3, l0, m1, m2, m3, g = sp.symbols("l1 l2 l3 l0 m1 m2 m3 g", positive=True)
    w1, w2, w3 = (angle.diff() for angle in (t1, t2, t3))
    crank = l1 * sp.Matrix([sp.cos(t1), sp.sin(t1)])
    coupler = l2 * sp.Matrix([sp.cos(t2), sp.sin(t2)])
    rocker = l3 * sp.Matrix([sp.cos(t3), sp.sin(t3)])
    ground = sp.Matrix([l0, 0])
    gap = crank + coupler - rocker - ground
    square = (m1 / 3 + m2) * l1**2 * w1**2 + m2 * l2**2 * w2**2 / 3 + m3 * l3**2 * w3**2 / 3
    heights = m1 * crank[1] / 2 + m2 * (crank[1] + coupler[1] / 2) + m3 * rocker[1] / 2
    return CatalogueSystem(
        "four_bar",
        coordinates=(t1, t2, t3),
        kinetic=square / 2 + m2 * l1 * l2 * w1 * w2 * sp.cos(t1 - t2) / 2,
        potential=g * heights,
        constraints={"loop_x": gap[0], "loop_y": gap[1]},
        parameters={l1: 1.0, l2: 2.0, l3: 1.5, l0: 2.2, m1: 1.0, m2: 1.4, m3: 0.8, g: 9.81},
        positions={
            "crank": tuple(crank),
            "coupler": tuple(crank + coupler),
            "bars": [(0, 0), tuple(crank), tuple(ground + rocker), tuple(ground)],
        },
        reference_state={
            "q0": (1.0, 0.325720853941296127, 1.413385124163572719),
            "v0": (1.3, -0.29486108928672544, 0.611025130836330358),
        },
        source="E. J. Haug, Computer Aided Kinematics and Dynamics of Mechanical Systems, 1989",
    )


def slider_crank() -> CatalogueSystem:
    """A crank, a connecting rod and a piston with a spring."""
    theta, beta, x = coordinates("theta beta x")
    l1, l2, m1, m2, m3, k, g = sp.symbols("l1 l2 m1 m2 m3 k g", positive=True)
    pin = l1 * sp.Matrix([sp.cos(theta), sp.sin(theta)])
    rod = l2 * sp.Matrix([sp.cos(beta), -sp.sin(beta)])
    speeds = (theta.diff(), beta.diff(), x.diff())
    rates = (pin + rod / 2).jacobian([theta, beta]) * sp.Matrix(speeds[:2])
    kinetic = m1 * l1**2 * speeds[0] ** 2 / 6 + m3 * speeds[2] ** 2 / 2
    kinetic += m2 * (rates.T * rates)[0] / 2 + m2 * l2**2 * speeds[1] ** 2 / 24
    return CatalogueSystem(
        "slider_crank",
        coordinates=(theta, beta, x),
        kinetic=kinetic,
        potential=g * (m1 * pin[1] / 2 + m2 * (pin + rod / 2)[1]) + k * (x - l2) ** 2 / 2,
        constraints={"pin_x": pin[0] + rod[0] - x, "pin_y": pin[1] + rod[1]},
        parameters={l1: 0.5, l2: 1.5, m1: 1.0, m2: 0.8, m3: 0.6, k: 5.0, g: 9.81},
        positions={"pin": tuple(pin), "piston": (x, 0), "bars": [(0, 0), tuple(pin), (x, 0)]},
        reference_state={"q0": (0.0, 0.0, 2.0), "v0": (6.0, 2.0, 0.0)},
        source="P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988",
    )


#: Parameters of the squeezer in SI units: masses, inertias, lengths, points, spring and torque.
_MASSES = (0.04325, 0.00365, 0.02373, 0.00706, 0.0705, 0.00706, 0.05498)
_INERTIAS = (2.194e-06, 4.41e-07, 5.255e-06, 5.667e-07, 1.169e-05, 5.667e-07, 1.912e-05)
_SQUEEZER = {
    **{f"m{k}": value for k, value in enumerate(_MASSES, 1)},
    **{f"i{k}": value for k, value in enumerate(_INERTIAS, 1)},
    **read_numbers("""
        xa -0.06934  ya -0.00227  xb -0.03635  yb 0.03273  xc 0.014  yc 0.072  c0 4530.0
        d 0.028  da 0.0115  e 0.02  ea 0.01421  rr 0.007  ra 0.00092
        ss 0.035  sa 0.01874  sb 0.01043  sc 0.018  sd 0.02  zt 0.04  ta 0.02308  tb 0.00916
        u 0.04  ua 0.01228  ub 0.00449  zf 0.02  fa 0.01421  l0 0.07785  mom 0.033
        """),
}


def andrews_squeezer() -> CatalogueSystem:
    """Seven bodies in three loops, a test problem for solvers with constraints.

    A constant torque turns the first body, and a spring acts on the third.
    """
    be, th, ga, ph, de, om, ep = coordinates("be th ga ph de om ep")
    a = {name: sp.Symbol(name, real=True) for name in _SQUEEZER}
    m1, m2, m3, m4, m5, m6, m7 = (a[f"m{k}"] for k in range(1, 8))
    i1, i2, i3, i4, i5, i6, i7 = (a[f"i{k}"] for k in range(1, 8))
    rr, ss, d, e, zt, zf, u = (a[name] for name in ("rr", "ss", "d", "e", "zt", "zf", "u"))
    da, ea, fa, ra, sa, sb = (a[name] for name in ("da", "ea", "fa", "ra", "sa", "sb"))
    ta, tb, ua, ub = (a[name] for name in ("ta", "tb", "ua", "ub"))
    rod, bar, slide = e - ea, zf - fa, sp.cos(th)
    # entries of the mass matrix of the Test Set, on and above the diagonal
    entries = {
        (be, be): m1 * ra**2 + m2 * (rr**2 - 2 * da * rr * slide + da**2) + i1 + i2,
        (be, th): m2 * (da**2 - da * rr * slide) + i2,
        (th, th): m2 * da**2 + i2,
        (ga, ga): m3 * (sa**2 + sb**2) + i3,
        (ph, ph): m4 * rod**2 + i4,
        (ph, de): m4 * (rod**2 + zt * rod * sp.sin(ph)) + i4,
        (de, de): m4 * (zt**2 + 2 * zt * rod * sp.sin(ph) + rod**2)
        + m5 * (ta**2 + tb**2)
        + i4
        + i5,
        (om, om): m6 * bar**2 + i6,
        (om, ep): m6 * (bar**2 - u * bar * sp.sin(om)) + i6,
        (ep, ep): m6 * (bar**2 - 2 * u * bar * sp.sin(om) + u**2) + m7 * (ua**2 + ub**2) + i6 + i7,
    }
    kinetic = sum(
        (M * p.diff() * q.diff() / (2 if p == q else 1) for (p, q), M in entries.items()), sp.S.Zero
    )
    hook = (
        a["xb"] + a["sc"] * sp.sin(ga) + a["sd"] * sp.cos(ga),
        a["yb"] + a["sd"] * sp.sin(ga) - a["sc"] * sp.cos(ga),
    )
    length = sp.sqrt((hook[0] - a["xc"]) ** 2 + (hook[1] - a["yc"]) ** 2)
    end = [rr * f(be) - d * f(be + th) for f in (sp.cos, sp.sin)]
    first = (-ss * sp.sin(ga) - a["xb"], ss * sp.cos(ga) - a["yb"])
    second = (-e * sp.sin(ph + de) - zt * sp.cos(de), e * sp.cos(ph + de) - zt * sp.sin(de))
    third = (-zf * sp.cos(om + ep) - u * sp.sin(ep), -zf * sp.sin(om + ep) + u * sp.cos(ep))
    anchor = (a["xa"], a["ya"])
    ways = {"1": (first, (0, 0)), "2": (second, anchor), "3": (third, anchor)}
    loops = {
        f"loop{name}_{axis}": end[k] + way[k] - fixed[k]
        for name, (way, fixed) in ways.items()
        for k, axis in enumerate("xy")
    }
    return CatalogueSystem(
        "andrews_squeezer",
        coordinates=(be, th, ga, ph, de, om, ep),
        kinetic=kinetic,
        potential=a["c0"] * (length - a["l0"]) ** 2 / 2 - a["mom"] * be,
        constraints=loops,
        parameters={symbol: _SQUEEZER[name] for name, symbol in a.items()},
        positions={"end": tuple(end), "hook": hook},
        reference_state={
            "q0": (
                -0.06171389001427644,
                0.0,
                0.45527981916307038,
                0.222668390165885884,
                0.48736497954384255,
                -0.22266839016588588,
                1.230547444549821192,
            ),
            "v0": (0.0,) * 7,
        },
        source="F. Mazzia and C. Magherini, Test Set for IVP Solvers, section II-18",
    )


RIGHT = math.pi / 2
#: Links in the standard Denavit-Hartenberg convention, in metres, kilograms and radians.
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
    """The first joints of the robot arm PUMA 560, which swings freely under gravity."""
    check_count("puma560", "joints", joints, 1, 6)
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


def cart_pole() -> CatalogueSystem:
    """A rolling cart that carries a pendulum, with theta = 0 hanging down."""
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
    """The cart with a pole, with a motor of force u and with friction in wheels and joint."""
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
