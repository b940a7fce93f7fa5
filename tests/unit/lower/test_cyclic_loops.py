"""Loops over the coordinates that are left when cyclic ones follow from their momenta."""

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.cases import sweep
from support.forms import limited
from support.in_c import InC
from support.oracle import DIGITS, discrete_lagrangian, gradient
from support.workspace import TABLES, begin, block, state, take_step

import symsimpson as ss
from symsimpson.discrete.reductions import Routh
from symsimpson.lower.pipeline import source
from symsimpson.targets.binding import bind_mpmath
from symsimpson.targets.counting import cost

H = 0.05


def turned(cyclic="a b c", others="x y"):
    """Cyclic coordinates before others and behind them; M changes, and couples all of them."""
    angles, free = ss.coordinates(cyclic), ss.coordinates(others)
    q = (*angles[:1], *free, *angles[1:])
    v = [one.diff() for one in q]
    first, last = free[0], free[-1]
    kinetic = sum((3 + sp.cos(k * first)) * u**2 for k, u in enumerate(v)) + last**2 * v[0] * v[1]
    pairs = [(i, k) for k in range(len(q)) for i in range(k)]
    kinetic += sum(sp.sin((i + 2 * k) * first) * v[i] * v[k] / 2 for i, k in pairs)
    swing = sum(sp.sin(first + k * last) * u / 3 for k, u in enumerate(v))
    return ss.MechanicalSystem(
        "turned",
        coordinates=q,
        kinetic=kinetic / 2,
        potential=sum(one**2 for one in free),
        gyroscopic=swing,
    )


def cart_with_links(count):
    """Links that hang from a cart; its momentum stays."""
    x, *angles = ss.coordinates(" ".join(["x", *(f"a{k}" for k in range(count))]))
    vx, vy, height = x.diff(), 0, 0
    kinetic, potential = vx**2 / 2, 0
    for angle in angles:
        vx += sp.cos(angle) * angle.diff()
        vy += sp.sin(angle) * angle.diff()
        height -= sp.cos(angle)
        kinetic += (vx**2 + vy**2) / 2
        potential += height
    return ss.MechanicalSystem(
        "cart", coordinates=[x, *angles], kinetic=kinetic, potential=potential
    )


SYSTEMS = {
    "turned": turned(),
    "one": turned("a", "x y"),
    "top": ss.systems.lagrange_top(),
    "kepler": ss.systems.kepler(),
    "rigid_body": ss.systems.rigid_body(),
}


@pytest.fixture
def in_loops(monkeypatch):
    """All systems are loops, and all that can be reduced are."""
    limited(monkeypatch, UNROLLED_UNKNOWNS=0)
    monkeypatch.setattr(Routh, "pays", lambda self, stages: True)


def states(text, q, p, parameters, steps):
    """The states after each step, and the increments of the last one."""
    module = bind_float(text)
    W = begin(module, q, p, parameters, H)
    found = [state(module, W)]
    for _ in range(steps):
        take_step(module, W, H)
        found.append(state(module, W))
    return np.array(found), W[block(module, "SOLVED", module.UNKNOWNS), 0], module


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "gauss4", "lobatto6"], 2))
@pytest.mark.parametrize("name", sweep(SYSTEMS, 2))
def test_reduced_loops_agree_with_all_equations(name, scheme, in_loops):
    """States, and increments of the cyclic coordinates; their momenta stay to the last bit."""
    system = SYSTEMS[name]
    q = np.linspace(0.4, 0.9, system.n)
    p = np.linspace(0.3, 0.2, system.n) * (0.01 if name == "top" else 1)
    given = (q, p, system.parameters.values(), 5)
    general, increments, _ = states(source(system, scheme, ()), *given)
    reduced, followed, module = states(source(system, scheme), *given)
    names = [one.func.__name__ for one in system.coordinates]
    cyclic = [names.index(one) for one in system.structure.cyclic]
    assert system.n - len(cyclic) == module.SOLVE_COORDINATES
    assert np.abs(reduced - general).max() < 1e-14 * np.abs(general).max()
    assert np.abs(followed - increments).max() < 1e-14 * np.abs(increments).max()
    assert (np.ptp(reduced[:, [system.n + a for a in cyclic]], axis=0) == 0).all()


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4", "lobatto6"]))
def test_reduced_loops_solve_all_equations(scheme, in_loops):
    """D_k L_d of all coordinates, in differences of L_d in many digits."""
    system = turned()
    quadrature, stages, d = TABLES[scheme]
    q, p = [0.3, 0.4, -0.2, 0.1, 0.6], [0.3, 0.1, -0.2, 0.5, 0.2]
    with mp.workdps(DIGITS):
        module = bind_mpmath(source(system, scheme))
        q, p, h = [mp.mpf(x) for x in q], [mp.mpf(x) for x in p], mp.mpf(H)
        W = begin(module, q, p, [], h, dtype=object)
        take_step(module, W, h, 7)
        points = W[block(module, "SOLVED", module.UNKNOWNS), 0].reshape(d, system.n)
        X = [q, *([x + y for x, y in zip(q, row, strict=True)] for row in points)]
        D = gradient(discrete_lagrangian(system, quadrature, stages, d), X, h, [])
        D[0] = [x + y for x, y in zip(D[0], p, strict=True)]
        after = state(module, W)
        D[d] = [x - y for x, y in zip(D[d], after[system.n :], strict=True)]
        assert max(abs(x) for row in D for x in row) < mp.mpf(10) ** -35
        assert max(abs(x - y) for x, y in zip(X[d], after, strict=False)) < mp.mpf(10) ** -50


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4"]))
def test_checks_of_a_step_are_those_of_straight_lines(scheme, monkeypatch):
    system = turned()
    found = []
    for limits in ({}, {"UNROLLED_UNKNOWNS": 0}):
        limited(monkeypatch, **limits)
        monkeypatch.setattr(Routh, "pays", lambda self, stages: True)
        module = bind_float(source(system, scheme))
        W = begin(module, np.linspace(0.3, 0.9, 5), np.linspace(2.0, 1.0, 5), [], 0.2)
        take_step(module, W, 0.2)
        names = ("CYCLIC_JUMP_SQUARED", "CYCLIC_MASS_CHANGE", "VELOCITY_JUMP_SQUARED")
        found.append([W[getattr(module, name), 0] for name in names])
    assert min(found[0]) > 1e-9
    np.testing.assert_allclose(found[1], found[0], rtol=1e-8)


