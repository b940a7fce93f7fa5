"""Steps in a time of their own: golden values of 50 digits, orders of q, p and t, what is kept.

``tests/data/golden_retimed.json``: decimal inputs, rates as they are, without a first value of one.
"""

import json

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep
from support.forms import limited
from support.places import DATA

import symsimpson as ss
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.quadrature import Quadrature

DATA = DATA / "golden_retimed.json"
EVERY = json.loads(DATA.read_text())["cases"]
CASES, COMPOSED = ([x for x in EVERY if kind in x] for kind in ("g", "composition"))
#: Coarse at its pericentre, where rounding is amplified.
AMPLIFIED = {"kepler_r_gauss8": 1e-9}
KINDS = {("lobatto", 3): "simpson", ("gauss", 4): "gauss8", ("gauss", 1): "midpoint"}


def stepper_of(case, **options):
    """Return a stepper of the case, and its rate at the start."""
    n = case["n"]
    q = ss.coordinates(" ".join(f"q{i}" for i in range(n)))
    symbols = {name: sp.Symbol(name, positive=True) for name in case["parameters"]}
    names = {x.func.__name__: x for x in q} | symbols | {"E0": ss.energy}
    names |= {f"v{i}": x.diff() for i, x in enumerate(q)}
    T, V, g = (sp.sympify(case[name], locals=names) for name in "TVg")
    values = {symbols[name]: float(value) for name, value in case["parameters"].items()}
    system = ss.MechanicalSystem("case", coordinates=q, kinetic=T, potential=V, parameters=values)
    exact = {symbols[name]: sp.Rational(x) for name, x in case["parameters"].items()}
    exact |= dict(zip(q, map(sp.Rational, case["q0"]), strict=True))
    exact[ss.energy] = sp.Float(case["results"]["E0"], 40)
    quadrature = case["scheme"]
    scheme = KINDS[quadrature["quadrature"], quadrature["nodes"]]
    return ss.compile(system.retimed(g), scheme, **options), g.subs(exact).evalf(40)


def run_of(case, number, **options):
    stepper, first = stepper_of(case, **options)
    read = np.frompyfunc(number, 1, 1)
    step = sp.Float(case["dtau"], 40) * first
    return stepper.integrate(
        read(case["q0"]),
        p0=read(case["p0"]),
        h=number(str(step)),
        steps=case["steps"],
        t0=number(case["t0"]),
        parameters={name: number(value) for name, value in case["parameters"].items()},
    )


def off(found, wanted, number):
    wanted = np.array([number(x) for x in np.atleast_1d(wanted)])
    return float(max(abs(found - wanted)) / max(1, *map(abs, wanted)))


def check(case, run, number, most):
    golden = case["results"]
    first, dense = golden["first_step"], golden["dense"]
    assert off(run.q[1], first["q1"], number) < most
    assert off(run.p[1], first["p1"], number) < most
    assert off(run.t[1:2], first["t1"], number) < most
    assert off(run.q[-1], golden["q"], number) < most
    assert off(run.p[-1], golden["p"], number) < most
    assert off(run.t[-1:], golden["t"], number) < most
    assert off(np.array([run.E0]), golden["E0"], number) < most
    between = run.at([number(case["t_dense"])])
    assert off(between.q[0], dense["q"], number) < most
    assert off(between.p[0], dense["p"], number) < most


@pytest.mark.parametrize("case", sweep(CASES, 1), ids=lambda case: case["name"])
def test_double_precision(case):
    check(case, run_of(case, float), float, AMPLIFIED.get(case["name"], 1e-13))


@pytest.mark.parametrize("case", sweep(CASES, 1), ids=lambda case: case["name"])
def test_many_digits(case):
    with mp.workdps(45):
        check(case, run_of(case, mp.mpf, precision=45), mp.mpf, 1e-30)


def verlet():
    half = sp.S.Half
    times = Quadrature("composition", (sp.S.Zero, sp.S.One), (half, half), 2)
    return Composition("verlet", times, 1, (sp.S.One,), "Stoermer and Verlet")


