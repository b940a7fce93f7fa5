"""What forces give to momenta, as a certificate measures it."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.analysis import momentum_balance
from symsimpson.analysis.precise import Precise
from symsimpson.analysis.subject import Subject

x, y = ss.coordinates("x y")
c, w = sp.symbols("c w", positive=True)
SPEED, R2 = sp.sqrt(x.diff() ** 2 + y.diff() ** 2), x**2 + y**2


def kepler():
    """Drag, and a swirl that turns with time."""
    swirl = w / R2 * sp.cos(ss.time)
    drag = {x: -c * SPEED * x.diff() - swirl * y, y: -c * SPEED * y.diff() + swirl * x}
    return ss.MechanicalSystem(
        "kepler_with_drag",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-1 / sp.sqrt(R2),
        parameters={c: 0.001, w: 0.002},
        forces={"drag": drag},
    )


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["simpson", "gauss6"])
def test_forces_give_what_the_quadrature_says(scheme):
    certificate = ss.compile(kepler(), scheme).certify([1.0, 0.0], v0=[0.0, 1.1], h=0.1)
    assert certificate.passed, certificate
    assert certificate["momenta"].measured < 1e-45
    assert "p_x*y" in certificate["momenta"].what


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["simpson", "gauss6"])
def test_constraints_pull_beside_the_forces(scheme):
    z, u = ss.coordinates("z")[0], sp.Symbol("u")
    system = ss.MechanicalSystem(
        "sphere",
        coordinates=(x, y, z),
        kinetic=(x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2,
        potential=9.81 * z,
        parameters={c: 0.1},
        forces={"torque": {x: -u * y, y: u * x}},
        dissipation=c * (x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2,
        inputs=(u,),
        constraints=[x**2 + y**2 + z**2 - 1],
    )
    certificate = ss.compile(system, scheme).certify([0.6, 0.0, -0.8], v0=[0.0, 1.0, 0.0], h=0.05)
    assert certificate["momenta"].measured < 1e-45
    assert "p_x*y" in certificate["momenta"].what
    assert certificate.passed, certificate


@pytest.mark.parametrize("push", [sp.Rational(1, 4), -x.diff() / 9])
def test_forces_with_numbers_alone_have_all_digits(push):
    """A number of the force, or a multiple of v, stood to the left of q, with 15 digits."""
    system = ss.MechanicalSystem(
        "pushed",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=R2,
        forces={x: push},
    )
    stepper = ss.compile(system)
    precise = Precise(stepper, {}, 50)
    subject = Subject(stepper, precise, np.array([1.0, 0.0, 0.0, 0.6]), 0.03)
    defect, symmetries = momentum_balance.momentum_balance(subject)
    assert [symmetry.name for symmetry in symmetries] == ["p_x*y - p_y*x"]
    assert defect < 1e-45


@pytest.mark.slow
def test_coarse_steps_are_halved_until_they_show_the_order():
    """From h to h/2 alone the order of this sleigh's energy less work would seem to be 2.2."""
    x, y, th = ss.coordinates("x y th")
    u = sp.Symbol("u")
    sleigh = ss.MechanicalSystem(
        "rubbed_sleigh",
        coordinates=(x, y, th),
        kinetic=(x.diff() ** 2 + y.diff() ** 2 + th.diff() ** 2) / 2,
        potential=0,
        velocity_constraints={"blade": sp.cos(th) * y.diff() - sp.sin(th) * x.diff()},
        forces={th: u - th.diff() / 10},
        inputs=(u,),
    )
    q0 = [0.873266, 0.542808, 0.336876]
    _, v0 = sleigh.consistent(q0, [0.4, 0.1, 0.5])
    certificate = ss.compile(sleigh, "gauss4").certify(q0, v0=v0, h=0.5)
    assert 3.5 < certificate["balance"].measured < 4.5
    assert "h/4" in certificate["balance"].what
    assert certificate.passed, certificate


@pytest.mark.slow
def test_other_forces_would_be_seen(monkeypatch):
    exact = momentum_balance._force

    def doubled(system):
        force = exact(system)
        return lambda *given: [2 * f for f in force(*given)]

    monkeypatch.setattr(momentum_balance, "_force", doubled)
    certificate = ss.compile(kepler()).certify([1.0, 0.0], v0=[0.0, 1.1], h=0.1)
    assert not certificate.passed
    assert certificate["momenta"].measured > 1e-6


@pytest.mark.slow
def test_where_l_depends_on_the_time_nothing_is_asked():
    system = ss.MechanicalSystem(
        "in_time",
        coordinates=(x,),
        kinetic=(2 + sp.sin(ss.time)) * x.diff() ** 2 / 2,
        potential=0 * x,
        parameters={c: 0.1},
        forces={x: -c * x.diff() ** 3},
    )
    certificate = ss.compile(system).certify([0.3], v0=[0.5], h=0.1)
    assert certificate["momenta"].exempt
