import mpmath as mp
import pytest
import sympy as sp
from support.oracle import lagrangian
from support.workspace import jet_values

import symsimpson as ss
from symsimpson.discrete import jet
from symsimpson.discrete.jet import derive_jet


@pytest.mark.parametrize(
    "make", [ss.systems.lagrange_top, ss.systems.n_pendulum, ss.systems.kepler]
)
def test_jet_agrees_with_differences(make):
    system = make()
    plain, n = system.plain, system.n
    point = [sp.Rational(k + 3, 7) for k in range(2 * n)]
    parameters = [sp.Rational(k + 4, 5) for k in range(len(plain.parameters))]
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

        found = jet_values(derive_jet(plain), z[:n], z[n:], a)

        def agrees(key, truth):
            return abs(found[key] - truth) < mp.mpf("1e-25") * (1 + abs(truth))

        for i in range(n):
            assert agrees(("F", i), first(i))
            assert agrees(("P", i), first(n + i))
            for j in range(n):
                assert agrees(("F_q", i, j), second(i, j))
                assert agrees(("F_v", i, j), second(i, n + j))
                assert agrees(("P_q", i, j), second(n + i, j))
                assert agrees(("M", i, j), second(n + i, n + j))


def test_strategies_with_more_terms_are_not_tried(monkeypatch):
    """A chain in relative angles: v.M.v/2 has many times the terms of T as it is written."""
    angles = ss.coordinates("a b c d e f")
    x, y, angle, T = sp.S.Zero, sp.S.Zero, sp.S.Zero, sp.S.Zero
    for q in angles:
        angle += q
        x, y = x + sp.sin(angle), y - sp.cos(angle)
        T += (sp.diff(x, ss.time) ** 2 + sp.diff(y, ss.time) ** 2) / 2
    chain = ss.MechanicalSystem("chain", coordinates=angles, kinetic=T, potential=y)
    tried = []
    derived = jet._derive_by

    def told(plain, T, way, *others):
        tried.append((way, derived(plain, T, way, *others)))
        return tried[-1][1]

    monkeypatch.setattr(jet, "_derive_by", told)
    shortest = derive_jet(chain.structure.plain)
    assert not any(way.by_mass for way, _ in tried)
    assert shortest.operations == min(one.operations for _, one in tried)
    monkeypatch.setattr(jet, "LONGER", 1e9)
    assert derive_jet(chain.structure.plain).operations == shortest.operations
    assert any(way.by_mass for way, _ in tried)
