"""Linear point symmetries: which there are, in what digits, and of how many coordinates."""

import numpy as np
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.analysis.certify import DIGITS
from symsimpson.analysis.precise import Precise
from symsimpson.analysis.symmetries import _refined, block_size, linear_symmetries


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
    precise = Precise(stepper, run.parameters, DIGITS)
    found = linear_symmetries(precise, np.concatenate([run.q[0], run.p[0]]))
    assert [symmetry.name for symmetry in found] == momenta


def test_a_symmetry_that_is_not_determined_is_a_row_that_has_not_passed(monkeypatch):
    """mpmath's QR of a singular matrix raised a ValueError of its own, out of the certificate."""

    def undetermined(precise, z):
        return _refined(np.array([0.123456789, 0.23456789]), np.zeros((5, 2)), precise.context)

    monkeypatch.setattr("symsimpson.analysis.subject.linear_symmetries", undetermined)
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
        Precise(stepper, {"m": 1.5}, DIGITS), np.array([0.3, 0.4, 0.5, 1.0, -1.0, 0.2])
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
    precise = Precise(stepper, run.parameters, DIGITS)
    symmetries = linear_symmetries(precise, np.concatenate([run.q[0], run.p[0]]))
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
