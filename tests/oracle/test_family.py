"""Every member of the family: order, geometry, equivalences, and the iteration over stages."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest
from support.bindings import bind_float
from support.cases import sweep
from support.oracle import nodes_and_weights
from support.workspace import new_workspace

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.program.digits import MOST_BY_STAGES
from symsimpson.reference import canonical
from symsimpson.schemes.named import read_scheme
from symsimpson.stepping.run import Run
from symsimpson.targets.binding import bind_mpmath

PENDULUM, TOP = ss.systems.double_pendulum(), ss.systems.lagrange_top()

#: Schemes of each kind up to order 10.
SCHEMES = [
    "midpoint",
    "simpson",
    "lobatto6",
    "lobatto8",
    "lobatto10",
    "gauss4",
    "gauss6",
    "gauss8",
    "gauss10",
    "lobatto2",
    "lobatto_2_2",
    "lobatto_3_3",
    "lobatto_4_4",
    "lobatto_5_5",
    "gauss_3_2",
    "gauss_4_3",
]
#: With so many digits nothing is iterated over stages.
BY_NEWTON = MOST_BY_STAGES + 1
BY_STAGES = ["gauss6", "gauss8", "gauss12", "gauss16", "lobatto_3_3", "lobatto_5_5"]


def end(system, scheme, steps, t_end, precision=50):
    stepper = ss.compile(system, scheme, precision=precision, arithmetic="arb")
    run = stepper.integrate(
        **system.reference_state, h=mpmath.mpf(t_end) / steps, steps=steps, every=None
    )
    return np.concatenate([run.q[0], run.p[0]])


@pytest.mark.parametrize("scheme", sweep(SCHEMES))
@pytest.mark.parametrize(
    ("system", "t_end"), sweep([(PENDULUM, "0.125"), (TOP, "0.125")]), ids=["pendulum", "top"]
)
def test_order(system, t_end, scheme):
    """In 50 digits, from the differences of runs with h, h/2, h/4 and h/8."""
    ends = [end(system, scheme, steps, t_end) for steps in (6, 12, 24, 48)]
    scale = np.abs(ends[-1]).astype(float).max() if system is TOP else 1.0
    gaps = [float(np.abs(a - b).max()) / scale for a, b in pairwise(ends)]
    found = np.log2(np.array(gaps[:-1]) / np.array(gaps[1:]))
    assert abs(found[-1] - read_scheme(scheme).order) < 0.15, (found, gaps)


def runge_kutta_step(system, kind, stages, h):
    """One step of the partitioned Runge-Kutta method of a quadrature, from its definition."""
    n = system.n
    rates, values = canonical(system).function("mpmath"), canonical(system).values(None)
    values = [mpmath.mpf(x) for x in values]
    start = system.reference_state
    q, p = ([mpmath.mpf(float(x)) for x in start[k]] for k in ("q0", "p0"))
    c, _ = nodes_and_weights(kind, stages)

    def basis(j):
        polynomial = [mpmath.mpf(1)]
        for k, x in enumerate(c):
            if k != j:
                shifted = [mpmath.mpf(0), *polynomial]
                polynomial = [a - x * b for a, b in zip(shifted, [*polynomial, 0], strict=True)]
                polynomial = [a / (c[j] - x) for a in polynomial]
        return polynomial

    def integral(j, x):
        return sum(a * x ** (k + 1) / (k + 1) for k, a in enumerate(basis(j)))

    b = [integral(j, mpmath.mpf(1)) for j in range(stages)]
    a = [[integral(j, c[i]) for j in range(stages)] for i in range(stages)]
    hat = [[b[j] - b[j] * a[j][i] / b[i] for j in range(stages)] for i in range(stages)]
    K = [[mpmath.mpf(0)] * (2 * n) for _ in range(stages)]
    for _ in range(200):
        before = K
        K = []
        for i in range(stages):
            Q = [q[x] + h * sum(a[i][j] * before[j][x] for j in range(stages)) for x in range(n)]
            P = [
                p[x] + h * sum(hat[i][j] * before[j][n + x] for j in range(stages))
                for x in range(n)
            ]
            K.append(rates(*Q, *P, *values))
        if (
            max(
                abs(x - y)
                for u, v in zip(K, before, strict=True)
                for x, y in zip(u, v, strict=True)
            )
            < mpmath.mpf(10) ** -58
        ):
            break
    return [x + h * sum(b[j] * K[j][m] for j in range(stages)) for m, x in enumerate([*q, *p])]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "stages"),
    sweep([("gauss", 2), ("gauss", 3), ("gauss", 6), ("lobatto", 3), ("lobatto", 5)], 2),
)
def test_as_many_nodes_as_degrees_are_runge_kutta_methods(kind, stages):
    """Gauss methods, and Lobatto IIIA-IIIB, to 1e-30 in 64 digits."""
    with mpmath.workdps(64):
        h = mpmath.mpf("0.05")
        oracle = runge_kutta_step(PENDULUM, kind, stages, h)
        stepper = ss.compile(PENDULUM, ss.galerkin(kind, stages, stages), precision=64)
        run = stepper.integrate(**PENDULUM.reference_state, h=h, steps=1, every=None)
        found = [*run.q[0], *run.p[0]]
        assert max(abs(x - y) for x, y in zip(found, oracle, strict=True)) < 1e-30


@pytest.mark.parametrize("momentum", sweep([0.0, 0.02], 2))
def test_stages_look_at_the_velocities_of_cyclic_coordinates(momentum):
    """They leave the path by h^4, squared; of the top as a plane pendulum there are none."""
    module = bind_float(source(TOP, "gauss6"))
    p, jumps = [momentum, 0.01, momentum / 2], []
    for h in (0.01, 0.005):
        W = new_workspace(module, [0.0, 0.5, 0.0], p, TOP.parameters.values())
        module.prepare(h, 0.0, W)
        module.start_stages(h, 0.0, W)
        for _ in range(20):
            module.iterate(h, 0.0, W)
        W[module.ACTIVE, 0] = 1
        module.advance_stages(h, 0.0, W)
        jumps.append(W[module.CYCLIC_JUMP_SQUARED, 0])
    if momentum:
        assert 2**7 < jumps[0] / jumps[1] < 2**9
    else:
        assert jumps == [0, 0]


@pytest.mark.parametrize("scheme", sweep(["gauss6", "gauss12", "lobatto_3_3", "lobatto_5_5"]))
@pytest.mark.parametrize("system", sweep([PENDULUM, TOP]), ids=["pendulum", "top"])
def test_stages_solve_the_equations(system, scheme):
    """The kernels over stages, run in 40 digits, come to what Newton's method comes to."""
    h = "0.01"
    with mpmath.workdps(40):
        module = bind_mpmath(source(system, scheme), mpmath.mp, checking=True)
        W = np.full((module.ROWS, 1), mpmath.mpf(0), dtype=object)
        newton = ss.compile(system, scheme, precision=BY_NEWTON)
        start = newton.integrate(**system.reference_state, h=h, steps=0)
        blocks = {
            "POSITION": start.q[0],
            "MOMENTUM": start.p[0],
            "PARAMETER": [mpmath.mpf(x) for x in system.parameters.values()],
        }
        for name, values in blocks.items():
            first = getattr(module, name)
            W[first : first + len(values), 0] = values
        module.prepare(mpmath.mpf(h), 0, W)
        module.start_stages(mpmath.mpf(h), 0, W)
        W[module.CONTRACTION, 0] = 1
        for _ in range(3):
            W[module.RELATIVE, 0] = mpmath.inf
            W[module.ACTIVE, 0] = 1
            for _ in range(120):
                module.iterate(mpmath.mpf(h), 0, W)
                if W[module.ACTIVE, 0] != 1:
                    break
            assert W[module.ACTIVE, 0] == 0
            W[module.ACTIVE, 0] = 1
            module.advance_stages(mpmath.mpf(h), 0, W)
        run = newton.integrate(**system.reference_state, h=h, steps=3, every=None)
        n = system.n
        for block, values in (("POSITION", run.q[0]), ("MOMENTUM", run.p[0])):
            first = getattr(module, block)
            scale = max(map(abs, values))
            gaps = [abs(x - y) for x, y in zip(W[first : first + n, 0], values, strict=True)]
            assert max(gaps) < 1e-34 * scale


