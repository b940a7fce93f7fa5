"""Equations with forces against differences of L_d and virtual work in 60 digits."""

import dataclasses
import random

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.cases import sweep
from support.chains import damped_chain
from support.oracle import DIGITS, discrete_lagrangian, gradient, virtual_work
from support.random_systems import random_state, random_system
from support.workspace import TABLES, begin, block, newton_gaps, take_step

import symsimpson as ss
from symsimpson.lower.pipeline import source

SCHEMES = ("simpson", "midpoint", "gauss4", "simpson", "midpoint")
H = 0.125


def forced_system(seed):
    """A random system with random forces of t, q and v, one of them of everything."""
    system, pick = random_system(seed), random.Random(seed + 77)
    q = system.coordinates
    v = [x.diff() for x in q]
    k = list(system.parameters)[1]
    forces = {}
    for a in pick.sample(q, pick.randint(1, len(q))):
        x, u = pick.choice(q), pick.choice(v)
        forces[a] = sp.Rational(pick.randint(1, 9), 10) * pick.choice(
            [
                -u,
                -(u**3) / 3,
                sp.cos(2 * ss.time) * x,
                k * u * sp.sin(x),
                sp.exp(-ss.time) / (2 + x**2),
                -u * sp.sqrt(1 + sum(w**2 for w in v)),
                sp.tanh(u) * sp.cos(x),
                u * pick.choice(v),
            ]
        )
    loss = sum((k * w**2 / 5 for w in v[::2]), sp.S.Zero) if seed % 2 else None
    fields = {f.name: getattr(system, f.name) for f in dataclasses.fields(system) if f.init}
    return ss.MechanicalSystem(**fields | {"forces": forces, "dissipation": loss})


def rows_and_scale(system, scheme, points, p):
    """p0 [k = 0] + D_k L_d + F_k of all control points, in many digits."""
    quadrature, stages, d = TABLES[scheme]
    h, exact = mp.mpf(H), [mp.mpf(a) for a in system.parameters.values()]
    Ld, F = (make(system, quadrature, stages, d) for make in (discrete_lagrangian, virtual_work))

    def rows(X):
        both = zip(gradient(Ld, X, h, exact), F(X, h, exact), strict=True)
        found = [[a + b for a, b in zip(one, two, strict=True)] for one, two in both]
        found[0] = [a + mp.mpf(x) for a, x in zip(found[0], p, strict=True)]
        return found

    return rows, 1 + max(abs(x) for row in rows(points) for x in row)


def agrees_with_the_oracle(system, scheme, seed, exploit="all"):
    """Residual and some columns of the Jacobian, against differences in 60 digits."""
    d, n = TABLES[scheme][2], system.n
    q, slope = random_state(seed, n)
    p = [0.3] * n
    increments = np.array([[H * s * (k + 1) / d + (k % 2) * 0.01 for s in slope] for k in range(d)])
    module = bind_float(source(system, scheme, exploit))
    W = begin(module, q, p, system.parameters.values(), H)
    W[block(module, "INCREMENT", d * n), 0] = increments.ravel()
    module.equations(H, 0.0, W)
    residual = W[block(module, "RESIDUAL", d * n), 0].reshape(d, n)
    jacobian = W[block(module, "JACOBIAN", (d * n) ** 2), 0].reshape(d, n, d, n)
    with mp.workdps(DIGITS):
        X = [[mp.mpf(x) for x in q]]
        X += [[a + mp.mpf(b) for a, b in zip(X[0], row, strict=True)] for row in increments]
        rows, scale = rows_and_scale(system, scheme, X, p)
        truth = rows(X)
        for row, k in enumerate(module.ROW_ORDER):
            assert max(abs(residual[row, a] - truth[k][a]) for a in range(n)) < 4e-14 * scale
        size, step = np.abs(jacobian).max(), mp.mpf("1e-15")
        for column, m in enumerate(module.COLUMN_ORDER):
            b = (seed + column) % n  # one column of each block
            up, down = ([list(x) for x in X] for _ in range(2))
            up[m][b] += step
            down[m][b] -= step
            ends = rows(up), rows(down)
            for row, k in enumerate(module.ROW_ORDER):
                for a in range(n):
                    slope = (ends[0][k][a] - ends[1][k][a]) / (2 * step)
                    assert abs(jacobian[row, a, column, b] - slope) < 1e-12 * size, (seed, k, m)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("start", sweep(range(0, 100, 4)))
def test_equations_agree_with_the_oracle(start):
    for seed in range(start, start + 4):
        agrees_with_the_oracle(forced_system(seed), SCHEMES[seed % 5], seed)


@pytest.mark.parametrize("seed", sweep(range(4)))
def test_loops_over_terms_of_forces_agree_with_the_oracle(seed):
    """Dampers between neighbours, drag, and a drive: what is alike is written once."""
    system = damped_chain(17, driven=False)
    module = agrees_with_the_oracle(system, ("simpson", "midpoint")[seed % 2], seed, ())
    assert hasattr(module, "FAMILY_1")
    assert len(module.FAMILY_1) == 17


@pytest.mark.parametrize("start", sweep(range(0, 40, 2)))
def test_newton_solves_the_equations(start):
    """One correction, in fixed order and pivoted, is that of residual and Jacobian."""
    for seed in range(start, start + 2):
        system = forced_system(seed)
        module = bind_float(source(system, SCHEMES[seed % 5], ()))
        q, v = random_state(seed, system.n)
        W = begin(module, q, v, system.parameters.values(), H)
        for gap in newton_gaps(module, W, H, 0.7, system.n):
            assert gap < 1e-11, seed


@pytest.mark.parametrize("seed", sweep(range(0, 40, 4)))
def test_reduced_and_general_steps_agree(seed):
    """Whatever is exploited, compiled or in plain floats."""
    system = forced_system(seed)
    q, v = random_state(seed, system.n)
    scheme = SCHEMES[seed % 5]
    reduced, general = (bind_float(source(system, scheme, e)) for e in ("all", ()))
    ends = []
    for module in (reduced, general):
        W = begin(module, q, v, system.parameters.values(), H)
        take_step(module, W, H)
        names = ("POSITION", "MOMENTUM")
        ends.append(np.concatenate([W[block(module, x, system.n), 0] for x in names]))
    compiled = np.concatenate(ss.compile(system, scheme).step(q, p=v, h=H))
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=2e-13)
    np.testing.assert_allclose(compiled, ends[1], rtol=0, atol=2e-13)
