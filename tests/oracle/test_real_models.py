"""Arms, molecules, crystals and bodies: against textbooks and other packages."""

import pickle
import time
from fractions import Fraction
from functools import cache

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.newton_euler import accelerations
from support.random_systems import random_system
from support.workspace import jet_values

import symsimpson as ss
from symsimpson.discrete.jet import derive_jet
from symsimpson.systems.mechanisms import LINKS

GRAVITY = (0, 0, -9.81)


@pytest.mark.slow
def test_the_energy_of_the_argon_crystal_is_that_of_the_textbook():
    crystal = ss.systems.argon()
    energy = ss.compile(crystal, "midpoint").energy(
        [crystal.reference_state["q0"]],
        p=[
            [crystal.parameters[m] * v for v in crystal.reference_state["v0"]]
            for m in crystal.parameters
            if m.name == "m"
        ],
    )
    assert abs(energy[0] + 1260.2) < 0.05


@pytest.mark.slow
def test_bodies_on_a_polygon_stay_there():
    ring = ss.systems.n_body(3)
    run = ss.compile(ring, "kahan_li6").integrate(**ring.reference_state, h=0.02, steps=200)
    radius = np.hypot(run.q[:, 0::3], run.q[:, 1::3])
    assert abs(radius - 1).max() < 1e-9


@cache
def dh_arm(joints):
    """The same arm from matrices of Denavit and Hartenberg multiplied out by SymPy."""
    q = ss.coordinates(f"q1:{joints + 1}")
    v = [x.diff() for x in q]
    kinetic, potential, total = 0, 0, sp.eye(4)
    for k, link in enumerate(LINKS[:joints]):
        c, s = sp.cos(q[k]), sp.sin(q[k])
        ca, sa = round(float(np.cos(link.alpha))), round(float(np.sin(link.alpha)))
        total = total * sp.Matrix(
            [
                [c, -s * ca, s * sa, link.a * c],
                [s, c * ca, -c * sa, link.a * s],
                [0, sa, ca, link.d],
                [0, 0, 0, 1],
            ]
        )
        rotation = total[:3, :3]
        place = total[:3, 3] + rotation * sp.Matrix(link.centre)
        moving = place.jacobian(q) * sp.Matrix(v)
        turning = sp.zeros(3, 3)
        for j in range(k + 1):
            turning += rotation.diff(q[j]) * v[j]
        spin = rotation.T * turning
        omega = sp.Matrix([spin[2, 1], spin[0, 2], spin[1, 0]])
        inertia = sp.diag(*link.inertia)
        kinetic += link.mass * moving.dot(moving) / 2 + (omega.T * inertia * omega)[0] / 2
        kinetic += link.rotor * v[k] ** 2 / 2
        potential += 9.81 * link.mass * place[2]
    return ss.MechanicalSystem(f"dh_{joints}", coordinates=q, kinetic=kinetic, potential=potential)


@pytest.mark.slow
def test_trees_of_large_graphs_are_never_made():
    """Six joints from matrices: what is shown, hashed, pickled and analysed stays short."""
    arm = dh_arm(6)
    start = time.process_time()
    text = repr(arm) + arm.digest + arm._repr_latex_()
    again = pickle.loads(pickle.dumps(arm))
    assert again == arm
    assert len(text) < 10**5
    assert time.process_time() - start < 20  # a tree would take for ever


@pytest.mark.slow
@pytest.mark.parametrize("joints", sweep([3, 6]))
def test_arms_against_newton_and_euler(joints):
    """M v' = F - P_q v, from the jet, for the recursion and for matrices."""
    random = np.random.default_rng(joints)
    for arm in (ss.systems.puma560(joints), dh_arm(joints)):
        jet = derive_jet(arm.structure.plain)
        for _ in range(3):
            q, v = random.uniform(-2, 2, joints), random.uniform(-1, 1, joints)
            found = jet_values(jet, q, v, [])
            table = {
                name: np.array(
                    [[float(found[name, i, j]) for j in range(joints)] for i in range(joints)]
                )
                for name in ("M", "P_q")
            }
            force = np.array([float(found["F", i]) for i in range(joints)])
            mine = np.linalg.solve(table["M"], force - table["P_q"] @ v)
            truth = accelerations(LINKS[:joints], q, v, GRAVITY)
            np.testing.assert_allclose(mine, truth, rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_conventions_of_denavit_and_hartenberg_agree():
    """Two bars in a plane and a slide, in the standard and in the modified convention."""
    bar = {"mass": 2.0, "inertia": (0.1, 0.2, 0.3)}
    standard = ss.serial_arm(
        "standard",
        [ss.Link(a=0.5, centre=(-0.2, 0, 0), **bar), ss.Link(a=0.4, centre=(-0.1, 0, 0), **bar)],
        gravity=(0, -9.81, 0),
    )
    modified = ss.serial_arm(
        "modified",
        [ss.Link(centre=(0.3, 0, 0), **bar), ss.Link(a=0.5, centre=(0.3, 0, 0), **bar)],
        gravity=(0, -9.81, 0),
        modified=True,
    )
    runs = [
        ss.compile(arm).integrate([0.3, 0.5], v0=[0.1, -0.4], h=0.01, steps=50)
        for arm in (standard, modified)
    ]
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=1e-12, atol=1e-12)
    height = ss.Link(prismatic=True, mass=3.0)
    lift = ss.serial_arm("lift", [height], joints="z")
    run = ss.compile(lift).integrate([1.0], v0=[2.0], h=0.125, steps=8)
    np.testing.assert_allclose(run.q[-1, 0], 1 + 2 - 9.81 / 2, rtol=1e-14)