@pytest.mark.parametrize("scheme", sweep(BY_STAGES))
@pytest.mark.parametrize(
    "name",
    sweep(
        [
            "double_pendulum",
            "lagrange_top",
            "heavy_top",
            "kepler",
            "henon_heiles",
            "ellipsoid_geodesic",
        ]
    ),
)
def test_compiled_stages_against_many_digits(name, scheme):
    system = ss.systems.CATALOGUE[name]()
    stepper = ss.compile(system, scheme)
    assert stepper.program.header.by_stages
    h = 1 / 64
    run = stepper.integrate(**system.reference_state, h=h, steps=20)
    precise = ss.compile(system, scheme, precision=BY_NEWTON, arithmetic="arb")
    exact = precise.integrate(run.q[0], p0=run.p[0], h=h, steps=20, every=None)
    for found, values in ((run.q[-1], exact.q[0]), (run.p[-1], exact.p[0])):
        gap = np.abs((found - values).astype(float)).max()
        assert gap < 2e-13 * max(1.0, np.abs(values.astype(float)).max())


@pytest.mark.parametrize("scheme", sweep(BY_STAGES))
@pytest.mark.parametrize(
    ("system", "h"), sweep([(PENDULUM, 0.05), (TOP, 0.05)]), ids=["pendulum", "top"]
)
def test_stages_are_reversible(system, h, scheme):
    stepper = ss.compile(system, scheme)
    there = stepper.integrate(**system.reference_state, h=h, steps=100)
    back = stepper.integrate(there.q[-1], p0=there.p[-1], h=-h, steps=100, every=None)
    scale = np.maximum(1.0, np.abs(there.q).max(axis=0))
    assert np.abs((back.q[0] - there.q[0]) / scale).max() < 2e-12
    assert np.abs(back.p[0] - there.p[0]).max() < 2e-12 * max(1.0, np.abs(there.p[0]).max())


