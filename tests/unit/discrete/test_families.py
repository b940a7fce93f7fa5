"""Families of terms stand for the terms they were read from."""

import random
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from support.chains import damped_chain

import symsimpson as ss
from symsimpson.declare.structure import _is_whole_multiple
from symsimpson.discrete import families as made
from symsimpson.discrete.bandwidth import list_neighbours, order_coordinates
from symsimpson.discrete.families import find_families


def lagrangian(plain):
    quadratic = (
        sum(
            plain.mass[i, j] * plain.v[i] * plain.v[j]
            for i in range(len(plain.v))
            for j in range(len(plain.v))
        )
        / 2
    )
    linear = sum(plain.to_sympy(a) * v for a, v in zip(plain.a, plain.v, strict=True))
    return quadratic + linear - plain.to_sympy(plain.V)


def total(found, plain):
    """Put coordinates and coefficients into the slots of each member and add up."""
    value = sp.S.Zero
    for family in found:
        term = lagrangian(family.plain)
        for places, numbers in zip(family.coordinates, family.coefficients, strict=True):
            q = dict(zip(family.plain.q, (plain.q[i] for i in places), strict=True))
            v = dict(zip(family.plain.v, (plain.v[i] for i in places), strict=True))
            numbers = map(plain.to_sympy, numbers)
            slots = dict(zip(family.plain.parameters[: family.slots], numbers, strict=True))
            value += term.xreplace(q | v | slots)
    return value


@pytest.mark.parametrize(
    ("make", "most"),
    [
        (lambda: ss.systems.n_pendulum(5), 4),
        (lambda: ss.systems.fermi_pasta_ulam(8), 6),
        (ss.systems.double_pendulum, 6),
        (ss.systems.heavy_top, 20),
        (ss.systems.rigid_body, 30),
    ],
)
def test_families_add_up_to_the_lagrangian(make, most):
    plain = make().structure.plain
    found = find_families(plain)
    assert len(found) <= most
    gap = total(found, plain) - lagrangian(plain)
    symbols = sorted(gap.free_symbols, key=str)
    assert (
        sp.expand(gap) == 0
        or abs(
            gap.evalf(40, subs={s: sp.Rational(k + 3, 7) for k, s in enumerate(symbols)}, maxn=400)
        )
        < 1e-30
    )


def test_terms_of_other_signs_and_orders_are_one_family():
    x = ss.coordinates("x0:6")
    v = [c.diff() for c in x]
    chain = ss.MechanicalSystem(
        "chain",
        coordinates=x,
        parameters={},
        kinetic=sum((3 + i) * u**2 for i, u in enumerate(v)) / 2,
        potential=sum(sp.cos((2 + i) * (x[i] - x[i + 1])) * (5 - i) for i in range(5)),
    )
    found = find_families(chain.structure.plain)
    assert sorted(len(family.coordinates) for family in found) == [5, 6]


def test_families_add_up_to_the_forces():
    plain = damped_chain().plain
    found = find_families(plain)
    assert len(found) <= 13
    forces = [sp.S.Zero] * len(plain.q)
    for family in found:
        for places, numbers in zip(family.coordinates, family.coefficients, strict=True):
            q = dict(zip(family.plain.q, (plain.q[i] for i in places), strict=True))
            v = dict(zip(family.plain.v, (plain.v[i] for i in places), strict=True))
            numbers = map(plain.to_sympy, numbers)
            slots = dict(zip(family.plain.parameters[: family.slots], numbers, strict=True))
            for place, f in zip(places, family.plain.f, strict=True):
                forces[place] += family.plain.to_sympy(f).xreplace(q | v | slots)
    for force, f in zip(forces, plain.f, strict=True):
        assert sp.expand(force - plain.to_sympy(f)) == 0
    assert sp.expand(total(found, plain) - lagrangian(plain)) == 0


def ring(constant, n=5):
    """Rotors on a ring, each coupled to the next; the constant is how everybody writes it."""
    a, K = ss.coordinates(f"a0:{n}"), sp.Symbol("K", positive=True)
    potential = K * sum(constant - sp.cos(a[i] - a[(i + 1) % n]) for i in range(n))
    return ss.MechanicalSystem(
        "ring",
        coordinates=a,
        kinetic=sum(x.diff() ** 2 for x in a) / 2,
        potential=potential,
        parameters={K: 1.5},
    )


