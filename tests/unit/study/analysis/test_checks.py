"""Checks of a certificate, one by one."""

import mpmath
import numpy as np
import pytest
import sympy as sp

import symsimpson as ss
from symsimpson.study.analysis import checks
from symsimpson.study.analysis.certify import DIGITS
from symsimpson.study.analysis.checks import measure_drift, order_of_corrections
from symsimpson.study.analysis.discrete_flow import DiscreteFlow
from symsimpson.study.analysis.subject import Subject


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
    subject = DiscreteFlow(stepper, {}, DIGITS)
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
    flow = DiscreteFlow(ss.compile(system, "midpoint"), {}, DIGITS)
    with mpmath.workdps(DIGITS):
        z = np.array([mpmath.mpf(k) / 25 for k in (15, -20, 6, -8)])
    assert abs(flow.gradient(z)[2:] - z[2:]).max() < 1e-45


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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.errors.ResolutionWarning")
def test_violent_motions_change_their_level_with_half_the_step_too(monkeypatch):
    """The energy of three pendulums wanders by 3e-1 with h, by 3e-3 with h/2."""
    monkeypatch.setattr("symsimpson.study.analysis.certify.CHECKS", {"drift": measure_drift})
    chain = ss.systems.n_pendulum(3)
    certificate = ss.compile(chain, "gauss8").certify([2.0, 1.0, 0.0], v0=[0.0] * 3, h=1 / 64)
    assert certificate.passed, certificate


@pytest.mark.slow
def test_the_energy_of_what_rolls_is_watched(monkeypatch):
    """A coin turns through 2e5 rad: the rounding of its angles turns the constraints, too."""
    monkeypatch.setattr("symsimpson.study.analysis.certify.CHECKS", {"drift": measure_drift})
    x, y, roll, turn = ss.coordinates("x y roll turn")
    coin = ss.MechanicalSystem(
        "coin",
        coordinates=(x, y, roll, turn),
        kinetic=(x.diff() ** 2 + y.diff() ** 2 + (roll.diff() ** 2 + turn.diff() ** 2) / 50) / 2,
        potential=0,
        velocity_constraints={
            "along": x.diff() - sp.cos(turn) * roll.diff() / 5,
            "aside": y.diff() - sp.sin(turn) * roll.diff() / 5,
        },
    )
    certificate = ss.compile(coin, "gauss4").certify([0.0] * 4, v0=[0.4, 0.0, 2.0, 1.0], h=4.0)
    assert certificate.passed, certificate
    assert [row.name for row in certificate.checks] == ["watched"]


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
    flow = DiscreteFlow(stepper, {}, 50)
    subject = Subject(stepper, flow, np.array([1.0, 0.0, 0.0, 0.6]), 0.03)
    defect, symmetries = checks.momentum_balance(subject)
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
    exact = checks._force

    def doubled(system):
        force = exact(system)
        return lambda *given: [2 * f for f in force(*given)]

    monkeypatch.setattr(checks, "_force", doubled)
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