def test_the_trapezoidal_rule_is_stoermer_verlet():
    """Where M is constant a step is explicit: kick, drift, kick."""
    system = ss.systems.henon_heiles()
    stepper = ss.compile(system, "lobatto2")
    assert stepper.program.header.newton_unknowns == 0
    run = stepper.integrate(**system.reference_state, h=0.05, steps=100)
    (q, p), h = (run.q[0].copy(), run.p[0].copy()), 0.05

    def force(q):
        return -np.array([q[0] + 2 * q[0] * q[1], q[1] + q[0] ** 2 - q[1] ** 2])

    for _ in range(100):
        p += h / 2 * force(q)
        q += h * p
        p += h / 2 * force(q)
    assert np.abs(run.q[-1] - q).max() < 1e-14
    assert np.abs(run.p[-1] - p).max() < 1e-14
    assert run.newton_iterations.sum() == 0


@pytest.mark.parametrize("scheme", sweep(BY_STAGES))
def test_stages_keep_cyclic_momenta(scheme):
    run = ss.compile(TOP, scheme).integrate(**TOP.reference_state, h=0.01, steps=500)
    assert np.ptp(run.p[:, [0, 2]], axis=0).max() == 0.0


@pytest.fixture
def used_sets(monkeypatch):
    """The kernels that a run came to use."""
    used = []
    change = Run._change_to
    monkeypatch.setattr(Run, "_change_to", lambda self, k: (used.append(k), change(self, k)))
    return used


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*turns by 15 rad in a step:symsimpson.StabilityWarning")
def test_newton_takes_over_where_stages_do_not_converge(used_sets):
    """A stiff spring: h omega = 15, far beyond what the iteration contracts for."""
    system, given = ss.systems.elastic_pendulum(), {"k": 2e5}
    omega = given["k"] ** 0.5  # the mass is 1
    stepper = ss.compile(system, "gauss6")
    state = {"q0": [1.0 + 9.81 * np.cos(0.3) / given["k"], 0.3], "v0": [0.0, 0.0]}
    run = stepper.integrate(**state, h=15 / omega, steps=200, parameters=given)
    assert 1 in used_sets
    assert np.abs(run.energy_error).max() < 1e-6
    used_sets.clear()
    stepper.integrate(**state, h=0.5 / omega, steps=200, parameters=given)
    assert not used_sets


@pytest.mark.slow
def test_what_stages_cannot_solve_is_never_a_false_success():
    """Steps far too large: what is called a success has about its energy."""
    stepper = ss.compile(PENDULUM, "gauss16")
    angles = np.random.default_rng(1).uniform(-2, 2, (40, 2))
    for h in (0.1, 0.2):
        for q0 in angles:
            run = stepper.integrate(q0, p0=[0, 0], h=h, steps=40, on_failure="return")
            off = np.abs(run.energy - run.energy[0]).max()
            assert off < 0.1 or run.status is ss.Status.STEP_TOO_LARGE
