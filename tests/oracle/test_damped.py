"""Friction: kicks that damp, strong damping, left Radau nodes."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from support.cases import sweep
from support.driven import PROBLEMS
from support.forms import limited
from support.hamilton import truth

import symsimpson as ss

t = ss.time
a, c, g, k, w = sp.symbols("a c g k w", positive=True)


@pytest.mark.parametrize("scheme", sweep(["suzuki4", "blanes_moan4", "kahan_li6"], 1))
def test_kicks_damp_as_friction_does_by_itself(scheme, monkeypatch):
    x, y = ss.coordinates("x y")
    u = x.diff() + y.diff() / 2
    system = ss.MechanicalSystem(
        "damped_kicks",
        coordinates=(x, y),
        kinetic=(2 * x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=x**4 / 4 + x**2 * y + y**2,
        parameters={c: 0.3, k: 0.2, w: 3.0},
        forces={x: sp.cos(w * t) * y - c * x.diff(), y: -k * y.diff()},
    )
    stepper, q, v = ss.compile(system, scheme), [0.5, 0.2], [0.1, 0.0]
    p = stepper.integrate(q, v, h=0.1, steps=0).p[0]
    exact = truth(system, q, p, 2.0)

    def error(steps):
        run = stepper.integrate(q, p0=p, h=2 / steps, steps=steps)
        return np.abs(np.concatenate([run.q[-1], run.p[-1]]) - exact).max()

    assert abs(np.log2(error(20) / error(40)) - stepper.order) < 0.15
    precise = ss.compile(system, scheme, precision=30).integrate(q, p0=p, h=0.1, steps=5)
    run = stepper.integrate(q, p0=p, h=0.1, steps=5)
    assert np.abs((run.p - precise.p).astype(float)).max() < 1e-15
    with monkeypatch.context() as patch:  # the same in loops
        limited(patch, UNROLLED_FORCES=1)
        looped = ss.compile(system, scheme)
    assert "sinh(" in looped.source
    assert np.abs(looped.integrate(q, p0=p, h=0.1, steps=5).p - run.p).max() < 1e-15
    # not in proportion to each momentum, of no positive rate, or of another order
    for force, message in (
        ({x: -c * u, y: -c * u / 2}, "force depends on velocities"),
        ({x: c * x.diff()}, "proportional to each momentum, with a positive rate"),
        ({x: -c * x * x.diff()}, "force depends on velocities"),
    ):
        other = ss.MechanicalSystem(
            "other_kicks",
            coordinates=(x, y),
            kinetic=system.kinetic,
            parameters={c: 0.3},
            potential=system.potential,
            forces=force,
        )
        with pytest.raises(ss.SchemeError, match=message):
            ss.compile(other, scheme)
    with pytest.raises(ss.SchemeError, match="With friction the order would be 4"):
        ss.compile(system, "blanes_moan6")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.StabilityWarning")
def test_strong_damping_makes_no_step_singular():
    """Where the iteration over stages does not contract, Newton's method goes on."""
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "stiff",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=sp.cos(x),
        forces={x: -k * (x.diff() - sp.cos(t))},
        parameters={k: 100.0},
    )
    for scheme in ("simpson", "gauss4", "gauss8", "midpoint"):
        run = ss.compile(system, scheme).integrate([0.0], [1.0], h=0.05, t_end=2.0)
        assert abs(run.q[-1, 0] - 0.93588) < 1e-3


RADAU = {"radau1": (200, 400), "radau3": (80, 160), "radau5": (40, 80)}


@pytest.mark.slow
@pytest.mark.parametrize("scheme", sweep(["radau3", "radau1", "radau5"]))
@pytest.mark.parametrize("name", sweep(PROBLEMS))
def test_radau_schemes_have_odd_orders(name, scheme):
    system, q, v, end = PROBLEMS[name]()
    stepper = ss.compile(system, scheme)
    p = stepper.integrate(q, v, h=0.1, steps=0).p[0]
    exact = truth(system, q, p, end)
    errors = [
        np.abs(np.concatenate([run.q[-1], run.p[-1]]) - exact).max()
        for run in (stepper.integrate(q, p0=p, h=end / n, steps=n) for n in RADAU[scheme])
    ]
    assert abs(np.log2(errors[0] / errors[1]) - stepper.order) < 0.15


@pytest.mark.parametrize("scheme", sweep(["radau3", "radau5"]))
@pytest.mark.parametrize("make", sweep([ss.systems.harmonic_oscillator, ss.systems.kepler], 0))
def test_radau_steps_are_symplectic_whatever_is_skipped(make, scheme):
    system = make()
    certificate = ss.compile(system, scheme).certify(h=0.02)
    assert certificate.passed, certificate
    assert [check.exempt for check in certificate.checks if check.name == "reversible"] == [True]
    given = {**system.reference_state, "h": 0.02, "steps": 9}
    ends = [ss.compile(system, scheme, exploit=e).integrate(**given) for e in ("all", ())]
    assert np.abs(ends[0].p - ends[1].p).max() < 1e-14


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.StabilityWarning")
@pytest.mark.filterwarnings(r"ignore:[\s\S]*unless damping makes:symsimpson.ResolutionWarning")
def test_strong_damping_decays_with_radau_nodes():
    """x'' = -c (x' - cos t) - sin x with h c = 500, against an implicit method in small steps."""
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "stiff",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=-sp.cos(x),
        forces={x: -c * (x.diff() - sp.cos(t))},
        parameters={c: 1e4},
    )
    q, p = solve_ivp(
        lambda s, y: [y[1], -1e4 * (y[1] - np.cos(s)) - np.sin(y[0])],
        (0, 2),
        [0.0, 1.5],
        method="Radau",
        rtol=1e-12,
        atol=1e-13,
    ).y[:, -1]
    errors = {}
    for scheme in ("midpoint", "radau3", "radau5"):
        run = ss.compile(system, scheme).integrate([0.0], [1.5], h=0.05, steps=40)
        errors[scheme] = abs(run.q[-1, 0] - q), abs(run.p[-1, 0] - p)
    assert errors["midpoint"][1] > 0.1
    assert errors["radau3"][0] < 1e-6
    assert errors["radau3"][1] < 3e-4
    assert errors["radau5"][0] < 1e-9
    assert errors["radau5"][1] < 3e-6


@pytest.mark.slow
def test_damping_that_is_not_resolved_is_warned_of():
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "braked",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=sp.cos(x),
        dissipation=c * x.diff() ** 2 / 2,
        parameters={c: 100.0},
    )
    told = r"damping at the initial state\. Its rate is 100(.|\n)*'radau3'"
    with pytest.warns(ss.StabilityWarning, match=told):
        ss.compile(system).integrate([0.1], [1.0], h=0.05, steps=1)
    ss.compile(system).integrate([0.1], [1.0], h=0.03, steps=1)
    ss.compile(system, "radau3").integrate([0.1], [1.0], h=0.05, steps=1)