def composed_run(case, number, **options):
    """Run a case of kicks and drifts with f' = 1/x, that is g = -1/V."""
    q = ss.coordinates(" ".join(f"q{i}" for i in range(case["n"])))
    values = {sp.Symbol(a, positive=True): sp.Rational(x) for a, x in case["parameters"].items()}
    names = {x.func.__name__: x for x in q} | {a.name: a for a in values}
    V = sp.sympify(case["V"], locals=names)
    masses = [next((a for a in values if a.name == f"m{i // 2 + 1}"), 1) for i in range(len(q))]
    T = sum(m * x.diff() ** 2 for m, x in zip(masses, q, strict=True)) / 2
    system = ss.MechanicalSystem(
        "case",
        coordinates=q,
        kinetic=T,
        potential=V,
        parameters={a: float(x) for a, x in values.items()},
    )
    name = case["composition"]
    stepper = ss.compile(
        system.retimed(-1 / V), verlet() if name == "verlet" else ss.composition(name), **options
    )
    start = values | dict(zip(q, map(sp.Rational, case["q0"]), strict=True))
    step = sp.Float(str(case["dtau"]), 40) * (-1 / V).subs(start).evalf(40)
    read = np.frompyfunc(number, 1, 1)
    return stepper.integrate(
        read(case["q0"]), p0=read(case["p0"]), h=number(str(step)), steps=case["steps"]
    )


@pytest.mark.parametrize(
    "case",
    sweep(sorted(COMPOSED, key=lambda case: "suzuki" in case["name"])),
    ids=lambda case: case["name"],
)
@pytest.mark.parametrize("digits", [pytest.param(15, marks=pytest.mark.slow), 45])
def test_kicks_and_drifts(case, digits):
    number, most = (float, 1e-13) if digits == 15 else (mp.mpf, 1e-32)
    with mp.workdps(45):
        run = composed_run(case, number, **({} if digits == 15 else {"precision": digits}))
        golden = case["results"]
        for found, wanted in (
            (run.q[1], golden["first_step"]["q1"]),
            (run.p[1], golden["first_step"]["p1"]),
            (run.t[1:2], golden["first_step"]["t1"]),
            (run.q[-1], golden["q"]),
            (run.p[-1], golden["p"]),
            (run.t[-1:], golden["t"]),
            (np.array([run.E0]), golden["E0"]),
        ):
            assert off(found, wanted, number) < most


def kepler(**more):
    x, y = ss.coordinates("x y")
    return ss.MechanicalSystem(
        "kepler_plane",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-1 / sp.sqrt(x**2 + y**2),
        **more,
    )


def apocentre(e, number=float):
    e = number(e)
    return [1 + e, 0], [0, mp.sqrt((1 - e) / (1 + e))]


@pytest.fixture(scope="module")
def reference():
    """Half an orbit of eccentricity 0.6 in tau, and a little: q, p and t."""
    with mp.workdps(40):
        return states(ss.compile(kepler().retimed("encounters"), "gauss16", precision=40), 80)


def states(stepper, steps, e="0.6"):
    """Return q, p and t after the same tau, h being dtau in the unit of g at the start."""
    with mp.workdps(40):
        q0, v0 = apocentre(e, mp.mpf)
        span = 4 * (1 + mp.mpf(e)) ** 1.5
        run = stepper.integrate(q0, v0=v0, h=span / steps, steps=steps)
        return np.concatenate([run.q[-1], run.p[-1], run.t[-1:]])


def test_loops_keep_a_time_of_their_own(monkeypatch):
    """Kicks and drifts of large systems are those of a written-out step."""
    system, (q0, v0) = kepler().retimed("encounters"), apocentre(0.6)
    given = {"q0": q0, "v0": [float(x) for x in v0], "h": 0.05, "steps": 40}
    straight = ss.compile(system, "kahan_li6").integrate(**given)
    limited(monkeypatch, UNROLLED_FORCES=1)
    looped = ss.compile(system, "kahan_li6")
    assert "own_time(" in looped.source
    run = looped.integrate(**given)
    for found, wanted in ((run.q, straight.q), (run.p, straight.p), (run.t, straight.t)):
        assert np.abs(found - wanted).max() < 1e-14