@pytest.mark.parametrize(
    "wrong", [{"links": []}, {"gravity": (0, 9.81)}, {"centre": (1, 2)}, {"inertia": (1, 2)}]
)
def test_arms_that_are_none(wrong):
    link = ss.Link(a=1.0, mass=1.0, inertia=(1, 1, 1))
    if wrong.keys() & {"centre", "inertia"}:
        link = ss.Link(a=1.0, mass=1.0, **wrong)
    options = {key: value for key, value in wrong.items() if key == "gravity"}
    with pytest.raises(ss.ModelError, match="system 'arm'"):
        ss.serial_arm("arm", wrong.get("links", [link]), **options)


@pytest.mark.parametrize("name", sweep(sorted(ss.systems.MODELS, key="puma560".__eq__), 6))
def test_models_are_complete(name):
    small = {"n_body": (3,), "argon_cluster": (3,), "cloth": (2,)}
    model = ss.systems.MODELS[name](*small.get(name, ()))
    assert model.source
    assert len(model.reference_state["q0"]) == model.n
    assert not model.structure.undecided


@pytest.mark.slow
def test_a_report_tells_what_was_done():
    report = ss.compile(ss.systems.water()).report()
    assert report.form == "unrolled"
    assert report.operations <= 500
    assert "seconds" not in repr(report)
    assert "operations at a node" in repr(report)
    assert "<table>" in report._repr_html_()
    assert ss.compile(ss.systems.n_body(6), "gauss4").report().form == "loops"


def exact(expression):
    """Write floats as the fractions that they are."""
    floats = {
        x: sp.Rational(*Fraction(float(x)).as_integer_ratio()) for x in expression.atoms(sp.Float)
    }
    return expression.xreplace(floats)


def symengine_truth(system, point):
    """Second derivatives of L by SymEngine, in many digits."""
    symengine = pytest.importorskip("symengine")
    n = system.n
    names = [
        *(f"q_{i}" for i in range(n)),
        *(f"v_{i}" for i in range(n)),
        *(f"a_{i}" for i in range(len(system.parameters))),
    ]
    own = sp.symbols(names, real=True)
    users = [*system.coordinates, *(x.diff() for x in system.coordinates), *system.parameters]
    lagrangian = exact(system.lagrangian).xreplace(dict(zip(users, own, strict=True)))
    L = symengine.sympify(lagrangian)
    plain = [symengine.sympify(s) for s in own]
    slopes = [L.diff(s) for s in plain[: 2 * n]]
    second = [slope.diff(s) for slope in slopes for s in plain[: 2 * n]]
    numbers = {s: symengine.sympify(sp.Float(x, 70)) for s, x in zip(plain, point, strict=True)}
    replacements, reduced = symengine.cse([*slopes, *second])
    for name, value in replacements:
        numbers[name] = value.subs(numbers).n(230, real=True)
    flat = [mp.mpf(str(e.subs(numbers).n(230, real=True))) for e in reduced]
    return flat[: 2 * n], flat[2 * n :]


def agrees_with_symengine(system, seed=0):
    n = system.n
    random = np.random.default_rng(seed)
    with mp.workdps(60):
        q, v = (random.uniform(0.2, 0.9, n) for _ in range(2))
        parameters = [float(x) for x in system.parameters.values()]
        found = jet_values(derive_jet(system.structure.plain), q, v, parameters)
        first, second = symengine_truth(system, [*q, *v, *parameters])
        size = 1 + max(map(abs, second))
        for i in range(n):
            assert abs(found["F", i] - first[i]) < mp.mpf("1e-30") * size
            assert abs(found["P", i] - first[n + i]) < mp.mpf("1e-30") * size
            for j in range(n):
                for name, a, b in (
                    ("F_q", i, j),
                    ("F_v", i, n + j),
                    ("P_q", n + i, j),
                    ("M", n + i, n + j),
                ):
                    gap = abs(found[name, i, j] - second[2 * n * a + b])
                    assert gap < mp.mpf("1e-30") * size, (system.name, name, i, j)


