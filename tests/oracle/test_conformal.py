"""Momenta damped in proportion: areas of phase space shrink by exp(-2 gamma h) exactly."""

import warnings

import mpmath as mp
import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from support.cases import sweep

import symsimpson as ss

x, y = ss.coordinates("x y")
k = sp.Symbol("k", positive=True)
GAMMA = 0.25


def damped():
    kinetic = (1 + x**2 / 4) * (x.diff() ** 2 + y.diff() ** 2) / 2
    return ss.MechanicalSystem(
        "damped_henon_heiles",
        coordinates=(x, y),
        kinetic=kinetic,
        potential=(x**2 + 2 * y**2) / 2 + x**2 * y,
        parameters={k: GAMMA},
        dissipation=2 * k * kinetic,
    )


def weighted(system, scheme="simpson", **options):
    return ss.compile(system, scheme, exploit=("all", "conformal"), **options)


STATE = np.array([0.3, 0.2, 0.4, -0.1])
SCHEMES = ["simpson", "midpoint", "gauss4", "lobatto6", "gauss8", "radau3"]


def slope_of(stepper, h, steps, number=float, eps=1e-5):
    def flow(z):
        run = stepper.integrate(z[:2], p0=z[2:], h=h, steps=steps, every=None)
        return np.concatenate([run.q[0], run.p[0]])

    state = [number(a) for a in STATE]
    columns = []
    for i in range(4):
        ends = []
        for sign in (1, -1):
            z = list(state)
            z[i] += sign * eps
            ends.append(flow(z))
        columns.append((ends[0] - ends[1]) / (2 * eps))
    return np.array(columns).T


J = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])


@pytest.mark.parametrize("scheme", sweep(SCHEMES))
def test_areas_shrink_exactly(scheme):
    with mp.workdps(50):
        made = weighted(damped(), scheme, precision=50)
        D = slope_of(made, mp.mpf("0.1"), 3, mp.mpf, mp.mpf(10) ** -16)
        whole = J.astype(int)
        defect = D.T @ whole @ D - mp.exp(-2 * mp.mpf(GAMMA) * mp.mpf("0.3")) * whole
        assert max(map(abs, defect.ravel())) < 1e-28
    # taken as a force, damping shrinks them to the order of the scheme alone
    general = slope_of(ss.compile(damped(), scheme, exploit=()), 0.1, 10)
    defect = abs(general.T @ J @ general - np.exp(-2 * GAMMA) * J).max()
    assert defect > {"gauss8": 1e-13, "lobatto6": 1e-12}.get(scheme, 1e-8)


def test_the_equations_have_the_weights_of_the_step():
    stepper = weighted(damped(), "midpoint")
    q, _ = stepper.step(STATE[:2], p=STATE[2:], h=0.1)
    assert np.abs(stepper.residual(STATE[:2], STATE[2:], [q], 0.1)).max() < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(SCHEMES, 1))
def test_compiled_steps_agree_with_many_digits(scheme):
    run = weighted(damped(), scheme).integrate(STATE[:2], p0=STATE[2:], h=0.1, steps=20)
    exact = weighted(damped(), scheme, precision=30).integrate(
        STATE[:2], p0=STATE[2:], h=0.1, steps=20
    )
    assert np.abs((run.q - exact.q).astype(float)).max() < 1e-15
    assert np.abs((run.p - exact.p).astype(float)).max() < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(SCHEMES))
def test_the_order_is_kept_and_work_is_counted(scheme):
    made = weighted(damped(), scheme)
    found = solve_ivp(_rates, (0, 2), STATE, rtol=1e-13, atol=1e-14, method="DOP853").y[:, -1]

    def errors(count):
        run = made.integrate(STATE[:2], p0=STATE[2:], h=2 / count, steps=count)
        end = np.concatenate([run.q[-1], run.p[-1]])
        return np.array([np.abs(end - found).max(), np.abs(run.energy_balance).max()])

    few = 4 if made.order > 6 else 16
    orders = np.log2(errors(few) / errors(2 * few))
    assert (orders > made.order - 0.4).all()


def _rates(t, z):
    q1, q2, p1, p2 = z
    mass = 1 + q1**2 / 4
    v1, v2 = p1 / mass, p2 / mass
    force = q1 / 4 * (v1**2 + v2**2) - q1 - 2 * q1 * q2
    return [v1, v2, force - 2 * GAMMA * p1, -2 * q2 - q1**2 - 2 * GAMMA * p2]


@pytest.mark.slow
def test_certificates_have_the_factor():
    certificate = weighted(damped()).certify(STATE[:2], p0=STATE[2:], h=0.1)
    assert certificate.passed
    assert certificate["conformal"].measured < 1e-25


@pytest.mark.slow
def test_large_systems_damp_by_forces():
    q = ss.coordinates(" ".join(f"x{i}" for i in range(20)))
    kinetic = sum(a.diff() ** 2 for a in q) / 2
    potential = sum((a - b) ** 4 for a, b in zip(q[1:], q, strict=False))
    system = ss.MechanicalSystem(
        "long",
        coordinates=q,
        kinetic=kinetic,
        potential=potential,
        parameters={k: 0.1},
        dissipation=k * kinetic,
    )
    made = weighted(system)
    assert not made.program.header.conformal
    run = made.integrate(np.linspace(0, 2, 20), v0=np.ones(20), h=0.05, steps=40)
    # the sum of all momenta decays by itself
    assert abs(run.p.sum(axis=1)[-1] / 20 - np.exp(-0.2)) < 1e-8


@pytest.mark.parametrize("scheme", sweep(["simpson", "radau5", "gauss8", "lobatto6"]))
@pytest.mark.parametrize(("stiffness", "friction"), [(100, 2000), (4, 20), (4, 50)])
def test_friction_that_steps_do_not_resolve_is_a_force(scheme, stiffness, friction):
    """Weights that grow by exp(2 gamma h) would lose the slow motion."""
    system = ss.MechanicalSystem(
        "door",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=stiffness * x**2 / 2,
        dissipation=friction * x.diff() ** 2 / 2,
    )
    stepper = ss.compile(system, scheme)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ss.StabilityWarning)
        run = stepper.integrate([1.0], [0.0], h=0.1, t_end=10.0)
        varied = stepper.integrate([1.0], [0.0], h=0.1, t_end=10.0, tangents=2)
    assert np.abs(varied.q - run.q).max() < 1e-13
    root = np.sqrt(friction**2 / 4 - stiffness)
    slow, fast = -stiffness / (friction / 2 + root), -friction / 2 - root
    exact = (fast * np.exp(10 * slow) - slow * np.exp(10 * fast)) / (fast - slow)
    assert abs(run["x"][-1] - exact) < 2e-6
