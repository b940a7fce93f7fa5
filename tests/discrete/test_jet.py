import mpmath as mp
import pytest
import sympy as sp
from oracle import lagrangian

import symsimpson as ss
from symsimpson.discrete.jet import derive_jet


@pytest.mark.parametrize(
    "make", [ss.systems.lagrange_top, ss.systems.n_pendulum, ss.systems.kepler]
)
def test_jet_agrees_with_differences(make):
    system = make()
    plain, jet, n = system.plain, derive_jet(system.plain), system.n
    symbols = (*plain.q, *plain.v, *plain.parameters)
    point = [sp.Rational(k + 3, 7) for k in range(2 * n)]
    parameters = [sp.Rational(k + 4, 5) for k in range(len(plain.parameters))]
    values = dict(zip(symbols, [*point, *parameters], strict=True))
    with mp.workdps(60):
        L = lagrangian(system)
        z = [mp.mpf(x.p) / x.q for x in point]
        a = [mp.mpf(x.p) / x.q for x in parameters]
        step = mp.mpf("1e-15")

        def at(*moves):
            moved = list(z)
            for index, amount in moves:
                moved[index] += amount
            return L(moved[:n], moved[n:], a)

        def first(i):
            return (at((i, step)) - at((i, -step))) / (2 * step)

        def second(i, j):
            signs = [(s, t) for s in (1, -1) for t in (1, -1)]
            return sum(s * t * at((i, s * step), (j, t * step)) for s, t in signs) / (4 * step**2)

        def agrees(expression, truth):
            found = mp.mpf(sp.N(expression.xreplace(values), 50))
            return abs(found - truth) < mp.mpf("1e-25") * (1 + abs(truth))

        for i in range(n):
            assert agrees(jet.L_q[i], first(i))
            assert agrees(jet.L_v[i], first(n + i))
            for j in range(n):
                assert agrees(jet.L_qq[i, j], second(i, j))
                assert agrees(jet.L_qv[i, j], second(i, n + j))
                assert agrees(jet.L_vv[i, j], second(n + i, n + j))
