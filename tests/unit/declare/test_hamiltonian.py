"""Declarations by H(q, p), and what is rejected."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

x, y = ss.coordinates("x y")
p, q = sp.symbols("p q", real=True)
k = sp.Symbol("k", positive=True)


def declare(hamiltonian, coordinates=(x, y), momenta=(p, q), **others):
    return ss.HamiltonianSystem(
        "some", coordinates=coordinates, momenta=momenta, hamiltonian=hamiltonian, **others
    )


WRONG = {
    "velocity": ({"hamiltonian": p**2 + x.diff() ** 2}, r"velocity x'.*\n.*from_lagrangian"),
    "count": ({"hamiltonian": p**2, "momenta": (p,)}, "2 coordinates and 1 momenta"),
    "equal names": ({"hamiltonian": p**2, "momenta": (p, p)}, "two symbols have the name 'p'"),
    "name of a coordinate": (
        {"hamiltonian": p**2, "momenta": (p, sp.Symbol("x", real=True))},
        "a momentum and a coordinate",
    ),
    "unknown": ({"hamiltonian": p**2 * k}, "unknown symbol k"),
    "no momentum": ({"hamiltonian": x**2}, "contains no momentum"),
    "text": ({"hamiltonian": p**2, "momenta": "p q"}, "not a tuple of symbols"),
}


@pytest.mark.parametrize("case", WRONG.values(), ids=WRONG)
def test_rejected(case):
    given, message = case
    with pytest.raises(ss.ModelError, match=message):
        declare(**given)


SINGULAR = {
    "degree one": (sp.sqrt(x.diff() ** 2 + y.diff() ** 2), r"degree one.*\n.*F\*\*2/2"),
    "linear": (x * y.diff() - x**2 - y**2, r"degenerate.*\n.*HamiltonianSystem"),
    "one row": (x.diff() ** 4 - y**2, "zero row"),
}


@pytest.mark.parametrize("case", SINGULAR.values(), ids=SINGULAR)
def test_lagrangians_with_a_singular_hessian(case):
    lagrangian, message = case
    with pytest.raises(ss.ModelError, match=message):
        ss.MechanicalSystem.from_lagrangian("some", lagrangian, (x, y), {})


def test_schemes_with_more_nodes_than_degrees():
    with pytest.raises(ss.SchemeError, match=r"many nodes as degrees.*\n.*gauss4 or lobatto_3_3"):
        ss.compile(declare(p**2 + q**2), "simpson")
    with pytest.raises(ss.SchemeError, match=r"rank 1 of 2. H is linear in q"):
        ss.compile(declare(p**2 + q * x), "simpson")
    with pytest.raises(ss.SchemeError, match=r"not T\(p\) \+ V\(q\).*\n?.*gauss8"):
        ss.compile(declare(p**2 + q * x), "kahan_li8")
    with pytest.raises(ss.SchemeError, match="quadratic"):
        ss.compile(declare(p**4 + q**2 + x**2), "blanes_moan4")


def test_structure_equations_and_linear_equations():
    system = declare(p**2 / 2 + q * y + k * x**2 / 2, parameters={k: 4.0})
    assert system.structure.momentum_rank == 1
    assert "rank 1 of 2" in str(system.structure)
    assert sp.Eq(x.diff(), sp.Function("p")(ss.time)) in system.equations
    A, B = system.linearise([0.1, 0.2], [0.3, 0.4])
    np.testing.assert_array_equal(A, [[0, 0, 1, 0], [0, 1, 0, 0], [-4, 0, 0, 0], [0, 0, 0, -1]])
    assert B.shape == (4, 0)
    assert "H" in system._repr_latex_()
    with pytest.raises(ss.ModelError, match="no Lagrangian"):
        _ = system.lagrangian
    with pytest.raises(ss.ModelError, match="no mass matrix"):
        _ = system.mass_matrix


def test_indefinite_masses():
    with pytest.raises(ss.ModelError, match="indefinite=True"):
        ss.MechanicalSystem(
            "some", coordinates=(x, y), kinetic=x.diff() ** 2 - y.diff() ** 2, potential=0 * x
        )
    system = ss.MechanicalSystem.from_lagrangian("some", x.diff() * y.diff() - x * y, (x, y), {})
    assert not system.plain.definite
    assert "indefinite" in str(system.structure)


@pytest.mark.slow
def test_a_cyclic_coordinate_without_kinetic_energy_of_its_own():
    """M_yy = 0, so the velocity of y cannot be eliminated first."""
    lagrangian = (2 + sp.sin(x)) * x.diff() * y.diff() + x.diff() ** 2 / 2
    system = ss.MechanicalSystem.from_lagrangian("some", lagrangian, (x, y), {})
    runs = [
        ss.compile(system, "simpson", exploit=exploit).integrate(
            [0.1, 0.2], v0=[0.5, 0.3], h=0.05, steps=40
        )
        for exploit in ("all", ())
    ]
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=0, atol=1e-14)
    np.testing.assert_allclose(runs[0].p[:, 1], runs[0].p[0, 1], rtol=0, atol=1e-15)


def test_runs_of_hamiltonians():
    system = declare(
        p**2 / 2 + (q**2 + x**2) / 2 + y**4 / 4 + p * y / 3,
        forces={"drag": {x: -x.diff() / 5}},
        invariants={"sum": p + q},
    )
    stepper = ss.compile(system, "gauss4")
    run = stepper.integrate([0.3, 0.4], p0=[0.1, 0.2], h=0.05, steps=40)
    np.testing.assert_allclose(run.v[:, 0], run.p[:, 0] + run.q[:, 1] / 3, rtol=0, atol=1e-15)
    assert np.abs(run.energy_balance).max() < 1e-8
    np.testing.assert_allclose(run.invariants["sum"], run.p.sum(axis=1), rtol=0, atol=1e-15)
    again = stepper.integrate([0.3, 0.4], v0=run.v[0], h=0.05, steps=40)
    np.testing.assert_allclose(again.p, run.p, rtol=0, atol=1e-14)
    with pytest.raises(AttributeError, match="no kinetic"):
        _ = run.kinetic_energy


def test_no_velocity_of_a_momentum():
    lagrangian = sp.sin(x.diff()) - x**2 / 2
    system = ss.MechanicalSystem.from_lagrangian("some", lagrangian, (x,), {})
    stepper = ss.compile(system, "gauss4")
    with pytest.raises(ss.InputError, match=r"no velocity has the momentum.*\nGive v0"):
        stepper.integrate([0.0], p0=[2.0], h=0.1, steps=1)
    vortices = ss.compile(ss.systems.point_vortices(), "gauss4")
    with pytest.raises(ss.InputError, match=r"no momentum has the velocity.*\nGive p0"):
        vortices.integrate([0.0, 1.0, 0.25], v0=[0.1, 0.1, 0.1], h=0.1, steps=1)


def test_second_names_of_schemes():
    system = ss.systems.restricted_three_bodies()
    assert ss.compile(system, "lobatto_iiiab4").scheme == "lobatto_3_3"
    assert ss.compile(system, "lobatto_iiiab6").scheme == "lobatto_4_4"


def test_impacts_need_a_lagrangian():
    stepper = ss.compile(declare(p**2 / 2 + (q**2 + x**2) / 2), "gauss4")
    wall = ss.Event(x + 1, name="wall", action=ss.Impact(0.5))
    with pytest.raises(ss.ModelError, match=r"is an impact.*\nWrite the jump"):
        stepper.integrate([0.3, 0.4], p0=[0.1, 0.2], h=0.05, steps=4, events=[wall])


def test_what_a_hamiltonian_does_not_have():
    system = declare(p**2 / 2 + (q**2 + x**2) / 2)
    stepper = ss.compile(system, "gauss4")
    with pytest.raises(ss.InputError, match=r"no equations of a step.*\n(.*\n)*.*gradient"):
        stepper.residual([0.3, 0.4], [0.1, 0.2], [[0.3, 0.4], [0.3, 0.4]], h=0.05)
    with pytest.raises(ss.ModelError, match=r"cannot be retimed.*\+ p_t"):
        system.retimed(1 + x**2)
    with pytest.raises(ss.InputError, match="optimal control does not accept"):
        ss.OptimalControl(system)


def test_time_as_a_coordinate():
    """K = g (H + p_t) has the orbits of H in t, with fixed steps in tau."""
    t, pt = ss.coordinates("time_")[0], sp.Symbol("pt", real=True)
    H, r = (p**2 + q**2) / 2 - 1 / sp.sqrt(x**2 + y**2), sp.sqrt(x**2 + y**2)
    in_tau = declare(r ** sp.Rational(3, 2) * (H + pt), coordinates=(x, y, t), momenta=(p, q, pt))
    stepper = ss.compile(in_tau, "gauss12")
    turn = ss.Event(y, name="turn", direction=1, terminal=3)
    start = {"p0": [0.0, 19**0.5, 0.5], "h": 0.1, "t_end": 100.0}
    run = stepper.integrate([0.1, 0.0, 0.0], **start, events=[turn])
    assert abs(run.q[-1, 2] - 6 * np.pi) < 1e-10
    assert np.abs(run.energy_error).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["midpoint", "gauss4", "lobatto_3_3"])
def test_shadow_energies(scheme):
    """H oscillates with h^2 or h^4, its modified energy with h^4 or h^8."""
    system = ss.systems.post_newtonian_binary()
    stepper, sizes = ss.compile(system, scheme), []
    for h in (0.08, 0.04):
        run = stepper.integrate(**system.reference_state, h=h, t_end=8.0)
        sizes.append((np.ptp(run.energy), np.ptp(run.shadow_energy)))
    order, shadow = np.log2(sizes[0]) - np.log2(sizes[1])
    assert sizes[1][1] < sizes[1][0] / 100
    assert shadow > 2 * order - 0.7


@pytest.mark.slow
def test_a_scheme_is_chosen():
    system = ss.systems.restricted_three_bodies()
    run = ss.integrate(system, **system.reference_state, t_end=20.0, error=1e-9)
    assert 0 < run.error_estimate < 1e-9
