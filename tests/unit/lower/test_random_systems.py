"""Emitted equations against differences of L_d in 60 digits, for random systems."""

import mpmath as mp
import numpy as np
import pytest
from support.bindings import bind_float
from support.cases import sweep
from support.oracle import DIGITS, discrete_lagrangian, gradient, hessian
from support.random_systems import random_state, random_system
from support.workspace import TABLES, begin, block, newton_gaps, take_step

import symsimpson as ss
from symsimpson.lower.pipeline import source

SCHEMES = ("simpson", "midpoint", "gauss4", "simpson", "midpoint")
H = 0.125


@pytest.mark.slow
@pytest.mark.parametrize("start", sweep(range(0, 300, 4)))
def test_equations_agree_with_the_oracle(start):
    for seed in range(start, start + 4):
        check_equations(seed)


def test_equations_beside_those_of_a_part_have_values_of_their_own():
    """A cyclic coordinate moves as its nodes say, not as its momentum does."""
    check_equations(188)


def check_equations(seed):
    scheme = SCHEMES[seed % 5]
    quadrature, stages, d = TABLES[scheme]
    system = random_system(seed)
    n = system.n
    q, slope = random_state(seed, n)
    nodes = [
        [x + H * s * (k + 1) / d + (k % 2) * 0.01 for x, s in zip(q, slope, strict=True)]
        for k in range(d)
    ]
    parameters = list(system.parameters.values())
    p = [0.3] * n
    module = bind_float(source(system, scheme))
    W = begin(module, q, p, parameters, H)
    increments = np.array(nodes) - np.array(q)
    W[block(module, "INCREMENT", d * n), 0] = increments.ravel()
    module.equations(H, 0.0, W)
    residual = W[block(module, "RESIDUAL", d * n), 0].reshape(d, n)
    jacobian = W[block(module, "JACOBIAN", (d * n) ** 2), 0].reshape(d, n, d, n)
    with mp.workdps(DIGITS):
        Ld = discrete_lagrangian(system, quadrature, stages, d)
        X = [[mp.mpf(x) for x in q]]
        X += [[mp.mpf(x) + mp.mpf(i) for x, i in zip(q, row, strict=True)] for row in increments]
        exact = [mp.mpf(a) for a in parameters]
        h = mp.mpf(H)
        D = gradient(Ld, X, h, exact)
        second = hessian(Ld, X, h, exact)
        scale = 1 + max(abs(entry) for row in D for entry in row)
        for row, k in enumerate(module.ROW_ORDER):
            for a in range(n):
                truth = D[k][a] + (mp.mpf(p[a]) if k == 0 else 0)
                assert abs(residual[row, a] - truth) < 4e-14 * scale, (seed, k, a)
        columns = [(c, m, b) for c, m in enumerate(module.COLUMN_ORDER) for b in range(n)]
        size = np.abs(jacobian).max()
        pairs = [
            (r, k, a, c, m, b)
            for r, k in enumerate(module.ROW_ORDER)
            for a in range(n)
            for c, m, b in columns
        ]
        # every fifth entry keeps the time of 300 systems small; which ones changes with the seed
        for r, k, a, c, m, b in pairs[seed % 5 :: 5]:
            truth = second(k, a, m, b)
            assert abs(jacobian[r, a, c, b] - truth) < 2e-13 * size, (seed, k, a, m, b)


@pytest.mark.parametrize("start", sweep(range(0, 60, 2)))
def test_newton_solves_the_equations(start):
    """One Newton correction, in fixed order and pivoted, is that of residual and Jacobian."""
    for seed in range(start, start + 2):
        system = random_system(seed)
        module = bind_float(source(system, SCHEMES[seed % 5], ()))
        q, v = random_state(seed, system.n)
        W = begin(module, q, v, system.parameters.values(), H)
        for gap in newton_gaps(module, W, H, 0.0, system.n):
            assert gap < 1e-11, seed


@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("lagrange_top", "simpson"),
            ("kepler", "simpson"),
            ("kepler", "midpoint"),
            ("lagrange_top", "lobatto6"),
            ("rigid_body", "simpson"),
        ]
    ),
)
def test_cyclic_coordinates_follow_where_rows_are_pivoted(name, scheme):
    """A correction of the reduced equations is that of all equations, once cyclic rows hold."""
    system = ss.systems.CATALOGUE[name]()
    module = bind_float(source(system, scheme))
    q, p = system.reference_state["q0"], np.linspace(0.3, 0.7, system.n)
    W = begin(module, q, p, system.parameters.values(), H)
    W[block(module, "INCREMENT", module.UNKNOWNS)] *= 1.02  # a correction to be found
    pivoted = W.copy()
    module.newton(H, 0.0, W)
    module.newton_pivoted(H, 0.0, pivoted)
    increments = block(module, "INCREMENT", module.UNKNOWNS)
    solved = np.tile(np.array(module.FOLLOWING) == 0, module.DEGREE)
    assert not solved.all()
    change = np.abs(W[increments, 0] - pivoted[increments, 0])[solved]
    assert change.max() < 1e-12 * np.abs(W[increments, 0]).max()


@pytest.mark.parametrize("seed", sweep(range(3, 300, 15), 0))
def test_compiled_step_agrees_with_plain_floats(seed):
    system = random_system(seed)
    q, v = random_state(seed, system.n)
    scheme = SCHEMES[seed % 5]
    stepper = ss.compile(system, scheme, exploit=())
    q1, p1 = stepper.step(q, p=v, h=H)
    module = bind_float(stepper.source)
    W = begin(module, q, v, system.parameters.values(), H)
    take_step(module, W, H)
    n = system.n
    np.testing.assert_allclose(q1, W[block(module, "POSITION", n), 0], rtol=0, atol=2e-15)
    np.testing.assert_allclose(p1, W[block(module, "MOMENTUM", n), 0], rtol=0, atol=1e-13)
    R = stepper.residual(q, v, np.array(q) + np.zeros((module.DEGREE, n)), H)
    J = stepper.jacobian(q, v, np.array(q) + np.zeros((module.DEGREE, n)), H)
    assert R.shape == (module.DEGREE * n,)
    # with all control points at q0, one Newton step solves the linearised equations
    nodes = np.array(q) - np.linalg.solve(J, R).reshape(module.DEGREE, n)
    assert np.abs(stepper.residual(q, v, nodes, H)).max() < np.abs(R).max()
