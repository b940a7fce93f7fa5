"""Findings are exact: what algebra proves is found, what is almost there is not."""

import random

import pytest
import sympy as sp
from support.cases import sweep
from support.random_systems import structured_system

import symsimpson as ss
from symsimpson.declare.identities import vanishes
from symsimpson.discrete.equations import discretise
from symsimpson.discrete.reductions import Coupled, Linear, Routh, Separable

x, y, z = ss.coordinates("x y z")
vx, vy, vz = (c.diff() for c in (x, y, z))
k = sp.Symbol("k", positive=True)
SQUARES = (vx**2 + vy**2) / 2


def declare(kinetic=SQUARES, potential=sp.S.Zero, coordinates=(x, y), gyroscopic=sp.S.Zero):
    symbols = potential.free_symbols & {k}
    return ss.MechanicalSystem(
        "some",
        coordinates=coordinates,
        kinetic=kinetic,
        potential=potential,
        gyroscopic=gyroscopic,
        parameters=dict.fromkeys(symbols, 1.5),
    )


def parts(system, scheme=ss.SIMPSON, exploit="all"):
    return discretise(system, scheme, exploit).parts


HIDDEN_ONE = sp.sin(y) ** 2 + sp.cos(y) ** 2
DOUBLED = sp.sin(2 * y) - 2 * sp.sin(y) * sp.cos(y)


@pytest.mark.parametrize(
    ("kinetic", "potential"),
    [
        (SQUARES, x**4),
        (vx**2 / 2 + vy**2 * HIDDEN_ONE / 2, x**4),
        (SQUARES, x**4 * HIDDEN_ONE),
        (SQUARES + vx * vy * DOUBLED, sp.exp(x) + DOUBLED),
        (SQUARES, x**4 + (x + y) ** 2 - x**2 - 2 * x * y - y**2),
        (SQUARES, sp.exp(x + y) * sp.exp(-y)),
    ],
)
def test_hidden_cyclic_coordinates_are_found(kinetic, potential):
    found = declare(kinetic, potential).structure
    assert found.cyclic == ("y",)
    assert not found.undecided
    assert found.separable
    assert found.zeros["M"] == (2, 4)


@pytest.mark.parametrize(
    "zero", [sp.acos(sp.cos(y)) ** 2 - y**2, sp.acos(sp.sin(y)) + y - sp.pi / 2]
)
def test_zero_at_every_sample_is_not_zero(zero):
    """Both vanish in the interval of the samples and not beyond it."""
    system = declare(potential=x**4 + zero)
    assert not vanishes(zero.subs(y, sp.Symbol("y", real=True)))
    found = system.structure
    assert found.cyclic == ()
    assert found.undecided == ("whether V depends on y",)
    assert "undecided" in str(found)
    assert not any(isinstance(part, Routh) for part in parts(system))


def test_a_constant_mass_that_is_hidden():
    found = declare((vx**2 + vy**2) * HIDDEN_ONE / 2 + vx * vy * DOUBLED).structure
    assert found.constant_mass
    assert found.diagonal_mass


@pytest.mark.parametrize(
    ("potential", "groups"),
    [
        (x**4 + sp.cos(y), 2),
        ((x + y) ** 2 + (x - y) ** 2, 2),
        ((x + y) ** 4 + (x - y) ** 4, 1),
        (sp.log(k * sp.exp(x) * sp.exp(y**2)), 2),
        (sp.cos(x + y) + sp.cos(x - y), 1),
        (sp.cos(x + y) + sp.sin(x) * sp.sin(y) - sp.cos(x) * sp.cos(y) + x**4 + y**4, 2),
    ],
)
def test_subsystems(potential, groups):
    system = declare(potential=potential)
    assert len(system.structure.subsystems) == groups
    assert len(parts(system)) == groups
    assert len(parts(system, exploit=("linear", "cyclic"))) == 1


def test_coupling_through_mass_joins():
    joined = [
        declare(SQUARES + vx * vy / 3, x**4 + y**4),
        declare(vx**2 / 2 * (2 + sp.cos(y)) + vy**2 / 2, x**4 + y**4),
        declare(SQUARES, x**4 + y**4, gyroscopic=y * vx),
    ]
    for system in joined:
        assert len(system.structure.subsystems) == 1


@pytest.mark.parametrize(
    ("potential", "linear"),
    [
        (k * x**2 / 2 + x * y - y, True),
        ((x + y) ** 3 - x**3 - y**3 - 3 * x**2 * y - 3 * x * y**2 + x**2, True),
        (k * x**2 * HIDDEN_ONE + y**2, True),
        (x**2 + y**2 + sp.Float(1e-12) * x**3, False),
        (sp.sqrt(x**2 + 1) + y**2, False),
    ],
)
def test_linear(potential, linear):
    system = declare(potential=potential)
    assert system.structure.linear is linear
    kinds = {type(part) for part in parts(system)}
    assert (kinds == {Linear}) is linear
    assert Linear not in {type(part) for part in parts(system, exploit=("decoupled", "sparse"))}


def test_linear_in_one_part_only():
    system = declare(potential=x**2 + y**4)
    assert [type(part) for part in parts(system)] == [Linear, Separable]
    assert not system.structure.linear


def test_coordinates_that_are_angles():
    half = declare(potential=sp.cos(x / 2) + sp.sin(2 * y)).structure
    assert half.periodic == ("y",)
    assert declare(potential=sp.cos(x) * x + sp.cos(y) ** 3).structure.periodic == ("y",)
    assert ss.systems.double_pendulum().structure.periodic == ("q1", "q2")


