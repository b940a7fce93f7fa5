"""What forced and timed steps keep: order, momenta, reversal, work; what mistakes would cost."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest
import sympy as sp
from scipy.optimize import fsolve
from support.cases import sweep
from support.driven import PROBLEMS, double_pendulum, growing_mass, kepler_with_drag, van_der_pol
from support.hamilton import truth

import symsimpson as ss

t = ss.time
a, c, g, k, w = sp.symbols("a c g k w", positive=True)


STEPS = {
    "midpoint": (160, 320),
    "simpson": (80, 160),
    "lobatto6": (40, 80),
    "gauss4": (80, 160),
    "gauss6": (40, 80),
    "gauss8": (14, 28),
    "gauss12": (10, 16),
}


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(STEPS, 2))
@pytest.mark.parametrize("name", sweep(PROBLEMS, 2))
def test_the_order_is_that_without_forces(name, scheme):
    system, q, v, end = PROBLEMS[name]()
    stepper = ss.compile(system, scheme)
    p = stepper.integrate(q, v, h=0.1, steps=0).p[0]
    exact = truth(system, q, p, end)
    errors = []
    for steps in STEPS[scheme]:
        run = stepper.integrate(q, p0=p, h=end / steps, steps=steps)
        errors.append(np.abs(np.concatenate([run.q[-1], run.p[-1]]) - exact).max())
    few, many = STEPS[scheme]
    order = np.log(errors[0] / errors[1]) / np.log(many / few)
    # high orders are seen in steps that are not small, and come up from below: rounding is near
    short = 0.15 if stepper.order < 8 else 0.5 if stepper.order == 8 else 1.0
    assert order > stepper.order - short or errors[1] < 1e-13


def test_explicit_steps_take_forces_of_time_and_position():
    x, y = ss.coordinates("x y")
    system = ss.MechanicalSystem(
        "kicked",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + 2 * y.diff() ** 2) / 2,
        potential=x**4 / 4 + y**2 / 2,
        parameters={a: 0.5, w: 3.0},
        forces={x: a * sp.cos(w * t) + y / 10, y: -sp.sin(y) * x / 5},
    )
    q, v = [0.5, 0.3], [0.2, 0.1]
    for scheme, (few, many) in {"suzuki4": (20, 40), "blanes_moan6": (10, 20)}.items():
        stepper = ss.compile(system, scheme)
        p = stepper.integrate(q, v, h=0.1, steps=0).p[0]
        exact = truth(system, q, p, 2.0)
        errors = [
            np.abs(np.concatenate([run.q[-1], run.p[-1]]) - exact).max()
            for run in (stepper.integrate(q, p0=p, h=2 / n, steps=n) for n in (few, many))
        ]
        assert np.log2(errors[0] / errors[1]) > stepper.order - 0.3
    run = stepper.integrate(q, v, h=0.1, steps=4)
    with pytest.raises(ss.InputError, match="is explicit: its steps have no nodes"):
        _ = run.work
    with pytest.raises(ss.SchemeError, match="force depends on velocities in x"):
        ss.compile(ss.systems.van_der_pol(), "suzuki4")
    with pytest.raises(ss.SchemeError, match="mass matrix depends on the time in x"):
        ss.compile(growing_mass()[0], "suzuki4")


def simpson_by_hand(rate, wrong, h, steps, q, p):
    """Simpson's forced step for L = v^2/2 - V written down anew, with a mistake or without.

    Forces of a node come in with its weight and the shares A_ik of the control points.
    """
    shares = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    slopes = np.array([[-3, 4, -1], [-1, 0, 1], [1, -4, 3]], dtype=float)
    weights, places = np.array([1, 4, 1]) / 6, np.array([0, 0.5, 1])
    force, pull = rate

    def rows(inner, start, momentum, time):
        X = np.array([start, *inner])
        Q, velocity = shares @ X, slopes @ X / h
        times = time + places * h
        if wrong == "time of the middle":
            times = np.full(3, time + h / 2)
        mean = np.full(3, (X[2] - X[0]) / h)
        speeds = mean if wrong == "mean velocity" else velocity
        f = np.array([force(*at) for at in zip(times, Q, speeds, strict=True)])
        L_q = np.array([pull(x) for x in Q])
        share = weights[:, None] * shares
        if wrong == "ends alone":
            share = np.diag([0.5, 0, 0.5])
        if wrong == "middle alone":
            share = np.zeros((3, 3))
            share[1] = 0.5, 0, 0.5
        D = h * (weights * L_q) @ shares + (weights * velocity) @ slopes
        F = h * f @ share
        if wrong == "all into the start":
            F = np.array([F.sum(), 0, 0])
        return D + F

    for step in range(steps):

        def left(inner, start=q, momentum=p, time=step * h):
            found = rows(inner, start, momentum, time)
            return [momentum + found[0], found[1]]

        inner = fsolve(left, [q + h * p / 2, q + h * p], xtol=1e-12)
        q, p = inner[1], rows(inner, q, p, step * h)[2]
    return np.array([q, p])


MISTAKES = [
    "",
    "ends alone",
    "middle alone",
    "mean velocity",
    "time of the middle",
    "all into the start",
]


@pytest.mark.parametrize("wrong", MISTAKES)
def test_every_mistake_in_the_virtual_work_costs_the_order(wrong):
    """The scheme written down anew is the product's; with a mistake its order is two or one."""
    system, (q,), (v,), _ = van_der_pol()
    rate = (lambda s, x, u: 1.5 * (1 - x**2) * u + 0.5 * np.cos(2 * s), lambda x: -x)
    exact = truth(system, [q], [v], 1.0)
    errors = []
    for steps in (20, 40):
        found = simpson_by_hand(rate, wrong, 1 / steps, steps, q, v)
        errors.append(np.abs(found - exact).max())
        if not wrong:
            run = ss.compile(system).integrate([q], [v], h=1 / steps, steps=steps)
            assert np.abs(found - [run.q[-1, 0], run.p[-1, 0]]).max() < 1e-11
    order = np.log2(errors[0] / errors[1])
    assert order > 3.85 if not wrong else order < 2.2


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "gauss4", "lobatto6", "gauss8"]))
def test_momentum_changes_by_what_forces_give(scheme):
    """Angular momentum: the change is h sum_i b_i (q_i x f_i), the quadrature of a new coordinate.

    A coordinate z with L = z'^2/2 and the force q x f on it adds up the same sum.
    """
    system, q, v, _ = kepler_with_drag()
    x, y, z = ss.coordinates("x y z")
    drag = system.forces["drag"]
    wider = ss.MechanicalSystem(
        "with_torque",
        coordinates=(x, y, z),
        kinetic=system.kinetic + z.diff() ** 2 / 2,
        potential=system.potential,
        parameters=system.parameters,
        forces={"drag": {**drag, z: x * drag[y] - y * drag[x]}},
    )
    run = ss.compile(wider, scheme).integrate([*q, 0.0], [*v, 0.0], h=0.1, steps=100)
    angular = run["x"] * run["p_y"] - run["y"] * run["p_x"]
    assert abs(angular[-1] - angular[0]) > 0.1
    assert np.abs(angular - angular[0] - run["p_z"]).max() < 1e-14 * 100**0.5


