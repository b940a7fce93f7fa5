"""What passes: right steppers, whatever their units, orders, stiffness and states."""

from dataclasses import replace
from types import SimpleNamespace

import mpmath
import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.study.analysis.certificate import Check
from symsimpson.study.analysis.order import measure_order

PENDULUM = ss.systems.double_pendulum()


def test_an_order_that_is_late_is_seen_with_another_half():
    """Errors h^4 - 3.9 h^6 change their sign, and from h/4 to h/8 they show an order of 3.7."""
    measured = SimpleNamespace(
        stepper=SimpleNamespace(order=4, source=""),
        flow=SimpleNamespace(context=mpmath.mp, advance=lambda z, h, steps: h**4 - 3.9 * h**6),
        h=1.0,
        z=0.0,
        solve_exactly=lambda end, error: 0.0,
        distance=lambda a, b: float(abs(a - b)),
    )
    (row,) = measure_order(measured)
    assert row.passed
    assert "for h to h/32" in row.what
    measured.flow.advance = lambda z, h, steps: h**3
    (row,) = measure_order(measured)
    assert not row.passed
    assert row.measured == pytest.approx(3)


@pytest.mark.slow
def test_a_limit_that_is_missed_by_little_is_shown_in_full():
    row = Check("order", 7.83, "at least", 7.85, "errors", "The scheme has order 8.")
    shown = repr(replace(ss.compile(PENDULUM).certify(h=0.01), checks=(row,)))
    assert "FAIL order             7.83 >= 7.85" in shown


@pytest.mark.slow
def test_a_body_that_turns_on_its_orbit_passes():
    """In metres, 1.5e11 from the sun and in the plane of its orbit, with a unit quaternion."""
    (x, y, z), (a, b, c, d) = ss.coordinates("x y z"), ss.coordinates("a b c d")
    m, GM, A, B, C, J = sp.symbols("m GM A B C J", positive=True)
    rates = (
        2 * (-b * a.diff() + a * b.diff() + d * c.diff() - c * d.diff()),
        2 * (-c * a.diff() - d * b.diff() + a * c.diff() + b * d.diff()),
        2 * (-d * a.diff() + c * b.diff() - b * c.diff() + a * d.diff()),
    )
    turning = sum(i * w**2 for i, w in zip((A, B, C), rates, strict=True)) / 2
    # what the constraint keeps at zero makes M regular
    stretch = J * (a * a.diff() + b * b.diff() + c * c.diff() + d * d.diff()) ** 2
    craft = ss.MechanicalSystem(
        "craft",
        coordinates=(x, y, z, a, b, c, d),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2 + z.diff() ** 2) / 2 + turning + stretch,
        potential=-GM * m / sp.sqrt(x**2 + y**2 + z**2),
        parameters={m: 500, GM: 1.327e20, A: 100, B: 150, C: 200, J: 300},
        constraints={"unit": a**2 + b**2 + c**2 + d**2 - 1},
    )
    start = {"q0": [1.5e11, 0, 0, 1, 0, 0, 0], "v0": [0, 2.98e4, 0, 0, 0.005, 0.01, 0.015]}
    certificate = ss.compile(craft).certify(**start, h=5.0)
    assert certificate.passed, certificate
    assert certificate["momenta"].what.count("p_") == 6 + 3 * 4


@pytest.mark.slow
def test_a_step_that_is_chosen_is_solved_in_few_iterations():
    """Newton's method takes long steps in a strong field; nodes are iterated in shorter ones."""
    x, y, z = q = ss.coordinates("x y z")
    kinetic = sum(c.diff() ** 2 for c in q) / 2
    field = (x * y.diff() - y * x.diff()) / 2
    well = 0.00887 * (z**2 - (x**2 + y**2) / 2)
    trap = ss.MechanicalSystem.from_lagrangian("trap", kinetic + field - well, q)
    certificate = ss.compile(trap, "gauss8").certify([1.0, 0.0, 2.0], v0=[0.0, 0.2, 0.0])
    assert certificate.passed, certificate


