"""How steps are solved, as certificates see it."""

import mpmath
import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.analysis.certify import DIGITS
from symsimpson.analysis.precise import Precise
from symsimpson.analysis.solver_checks import order_of_corrections


@pytest.mark.slow
@pytest.mark.plain
def test_a_jacobian_of_loops_is_that_of_the_unknowns():
    """A ring of 17 bodies: control points that follow from the others are no unknowns."""
    q = ss.coordinates("q:17")
    ring = ss.MechanicalSystem(
        "ring",
        coordinates=q,
        kinetic=sum(x.diff() ** 2 for x in q) / 2,
        potential=sum(1 - sp.cos(q[i] - q[i - 1]) for i in range(17)),
    )
    stepper = ss.compile(ring, "simpson")
    assert len(stepper.program.header.tables["SOLVE_COLUMNS"]) == 1
    subject = Precise(stepper, {}, DIGITS)
    z = np.array([mpmath.mpf(k % 7) / 40 for k in range(34)])
    assert subject.jacobian_defect(z, mpmath.mpf("0.05")) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.1, 4.0])
def test_rows_hold_where_forces_have_one_derivative(h):
    """Drag in each direction from rest: x rests all the time; large steps take 11 iterations."""
    x, y = ss.coordinates("x y")
    vx, vy = x.diff(), y.diff()
    system = ss.MechanicalSystem(
        "dropped",
        coordinates=(x, y),
        kinetic=(vx**2 + vy**2) / 2,
        potential=9.81 * y,
        forces={"drag": {x: -vx * sp.sqrt(vx**2) / 5, y: -vy * sp.sqrt(vy**2) / 5}},
    )
    certificate = ss.compile(system, "gauss4").certify([0.0, 0.0], v0=[0.0, 0.0], h=h)
    rows = {check.name: check for check in certificate.checks}
    assert rows["equations"].passed
    assert rows["Jacobian"].passed


def test_kernels_are_compared_in_a_step_that_all_of_them_take():
    """At h = 2 stages do not converge here: the state that they left was compared with others."""
    x, y = ss.coordinates("x y")
    vx, vy = x.diff(), y.diff()
    system = ss.MechanicalSystem(
        "rubbed",
        coordinates=(x, y),
        kinetic=(vx**2 + vy**2) / 2 + vx * vy * sp.cos(x) / 4,
        potential=x**2 / 2 + y**4 / 4,
        dissipation=(vx - vy) ** 2 / 4,
    )
    certificate = ss.compile(system, "gauss6").certify([1.0, 0.5], v0=[1.0, 0.0], h=2.0)
    assert certificate["fallbacks"].passed, certificate
    assert "a step of h/2 by newton" in certificate["fallbacks"].what


def test_velocities_at_a_momentum_are_those_that_constraints_move():
    """A string is pulled in: H is no function whose slope by p is v, and was differentiated."""
    x, y = ss.coordinates("x y")
    length = 1 + sp.sin(2 * ss.time) / 5
    system = ss.MechanicalSystem(
        "string",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        velocity_constraints={"string": (x**2 + y**2 - length**2).diff(ss.time) / 2},
    )
    precise = Precise(ss.compile(system, "midpoint"), {}, DIGITS)
    with mpmath.workdps(DIGITS):
        z = np.array([mpmath.mpf(k) / 25 for k in (15, -20, 6, -8)])
    assert abs(precise.gradient(z)[2:] - z[2:]).max() < 1e-45


def test_a_correction_that_is_better_than_quadratic_hides_no_order():
    """From 1e-6 to 2e-15 one gained more than its square, and the next ones looked slow."""
    assert order_of_corrections([1e-3, 1e-6, 2e-15, 8e-30]) > 1.9
    assert order_of_corrections([1e-1, 3e-1, 9e-2]) == 0.0


@pytest.mark.parametrize("ratio", [1e-1, 1e-4, 1e-8])
@pytest.mark.parametrize("start", [0.5, 1e-3, 1e-9])
def test_corrections_by_a_jacobian_that_is_off_by_little_are_linear(ratio, start):
    sizes = [start]
    while len(sizes) < 8 and sizes[-1] > 1e-37:
        sizes.append(max(sizes[-1] ** 2, ratio * sizes[-1]))
    assert order_of_corrections(sizes) < 1.5