@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8"]))
def test_momentum_of_a_cyclic_coordinate_stays_to_the_bit(scheme):
    theta, phi = ss.coordinates("theta phi")
    kinetic = (theta.diff() ** 2 + sp.sin(theta) ** 2 * phi.diff() ** 2) / 2
    system = ss.MechanicalSystem(
        "braked",
        coordinates=(theta, phi),
        kinetic=kinetic,
        potential=g * sp.cos(theta),
        parameters={g: 9.81, c: 0.3},
        dissipation=c * theta.diff() ** 2 / 2,
    )
    run = ss.compile(system, scheme).integrate([1.5, 0.0], [0.2, 2.0], h=0.02, steps=500)
    assert np.ptp(run["p_phi"]) == 0
    assert run.energy[-1] < run.energy[0] - 0.1


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "lobatto6", "gauss8"]))
@pytest.mark.parametrize("name", sweep(PROBLEMS))
def test_a_step_back_undoes_a_step(name, scheme):
    system, q, v, _ = PROBLEMS[name]()
    stepper = ss.compile(system, scheme)
    p = stepper.integrate(q, v, h=0.1, steps=0).p[0]
    there = stepper.step(q, p=p, h=0.02, t=0.3)
    back = stepper.step(there[0], p=there[1], h=-0.02, t=0.32)
    assert np.abs(np.concatenate(back) - [*q, *p]).max() < 1e-14


@pytest.mark.parametrize("scheme", sweep(["simpson", "midpoint", "gauss4", "lobatto6"]))
@pytest.mark.parametrize("name", sweep(PROBLEMS))
def test_energy_balance_has_the_order_of_the_scheme(name, scheme):
    system, q, v, _ = PROBLEMS[name]()
    stepper = ss.compile(system, scheme)
    largest = [
        np.abs(stepper.integrate(q, v, h=2 / n, steps=n).energy_balance).max() for n in (80, 160)
    ]
    # where energy and work are quadratic, Gauss schemes balance them to rounding
    assert np.log2(largest[0] / largest[1]) > stepper.order - 0.4 or largest[1] < 1e-14


def test_named_forces_do_work_by_themselves():
    system, q, v, _ = double_pendulum()
    run = ss.compile(system).integrate(q, v, h=0.01, t_end=2.0)
    assert list(run.work) == ["drive", "dissipation", "total"]
    assert np.abs(run.work["drive"] + run.work["dissipation"] - run.work["total"]).max() < 1e-15
    assert (np.diff(run.work["dissipation"]) <= 0).all()
    # the trapezoid of the power at the states has order two
    power = run.power["dissipation"]
    rough = np.cumsum((power[1:] + power[:-1]) / 2) * 0.01
    assert np.abs(rough - run.work["dissipation"][1:]).max() < 2e-4
    with pytest.raises(ss.InputError, match=r"forces do work(.|\n)*run.energy_balance"):
        _ = run.energy_error
    with pytest.raises(ss.InputError, match="stored only its final state"):
        _ = ss.compile(system).integrate(q, v, h=0.01, steps=5, every=None).work