@pytest.mark.slow
def test_what_is_watched_and_no_invariant_is_not_asked_of():
    (x,) = ss.coordinates("x")
    energy = x.diff() ** 2 / 2 - sp.cos(x)
    system = ss.MechanicalSystem(
        "swing",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=-sp.cos(x),
        invariants={"speed": x.diff() ** 2, "energy_again": energy},
    )
    certificate = ss.compile(system).certify([0.5], v0=[0.3])
    assert certificate.passed, certificate
    watched, kept = (check for check in certificate.checks if check.name == "invariant")
    assert "speed: not measured" in watched.what
    assert kept.measured > 3.5


def test_an_error_without_words_is_a_row_that_has_not_passed(monkeypatch):
    """mpmath divides by zero without a message."""

    def divided(subject):
        yield mpmath.mpf(1) / 0

    monkeypatch.setattr("symsimpson.study.analysis.certify.CHECKS", {"order": divided})
    (row,) = ss.compile(PENDULUM).certify(h=0.01).checks
    assert not row.passed
    assert row.failure == "ZeroDivisionError"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["midpoint", "simpson", "gauss4", "gauss6"]))
def test_a_stiff_direction_in_which_nothing_swings_is_resolved(scheme):
    """Steps without its oscillation succeed at any h, but differences of the map see it."""
    x, y = ss.coordinates("x y")
    spring = 5e5 * (sp.sqrt(x**2 + y**2) - 1) ** 2
    system = ss.MechanicalSystem(
        "stiff",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y + spring,
    )
    certificate = ss.compile(system, scheme).certify([0.8, -0.6], [0.0, 0.0])
    assert certificate.passed, certificate
    assert certificate.h * 1000 < 1.5


@pytest.mark.slow
def test_a_system_without_a_state_of_reference():
    x, y = ss.coordinates("x y")
    m, k = sp.symbols("m k", positive=True)
    system = ss.MechanicalSystem(
        "spring",
        coordinates=(x, y),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=k * (sp.sqrt(x**2 + y**2) - 1) ** 2 / 2,
        parameters={m: 2.0, k: 10.0},
    )
    stepper = ss.compile(system)
    certificate = stepper.certify()
    assert certificate.passed, certificate
    assert "p_x*y - p_y*x" in certificate["momenta"].what
    own = stepper.certify([0.5, 0.5], [0.0, 1.0], h=0.02, parameters={"k": 20.0})
    assert own.h == 0.02
    assert own.q0 == (0.5, 0.5)
    assert own.p0 == (0.0, 2.0)
    assert own.parameters["k"] == 20.0
    with pytest.raises(ss.InputError, match="without q0"):
        stepper.certify(p0=[1.0, 0.0])


@pytest.mark.parametrize("mass", [sp.Rational(11, 10), 1])
@pytest.mark.slow
def test_free_bodies_pass(mass):
    """Generators of symmetries are exact, and the rounding of angular momenta grows with the way.

    The generators that mix bodies of unequal masses are made of elevenths.
    """
    q = ss.coordinates("x1 y1 x2 y2")
    v = [c.diff() for c in q]
    system = ss.MechanicalSystem(
        "free_bodies",
        coordinates=q,
        parameters={},
        kinetic=(v[0] ** 2 + v[1] ** 2 + mass * (v[2] ** 2 + v[3] ** 2)) / 2,
        potential=((q[0] - q[2]) ** 2 + (q[1] - q[3]) ** 2) ** 2,
    )
    certificate = ss.compile(system).certify(h=0.125)
    assert certificate.passed, certificate
    assert certificate["momenta"].what.count(",") == 3


@pytest.mark.slow
def test_coefficients_of_few_digits_pass_at_any_step():
    """Errors of a small step are below those that rounding published coefficients leaves."""
    certificate = ss.compile(ss.systems.henon_heiles(), "blanes_moan6").certify(h=0.02)
    assert certificate.passed, certificate
    assert certificate["order"].measured > 5.9
