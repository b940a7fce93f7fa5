"""Every reduction is the same scheme: reduced steppers against general ones, many digits, drift."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.cases import sweep
from support.random_systems import random_state, structured_system
from support.workspace import begin, block, new_workspace, state, take_step

import symsimpson as ss
from symsimpson.lower.pipeline import source
from symsimpson.targets.binding import bind_mpmath
from symsimpson.targets.counting import cost

STEPS = 200
SCHEMES = ("simpson", "midpoint")


def run(module, W, h, steps, most=12):
    """Steps with Newton to stagnation."""
    for _ in range(steps):
        last = np.inf
        for _ in range(most if module.NEWTON_UNKNOWNS else 0):
            module.newton(h, 0.0, W)
            size = W[module.CORRECTION_SQUARED, 0]
            if size == 0 or (size >= last and size < 1e-22 * W[module.INCREMENT_SQUARED, 0]):
                break
            last = size
        module.advance(h, 0.0, W)
    return np.array(state(module, W))


def momenta(module, q, v, parameters):
    W = new_workspace(module, q, [0.0] * len(q), parameters)
    W[block(module, "VELOCITY", len(q)), 0] = v
    module.prepare(1.0, 0.0, W)
    module.legendre(1.0, 0.0, W)
    return list(W[block(module, "MOMENTUM", len(q)), 0])


def gap(system, scheme, q, p, h, steps=STEPS):
    """Largest difference of the reduced and the general path, relative to q and to p."""
    ends = []
    for exploit in ((), "all"):
        module = bind_float(source(system, scheme, exploit))
        W = begin(module, q, p, system.parameters.values(), h)
        ends.append(run(module, W, h, steps).reshape(2, -1))
    size = np.abs(ends[0]).max(axis=1, keepdims=True)
    return (np.abs(ends[0] - ends[1]) / size).max()


@pytest.mark.parametrize("scheme", sweep(SCHEMES))
@pytest.mark.parametrize("name", sweep(ss.systems.CATALOGUE, 2))
def test_catalogue(name, scheme):
    system = ss.systems.CATALOGUE[name]()
    given = system.reference_state
    p = given.get("p0")
    if p is None:
        module = bind_float(source(system, scheme))
        p = momenta(module, given["q0"], given["v0"], system.parameters.values())
    assert gap(system, scheme, given["q0"], p, 0.005) < 1e-12


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4"]))
def test_three_cyclic_coordinates(scheme):
    """Their masses change from node to node, and each is coupled to each."""
    x, *turned = q = ss.coordinates("x a b c")
    v = [one.diff() for one in q]
    kinetic = sum((3 + sp.cos(k * x)) * u**2 for k, u in enumerate(v))
    kinetic += sum(sp.sin((i + 2 * k) * x) * v[i] * v[k] / 2 for k in range(4) for i in range(k))
    system = ss.MechanicalSystem("cyclic", coordinates=q, kinetic=kinetic / 2, potential=x**2)
    assert set(system.structure.cyclic) == {str(one.func) for one in turned}
    assert gap(system, scheme, [0.3, 0, 0, 0], [0.5, 1.0, -0.7, 0.4], 0.1, 5) < 1e-13


@pytest.mark.parametrize("start", sweep(range(0, 200, 2), 0))
def test_planted_structure(start):
    for seed in range(start, start + 2):
        system, planted = structured_system(seed)
        check_found(system, planted)
        q, v = random_state(seed, system.n)
        scheme = SCHEMES[seed % 2] if seed % 5 else ("gauss4", "lobatto6", "lobatto_3_3")[seed % 3]
        assert gap(system, scheme, q, v, 0.02) < 1e-12, (seed, scheme, planted)


def check_found(system, planted):
    found = system.structure
    assert ("cyclic" in planted) <= bool(found.cyclic)
    assert ("decoupled" in planted) <= (len(found.subsystems) > 1)
    assert ("linear" in planted) <= any(s.linear for s in found.subsystems)
    assert ("constant" in planted) <= any(s.separable and not s.linear for s in found.subsystems)
    if "plain" in planted:
        assert any(not s.constant_mass and not s.cyclic for s in found.subsystems)


@pytest.mark.parametrize("seed", sweep(range(0, 200, 10), 0))
def test_planted_structure_compiled(seed):
    system, _ = structured_system(seed)
    q, v = random_state(seed, system.n)
    ends = [
        ss.compile(system, SCHEMES[seed // 10 % 2], exploit=exploit).integrate(
            q, p0=v, h=0.02, steps=STEPS, every=None
        )
        for exploit in ((), "all")
    ]
    for a, b in ((ends[0].q, ends[1].q), (ends[0].p, ends[1].p)):
        assert np.abs(a - b).max() < 1e-12 * np.abs(a).max()


@pytest.mark.parametrize(
    ("exploit", "seed"),
    sweep([("cyclic", 2), (["cyclic", "decoupled"], 5), (["linear", "sparse"], 17)], 0),
)
def test_some_findings_alone(exploit, seed):
    """On systems of which they make other code than no findings and than all."""
    system, _ = structured_system(seed)
    texts = [source(system, "simpson", chosen) for chosen in ((), exploit, "all")]
    assert len(set(texts)) == 3
    q, v = random_state(seed, system.n)
    ends = []
    for text in texts[:2]:
        module = bind_float(text)
        ends.append(run(module, begin(module, q, v, system.parameters.values(), 0.02), 0.02, 50))
    assert np.abs(ends[0] - ends[1]).max() < 1e-12 * np.abs(ends[0]).max()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(SCHEMES))
def test_top_near_the_vertical(scheme):
    """Where the mass matrix is nearly singular the reduced path keeps the digits."""
    system, h = ss.systems.lagrange_top(), 0.01
    values = list(system.parameters.values())
    general, reduced = (source(system, scheme, exploit) for exploit in ((), "all"))
    q = [0.0, 1e-3, 0.0]
    p = momenta(bind_float(general), q, [9.2, 0.0, 252.0], values)
    ends = []
    for text in (general, reduced):
        module = bind_float(text)
        ends.append(run(module, begin(module, q, p, values, h), h, STEPS))
    with mp.workdps(60):
        module = bind_mpmath(general)
        exact = [[mp.mpf(x) for x in numbers] for numbers in (q, p, values)]
        W = begin(module, *exact, mp.mpf(h), dtype=object)
        for _ in range(STEPS):
            for _ in range(7):
                module.newton(mp.mpf(h), 0, W)
            module.advance(mp.mpf(h), 0, W)
        truth = state(module, W)
        errors = np.array(
            [[abs(float(x - y)) for x, y in zip(end, truth, strict=True)] for end in ends]
        )
    assert errors[1, 1] < 1e-12
    assert (errors[1] <= errors[0] + 1e-15).all()
    assert errors[0, 0] > 1e-12  # else this is no test of it
    assert errors[1, [0, 2]].max() < 1e-12  # the angles about the axis, too


@pytest.mark.parametrize("scheme", SCHEMES)
def test_how_much_cyclic_masses_change(scheme):
    """From start, middle and end of a step of the top, where one factor is that of sin^2 theta."""
    system = ss.systems.lagrange_top()
    module = bind_float(source(system, scheme))
    q = [0.2, 0.7, 0.1]
    W = begin(module, q, [3.0, -0.2, 4.0], system.parameters.values(), 0.005)
    for _ in range(8):
        module.newton(0.005, 0.0, W)
    module.advance(0.005, 0.0, W)
    end = W[module.POSITION + 1, 0]
    middle = q[1] + W[module.SOLVED + 1, 0] if scheme == "simpson" else (q[1] + end) / 2
    mass = np.sin([q[1], middle, end]) ** 2
    spread = mass.mean() * (1 / mass).mean() - 1
    assert spread > 1e-6
    assert W[module.CYCLIC_MASS_CHANGE, 0] == pytest.approx(spread, rel=1e-6)


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4", "gauss_3_2"]))
def test_how_far_cyclic_velocities_are_from_a_path(scheme):
    """At the end of a step, in the error of an extrapolation of degree one, squared, times h^2."""
    system = ss.systems.lagrange_top()
    module = bind_float(source(system, scheme))
    found = []
    for h in (0.02, 0.01, 0.005):
        W = begin(module, [0.2, 0.7, 0.1], [0.03, -0.002, 0.04], system.parameters.values(), h)
        take_step(module, W, h)
        found.append(W[module.CYCLIC_JUMP_SQUARED, 0])
    assert 5.9 < np.log2(found[0] / found[1]) < 6.2
    assert 5.9 < np.log2(found[1] / found[2]) < 6.2


@pytest.mark.slow
def test_cyclic_momenta_do_not_change_a_bit():
    for name in ("lagrange_top", "cart_pole", "heavy_top", "kepler"):
        system = ss.systems.CATALOGUE[name]()
        found = ss.compile(system).integrate(**system.reference_state, h=0.01, steps=500)
        names = [c.func.__name__ for c in system.coordinates]
        for coordinate in system.structure.cyclic:
            assert np.ptp(found.p[:, names.index(coordinate)]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(SCHEMES))
def test_linear_systems_do_not_drift(scheme):
    """A step is q1 = a q + b p, p1 = c q + a p: p^2 - c q^2 / b stands still but for rounding."""
    stepper = ss.compile(ss.systems.harmonic_oscillator(), scheme)
    h, steps = 0.1, 8_000_000
    c = stepper.step([1.0], p=[0.0], h=h)[1][0]
    b = stepper.step([0.0], p=[1.0], h=h)[0][0]
    run = stepper.integrate([1.0], p0=[0.3], h=h, steps=steps, every=1000)
    assert run.newton_iterations.max() == 0
    invariant = run.p[:, 0] ** 2 - c / b * run.q[:, 0] ** 2
    blocks = invariant[1:].reshape(4, -1).mean(axis=1) / invariant[0]
    assert np.ptp(blocks) < 4 * 2**-52 * h * np.sqrt(steps)  # a random walk of compensated sums


def test_linear_system_against_its_matrix():
    """Two coupled oscillators with a constant force: the step of the theory, in 40 digits."""
    system, _ = next(
        (s, p) for s, p in map(structured_system, range(200)) if p == {"linear"} and s.n == 2
    )
    text = source(system, "simpson")
    assert "def newton_pivoted" not in text
    q, p, h = [0.3, -0.2], [0.1, 0.4], 0.3
    with mp.workdps(40):
        ends = []
        for exploit in ((), "all"):
            module = bind_mpmath(source(system, "simpson", exploit))
            numbers = [[mp.mpf(x) for x in x_] for x_ in (q, p, system.parameters.values())]
            W = begin(module, *numbers, mp.mpf(h), dtype=object)
            for _ in range(20):
                for _ in range(3 if module.NEWTON_UNKNOWNS else 0):
                    module.newton(mp.mpf(h), 0, W)
                module.advance(mp.mpf(h), 0, W)
            ends.append(state(module, W))
        for a, b in zip(*ends, strict=True):
            assert abs(a - b) < mp.mpf(10) ** -36


def test_linear_forces_without_a_value_at_the_origin():
    """They are evaluated at another point."""
    x, y = ss.coordinates("x y")
    V = x**2 + x * y + y**2
    kinetic = x.diff() ** 2 / 2 + y.diff() ** 2 / 2
    systems = [
        ss.MechanicalSystem(
            "quotient", coordinates=(x, y), kinetic=kinetic, potential=potential, parameters={}
        )
        for potential in (V**2 / V - x, sp.expand(V) - x)
    ]
    given = {"q0": [0.3, 0.4], "v0": [0.0, 0.1], "h": 0.1, "steps": 50}
    found, wanted = (ss.compile(system, "simpson").integrate(**given) for system in systems)
    assert found.newton_iterations.sum() == 0
    assert np.abs(found.q - wanted.q).max() < 1e-14


@pytest.mark.parametrize("every", [2, 7, 100, None])
def test_steps_in_one_call_are_steps_one_by_one(every):
    system = ss.systems.harmonic_oscillator()
    stepper = ss.compile(system)
    stored = stepper.integrate([1.0], p0=[0.0], h=0.1, steps=1000, every=1)
    other = stepper.integrate([1.0], p0=[0.0], h=0.1, steps=1000, every=every)
    assert (other.q == (stored.q[-1:] if every is None else stored.q[::every])).all()


@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
@pytest.mark.parametrize("every", [1, 10, None])
def test_overflow_stops_before_the_step(every):
    """Beyond its stability limit a linear system grows: the last finite state is kept."""
    system = ss.systems.harmonic_oscillator()
    stepper = ss.compile(system)
    run = stepper.integrate([1.0], p0=[0.0], h=30.0, steps=2000, every=every, on_failure="return")
    assert run.status.name == "NOT_FINITE"
    assert 0 < run.steps < 2000
    assert np.isfinite(run.q).all()
    assert np.isfinite(run.p).all()
    assert len(run.q) == len(run.t) == (1 if every is None else run.steps // every + 1)
    whole, one_more = (
        stepper.integrate([1.0], p0=[0.0], h=30.0, steps=2000, every=1, on_failure="return"),
        stepper.integrate([1.0], p0=[0.0], h=30.0, steps=run.steps + 1, on_failure="return"),
    )
    assert one_more.status.name == "NOT_FINITE"
    for other in (whole, one_more):
        assert other.steps == run.steps
        assert (other.q[-1] == run.q[-1]).all() or every == 10


@pytest.mark.slow
def test_chain_costs_grow_with_its_length():
    """Operations of a step, not time: chains of 32 and 128 coordinates."""
    short, long = (cost(source(ss.systems.fermi_pasta_ulam(n))) for n in (16, 64))
    for a, b in ((short.iteration, long.iteration), (short.closing, long.closing)):
        assert b < 4.4 * a
    dense = cost(source(ss.systems.fermi_pasta_ulam(16), "simpson", ("constant_mass",)))
    assert dense.iteration > 2 * short.iteration


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "lobatto6", "midpoint", "lobatto2"], 2))
def test_chain(scheme):
    """Twenty coordinates: loops, bands and another order against the general path."""
    system = ss.systems.fermi_pasta_ulam(10)
    given = system.reference_state
    assert gap(system, scheme, given["q0"], given["v0"], 0.002, steps=5) < 1e-13


@pytest.mark.slow
def test_chain_with_a_mass_that_depends_on_q():
    import sympy as sp

    n = 12
    x = ss.coordinates(f"x0:{n}")
    v = [c.diff() for c in x]
    kinetic = sum((2 + sp.cos(a)) * u**2 for a, u in zip(x, v, strict=True)) / 2
    kinetic += sum(sp.cos(x[i] - x[i + 1]) * v[i] * v[i + 1] / 3 for i in range(n - 1))
    system = ss.MechanicalSystem(
        "chain",
        coordinates=x,
        kinetic=kinetic,
        parameters={},
        potential=sum((x[i] - x[i + 1]) ** 4 + x[i] ** 2 for i in range(n - 1)),
    )
    text = source(system)
    assert "BAND = 1\n" in text
    q, p = [0.1 * (i % 4) for i in range(n)], [0.05 * (i % 3) for i in range(n)]
    for scheme in SCHEMES:
        assert gap(system, scheme, q, p, 0.01, steps=5) < 1e-13
    stepper = ss.compile(system)
    general = ss.compile(system, exploit=())
    nodes = np.array([q, q]) + 0.01
    for method in ("residual", "jacobian"):
        a, b = (getattr(s, method)(q, p, nodes, 0.01) for s in (stepper, general))
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max())
