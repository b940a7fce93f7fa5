import mpmath
import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.cases import sweep
from support.oracle import interpolate, nodes_and_weights

import symsimpson as ss
from symsimpson.discrete.combined_rows import elimination_order
from symsimpson.lower.pipeline import derive
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.quadrature import gauss, lobatto

FAMILY = [("gauss", s, s) for s in range(1, 6)] + [("lobatto", s, s - 1) for s in range(2, 7)]
FAMILY += [
    ("lobatto", 3, 3),
    ("gauss", 3, 2),
    ("gauss", 8, 8),
    ("lobatto", 9, 8),
    ("lobatto", 7, 7),
]


@pytest.mark.parametrize(("kind", "nodes", "degree"), sweep(FAMILY, 5))
def test_tables_agree_with_root_finding(kind, nodes, degree):
    scheme = ss.galerkin(kind, nodes, degree)
    with mpmath.workdps(40):
        points, weights = nodes_and_weights(kind, nodes)
        controls = nodes_and_weights("lobatto", degree + 1)[0]
        close = mpmath.mpf(10) ** -35

        def near(exact, value):
            return abs(mpmath.mpf(sp.N(exact, 40)) - value) < close

        assert all(map(near, scheme.quadrature.nodes, points))
        assert all(map(near, scheme.quadrature.weights, weights))
        for i, c in enumerate(points):
            basis, slopes = interpolate(controls, c)
            assert all(map(near, scheme.A[i], basis))
            assert all(map(near, scheme.B[i], slopes))


def test_how_far_radicals_go():
    assert [gauss(nodes).exact for nodes in (1, 4, 5)] == [True, True, False]
    assert [lobatto(nodes).exact for nodes in (2, 5, 6)] == [True, True, False]


@pytest.mark.parametrize(("kind", "nodes", "degree"), FAMILY)
def test_order_of_the_quadrature(kind, nodes, degree):
    rule = {"gauss": gauss, "lobatto": lobatto}[kind](nodes)

    def defect(power):
        total = sum(b * c**power for b, c in zip(rule.weights, rule.nodes, strict=True))
        return sp.N(total - sp.Rational(1, power + 1), 30)

    assert all(abs(defect(power)) < 1e-25 for power in range(rule.order))
    assert abs(defect(rule.order)) > 1e-10
    assert ss.galerkin(kind, nodes, degree).order == min(2 * degree, rule.order)


@pytest.mark.parametrize("name", ["midpoint", "simpson", "gauss4", "lobatto6"])
def test_the_predictor_continues_polynomials(name):
    """Increments of a polynomial of degree d + 1 are predicted without error."""
    scheme = read_scheme(name)
    x = sp.Symbol("x")
    d = scheme.degree
    path = sum(sp.Rational(k + 2, 3) * x**k for k in range(1, d + 2))
    old = [path.subs(x, c - 1) - path.subs(x, -1) for c in scheme.points[1:]]
    slope = path.diff(x).subs(x, 0)
    bend = slope - sum(s * o for s, o in zip(scheme.end_slope, old, strict=True))
    for k, c in enumerate(scheme.points[1:]):
        row = zip(scheme.extrapolation[k], old, strict=True)
        predicted = sum(e * o for e, o in row) + scheme.correction[k] * bend
        assert sp.simplify(predicted - path.subs(x, c)) == 0


@pytest.mark.parametrize(
    "name", ["midpoint", "simpson", "gauss4", "gauss6", "lobatto6", "lobatto8"]
)
def test_elimination_meets_no_singular_pivot(name):
    """For the oscillator no leading minor vanishes at any step: x2 = (h omega)^2 > 0."""
    scheme = read_scheme(name)
    rows, columns = elimination_order(scheme.degree)
    x2 = sp.Symbol("x2")
    weights = scheme.quadrature.weights
    matrix = sp.Matrix(
        len(rows),
        len(rows),
        lambda i, j: sp.expand(
            sum(
                b
                * (
                    scheme.B[m][rows[i]] * scheme.B[m][columns[j]]
                    - x2 * scheme.A[m][rows[i]] * scheme.A[m][columns[j]]
                )
                for m, b in enumerate(weights)
            )
        ),
    )
    for k in range(1, len(rows) + 1):
        minor = sp.Poly(sp.N(sp.expand(matrix[:k, :k].det()), 40), x2)
        roots = (
            mpmath.polyroots(
                [mpmath.mpf(c) for c in minor.all_coeffs()], maxsteps=200, extraprec=200
            )
            if minor.degree()
            else []
        )
        assert not [r for r in roots if abs(mpmath.im(r)) < 1e-12 and mpmath.re(r) > -1e-12]
        assert minor.eval(0) != 0


