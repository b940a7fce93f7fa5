"""The tables behind the reductions, each against what it is made for."""

import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.discrete.combined_rows import find_annihilators, shear_factors
from symsimpson.discrete.equations import discretise
from symsimpson.discrete.reductions import factorise, reduce
from symsimpson.schemes.named import read_scheme

SCHEMES = ["simpson", "midpoint", "gauss4", "lobatto6", "lobatto2", "lobatto_3_3"]


@pytest.mark.parametrize("name", SCHEMES)
def test_annihilating_combinations(name):
    scheme = read_scheme(name)
    nodes, d = scheme.quadrature.nodes, scheme.degree
    rows = find_annihilators(scheme)
    assert len(rows) == scheme.stages - d
    for row in rows:
        for power in range(d):
            total = sum(c * x**power for c, x in zip(row, nodes, strict=True))
            assert sp.simplify(total.subs(sp.S.Zero**0, 1)) == 0
        beyond = sum(c * x**d for c, x in zip(row, nodes, strict=True))
        assert len(rows) > 1 or sp.simplify(beyond) != 0


@pytest.mark.parametrize(
    ("name", "kicks"), [("simpson", 3), ("midpoint", 2), ("lobatto6", None), ("gauss4", None)]
)
def test_shears_multiply_to_the_step(name, kicks):
    """Products of shears of x'' = -z x against the residuals of the scheme itself."""
    scheme = read_scheme(name)
    shears = shear_factors(scheme)
    if kicks is None:
        assert shears is None
        return
    z = sp.Rational(7, 5)
    step = sp.eye(2)
    for is_kick, (first, second) in shears:
        if is_kick:
            factor = sp.Matrix([[1, 0], [first * z + second * z**2, 1]])
        else:
            factor = sp.Matrix([[1, first / (1 + second * z)], [0, 1]])
        step = factor * step
    assert sum(is_kick for is_kick, _ in shears) == kicks
    q, p, *X = sp.symbols(f"q p X1:{scheme.degree + 1}")
    path = [sp.S.Zero, *X]
    A, B, b = scheme.A, scheme.B, scheme.quadrature.weights
    rows, last = [], 0
    for k in range(scheme.degree + 1):
        row = 0
        for i in range(scheme.stages):
            position = q + sum(a * x for a, x in zip(A[i], path, strict=True))
            velocity = sum(a * x for a, x in zip(B[i], path, strict=True))
            row += b[i] * (B[i][k] * velocity - A[i][k] * z * position)
        rows.append(row + (p if k == 0 else 0))
    last = rows.pop()
    solution = sp.solve(rows, X, dict=True)[0]
    end = sp.Matrix([q + solution[X[-1]], last.subs(solution)])
    assert sp.simplify(end - step * sp.Matrix([q, p])) == sp.zeros(2, 1)


def test_factors_of_the_top_have_no_subtraction():
    """M_yy = [[A s^2 + C c^2, C c], [C c, C]]: the pivots are C and A s^2."""
    system = ss.systems.lagrange_top()
    plain = system.structure.plain
    factors = factorise(plain.mass.extract([0, 2], [0, 2]), plain.q)
    theta = plain.q[1]
    assert factors.order == (1, 0)
    assert factors.half_angles == (theta,)
    assert all(not pivot.is_Add for pivot in factors.pivots)
    assert sp.simplify(factors.fixed[1][0] + factors.moving[1][0] - sp.cos(theta)) == 0
    assert factors.moving[1][0].subs(theta, 0) == 0


@pytest.mark.parametrize("size", sweep([1, 2, 3, 4]))
def test_factors_multiply_to_the_matrix(size):
    q = sp.symbols(f"q0:{size + 1}", real=True)
    root = sp.Matrix(size, size, lambda i, j: sp.cos(q[i] + j) + (4 if i == j else 0))
    mass = sp.ImmutableDenseMatrix((root * root.T).expand())
    found = factorise(mass, q)
    lower = sp.eye(size) + sp.Matrix(found.fixed) + sp.Matrix(found.moving)
    product = lower * sp.diag(*found.pivots) * lower.T
    values = {x: sp.Rational(k + 2, 7) for k, x in enumerate(q)}
    gap = (product - mass.extract(list(found.order), list(found.order))).subs(values)
    assert all(abs(entry.evalf(30)) < 1e-25 for entry in gap)


@pytest.mark.slow
def test_factors_that_grow_without_end_are_given_up():
    size = 12
    q = sp.symbols(f"q0:{size}", real=True)
    mass = sp.ImmutableDenseMatrix(
        size, size, lambda i, j: sp.cos(q[i] - q[j]) / 20 + (1 if i == j else 0)
    )
    assert factorise(mass, q) is None


@pytest.mark.parametrize("exploit", [(), ("sparse",), ("cyclic",), ("decoupled", "linear")])
def test_every_coordinate_is_in_one_part(exploit):
    for make in ss.systems.CATALOGUE.values():
        found = make().structure
        parts = reduce(found, ss.SIMPSON, frozenset(exploit))
        taken = [i for part in parts for i in (*part.coordinates, *getattr(part, "cyclic", ()))]
        assert sorted(taken) == list(range(found.n))


@pytest.mark.parametrize(("exploit", "count"), [((), 1), ("linear", 1), ("decoupled", 2)])
def test_what_is_not_to_be_decoupled_is_one_part(exploit, count):
    x, y = ss.coordinates("x y")
    system = ss.MechanicalSystem(
        "two",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=x**4 + sp.cos(y),
        parameters={},
    )
    parts = discretise(system, ss.SIMPSON, exploit).parts
    assert [len(part.coordinates) for part in parts] == [2 // count] * count