def test_rows_of_the_mass_matrix_that_are_constant():
    assert ss.systems.lagrange_top().structure.constant_rows == ("theta",)
    assert "depends on q, except in the rows of theta" in str(ss.systems.lagrange_top().structure)
    assert ss.systems.double_pendulum().structure.constant_rows == ()
    assert ss.systems.henon_heiles().structure.constant_rows == ("x", "y")


def test_zeros_are_counted():
    found = declare(
        (vx**2 + vy**2 * (2 + sp.cos(x)) + vz**2) / 2 + vx * vz / 4, y * z, (x, y, z)
    ).structure
    assert found.zeros == {"M": (4, 9), "dM/dq": (26, 27), "Hess V": (7, 9)}


ALMOST = [1e-9, sp.Rational(1, 10**9)]


@pytest.mark.slow
@pytest.mark.parametrize("start", sweep(range(0, 200, 20)))
def test_almost_structure_is_no_structure(start):
    """Each planted finding is broken by a term of 1e-9, and what is made of it is general."""
    for seed in range(start, start + 20):
        system, planted = structured_system(seed)
        pick, tiny = random.Random(seed), ALMOST[seed % 2]
        for breaks in sorted(planted & {"cyclic", "linear", "constant", "decoupled"}):
            broken, is_gone = spoil(system, breaks, tiny, pick)
            assert is_gone(broken.structure), (seed, breaks)
            assert not broken.structure.undecided


def spoil(system, breaks, tiny, pick):
    """Add a tiny term; the second value tells whether the finding is gone."""
    before, q = system.structure, system.coordinates
    kinetic, potential = system.kinetic, system.potential

    def group_of(found, i):
        return next(s for s in found.subsystems if i in s.coordinates)

    if breaks == "cyclic":
        name = pick.choice(before.cyclic)
        i = [c.func.__name__ for c in q].index(name)
        if pick.random() < 0.5:
            potential += tiny * sp.cos(q[i])
        else:
            kinetic += tiny * q[i] ** 2 * q[i].diff() ** 2
        return declared(system, kinetic, potential), lambda found: name not in found.cyclic
    if breaks == "decoupled":
        a, b = (pick.choice(s.coordinates) for s in before.subsystems[:2])
        term = pick.choice([q[a] * q[b], sp.sin(q[a] - q[b])])
        return declared(
            system, kinetic, potential + tiny * term
        ), lambda found: len(found.subsystems) == len(before.subsystems) - 1
    i = pick.choice(
        [
            i
            for s in before.subsystems
            for i in s.coordinates
            if s.separable and s.linear == (breaks == "linear")
        ]
    )
    if breaks == "linear":
        broken = declared(system, kinetic, potential + tiny * q[i] ** 3)
        return broken, lambda found: not group_of(found, i).linear
    broken = declared(system, kinetic + tiny * sp.cos(q[i]) * q[i].diff() ** 2, potential)
    return (
        broken,
        lambda found: (
            not group_of(found, i).constant_mass
            and any(isinstance(part, Coupled) and i in part.coordinates for part in parts(broken))
        ),
    )


def declared(system, kinetic, potential):
    return ss.MechanicalSystem(
        "almost",
        coordinates=system.coordinates,
        kinetic=kinetic,
        potential=potential,
        gyroscopic=system.gyroscopic,
        parameters=system.parameters,
    )


def test_report_in_a_terminal():
    text = repr(ss.systems.lagrange_top().structure)
    for line in ("cyclic       phi, psi", "L does not contain them"):
        assert line in text
    assert max(map(len, text.splitlines())) <= 79
    text = str(ss.systems.harmonic_oscillator().structure)
    assert "forces linear in q" in text
    costs = repr(ss.step_costs(ss.systems.lagrange_top()))
    assert "6 > 2" in costs
    assert "3 > 1" in costs


def test_report_of_a_large_system_is_short():
    text = str(ss.systems.fermi_pasta_ulam(8).structure)
    assert "(16)" in text
    assert "operations" not in text


def test_a_report_does_no_work(monkeypatch):
    """Whoever prints what was found does not wait for modules to be generated."""
    found = ss.systems.rigid_body().structure

    def derived(*given):
        raise AssertionError("a report derives something")

    monkeypatch.setattr("symsimpson.lower.pipeline._derive", derived)
    monkeypatch.setattr("symsimpson.discrete.equations.derive_jet", derived)
    assert "mass matrix" in repr(found)
    assert "mass matrix" in found._repr_html_()


def test_report_in_a_notebook_is_escaped():
    odd = sp.Function("a<b>&")(*x.args)
    system = declare(odd.diff() ** 2 / 2, odd**4, (odd,))
    text = system.structure._repr_html_()
    assert "a&lt;b&gt;&amp;" in text
    assert "a<b" not in text
    assert text.count("<table") == text.count("</table>") == 1
    costs = ss.step_costs(system, ["midpoint"])._repr_html_()
    assert "midpoint" in costs
    assert costs.count("<table") == costs.count("</table>") == 1


@pytest.mark.parametrize("wrong", ["cycle", ["cyclic", "sparsity"], 3, [None]])
def test_exploit_is_checked(wrong):
    with pytest.raises(ss.GenerationError, match=r"(?s)exploit contains .*Choose 'all', \(\)"):
        ss.compile(ss.systems.kepler(), exploit=wrong)
