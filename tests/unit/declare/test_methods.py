"""Systems from SymPy's KanesMethod."""

import numpy as np
import pytest
import sympy as sp
import sympy.physics.mechanics as me
from support import kane as posed
from support.cases import sweep

import symsimpson as ss

x, y, u, w, F = ss.coordinates("x y u w F")
N = me.ReferenceFrame("N")

SYSTEMS = {
    "spring_and_damper": (["loads"], [], []),
    "pendulum": ([], [], []),
    "pendulums_with_a_joint": (["loads"], [], []),
    "rolling_disc": (["rolling"], [], []),
    "disc_with_its_place": ([], [], ["1", "2"]),
    "four_bars": ([], ["1", "2"], []),
    "flying_body": (["loads"], ["1"], []),
    "n_pendulum_on_a_cart": (["loads"], [], []),
    "masses_on_springs": (["loads"], [], []),
    "bicycle": (["rolling"], ["1"], ["2", "3"]),
}
LARGE = ("bicycle", "disc_with_its_place", "flying_body", "four_bars")


@pytest.mark.parametrize(
    "name", sweep(sorted(SYSTEMS, key=LARGE.__contains__), len(SYSTEMS) - len(LARGE))
)
def test_accelerations_are_those_of_kane(name):
    kane = getattr(posed, name)()
    forces, held, rolling = SYSTEMS[name]
    inputs = functions(kane)
    system = read(kane, inputs=inputs)
    assert list(system.forces) == forces
    assert list(system.constraints) == held
    assert list(system.velocity_constraints) == rolling
    values = {**system.parameters, **{f: 0.4 + k / 9 for k, f in enumerate(inputs)}}
    Q, U, V, W, a = posed.kane_accelerations(kane, values, np.random.default_rng(7))
    own = [str(q.func) for q in system.coordinates]
    extra = [k for k, speed in enumerate(kane.u) if f"{speed.func}_integral" in own]
    q, v = [*Q, *np.zeros(len(extra))], [*V, *U[extra]]
    found = posed.accelerations(system, q, v, values)
    np.testing.assert_allclose(found, [*a, *W[extra]], rtol=1e-12, atol=1e-12)


def constants(kane):
    """The symbols of Kane's equations."""
    parts = (kane.mass_matrix_full, kane.forcing_full, kane._f_h)
    return set().union(*(x.free_symbols for x in parts)) - {ss.time}


def functions(kane):
    """The functions of time that are prescribed in Kane's equations."""
    own = {*kane.q, *kane.u, *kane.q.diff(ss.time), *kane.u.diff(ss.time)}
    return sorted(me.find_dynamicsymbols(kane.forcing) - own, key=str)


def read(kane, **more):
    values = {a: 1 + k / 7 for k, a in enumerate(sorted(constants(kane), key=str))}
    return ss.MechanicalSystem.from_kanes_method("posed", kane, values, **more)


def moved(loads):
    """A body on a line, under loads."""
    point = me.Point("P")
    point.set_vel(N, u * N.x)
    body = me.Particle("body", point, 2)
    pairs = [(point, f * N.x) for f in loads]
    return posed.formed(N, [x], [u], [x.diff() - u], [body], pairs), body


def test_potentials_are_found():
    """Of gravity and of springs; what drives or brakes, or has no potential, is a force."""
    m, l, g, k, c = sp.symbols("m l g k c")
    (q,) = posed.pendulum().q
    assert read(posed.pendulum()).potential == -m * g * l * sp.cos(q)
    spring = read(posed.spring_and_damper())
    assert spring.potential == k * q**2 / 2
    assert spring.forces == {"loads": {q: -c * q.diff()}}
    chain = read(posed.masses_on_springs(2))
    a, b = chain.coordinates
    m0, m1, k0, k1 = sp.symbols("m0 m1 k0 k1")
    V = k0 * a**2 / 2 + k1 * b**2 / 2 - (m0 + m1) * g * a - m1 * g * b
    assert sp.expand(chain.potential - V) == 0  # of forces of which none has one alone
    others = [F * x, 1 / x, sp.sin(x) / x, sp.cos(ss.time), sp.exp(-u)]
    driven, _ = moved([-(x**3), *others])
    system = read(driven, inputs=(F,))
    assert sp.expand(system.potential - x**4 / 4 + x) == 0  # exp(-u) is 1 at rest
    left = sp.Add(*others, -1).xreplace({u: x.diff()})
    assert sp.expand(system.forces["loads"][x] - left) == 0


PAIRS = {
    "gravity": lambda r: -1 / r,
    "spring": lambda r: (r - 1) ** 2 / 2,
    "Lennard-Jones": lambda r: r**-12 - r**-6,
    "Morse": lambda r: (1 - sp.exp(-r)) ** 2,
    "Yukawa": lambda r: sp.exp(-r) / r,
    "Gauss": lambda r: sp.exp(-(r**2)),
}