def test_what_contains_no_coordinate_is_a_family_of_its_own():
    plain = ring(1).structure.plain
    found = find_families(plain)
    ((number,),) = next(f.coefficients for f in found if f.coordinates == ((),))
    assert plain.to_sympy(number) == -5 * plain.parameters[0]
    assert sp.expand(total(found, plain) - lagrangian(plain)) == 0


@pytest.mark.slow
def test_loops_over_families_take_constants():
    """The constant is in the energy, which is kept."""
    stepper = ss.compile(ring(1, n=6), "gauss6")
    assert "FAMILY_3" in stepper.source
    q0 = np.array([0.1, 0.2, -0.1, 0.3, 0.0, -0.2])
    run = stepper.integrate(q0, v0=[0.0] * 6, h=0.1, steps=20)
    assert np.isclose(run.energy[0], 1.5 * (1 - np.cos(q0 - np.roll(q0, -1))).sum(), rtol=1e-14)
    assert abs(run.energy_error).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_a_shuffled_chain_gets_its_order_back(seed):
    n = 30
    names = list(range(n))
    random.Random(seed).shuffle(names)
    near = [set() for _ in range(n)]
    for a, b in pairwise(names):
        near[a].add(b)
        near[b].add(a)
    order, band = order_coordinates(near)
    assert band == 1
    assert list(order) in (names, names[::-1])


def test_a_ladder_has_its_width_as_its_band():
    plain = ss.systems.fermi_pasta_ulam(20).structure.plain
    order, band = order_coordinates(list_neighbours(find_families(plain), 40))
    assert sorted(order) == list(range(40))
    assert band == 3


def test_what_is_shared_in_a_term_is_written_once(monkeypatch):
    """There are 2^40 paths down such a V; a level has two nodes and a power or a sum of them."""
    x, y = ss.coordinates("x y")
    product = summed = x
    for _ in range(40):
        product = sp.sin(product) * sp.cos(product)
        summed = sp.sin(summed) / 2 + sp.cos(summed) / 3
    system = ss.MechanicalSystem(
        "diamonds",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=product + y**2 + summed * y,
        parameters={},
    )
    visits, write = [], made._TermMatcher._new_node
    monkeypatch.setattr(
        made._TermMatcher, "_new_node", lambda *given: visits.append(given) or write(*given)
    )
    found = find_families(system.plain)
    assert len(visits) < 3 * len(system.plain.graph.nodes)
    assert sum(len(family.coordinates) for family in found) >= 4


def test_sums_of_shared_sums_are_not_split_without_end():
    x, y = ss.coordinates("x y")
    plain = ss.MechanicalSystem(
        "sums",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=y**2,
        parameters={},
    ).plain
    graph, (first, second) = plain.graph, plain.numbers(plain.q)
    value, moving = graph.power((1, first), 2), frozenset((first, second))
    for k in range(200):  # s_k = s_(k-1) + (s_(k-1) + sin(y + k))
        wave = graph.function("sin", graph.add([(1, second), (k + 1, 0)]))
        inner = graph.add([value, wave])
        value = graph.add([value, (1, graph.absorb_coefficient(inner))])
    assert list(made._split(graph, value, moving)) == [value]


def test_angles_of_shared_sums_are_whole_or_not():
    x, y = ss.coordinates("x y")
    graph = ss.MechanicalSystem(
        "angles",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=y**2,
        parameters={},
    ).plain.graph
    first, second = graph.symbol("q_0")[1], graph.symbol("q_1")[1]
    value = (1, first)
    for k in range(200):
        wave = graph.function("sin", graph.add([(1, second), (k + 1, 0)]))
        value = graph.add([value, (1, graph.absorb_coefficient(graph.add([value, wave])))])
    assert _is_whole_multiple(graph, value, first)  # 2^200 turns
    assert not _is_whole_multiple(graph, (0.5, graph.add([(1, first), (1, second)])[1]), first)
    assert not _is_whole_multiple(graph, value, second)