@pytest.mark.parametrize("scheme", sweep(["lobatto_5_5", "gauss6", "gauss16", "lobatto16"]))
def test_tables_that_modules_make(scheme):
    """In doubles they are the nearest numbers, and those of stages fit together exactly."""
    found = read_scheme(scheme)
    nodes, degree = found.stages, found.degree
    module = bind_float(derive(ss.systems.pendulum(), scheme, varied=()).text)
    if not found.exact:
        assert list(map(float, found.quadrature.weights)) == list(module.WEIGHTS)
        assert list(map(float, found.points)) == list(module.POINTS)
        for made, table in ((module.BASIS, found.A), (module.BASIS_SLOPE, found.B)):
            np.testing.assert_allclose(made, np.array(table, dtype=float), rtol=0, atol=1e-13)
        for name, table in (
            ("EXTRAPOLATION", found.extrapolation),
            ("END_SLOPE", found.end_slope),
            ("START_SLOPE", found.correction),
        ):
            exact = np.array(table, dtype=float)
            np.testing.assert_allclose(getattr(module, name), exact, rtol=1e-13, atol=1e-13)
    if found.by_stages:
        path, impulse, ahead, smooth = module.STAGE_TABLE[:, :nodes].reshape(4, nodes, nodes)
        assert not module.STAGE_TABLE[:, nodes:].any()
        assert np.all(path + impulse.T == 1.0)  # b_i a_ij + b_j a_ji^ = b_i b_j, without rounding
        b, c = (
            np.array(x, dtype=float) for x in (found.quadrature.weights, found.quadrature.nodes)
        )
        for power in range(nodes):  # sum_j a_ij c_j^k = c_i^(k + 1)/(k + 1)
            np.testing.assert_allclose(
                (b * c**power) @ path, c ** (power + 1) / (power + 1), atol=1e-14
            )
        np.testing.assert_allclose(b * c @ ahead, b * (1 + c), rtol=1e-9)
        # increments of control points have the slopes that they are made of
        slopes = np.array(found.B, dtype=float)[:, 1:]
        atol = 1e-13 * np.abs(slopes).max()
        np.testing.assert_allclose(slopes @ module.REACHED_BY_MOVES, np.diag(1 / b), atol=atol)
        for power in range(nodes):  # of what is not as smooth nothing is left
            part = np.polynomial.Legendre.basis(power, domain=[0, 1])
            left = b * part(1 + c) * (power <= nodes - 3)
            rounding = 1e-13 * np.abs(smooth).max(axis=0)
            assert np.all(np.abs(b * part(c) @ smooth - left) <= rounding)
    assert degree == module.DEGREE


def test_names():
    assert ss.galerkin("gauss", 1, 1) is ss.MIDPOINT
    assert ss.galerkin(quadrature="lobatto", nodes=3, degree=2) is ss.SIMPSON
    assert read_scheme("lobatto4") is ss.SIMPSON
    assert read_scheme("gauss2") is ss.MIDPOINT
    for scheme in (ss.galerkin("lobatto", 3, 3), ss.galerkin("gauss", 2, 2), ss.SIMPSON):
        assert read_scheme(scheme.name) is scheme
    assert "order 4" in repr(ss.SIMPSON)


@pytest.mark.parametrize("wrong", ["euler", "gauss3", "lobatto", "gauss0", "", None, 4, "simpson "])
def test_unknown_schemes(wrong):
    with pytest.raises(ss.SchemeError, match=r"no scheme|quadrature has at least"):
        ss.compile(ss.systems.pendulum(), wrong)


@pytest.mark.plain
def test_names_that_schemes_have_elsewhere():
    with pytest.raises(ss.SchemeError, match="Its name here is 'lobatto2'"):
        ss.compile(ss.systems.pendulum(), "Leapfrog")
    h, q, p = 0.1, 0.5, 0.3
    run = ss.compile(ss.systems.pendulum(), "lobatto2").integrate([q], p0=[p], h=h, steps=20)
    for _ in range(20):  # Stoermer and Verlet, by kick, drift and kick
        p -= h / 2 * 9.81 * np.sin(q)
        q += h * p
        p -= h / 2 * 9.81 * np.sin(q)
    assert abs(run.q[-1, 0] - q) < 1e-14
    assert abs(run.p[-1, 0] - p) < 1e-14


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("gauss", 2, 3), "2 quadrature nodes cannot determine"),
        (("gauss", 0, 1), "at least 1 node"),
        (("gauss", [2], 1), "a whole number of nodes, not"),
        (("gauss", 2.0, 1), "a whole number of nodes, not 2.0"),
        (("lobatto", 1, 1), "at least 2 node"),
        (("simpson", 2, 2), "no quadrature"),
        (("gauss", 2, 0), "at least 1, not 0"),
        (("gauss", 17, 17), "at most 16 nodes"),
    ],
)
def test_impossible_schemes(arguments, message):
    with pytest.raises(ss.SchemeError, match=message):
        ss.galerkin(*arguments)
