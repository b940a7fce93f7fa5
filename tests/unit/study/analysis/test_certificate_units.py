"""Certificates in units in which all numbers are small, or large."""

import pytest
import sympy as sp

import symsimpson as ss

x, y = ss.coordinates("x y")
m, r, G = sp.symbols("m r G", positive=True)


@pytest.mark.slow
@pytest.mark.parametrize(("length", "mass"), [(1e-9, 1e-26), (1e8, 5e24)])
def test_what_is_measured_does_not_depend_on_units(length, mass):
    def certified(length, mass):
        system = ss.MechanicalSystem(
            "swing",
            coordinates=(x,),
            kinetic=m * x.diff() ** 2 / 2,
            potential=m * r**2 * (1 - sp.cos(x / r)),
            parameters={m: mass, r: length},
        )
        found = ss.compile(system).certify(q0=[2.8 * length], v0=[0.0], h=0.25)
        return {check.name: check for check in found.checks}

    plain, other = certified(1.0, 1.0), certified(length, mass)
    assert [name for name, check in other.items() if not check.passed] == []
    assert other["order"].measured == pytest.approx(plain["order"].measured, abs=1e-3)
    assert other["shadow"].measured == pytest.approx(plain["shadow"].measured, rel=1e-2)


@pytest.mark.slow
def test_constraints_and_momenta_in_small_units():
    unit = 1e-9
    rod = ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=0,
        constraints={"rod": x**2 + y**2 - r**2},
        parameters={m: 1e-20, r: unit},
    )
    found = ss.compile(rod).certify(q0=[unit, 0.0], v0=[0.0, 0.7 * unit], h=0.1)
    assert [check.name for check in found.checks if not check.passed] == []


@pytest.mark.slow
@pytest.mark.parametrize("retimed", [False, True])
def test_metres_of_an_atom_beside_radians(retimed):
    """An electron around a proton, in polar coordinates and SI units; p_phi is Noether's."""
    k = sp.Symbol("k", positive=True)
    atom = ss.MechanicalSystem(
        "atom",
        coordinates=(x, y),
        kinetic=m * (x.diff() ** 2 + x**2 * y.diff() ** 2) / 2,
        potential=-k / x,
        parameters={m: 9.109e-31, k: 2.307e-28},
    )
    timed = atom.retimed("encounters") if retimed else atom
    scheme = "gauss8" if retimed else "simpson"
    found = ss.compile(timed, scheme).certify(q0=[5.3e-11, 0.0], v0=[0.0, 3.3e16], h=1e-18)
    assert [check.name for check in found.checks if not check.passed] == []
    (momenta,) = [check for check in found.checks if check.name == "momenta"]
    assert momenta.what.startswith("change of p_y")


W = sp.Symbol("w", positive=True)
SLOW = ss.MechanicalSystem(
    "slow",
    coordinates=(x,),
    kinetic=x.diff() ** 2 / 2,
    potential=W**2 * (x**2 / 2 + x**4 / 4),
    parameters={W: 1e-9},
)


@pytest.mark.slow
@pytest.mark.parametrize(("start", "speed"), [(0.7, 0.0), (0.0, 1e-9)])
def test_the_step_of_a_slow_motion_is_long(start, speed):
    found = ss.compile(SLOW).certify([start], v0=[speed])
    assert found.passed, found
    assert 0.01 < found.h * 1e-9 < 1


@pytest.mark.slow
@pytest.mark.parametrize(("start", "h"), [(0.7, 0.1), (0.0, None)])
def test_a_certificate_of_no_motion_does_not_pass(start, h):
    found = ss.compile(SLOW).certify([start], v0=[0.0], h=h)
    assert not found.passed
    assert "nothing was tested" in found["order"].failure  # and no RuntimeWarning is given


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
def test_a_step_that_is_far_too_large_is_measured_no_further():
    (row,) = ss.compile(ss.systems.double_pendulum(), "gauss8").certify(h=1e4).checks
    assert "more than 100 steps" in row.failure


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
@pytest.mark.filterwarnings("ignore::symsimpson.errors.ResolutionWarning")
def test_steps_of_which_some_parts_fail_are_measured_no_further():
    """The planets took 40 s at h = 1e4 days, of which eight steps succeed."""
    stepper = ss.compile(ss.systems.outer_solar_system())
    assert [row.name for row in stepper.certify(h=1e4).checks] == ["order"]