ORDERS = [
    ("simpson", 4, 40),
    ("gauss8", 8, 12),
    ("midpoint", 2, 80),
    ("gauss4", 4, 40),
    ("lobatto6", 6, 20),
    ("gauss6", 6, 16),
]


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "order", "steps"), sweep(ORDERS, 1))
def test_orders_of_positions_momenta_and_time(scheme, order, steps, reference):
    stepper = ss.compile(kepler().retimed("encounters"), scheme, precision=40)
    errors = [abs(states(stepper, k * steps) - reference) for k in (1, 2)]
    parts = [[max(x[some]) for x in errors] for some in (slice(2), slice(2, 4), slice(4, 5))]
    found = [float(mp.log(coarse / fine, 2)) for coarse, fine in parts]
    assert found == pytest.approx([order] * 3, abs=0.1 if order < 8 else 0.25)


@pytest.mark.parametrize(
    ("scheme", "order", "steps"),
    sweep([("suzuki4", 4, 80), ("kahan_li6", 6, 60), ("kahan_li8", 8, 40)], 0),
)
def test_orders_of_kicks_and_drifts(scheme, order, steps, reference):
    system = kepler().retimed("encounters")
    stepper = ss.compile(system, ss.composition(scheme), precision=40)
    errors = [abs(states(stepper, k * steps) - reference) for k in (1, 2)]
    parts = [[max(x[some]) for x in errors] for some in (slice(2), slice(2, 4), slice(4, 5))]
    found = [float(mp.log(coarse / fine, 2)) for coarse, fine in parts]
    assert found == pytest.approx([order] * 3, abs=0.1 if order < 8 else 0.25)


@pytest.mark.slow
def test_time_by_the_rate_at_the_ends_of_steps_is_of_low_order(reference):
    """The sum over the nodes of the scheme keeps its order; these would not."""
    stepper = ss.compile(kepler().retimed("encounters"), "simpson", precision=40)
    errors = {"ends": [], "starts": []}
    for steps in (40, 80):
        with mp.workdps(40):
            q0, v0 = apocentre("0.6", mp.mpf)
            h = 4 * mp.mpf("1.6") ** 1.5 / steps
            run = stepper.integrate(q0, v0=v0, h=h, steps=steps)
            rate = (run.q**2).sum(axis=1) ** mp.mpf("0.75") / mp.mpf("1.6") ** 1.5
            times = {"ends": h * (rate[1:] + rate[:-1]).sum() / 2, "starts": h * rate[:-1].sum()}
        for name, t in times.items():
            errors[name].append(abs(t - reference[4]))
    orders = {name: float(mp.log(a / b, 2)) for name, (a, b) in errors.items()}
    assert orders == pytest.approx({"ends": 2, "starts": 1}, abs=0.2)


@pytest.mark.slow
def test_states_at_given_times_have_the_order_of_the_scheme():
    exact = ss.compile(kepler().retimed("encounters"), "gauss16", precision=40)
    with mp.workdps(40):
        q0, v0 = apocentre("0.6", mp.mpf)
        stepper = ss.compile(kepler().retimed("encounters"), "simpson", precision=40)
        ends = [
            one.integrate(q0, v0=v0, h=mp.mpf(8) / steps, t_end=mp.mpf(4), every=None)
            for one, steps in ((exact, 80), (stepper, 40), (stepper, 80))
        ]
        assert all(run.t[-1] == 4 for run in ends)
        errors = [max(abs(run.q[-1] - ends[0].q[-1])) for run in ends[1:]]
        assert float(mp.log(errors[0] / errors[1], 2)) == pytest.approx(4, abs=0.15)


@pytest.mark.slow
def test_there_and_back():
    stepper = ss.compile(kepler().retimed("encounters"), "gauss8")
    run = stepper.integrate([1.9, 0.0], v0=[0.0, 0.2], h=0.2, t_end=7.0)
    back = stepper.integrate(run.q[-1], p0=run.p[-1], h=-0.05, t0=7.0, t_end=0.0)
    assert back.t[-1] == 0.0
    assert np.abs(back.q[-1] - run.q[0]).max() < 1e-12