@pytest.mark.parametrize("name", sweep(PAIRS))
def test_potentials_of_distances_are_found(name):
    q, u = ss.coordinates("x1 y1 x2 y2 x3 y3"), ss.coordinates("a1 b1 a2 b2 a3 b3")
    frame, places = me.ReferenceFrame("N"), [(q[k], q[k + 1]) for k in (0, 2, 4)]

    def distance(i, j):
        return sp.sqrt(sum((a - b) ** 2 for a, b in zip(places[i], places[j], strict=True)))

    V = sum(PAIRS[name](distance(i, j)) for i, j in ((0, 1), (0, 2), (1, 2)))
    points = [me.Point(f"P{k}") for k in range(3)]
    for k, point in enumerate(points):
        point.set_vel(frame, u[2 * k] * frame.x + u[2 * k + 1] * frame.y)
    kane = me.KanesMethod(frame, q, u, [a.diff() - b for a, b in zip(q, u, strict=True)])
    loads = [
        (point, -V.diff(x) * frame.x - V.diff(y) * frame.y)
        for point, (x, y) in zip(points, places, strict=True)
    ]
    kane.kanes_equations([me.Particle(f"b{k}", point, 1) for k, point in enumerate(points)], loads)
    system = ss.MechanicalSystem.from_kanes_method("three", kane, {})
    assert not system.forces
    at = dict(zip(q, (0.1, 0.3, 1.2, -0.4, -0.5, 0.9), strict=True))
    slopes = [(system.potential - V).diff(x).xreplace(at) for x in q]
    assert max(abs(float(slope)) for slope in slopes) < 1e-12


@pytest.mark.parametrize("name", sweep(PAIRS))
@pytest.mark.parametrize("alone", [True, False])
def test_potentials_of_distances_on_a_line_are_found(name, alone):
    """The distance is the root of a square, which SymPy writes as an absolute value of reals."""
    (x, y), (u, w) = q, v = ss.coordinates("x y"), ss.coordinates("u w")
    frame, points = me.ReferenceFrame("N"), [me.Point("P"), me.Point("Q")]
    V = PAIRS[name](sp.sqrt((x if alone else x - y) ** 2))
    for point, speed in zip(points, v, strict=True):
        point.set_vel(frame, speed * frame.x)
    kane = me.KanesMethod(frame, q, v, [x.diff() - u, y.diff() - w])
    loads = [(point, -V.diff(z) * frame.x) for point, z in zip(points, q, strict=True)]
    kane.kanes_equations([me.Particle(f"b{k}", point, 1) for k, point in enumerate(points)], loads)
    system = ss.MechanicalSystem.from_kanes_method("line", kane, {})
    assert system.forces is None or not system.forces
    for at in ({x: 1.3, y: 0.4}, {x: -0.7, y: 0.6}):
        slopes = [float((system.potential - V).diff(z).xreplace(at)) for z in q]
        assert np.abs(slopes).max() < 1e-12


def test_what_is_given_stands_beside_the_loads():
    kane, _ = moved([-u])
    system = read(kane, forces={"pull": {x: 1}}, units={"x": "m"}, invariants={"place": x})
    assert list(system.forces) == ["pull", "loads"]
    assert system.invariants == {"place": x}


def test_the_potential_energy_of_bodies_is_that_of_loads_or_nothing():
    kane, body = moved([-sp.exp(x) * sp.sin(x) ** 3 / (2 + sp.cos(x)), -u])
    body.potential_energy = x**4
    with pytest.warns(ss.ModelWarning, match="potential_energy of the bodies differs"):
        assert read(kane).potential == 0
    root = sp.sqrt(2 + sp.cos(x) + x**2)
    kane, body = moved([-root.diff(x), -u])
    body.potential_energy = root
    system = read(kane)
    assert system.potential == root
    assert system.forces == {"loads": {x: -x.diff()}}


@pytest.mark.slow
def test_a_rolling_disc_keeps_its_energy():
    """Its energy stays, and the terms that make it roll have no power."""
    system = read(posed.rolling_disc())
    run = ss.compile(system, "gauss4").integrate(
        [0.1, 0.2, 0.0], [0.3, 0.1, 2.0], h=0.01, steps=200
    )
    assert np.ptp(run.energy) < 1e-7 * run.energy[0]
    assert abs(run.work["rolling"]).max() < 1e-7


def test_methods_that_cannot_be_read_are_told():
    frame, point = me.ReferenceFrame("N"), me.Point("P")
    kane = me.KanesMethod(frame, [x], [u], [x.diff() - u])
    with pytest.raises(
        ss.ModelError, match=r"Need to compute Fr.*\nCall kanes_equations\(bodies, loads\) first"
    ):
        read_bare(kane)
    point.set_vel(frame, (u + w) * frame.x)
    body = me.Particle("body", point, 1)
    kane = me.KanesMethod(frame, [x], [u], [x.diff() - u], u_auxiliary=[w])
    kane.kanes_equations([body], [(point, F * frame.x)])
    with pytest.raises(ss.ModelError, match="auxiliary speeds"):
        read_bare(kane)
    point.set_vel(frame, u * frame.x)
    kane = posed.formed(
        frame, [x, y], [u], [x.diff() - u, y.diff() - u * x], [body], [(point, frame.x)]
    )
    with pytest.raises(ss.ModelError, match=r"2 kinematical equations.*1 speed .* Each speed"):
        read_bare(kane)
    kane = posed.formed(
        frame,
        [x],
        [u, w],
        [x.diff() - u, y.diff() - w],
        [body],
        [(point, frame.x)],
        q_dependent=[y],
        configuration_constraints=[x - y**2],
    )
    with pytest.raises(ss.ModelError, match="do not imply the configuration constraints"):
        read_bare(kane)
    with pytest.raises(ss.ModelError, match=r"JointsMethod is neither .* nor a KanesMethod"):
        read_bare(type("JointsMethod", (), {})())


def read_bare(kane):
    return ss.MechanicalSystem.from_kanes_method("posed", kane)
