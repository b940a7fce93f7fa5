"""Systems from a Lagrangian and from SymPy's LagrangesMethod."""

import numpy as np
import pytest
import sympy as sp
from support.bodies import hanging_particle
from sympy.physics import mechanics as me

import symsimpson as ss

x, y = ss.coordinates("x y")
m, w, k, g, l = sp.symbols("m w k g l", positive=True)


def rotating():
    """A particle on springs in a rotating frame: a Coriolis term linear in the velocities."""
    vx, vy = x.diff() - w * y, y.diff() + w * x
    return m * (vx**2 + vy**2) / 2 - k * (x**2 + y**2) / 2 - k * x**4


@pytest.mark.slow
def test_lagrangian_with_gyroscopic_terms():
    values = {m: 1.3, w: 0.7, k: 2.0}
    system = ss.MechanicalSystem.from_lagrangian("rotating", rotating(), (x, y), values)
    assert system.mass_matrix == sp.diag(m, m)
    assert sp.expand(system.lagrangian - rotating()) == 0
    assert sp.expand(system.gyroscopic - m * w * (x * y.diff() - y * x.diff())) == 0
    assert system.structure.gyroscopic
    start = {"q0": [0.5, 0.1], "v0": [0.0, 0.3]}
    stepper = ss.compile(system)
    errors = [
        np.abs(stepper.integrate(**start, h=h, t_end=20).energy_error).max() for h in (0.1, 0.05)
    ]
    assert abs(np.log2(errors[0] / errors[1]) - 4) < 0.2
    assert np.allclose(
        stepper.integrate(**start, h=0.1, steps=0).p[0], [-1.3 * 0.7 * 0.1, 1.3 * (0.3 + 0.7 * 0.5)]
    )


@pytest.mark.parametrize("extra", [x.diff() ** 3, sp.sin(x.diff()), x.diff() * y.diff() ** 2])
def test_lagrangian_of_higher_degree(extra):
    parameters = {m: 1.0, w: 1.0, k: 1.0}
    system = ss.MechanicalSystem.from_lagrangian("odd", rotating() + extra, (x, y), parameters)
    assert not system.plain.quadratic
    assert "not quadratic" in str(system.structure)


def pendulum_bodies():
    theta, frame, _, bob, body = hanging_particle(m, l)
    body.potential_energy = -m * g * l * sp.cos(theta)
    return theta, frame, body, bob


@pytest.mark.slow
def test_lagranges_method():
    theta, frame, body, _ = pendulum_bodies()
    lm = me.LagrangesMethod(me.Lagrangian(frame, body), [theta])
    system = ss.MechanicalSystem.from_lagranges_method(
        "swing",
        lm,
        {m: 1.0, l: 1.0, g: 9.81},
        positions={"bob": (l * sp.sin(theta), -l * sp.cos(theta))},
        invariants={"height": theta},
    )
    assert system.positions.keys() == {"bob"}
    assert system.invariants.keys() == {"height"}
    assert sp.simplify(system.mass_matrix[0, 0] - m * l**2) == 0
    run = ss.compile(system).integrate([1.0], v0=[0.0], h=0.05, steps=100)
    same = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.05, steps=100)
    np.testing.assert_allclose(run.q, same.q, rtol=0, atol=1e-13)


def test_lagranges_method_with_more_is_refused():
    _, frame, body, _ = pendulum_bodies()
    L, values = me.Lagrangian(frame, body), {m: 1.0, l: 1.0, g: 9.81}
    make = ss.MechanicalSystem.from_lagranges_method
    with pytest.raises(ss.ModelError, match="is neither a sympy"):
        make("swing", L, values)


def test_lagrangians_of_first_order_are_told_from_missing_masses():
    for lagrangian in (x.diff() * sp.log(y) - x - y, x * y.diff() - sp.log(x**2 + y**2)):
        with pytest.raises(ss.ModelError, match=r"degenerate.* Its equations.*first order"):
            ss.MechanicalSystem.from_lagrangian("first_order", lagrangian, (x, y))
    with pytest.raises(ss.ModelError, match="zero row"):
        ss.MechanicalSystem.from_lagrangian("massless", x.diff() ** 2 / 2 - x * y, (x, y))


def test_parameters_and_their_absence():
    """None are needed where there are none; a matrix of coordinates is a sequence of them."""
    given = {"kinetic": (x.diff() ** 2 + y.diff() ** 2) / 2, "potential": x**2 * y**2}
    system = ss.MechanicalSystem("plain", coordinates=sp.Matrix([x, y]), **given)
    assert system == ss.MechanicalSystem("plain", coordinates=(x, y), parameters={}, **given)
    with pytest.raises(ss.ModelError, match="unknown symbol k"):
        ss.MechanicalSystem(
            "missing", coordinates=(x,), kinetic=x.diff() ** 2, potential=sp.Symbol("k") * x
        )


@pytest.mark.parametrize("name", ss.systems.CATALOGUE)
def test_catalogue_entries_are_complete(name):
    system = ss.systems.CATALOGUE[name]()
    assert system.source
    assert len(system.reference_state["q0"]) == system.n
    assert len(system.reference_state.keys() & {"v0", "p0"}) == 1


@pytest.mark.parametrize("make", [ss.systems.n_pendulum, ss.systems.fermi_pasta_ulam])
@pytest.mark.parametrize("n", [0, 1.5, True, "3"])
def test_chains_need_a_whole_number(make, n):
    with pytest.raises(ss.ModelError, match="whole number"):
        make(n)