def test_work_of_a_conservative_system_is_none():
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], [0.0], h=0.1, steps=5)
    assert (run.work["total"] == 0).all()
    assert (run.power["total"] == 0).all()
    assert (run.energy_balance == run.energy - run.energy[0]).all()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["simpson", "gauss8"]))
def test_lanes_members_and_states_between_agree(scheme):
    system, q, v, _ = double_pendulum()
    stepper = ss.compile(system, scheme)
    starts = np.array([q, [0.3, -0.2], [1.0, 0.4]])
    many = stepper.ensemble(starts, v0=[v] * 3, h=0.02, steps=50, every=1, t0=0.4)
    for k, start in enumerate(starts):
        one = stepper.integrate(start, v, h=0.02, steps=50, t0=0.4)
        assert np.abs(many.q[k] - one.q).max() < 1e-13
        assert np.abs(many.energy[k] - one.energy).max() < 1e-13
    whole = stepper.integrate(starts[-1], v, h=0.02, steps=50, t0=0.4)
    # states between steps are parts of steps, at their times
    middle = whole.at([0.4 + 0.335])
    fine = stepper.integrate(starts[-1], v, h=0.005, steps=67, t0=0.4)
    assert np.abs(middle.q[0] - fine.q[-1]).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("force", ["of t and q", pytest.param("of v", marks=pytest.mark.slow)])
def test_loops_take_forces_too(force):
    """Eighteen masses on hard springs, written as loops, against the equations of Hamilton."""
    X = ss.coordinates(" ".join(f"x{i}" for i in range(18)))
    gaps = [X[0], *[q - p for p, q in pairwise(X)], -X[-1]]
    loss = c * sum(gap.diff(t) ** 2 for gap in gaps) / 2
    system = ss.MechanicalSystem(
        "driven_chain",
        coordinates=X,
        kinetic=sum(x.diff() ** 2 for x in X) / 2,
        potential=sum(z**2 / 2 + z**4 / 4 for z in gaps),
        parameters={c: 0.2, a: 0.5, w: 2.0},
        forces={"drive": {X[0]: a * sp.cos(w * t) * X[1]}},
        dissipation=loss if force == "of v" else None,
    )
    q, v = [0.3 * np.sin(i) for i in range(18)], [0.1] * 18
    stepper = ss.compile(system)
    assert not stepper.program.header.unrolled
    exact = truth(system, q, v, 1.0)
    errors = [
        np.abs(np.concatenate([run.q[-1], run.p[-1]]) - exact).max()
        for run in (stepper.integrate(q, v, h=1 / n, steps=n) for n in (10, 20))
    ]
    assert abs(np.log2(errors[0] / errors[1]) - 4) < 0.15
    assert np.abs(run_balance(stepper, q, v)).max() < 1e-6


def run_balance(stepper, q, v):
    return stepper.integrate(q, v, h=0.02, steps=50).energy_balance


@pytest.mark.slow
@pytest.mark.parametrize("name", sweep(ss.systems.FORCED, 1))
def test_the_catalogue_of_driven_systems(name):
    system = ss.systems.FORCED[name]()
    stepper = ss.compile(system)
    certificate = stepper.certify()
    assert certificate.passed, certificate
    exempt = [check.name for check in certificate.checks if check.exempt]
    forced = bool(system.forces or system.dissipation)
    assert ("symplectic" in exempt) == (forced and not stepper.program.header.conformal)
    assert "balance" in [check.name for check in certificate.checks]


@pytest.mark.slow
def test_kapitza_stands_where_theory_says():
    """Upside down it is stable for (a w)^2 > 2 g l."""
    stepper = ss.compile(ss.systems.kapitza(), "gauss8")
    ends = []
    for omega in (60.0, 35.0):  # (a w)^2 = 36 and 12.25 beside 2 g l = 19.62
        run = stepper.integrate([3.1], [0.0], h=0.004, t_end=10.0, parameters={"w": omega})
        ends.append(np.abs(run["theta"] - np.pi).max())
    assert ends[0] < 0.3
    assert ends[1] > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["gauss8", "gauss12"])
@pytest.mark.parametrize("name", PROBLEMS)
def test_high_orders_are_there_in_many_digits(name, scheme):
    """In doubles the errors of such steps end in rounding before they shrink with their order."""
    system, q, v, end = PROBLEMS[name]()
    p = list(ss.compile(system).integrate(q, v, h=0.1, steps=0).p[0])

    def last(scheme, steps):
        with mpmath.workdps(40):
            run = ss.compile(system, scheme, precision=40).integrate(
                q, p0=p, h=mpmath.mpf(end) / steps, steps=steps, every=None
            )
        return np.concatenate([run.q[-1], run.p[-1]])

    exact = last("gauss16", 120)
    errors = [float(np.abs(last(scheme, steps) - exact).max()) for steps in (40, 80)]
    assert abs(np.log2(errors[0] / errors[1]) - int(scheme[5:])) < 0.15
