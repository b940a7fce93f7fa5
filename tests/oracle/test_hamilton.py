"""General Lagrangians and Hamiltonians against golden values with 32 digits, and exact motions."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.hamilton_cases import CASES, EXACT, declared, relative_error, start_of

import symsimpson as ss


def case_ids(case):
    return case["name"]


@pytest.mark.parametrize("case", sweep(CASES, 3), ids=case_ids)
def test_states_in_double_precision(case):
    stepper = ss.compile(declared(case["name"]), case["scheme"]["name"])
    run = stepper.integrate(**start_of(case), steps=case["steps"])
    for k, state, bound in ((1, case["first_step"], 1e-13), (-1, case["final"], 1e-12)):
        assert relative_error([*run.q[k], *run.p[k]], [*state["q"], *state["p"]]) < bound
        assert relative_error(run.v[k], state["v"]) < 10 * bound
        assert relative_error([run.energy[k]], [state["H"]]) < 10 * bound


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=case_ids)
def test_states_in_many_digits(case):
    stepper = ss.compile(declared(case["name"]), case["scheme"]["name"], precision=40)
    with mp.workdps(40):
        run = stepper.integrate(
            **start_of(case, mp.mpf),
            steps=case["steps"],
            every=None,
            parameters={name: mp.mpf(value) for name, value in case["parameters"].items()},
        )
        final = case["final"]
        assert relative_error([*run.q[0], *run.p[0]], [*final["q"], *final["p"]]) < 1e-28


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=case_ids)
def test_tangents(case):
    stepper = ss.compile(declared(case["name"]), case["scheme"]["name"])
    start = start_of(case)
    given = {name[0]: start[name] for name in ("v0", "p0") if name in start}
    if "v" in given:
        given = {"p": [float(x) for x in case["p0_of_v0"]]}
    *_, found = stepper.tangent(start["q0"], **given, h=start["h"], t=start["t0"])
    truth = np.array(case["first_step"]["tangent"], dtype=float)
    assert np.abs(found - truth).max() < 1e-11 * np.abs(truth).max()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["midpoint", "gauss4", "lobatto_3_3", "gauss8"])
def test_a_quadratic_lagrangian_and_its_hamiltonian_agree(scheme):
    """L = v.M(q).v/2 + a.v - V, H = (p - a).M^-1 (p - a)/2 + V."""
    x, y = ss.coordinates("x y")
    px, py = sp.symbols("px py", real=True)
    M, a, V = sp.Matrix([[2 + sp.cos(x), y / 5], [y / 5, 1]]), sp.Matrix([y, -x]) / 3, x**4 + y**2
    v, p = sp.Matrix([x.diff(), y.diff()]), sp.Matrix([px, py])
    L = (v.T * M * v)[0] / 2 + a.dot(v) - V
    H = ((p - a).T * M.inv() * (p - a))[0] / 2 + V
    one = ss.MechanicalSystem.from_lagrangian("by_l", L, (x, y), {})
    other = ss.HamiltonianSystem("by_h", coordinates=(x, y), momenta=(px, py), hamiltonian=H)
    runs = [
        ss.compile(system, scheme).integrate([0.4, -0.3], p0=[0.5, 0.2], h=0.05, steps=100)
        for system in (one, other)
    ]
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=0, atol=1e-13)
    np.testing.assert_allclose(runs[0].p, runs[1].p, rtol=0, atol=1e-13)
    np.testing.assert_allclose(runs[0].v, runs[1].v, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_fast_charge_turns_with_the_exact_period():
    x, y = ss.coordinates("x y")
    given, exact = (
        {k: float(v) for k, v in EXACT["relativistic_cyclotron"][key].items()}
        for key in ("parameters", "values")
    )
    m, c, e, B = (given[k] for k in "mceB")
    speed = (x.diff() ** 2 + y.diff() ** 2) / c**2
    L = -m * c**2 * sp.sqrt(1 - speed) + e * B * (x * y.diff() - y * x.diff()) / 2
    system = ss.MechanicalSystem.from_lagrangian("cyclotron", L, (x, y), {})
    start = {"v0": [0.0, exact["speed"]], "h": exact["period"] / 200, "steps": 200}
    run = ss.compile(system, "gauss12").integrate([exact["radius"], 0.0], **start)
    assert np.abs(run.q[-1] - run.q[0]).max() < 1e-10
    assert abs(run.energy[0] - exact["energy"]) < 1e-12


@pytest.mark.slow
def test_two_vortices_turn_about_each_other():
    values = EXACT["vortex_pair"]["values"]
    g = [float(EXACT["vortex_pair"]["parameters"][name]) for name in ("g1", "g2")]
    x, p = ss.coordinates("x1 x2"), sp.symbols("p1 p2", real=True)
    distance = (x[0] - x[1]) ** 2 + (p[0] / g[0] - p[1] / g[1]) ** 2
    H = -g[0] * g[1] * sp.log(distance) / (4 * sp.pi)
    pair = ss.HamiltonianSystem("pair", coordinates=x, momenta=p, hamiltonian=H)
    start = [float(value) for value in values["start"]["x"]]
    period = float(values["period"])
    run = ss.compile(pair, "gauss12").integrate(start, p0=[0, 0], h=period / 100, steps=100)
    assert np.abs(run.q[-1] - run.q[0]).max() < 1e-11
    assert np.abs(run.p[-1] - run.p[0]).max() < 1e-11


@pytest.mark.slow
def test_the_triangular_point_stays_and_has_two_frequencies():
    system = ss.systems.restricted_three_bodies()
    point = EXACT["restricted_three_bodies"]["values"]["L4"]
    x, y = float(point["x"]), float(point["y"])
    stepper = ss.compile(system, "gauss12")
    run = stepper.integrate([x, y], p0=[-y, x], h=0.2, steps=100)
    assert np.abs(run.q - [x, y]).max() < 1e-12
    *_, D = stepper.tangent([x, y], p=[-y, x], h=0.2)
    found = np.sort(np.abs(np.angle(np.linalg.eigvals(D))) / 0.2)[::2]
    np.testing.assert_allclose(found, [float(w) for w in point["frequencies"]], rtol=0, atol=1e-10)


@pytest.mark.slow
def test_a_kerr_orbit_has_the_published_frequencies():
    """Per unit of the distant clock, from the mean advance over 50 radial periods."""
    system = ss.systems.kerr_geodesic()
    r = system.coordinates[1]
    turn = ss.Event(r.diff(), name="apocentre", direction=-1, terminal=50)
    stepper = ss.compile(system, "gauss12")
    run = stepper.integrate(**system.reference_state, h=1.0, t_end=7000.0, events=[turn])
    passed, _, turned = run.q[-1]
    assert abs(2 * np.pi * 50 / passed - 0.0376456484052298) < 1e-9
    assert abs(turned / passed - 0.0581612206109147) < 1e-9


@pytest.mark.slow
def test_the_pericentre_of_a_binary_advances():
    system = ss.systems.post_newtonian_binary()
    values = EXACT["post_newtonian_advance"]["values"]
    turn = ss.Event("x*v_x + y*v_y", name="apocentre", direction=-1, terminal=True)
    run = ss.compile(system, "gauss12").integrate(
        **system.reference_state, h=0.02, t_end=20.0, events=[turn]
    )
    angle = 2 * np.pi + np.arctan2(run.q[-1, 1], run.q[-1, 0])
    assert abs(angle - float(values["phi_per_orbit"])) < 1e-9
    assert abs(run.t[-1] - float(values["period"])) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        ("relativistic_charge", "gauss6"),
        ("post_newtonian_binary", "gauss8"),
        ("point_vortices", "gauss4"),
    ],
)
def test_certificates_pass(name, scheme):
    certificate = ss.compile(ss.systems.GENERAL[name](), scheme).certify()
    assert certificate.passed, str(certificate)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["relativistic_charge", "post_newtonian_binary"])
def test_the_energy_has_no_trend_over_a_million_steps(name):
    system = ss.systems.GENERAL[name]()
    run = ss.compile(system, "gauss8").integrate(
        **system.reference_state, h=0.1, steps=1_000_000, every=1000
    )
    first, last = np.abs(run.energy_error[1:101]).max(), np.abs(run.energy_error[-100:]).max()
    assert last < 1.5 * first + 1e-12


@pytest.mark.slow
def test_optimal_control_of_a_fast_particle():
    """The least integral of u^2 for a relativistic particle, against Pontryagin's equations."""
    pytest.importorskip("casadi")
    solve_bvp = pytest.importorskip("scipy.integrate").solve_bvp
    (x,), u = ss.coordinates("x"), sp.Symbol("u", real=True)
    system = ss.MechanicalSystem.from_lagrangian(
        "fast", -sp.sqrt(1 - x.diff() ** 2), (x,), {}, forces={x: u}, inputs=(u,)
    )
    ends = {"start": {x: 0, x.diff(): 0}, "end": {x: 1, x.diff(): 0}, "duration": 2.0}
    result = ss.OptimalControl(system, cost=u**2, **ends).solve("lobatto6", steps=20)
    assert result.success

    def rates(t, state):
        _, p, push, pull, _ = state
        speed = np.sqrt(1 + p**2)
        return np.vstack([p / speed, push, -pull / speed**3, 0 * t, push**2])

    def at_ends(first, last):
        return np.array([*first[[0, 1, 4]], last[0] - 1, last[1]])

    t = np.linspace(0, 2, 50)
    guess = np.vstack([t / 2, np.sin(np.pi * t / 2) / 2, 1 - t, 1 + 0 * t, t])
    truth = solve_bvp(rates, at_ends, t, guess, tol=1e-9, max_nodes=100_000)
    assert truth.success
    assert abs(result.cost - truth.y[4, -1]) < 1e-6