MODELS = {
    "puma560(3)": lambda: ss.systems.puma560(3),
    "water": ss.systems.water,
    "argon": ss.systems.argon,
    "n_body(4)": lambda: ss.systems.n_body(4),
    "dh_arm(3)": lambda: dh_arm(3),
    "n_pendulum(5)": lambda: ss.systems.n_pendulum(5),
    "heavy_top": ss.systems.heavy_top,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(MODELS, 2))
def test_jets_agree_with_symengine(name):
    agrees_with_symengine(MODELS[name]())


@pytest.mark.slow
@pytest.mark.parametrize("start", range(0, 300, 50))
def test_jets_of_random_systems_agree_with_symengine(start):
    for seed in range(start, start + 50):
        agrees_with_symengine(random_system(seed), seed)


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(MODELS, 1))
def test_jets_agree_with_casadi(name):
    """Doubles against doubles: the same entries up to rounding."""
    casadi = pytest.importorskip("casadi")
    system = MODELS[name]()
    n = system.n
    q, v = casadi.SX.sym("q", n), casadi.SX.sym("v", n)
    users = [*system.coordinates, *(x.diff() for x in system.coordinates)]
    own = sp.symbols(f"s0:{2 * n}")
    numbers = {a: sp.Float(x, 17) for a, x in system.parameters.items()}
    lagrangian = system.lagrangian.xreplace(dict(zip(users, own, strict=True))).xreplace(numbers)
    functions = {f: getattr(casadi, f) for f in ("sin", "cos", "tan", "exp", "log", "sqrt")}
    functions["acos"] = casadi.acos
    L = sp.lambdify(own, lagrangian, [functions], cse=True)(
        *(q[i] for i in range(n)), *(v[i] for i in range(n))
    )
    z = casadi.vertcat(q, v)
    evaluate = casadi.Function("f", [z], [casadi.gradient(L, z), casadi.hessian(L, z)[0]])
    random = np.random.default_rng(3)
    point = random.uniform(0.2, 0.9, 2 * n)
    first, second = (np.array(x) for x in evaluate(point))
    found = jet_values(
        derive_jet(system.structure.plain),
        point[:n],
        point[n:],
        [float(x) for x in system.parameters.values()],
    )
    size = 1 + abs(second).max()
    for i in range(n):
        assert abs(float(found["F", i]) - first[i, 0]) < 1e-12 * size
        for j in range(n):
            assert abs(float(found["F_q", i, j]) - second[i, j]) < 1e-12 * size
            assert abs(float(found["P_q", i, j]) - second[n + i, j]) < 1e-12 * size
            assert abs(float(found["M", i, j]) - second[n + i, n + j]) < 1e-12 * size


@pytest.mark.slow
def test_water_against_runge_and_kutta():
    """Ten femtoseconds of vibration, by gauss8 and by DOP853."""
    from scipy.integrate import solve_ivp

    from symsimpson.reference.first_order import canonical

    molecule = ss.systems.water()
    run = ss.compile(molecule, "gauss8").integrate(**molecule.reference_state, h=0.1, steps=100)
    rates = canonical(molecule).function("math")
    parameters = list(molecule.parameters.values())
    found = solve_ivp(
        lambda t, y: rates(*y, *parameters),
        (0, 10),
        [*run.q[0], *run.p[0]],
        "DOP853",
        rtol=1e-13,
        atol=1e-14,
    )
    np.testing.assert_allclose([*run.q[-1], *run.p[-1]], found.y[:, -1], rtol=1e-8, atol=1e-9)


@pytest.mark.slow
def test_the_outer_solar_system_over_a_century():
    """Against heyoka, with its own equations of motion."""
    heyoka = pytest.importorskip("heyoka")
    planets = ss.systems.outer_solar_system()
    state = planets.reference_state
    days = 36500.0
    run = ss.compile(planets, "kahan_li8").integrate(**state, h=25.0, t_end=days, every=None)
    values = {a.name: x for a, x in planets.parameters.items()}
    masses = [values[f"m{i}"] for i in range(6)]
    system = heyoka.model.nbody(6, masses=masses, Gconst=values["G"])
    q0, v0 = (np.reshape(state[key], (6, 3)) for key in ("q0", "v0"))
    integrator = heyoka.taylor_adaptive(system, np.hstack([q0, v0]).ravel(), tol=1e-16)
    integrator.propagate_until(days)
    truth = integrator.state.reshape(6, 6)[:, :3].ravel()
    assert abs(run.q[-1] - truth).max() < 1e-6  # astronomical units
