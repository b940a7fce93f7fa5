"""One system, two forms of code; one text, four arithmetics."""

import json
from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_complex, bind_float
from support.cases import sweep
from support.chains import swinging_chain
from support.forms import limited
from support.places import DATA
from support.random_systems import random_state, random_system
from support.workspace import begin, block, new_workspace, state, take_step

import symsimpson as ss
from symsimpson.discrete.equations import discretise
from symsimpson.lower import module_kernels
from symsimpson.lower.emit import emit
from symsimpson.lower.pipeline import source
from symsimpson.schemes.named import read_scheme
from symsimpson.targets.binding import bind_mpmath

SYSTEMS = [
    ss.systems.lagrange_top(),
    ss.systems.elastic_pendulum(),
    random_system(3),
    random_system(9),
]
GOLDEN = json.loads((DATA / "golden.json").read_text())["cases"]


@pytest.mark.parametrize("system", sweep(SYSTEMS), ids=lambda system: system.name)
@pytest.mark.parametrize("scheme", ["simpson", "midpoint"])
@pytest.mark.parametrize(("members", "exploit"), [(99, ()), (0, ()), (0, ("constant_mass",))])
def test_loops_and_straight_lines_agree(system, scheme, members, exploit, monkeypatch):
    text = source(system, scheme, ())
    limited(monkeypatch, UNROLLED_UNKNOWNS=0, FAMILY_MEMBERS=members)
    equations = discretise(system, read_scheme(scheme), exploit)
    looped = emit(equations, module_kernels.lower(equations))
    assert "newton_pivoted" in text
    assert "newton_pivoted" not in looped
    assert ("FAMILY_1" in looped) == (members == 0 or "sparse" in exploit)
    q, v = random_state(5, system.n)
    q = [x + 1 for x in q]  # away from the poles of angles
    results = []
    for module in map(bind_float, (text, looped)):
        W = new_workspace(module, q, [0.0] * system.n, system.parameters.values())
        W[block(module, "VELOCITY", system.n), 0] = v
        module.prepare(0.02, 0.0, W)
        module.legendre(0.02, 0.0, W)
        module.start(0.02, 0.0, W)
        assert W[module.MASS_PIVOT, 0] == 0
        for _ in range(10):
            take_step(module, W, 0.02)
        measures = W[[module.VELOCITY_JUMP_SQUARED, module.PREDICTION_ERROR_SQUARED], 0]
        predicted = W[block(module, "PREDICTED", module.UNKNOWNS), 0]
        masses = W[block(module, "MASS_DIAGONAL", system.n), 0]
        module.energy(0.02, 0.0, W)
        velocity = W[block(module, "VELOCITY", system.n), 0]
        assert np.abs(velocity).min() > 0
        energies = W[[module.KINETIC, module.ENERGY], 0]
        results.append([*state(module, W), *velocity, *predicted, *masses, *measures, *energies])
    np.testing.assert_allclose(results[0], results[1], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("case", sweep(GOLDEN[:6]), ids=lambda case: case["name"])
def test_first_step_in_many_digits(case):
    system = {
        "double_pendulum": ss.systems.double_pendulum,
        "lagrange_top": ss.systems.lagrange_top,
    }[case["system"]]()
    with mp.workdps(64):
        module = bind_mpmath(source(system, case["scheme"]))
        parameters = [mp.mpf(case["params"][str(a)]) for a in system.parameters]
        q, p = ([mp.mpf(x) for x in case[key]] for key in ("q0", "p0"))
        h = mp.mpf(case["h"])
        W = begin(module, q, p, parameters, h, dtype=object)
        take_step(module, W, h, iterations=12)
        truth = [mp.mpf(x) for x in (*case["first_step"]["q1"], *case["first_step"]["p1"])]
        for found, exact in zip(state(module, W), truth, strict=True):
            assert abs(found - exact) < mp.mpf(10) ** -32 * max(1, abs(exact))


@pytest.mark.parametrize("name", sweep(["double_pendulum", "lagrange_top", "fermi_pasta_ulam"]))
def test_arithmetics_agree(name):
    system = ss.systems.CATALOGUE[name]()
    text = source(system)
    q = [x + 0.1 for x in system.reference_state["q0"]]
    p = [0.01 * (i + 1) for i in range(system.n)]
    values = system.parameters.values()
    results = []
    for bind, dtype in ((bind_float, float), (bind_complex, complex), (bind_mpmath, object)):
        module = bind(text)
        W = begin(module, q, p, values, 0.01, dtype=dtype)
        take_step(module, W, 0.01)
        results.append(np.array([complex(x).real for x in state(module, W)]))
    stepper = ss.compile(system)
    results.append(np.concatenate(stepper.step(q, p=p, h=0.01)))
    for other in results[1:]:
        np.testing.assert_allclose(results[0], other, rtol=0, atol=1e-13)


@pytest.mark.parametrize("scheme", ["lobatto2", "simpson", "lobatto6"])
def test_ends_of_paths_agree(scheme, monkeypatch):
    """Of a constant M they follow from the bends of the path, or from p alone."""
    system = ss.systems.fermi_pasta_ulam(3)
    given = dict(system.reference_state) | {"h": 0.01, "steps": 3}
    straight = ss.compile(system, scheme).integrate(**given)
    limited(monkeypatch, UNROLLED_UNKNOWNS=-1)
    stepper = ss.compile(system, scheme, exploit=("constant_mass", "sparse"))
    run = stepper.integrate(**given)
    assert ("find_straight_path(" if scheme == "lobatto2" else "correct_end(") in stepper.source
    np.testing.assert_allclose(run.q, straight.q, rtol=0, atol=1e-14)
    np.testing.assert_allclose(run.p, straight.p, rtol=0, atol=1e-13)


def test_loops_find_the_velocity_of_a_momentum(monkeypatch):
    """Five coordinates, each coupled to each, and a linear term in the velocities."""
    x = ss.coordinates("x0:5")
    v = [c.diff() for c in x]
    kinetic = sum((2 + i + sp.cos(a)) * u**2 for i, (a, u) in enumerate(zip(x, v, strict=True)))
    kinetic += sum(sp.cos(x[i] - x[j]) * v[i] * v[j] / 4 for i in range(5) for j in range(i))
    system = ss.MechanicalSystem(
        "coupled",
        coordinates=x,
        kinetic=kinetic / 2,
        potential=sum(a**4 for a in x),
        gyroscopic=sum((i + sp.sin(x[i - 1])) * u for i, u in enumerate(v)),
        parameters={},
    )
    limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    equations = discretise(system, ss.SIMPSON, ())
    module = bind_float(emit(equations, module_kernels.lower(equations)))
    W = new_workspace(module, [0.1, 0.5, -0.4, 0.8, -0.2], [0.0] * 5, [])
    velocity = W[block(module, "VELOCITY", 5), 0] = np.array([0.3, -0.7, 0.2, 1.1, -0.5])
    module.prepare(0.1, 0.0, W)
    module.legendre(0.1, 0.0, W)
    W[block(module, "VELOCITY", 5), 0] = 0.0
    module.energy(0.1, 0.0, W)
    np.testing.assert_allclose(W[block(module, "VELOCITY", 5), 0], velocity, rtol=1e-13)


def test_bands_find_the_velocity_of_a_momentum(monkeypatch):
    """And the momentum of a velocity, with M and what is linear in v written down by hand."""
    system = swinging_chain()
    limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    equations = discretise(system, ss.SIMPSON, ("sparse",))
    text = emit(equations, module_kernels.lower(equations))
    assert "BAND = 1\n" in text
    assert '5 terms v_0*sin(q_1)/3."""' in text
    module = bind_float(text)
    q, v = map(np.array, random_state(1, 6))
    W = new_workspace(module, q, [0.0] * 6, [])
    W[block(module, "VELOCITY", 6), 0] = v
    module.prepare(0.1, 0.0, W)
    module.legendre(0.1, 0.0, W)
    between = np.cos(q[:-1] - q[1:]) / 2
    mass = np.diag(2 + np.cos(q)) + np.diag(between, 1) + np.diag(between, -1)
    momentum = mass @ v + [0.0, *np.sin(q[:-1]) / 3]
    np.testing.assert_allclose(W[block(module, "MOMENTUM", 6), 0], momentum, rtol=1e-14)
    W[block(module, "VELOCITY", 6), 0] = 0.0
    module.energy(0.1, 0.0, W)
    np.testing.assert_allclose(W[block(module, "VELOCITY", 6), 0], v, rtol=1e-13)
    assert W[module.KINETIC, 0] == pytest.approx(v @ mass @ v / 2, rel=1e-13)


@pytest.mark.parametrize(("exploit", "width"), [((), 12), (("sparse",), 3)])
def test_rows_are_exchanged_where_pivots_are_small(exploit, width, monkeypatch):
    """Matrices of random numbers, and of some zeros on the diagonal, against numpy."""
    limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    equations = discretise(swinging_chain(), ss.SIMPSON, exploit)
    module = bind_float(emit(equations, module_kernels.lower(equations)))
    size, pick = module.NEWTON_UNKNOWNS, np.random.default_rng(4)
    for _ in range(5):
        matrix = pick.uniform(-1, 1, (size, size)) * pick.choice([1e-3, 1], (size, 1))
        for i, j in np.ndindex(matrix.shape):
            matrix[i, j] *= abs(i - j) <= width and (i != j or i % 3 > 0)
        right = pick.uniform(-1, 1, size)
        W = np.zeros((module.ROWS, 1))
        for i, j in np.argwhere(matrix):
            place = i * module.SOLVE_STRIDE + j + module.SOLVE_OFFSET
            W[module.JACOBIAN + place, 0] = matrix[i, j]
        W[block(module, "RESIDUAL", size), 0] = right
        module.solve_pivoted(W, 0)
        found = W[block(module, "RESIDUAL", size), 0]
        np.testing.assert_allclose(matrix @ found, right, atol=1e-11 * np.abs(found).max())


@pytest.mark.parametrize(
    ("system", "scheme", "exploit"),
    sweep(
        [
            (ss.systems.henon_heiles(), "simpson", "all"),
            (ss.systems.henon_heiles(), "lobatto6", "all"),
            (ss.systems.henon_heiles(), "gauss4", "all"),
            (ss.systems.lagrange_top(), "simpson", "all"),
            (ss.systems.lagrange_top(), "gauss4", "all"),
            (ss.systems.double_pendulum(), "simpson", "all"),
            (ss.systems.double_pendulum(), "lobatto_3_3", "all"),
            (ss.systems.fermi_pasta_ulam(3), "simpson", ("constant_mass", "sparse")),
            (ss.systems.fermi_pasta_ulam(3), "lobatto6", ("constant_mass", "sparse")),
            (swinging_chain(), "simpson", ("sparse",)),
            (swinging_chain(), "simpson", ()),
        ],
        4,
    ),
    ids=lambda value: getattr(value, "name", value if isinstance(value, str) else "loops"),
)
def test_newton_converges_quadratically(system, scheme, exploit, monkeypatch):
    """In 60 digits; wrong entries of a Jacobian only make it slow, which nothing else sees."""
    if exploit != "all":
        limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    equations = discretise(system, read_scheme(scheme), exploit)
    text = emit(equations, module_kernels.lower(equations))
    assert ("newton_pivoted" in text) == (exploit == "all")
    q, p = random_state(7, system.n)
    p = [x / 100 for x in p]
    with mp.workdps(60):
        module = bind_mpmath(text)
        given = [[mp.mpf(x) for x in values] for values in (q, p, system.parameters.values())]
        h = mp.mpf("0.02")
        W = begin(module, *given, h, dtype=object)
        rows, size = block(module, "INCREMENT", module.UNKNOWNS), (module.DEGREE, system.n)
        sizes = []
        for _ in range(4):
            old = W[rows, 0].reshape(size).copy()
            module.newton(h, 0, W)
            new, masses = (W[rows, 0].reshape(size), W[block(module, "MASS_DIAGONAL", system.n), 0])
            for name, values in (("CORRECTION_SQUARED", new - old), ("INCREMENT_SQUARED", new)):
                exact = (masses * values**2).sum()
                assert abs(W[getattr(module, name), 0] - exact) <= 1e-50 * mp.sqrt(exact) + 1e-110
                if module.NEWTON_UNKNOWNS == module.DEGREE:  # one coordinate alone
                    continue
                own = W[block(module, f"OWN_{name.removesuffix('_SQUARED')}", system.n), 0]
                exact = (masses * values**2).sum(axis=0)
                assert (abs(own - exact) <= 1e-50 * exact**0.5 + 1e-110).all()
            sizes.append(mp.sqrt(W[module.CORRECTION_SQUARED, 0] / W[module.INCREMENT_SQUARED, 0]))
    assert all(after < before**2 + 1e-55 for before, after in pairwise(sizes))


@pytest.mark.parametrize(
    ("measures", "doubt"),
    [
        ({}, 0),
        ({"PREDICTION_ERROR_SQUARED": 1.5}, 1),
        (
            {"PREDICTION_ERROR_SQUARED": 1.5, "LARGEST_SQUARED": 0.0},
            0,
        ),  # the first step has nothing to compare with
        ({"VELOCITY_JUMP_SQUARED": 4.5}, 1),
        ({"VELOCITY_JUMP_SQUARED": 4.5, "INCREMENT_SQUARED": 1.5}, 0),
        ({"CYCLIC_MASS_CHANGE": 0.6}, 3),
        ({"CYCLIC_JUMP_SQUARED": 0.1}, 0),
        ({"CYCLIC_JUMP_SQUARED": 0.15}, 2),
        ({"CYCLIC_MASS_CHANGE": 0.6, "CYCLIC_JUMP_SQUARED": 1e30}, 2),
        (
            {"LARGEST_SQUARED": 0.0, "INCREMENT_SQUARED": 0.0, "PREDICTION_ERROR_SQUARED": 0.0},
            0,
        ),  # all at rest
    ],
)
def test_what_is_in_doubt(measures, doubt):
    """Surprises, lost velocities and masses that change, one at a time."""
    module = bind_mpmath(source(ss.systems.lagrange_top()), checking=True)
    W = np.zeros((module.ROWS, 1))
    quiet = {
        "LARGEST_SQUARED": 1.0,
        "INCREMENT_SQUARED": 0.5,
        "PREDICTION_ERROR_SQUARED": 0.5,
        "ACTIVE": 1.0,
    }
    for name, value in (quiet | measures).items():
        W[getattr(module, name), 0] = value
    module.check_acceptance(W, 0)
    assert W[module.IN_DOUBT, 0] == doubt
    known, increment = ((quiet | measures)[k] for k in ("LARGEST_SQUARED", "INCREMENT_SQUARED"))
    assert W[module.LARGEST_SQUARED, 0] == (known if doubt == 1 else max(known, increment))


@pytest.mark.parametrize(
    ("correction", "increment", "verdict"),
    [
        (0, 0, 0),
        (0, 1, 0),
        ("1e-40", 1, 0),
        ("1e-2", 1, 1),
        (1, 0, 1),
        (0, "inf", -3),
        ("inf", 1, -3),
        ("nan", 1, -3),
        (1, "nan", -3),
    ],
)
def test_when_an_iteration_is_done(correction, increment, verdict):
    """By the second correction: that of a body at rest is none of nothing."""
    module = bind_mpmath(source(ss.systems.pendulum()), checking=True)
    W = np.full((module.ROWS, 1), mp.mpf(0), dtype=object)
    given = {
        "CORRECTION_SQUARED": correction,
        "INCREMENT_SQUARED": increment,
        "ACTIVE": 1,
        "RELATIVE": "1e-4",
        "CONTRACTION": 1,
    }
    for name, value in given.items():
        W[getattr(module, name), 0] = mp.mpf(value)
    module.check_convergence(W, 0)
    assert W[module.ACTIVE, 0] == verdict
    assert W[module.ITERATIONS, 0] == 1
    if verdict == -3:
        assert W[module.RELATIVE, 0] == mp.mpf("1e-4")
    module.check_convergence(W, 0)
    assert W[module.ITERATIONS, 0] == 1 + (verdict == 1)


@pytest.mark.parametrize(
    ("correction", "before", "factor", "seen", "verdict"),
    [
        ("1e-10", "inf", 1, 1, 1),  # the first one
        ("1e-10", "1e-7", "1e-3", "1e-3", 1),
        ("1e-10", "1e-7", "1e-1", "0.025", 1),  # of late it was slower
        ("1e-26", "1e-20", "1e-6", "1e-6", 0),
        ("1e-26", "1e-20", "1e-3", "0.25e-3", 1),
        ("1e-26", "2e-26", "1e-3", "0.5", 1),  # it may be slow
        ("1e-26", "5e-27", "1e-3", "2", 1),  # it may have grown for once
        ("1e-28", "5e-29", "1e-3", "2", 0),  # it shrinks no more
        ("1e-28", "2e-28", "1e-3", "0.5", 1),
        ("2e-29", "4e-29", "1e-3", "0.5", 0),  # as small as rounding, it hardly does
        (0, "1e-20", "1e-3", "0.25e-3", 0),
        ("nan", "1e-20", "1e-3", None, -3),
    ],
)
def test_when_stages_are_done(correction, before, factor, seen, verdict):
    """By the largest of the factors of late; sizes are sums over the nodes."""
    with mp.workdps(15):
        module = bind_mpmath(source(ss.systems.pendulum(), "gauss6"), checking=True)
        W = np.full((module.ROWS, 1), mp.mpf(0), dtype=object)
        given = {"ACTIVE": 1, "RELATIVE": before, "CONTRACTION": factor}
        given["STAGE_EXPECTED"] = 2  # not checked before
        for name, value in given.items():
            W[getattr(module, name), 0] = mp.mpf(value)
        W[block(module, "STAGE_CORRECTION", 3), 0] = [mp.mpf(correction) * k for k in (1, 2, 1)]
        W[block(module, "STAGE_SIZE", 3), 0] = [mp.mpf(k) for k in (1, 1, 2)]
        module.check_stage_convergence(W, 0)
        assert W[module.ACTIVE, 0] == 1
        assert W[module.RELATIVE, 0] == mp.mpf(before)
        module.check_stage_convergence(W, 0)
        assert W[module.ACTIVE, 0] == verdict
        if seen is not None:
            assert abs(W[module.CONTRACTION, 0] / mp.mpf(seen) - 1) < 1e-12


@pytest.mark.parametrize(
    ("count", "expected", "first"), [(8, 7, 7), (7, 7, 4), (2, 2, -1), (5, 0, 4)]
)
def test_when_stages_are_checked_first(count, expected, first):
    """One iteration before the last; earlier where the first check found that all was done."""
    module = bind_mpmath(source(ss.systems.pendulum(), "gauss6"), checking=True)
    W = np.full((module.ROWS, 1), mp.mpf(0), dtype=object)
    W[module.STAGE_COUNT, 0], W[module.STAGE_EXPECTED, 0] = mp.mpf(count), mp.mpf(expected)
    module.check_stage_acceptance(W, 0)
    assert W[module.STAGE_EXPECTED, 0] == first
    assert W[module.STAGE_COUNT, 0] == 0


@pytest.mark.slow
def test_large_systems_run():
    """Eight links: looped kernels, compiled, of the right order."""
    system = ss.systems.n_pendulum(8)
    stepper = ss.compile(system)
    errors = [
        np.abs(stepper.integrate(**system.reference_state, h=h, t_end=1.0).energy_error).max()
        for h in (0.01, 0.005)
    ]
    assert abs(np.log2(errors[0] / errors[1]) - 4) < 0.3