@pytest.mark.slow
def test_momenta_are_kept_where_the_rate_is_invariant():
    x, y = ss.coordinates("x y")
    p_x, p_y = ss.momenta(x, y)
    system = kepler(
        invariants={"angular momentum": x * p_y - y * p_x, "by v": x * y.diff() - y * x.diff()}
    )
    run = ss.compile(system.retimed(sp.sqrt(x**2 + y**2)), "simpson").integrate(
        [1.9, 0.0], v0=[0.0, 0.2], h=0.2, steps=400
    )
    for values in run.invariants.values():
        assert np.abs(values - values[0]).max() < 1e-14
    system = kepler(invariants={"angular momentum": x * p_y - y * p_x})
    run = ss.compile(system.retimed(1 / (1 + x**2)), "simpson").integrate(
        [1.9, 0.0], v0=[0.0, 0.2], h=0.02, steps=80
    )
    values = run.invariants["angular momentum"]
    assert 1e-13 < np.abs(values - values[0]).max() < 1e-6  # of the order of the scheme alone


@pytest.mark.slow
def test_what_tau_keeps_does_not_drift():
    """K = g (H - E0) swings within each orbit, and stays."""
    stepper = ss.compile(kepler().retimed("encounters"), "simpson")
    run = stepper.integrate([1.9, 0.0], v0=[0.0, 0.2], h=0.3, steps=200_000, every=7)
    rate = (run.q**2).sum(axis=1) ** 0.75 / 1.9**1.5
    K = rate * (run.energy - run.E0)
    blocks = np.array([part.mean() for part in np.array_split(K, 20)])
    assert np.abs(K).max() < 1e-3
    assert np.abs(blocks - blocks[0]).max() < 1e-2 * np.abs(K).max()


@pytest.mark.slow
def test_what_tau_keeps_does_not_drift_over_a_hundred_thousand_orbits():
    stepper = ss.compile(kepler().retimed("encounters"), "gauss8")
    run = stepper.integrate([1.6, 0.0], v0=[0.0, 0.5], h=1.0, steps=2_400_000, every=37)
    assert run.t[-1] > 1e5 * 2 * np.pi
    rate = (run.q**2).sum(axis=1) ** 0.75 / 1.6**1.5
    K = rate * (run.energy - run.E0)
    blocks = np.array([part.mean() for part in np.array_split(K, 40)])
    assert np.abs(K).max() < 1e-8
    assert np.abs(np.polyfit(range(40), blocks, 1)[0]) * 40 < 1e-2 * np.abs(K).max()


def test_steps_are_symplectic_in_positions_momenta_energy_and_time():
    """D^T J D = J of (q, p, E0, t), E0 paired with t: differences in 50 digits."""
    with mp.workdps(50):
        stepper = ss.compile(kepler().retimed("encounters"), "simpson", precision=50)
        z0 = np.array([mp.mpf(x) for x in ("1.3", "0.4", "0.1", "0.7")])

        def step(z):
            """One step with the same dtau, in the unit of the rate itself."""
            first = (z[0] ** 2 + z[1] ** 2) ** mp.mpf("0.75")
            run = stepper.integrate(z[:2], p0=z[2:4], h=mp.mpf("0.3") * first, steps=1)
            return np.concatenate([run.q[-1], run.p[-1], run.t[-1:]])

        # along the level of H nothing but (q, p) moves: E0 follows, and t tells of it
        eps = mp.mpf(10) ** -16
        columns = []
        for k in range(4):
            d = np.array([mp.mpf(int(i == k)) for i in range(4)])
            columns.append((step(z0 + eps * d) - step(z0 - eps * d)) / (2 * eps))
        D = np.array(columns).T
        q, p = z0[:2], z0[2:]
        r = mp.sqrt(q[0] ** 2 + q[1] ** 2)
        slope = np.array([q[0] / r**3, q[1] / r**3, p[0], p[1]])  # of E0 = H
        full = np.vstack([D[:4], slope, D[4]])  # q, p, E0, t
        form = np.zeros((6, 6), dtype=object)
        for i, j in ((0, 2), (1, 3), (4, 5)):
            form[i, j], form[j, i] = 1, -1
        start = np.vstack([np.eye(4, dtype=object), slope, 0 * slope])
        defect = full.T @ form @ full - start.T @ form @ start
        scale = max(abs(x) for x in (full.T @ full).ravel())
        assert max(abs(x) for x in defect.ravel()) < mp.mpf(10) ** -25 * scale
