"""Linear point symmetries: which there are, in what digits, and of how many coordinates."""

import mpmath
import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.study.analysis.certify import DIGITS
from symsimpson.study.analysis.discrete_flow import DiscreteFlow
from symsimpson.study.analysis.symmetries import _refine_row, block_size, linear_symmetries


@pytest.mark.parametrize(
    ("name", "momenta"),
    sweep(
        [
            ("lagrange_top", ["p_phi", "p_psi"]),
            ("double_pendulum", []),
            ("spherical_pendulum", ["p_phi"]),
            ("cart_pole", ["p_x"]),
        ]
    ),
)
def test_linear_symmetries(name, momenta):
    system = ss.systems.CATALOGUE[name]()
    stepper = ss.compile(system)
    run = stepper.integrate(**system.reference_state, h=0.01, steps=1)
    flow = DiscreteFlow(stepper, run.parameters, DIGITS)
    found = linear_symmetries(flow, np.concatenate([run.q[0], run.p[0]]))
    assert [symmetry.name for symmetry in found] == momenta


@pytest.mark.slow
def test_a_symmetry_that_is_not_determined_is_a_row_that_has_not_passed(monkeypatch):
    """mpmath's QR of a singular matrix raised a ValueError of its own, out of the certificate."""

    def undetermined(flow, z):
        return _refine_row(np.array([0.123456789, 0.23456789]), np.zeros((5, 2)), flow.context)

    monkeypatch.setattr("symsimpson.study.analysis.subject.linear_symmetries", undetermined)
    found = ss.compile(ss.systems.pendulum(), "midpoint").certify()
    (row,) = [check for check in found.checks if check.name == "momenta"]
    assert "a linear symmetry is not determined" in row.failure
    assert not found.passed


def test_rotations_of_many_coordinates_are_found():
    """A free particle in space: three translations, and with equal masses three rotations."""
    x, y, z = ss.coordinates("x y z")
    m = sp.Symbol("m", positive=True)
    system = ss.MechanicalSystem(
        "free",
        coordinates=(x, y, z),
        parameters={m: 1.5},
        potential=sp.S.Zero,
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2,
    )
    stepper = ss.compile(system)
    found = linear_symmetries(
        DiscreteFlow(stepper, {"m": 1.5}, DIGITS), np.array([0.3, 0.4, 0.5, 1.0, -1.0, 0.2])
    )
    assert {symmetry.name for symmetry in found} == {
        "p_x",
        "p_y",
        "p_z",
        "p_x*y - p_y*x",
        "p_x*z - p_z*x",
        "p_y*z - p_z*y",
    }


def test_momenta_of_masses_that_differ_by_eight_orders_are_exact():
    """Pluto has so little of the Sun's mass; displacements and rotations of all bodies alike."""
    system = ss.systems.outer_solar_system()
    stepper = ss.compile(system, "midpoint")
    run = stepper.integrate(**system.reference_state, h=10.0, steps=1)
    flow = DiscreteFlow(stepper, run.parameters, DIGITS)
    symmetries = linear_symmetries(flow, np.concatenate([run.q[0], run.p[0]]))
    assert [x.name for x in symmetries[:2]] == [
        " + ".join(f"p_{axis}{k}" for k in range(6)) for axis in "xy"
    ]
    assert symmetries[3].name.startswith("p_x0*y0 - p_y0*x0 + p_x1*y1 - p_y1*x1 + p_x2*y2")
    assert len(symmetries) == 6
    truth = np.kron(np.eye(6), [[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
    assert (truth == symmetries[3].A).all()
    assert abs(symmetries[3].exact[:, :-1] - truth).max() < 1e-25


def test_of_many_coordinates_blocks_alike_are_looked_for():
    assert [block_size(n) for n in (2, 12, 13, 14, 15, 18)] == [2, 12, 0, 2, 3, 3]


@pytest.mark.slow
def test_a_planet_in_metres_and_seconds_has_the_symmetry_of_one_in_years():
    """At y = 0 points within a metre were looked at, where H does not depend on y to 12 digits."""
    x, y = ss.coordinates("x y")
    system = ss.MechanicalSystem(
        "planet",
        coordinates=(x, y),
        kinetic=5e24 * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=-6.67e44 / sp.sqrt(x**2 + y**2),
    )
    certificate = ss.compile(system).certify([1.5e11, 0.0], v0=[0.0, 2e4])
    assert certificate.passed, certificate
    assert "change of p_x*y - p_y*x in" in certificate["momenta"].what


def test_a_ratio_of_masses_is_that_of_doubles():
    """5e-4 / 1e-5 is 50 but for a part in 10^17, and momenta are looked at in 50 digits."""
    x, y = ss.coordinates("x y")
    masses = sp.symbols("m1 m2", positive=True)
    system = ss.MechanicalSystem(
        "two_masses",
        coordinates=(x, y),
        kinetic=sum(m * q.diff() ** 2 for m, q in zip(masses, (x, y), strict=True)) / 2,
        potential=sp.S.Zero,
        parameters=dict(zip(masses, (5e-4, 1e-5), strict=True)),
    )
    flow = DiscreteFlow(ss.compile(system), {"m1": 5e-4, "m2": 1e-5}, DIGITS)
    turning = linear_symmetries(flow, np.array([0.3, 0.4, 1.0, -1.0]))[-1]
    assert turning.name == "p_x*y - 50*p_y*x"
    with flow.context.workdps(DIGITS):
        ratio = flow.context.mpf(5e-4) / flow.context.mpf(1e-5)
        assert abs(ratio / 50 - 1) > 1e-18
        assert abs(turning.exact[1, 0] / turning.exact[0, 1] / ratio + 1) < 1e-27


def test_what_many_digits_do_not_confirm_is_no_symmetry():
    matrix = np.array([[1, -1], [1, -1 + 1e-13]], dtype=object) * mpmath.mpf(1)
    with pytest.raises(ArithmeticError, match="it does not hold in many digits"):
        _refine_row(np.array([1.0, 1.0]), matrix, mpmath.mp)


@pytest.mark.slow
def test_momenta_of_a_light_body_have_their_own_size():
    """Displaced by a part of a star's momentum, a planet would fly off."""
    q = ss.coordinates("x1 y1 x2 y2 x3 y3")
    m = sp.symbols("m1:4", positive=True)
    bodies = [(m[k], q[2 * k], q[2 * k + 1]) for k in range(3)]
    pairs = [(a, b) for i, a in enumerate(bodies) for b in bodies[:i]]
    system = ss.MechanicalSystem(
        "planet_of_two_stars",
        coordinates=q,
        kinetic=sum(m * (x.diff() ** 2 + y.diff() ** 2) for m, x, y in bodies) / 2,
        potential=-sum(
            a * b / sp.sqrt((x - u) ** 2 + (y - v) ** 2) for (a, x, y), (b, u, v) in pairs
        ),
        parameters=dict(zip(m, (1.0, 1e-8, 1.0), strict=True)),
    )
    stepper = ss.compile(system, "midpoint")
    certificate = stepper.certify([0, 0, 1, 0, 10, 0], v0=[0, 0, 0, 1, 0, 0.4], h=0.2)
    assert certificate["symplectic"].passed, certificate
    assert certificate["momenta"].passed, certificate