@pytest.mark.parametrize("scheme", sweep(["midpoint", "gauss4"], 2))
def test_ends_of_a_step_are_where_they_are_without_the_time(scheme):
    """Of a force that depends on the time, and is zero."""
    x, y = ss.coordinates("x y")
    t, c = x.args[0], sp.Symbol("c")
    kinetic = (x.diff() ** 2 + (2 + sp.sin(x)) * y.diff() ** 2) / 2
    found = []
    for potential, parameters in ((x**4, {}), (x**4 + c * x * sp.cos(t), {c: 0.0})):
        system = ss.MechanicalSystem(
            "timed", coordinates=[x, y], kinetic=kinetic, potential=potential, parameters=parameters
        )
        module = bind_float(source(system, scheme))
        W = begin(module, [0.4, 0.1], [2.0, 1.5], parameters.values(), 0.2)
        take_step(module, W, 0.2)
        found.append([W[module.CYCLIC_JUMP_SQUARED, 0], W[module.CYCLIC_MASS_CHANGE, 0]])
    assert min(found[0]) > 1e-9
    np.testing.assert_allclose(found[1], found[0], rtol=1e-10)


def test_a_large_system_is_reduced_where_that_pays():
    """With three nodes for two unknowns of each coordinate it does not."""
    system = cart_with_links(9)
    texts = {scheme: source(system, scheme) for scheme in ("gauss4", "simpson")}
    assert ["cyclic_equations" in text for text in texts.values()] == [True, False]
    assert "cyclic_equations" not in source(system, "gauss4", ("constant_mass", "sparse"))
    general, reduced = cost(source(system, "gauss4", ())), cost(texts["gauss4"])
    assert reduced.unknowns == general.unknowns - 2
    assert reduced.iteration < 0.9 * general.iteration


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "gauss4"], 0))
def test_derivatives_of_reduced_loops(scheme, in_loops):
    """Increments of cyclic coordinates are those of the step: tangents need no others."""
    system = turned("a b", "x")
    given = {"p0": [0.3, 0.5, -0.2], "h": H, "steps": 3, "tangents": 6}
    general, reduced = (
        ss.compile(system, scheme, exploit=exploit).integrate([0.2, 0.3, 0.4], **given)
        for exploit in ((), "all")
    )
    assert np.abs(reduced.tangent - general.tangent).max() < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["gauss4", "midpoint"], 0))
def test_compiled_reduced_loops(scheme, in_loops):
    """With friction and an input, and what these take and give."""
    _, y, z = q = ss.coordinates("x y z")
    v, (c, u) = [one.diff() for one in q], sp.symbols("c u")
    kinetic = (2 + sp.cos(y)) * v[0] ** 2 + (1 + y**2) * v[1] ** 2 + (3 + sp.sin(z)) * v[2] ** 2
    system = ss.MechanicalSystem(
        "driven",
        coordinates=q,
        kinetic=kinetic / 2 + sp.sin(z + y) * v[0] * v[2] / 2 + sp.cos(z) * v[1] * v[2] / 2,
        potential=y**2 + z**4,
        gyroscopic=sp.sin(y) * v[0],
        parameters={c: 0.3},
        forces={y: -c * v[1] - z * v[2], z: u - v[2] * y},
        inputs=[u],
    )
    given = {"v0": [0.5, 0.2, 0.3], "h": 0.02, "steps": 20, "inputs": {"u": [0.3] * 20}}
    general, reduced = (
        ss.compile(system, scheme, exploit=exploit).integrate([0.1, 0.4, 0.3], **given)
        for exploit in ((), "all")
    )
    assert np.abs(reduced.q - general.q).max() < 1e-15
    assert np.abs(reduced.p - general.p).max() < 1e-15
    for name, work in general.work.items():
        assert np.abs(reduced.work[name] - work).max() < 1e-15
    assert np.ptp(reduced.p[:, 0]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss4"], 0))
def test_reduced_loops_in_c(scheme, in_loops, tmp_path):
    """With multipliers and without."""
    stepper = ss.compile(turned("a b", "x"), scheme)
    q, p = [0.2, 0.3, 0.4], [0.3, 0.5, -0.2]
    exported = InC(stepper, tmp_path)
    exported.begin(H, q, p)
    for k in range(5):
        exported.step(H, k * H)
    run = stepper.integrate(q, p0=p, h=H, steps=5)
    for found, expected in zip(exported.get(), (run.q[-1], run.p[-1]), strict=False):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
