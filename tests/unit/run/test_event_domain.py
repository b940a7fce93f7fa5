"""Runs on which events act, and whose motion leaves the domain of V."""

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

X, Y = ss.coordinates("x y")
WELL = ss.MechanicalSystem(  # its force is real beyond x = 0, its energy is not
    "well_beside",
    coordinates=(X, Y),
    kinetic=(X.diff() ** 2 + Y.diff() ** 2) / 2,
    potential=sp.log(X) + Y**2,
)
HOW = {"q0": [0.5, 0.4], "v0": [-0.5, 0.2], "h": 0.02, "steps": 24}  # 22 steps lead to x < 0
SEEN = Y - sp.Rational(42, 100)


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(WELL)


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("action", [None, ss.Impact(restitution=1), ss.Switch()])
@pytest.mark.parametrize("every", [1, None])
def test_events_do_not_hide_that_the_energy_is_no_number(stepper, action, every):
    events = [ss.Event(-SEEN, name="seen", action=action)]
    run = stepper.integrate(**HOW, every=every, events=events, on_failure="return")
    assert run.status == ss.Status.NOT_FINITE
    assert np.isfinite(run.energy).all()
    assert run.t[-1] == pytest.approx(0.02 * run.steps, rel=1e-15)
    assert 18 < run.steps < 22
    assert len(run.events("seen")) == 1 + (action is None or isinstance(action, ss.Switch))
    with pytest.raises(ss.ConvergenceError, match="energy is not a finite real number"):
        stepper.integrate(**HOW, every=every, events=events)


@pytest.mark.parametrize("every", [1, None])
def test_an_event_out_of_the_domain_did_not_end_the_run(stepper, every):
    end = ss.Event(X + sp.Rational(1, 50), name="end", terminal=True)
    run = stepper.integrate(**HOW, every=every, events=[end], on_failure="return")
    assert run.status == ss.Status.NOT_FINITE
    assert run.ended_by is None
    assert len(run.events("end")) == 0
    assert np.isfinite(run.energy).all()


@pytest.mark.slow
@pytest.mark.plain
def test_members_do_not_hide_it(stepper):
    many = stepper.ensemble(
        [HOW["q0"]] * 2, v0=HOW["v0"], h=0.02, steps=24, events=[ss.Event(SEEN, name="seen")]
    )
    assert (many.status == ss.Status.NOT_FINITE).all()


@pytest.mark.parametrize("events", [None, [ss.Event(SEEN, name="seen")]])
def test_a_loop_stays_where_its_energy_is_a_number(stepper, events):
    loop = stepper.start(HOW["q0"], v0=HOW["v0"], h=HOW["h"], events=events)
    run = stepper.integrate(**HOW, events=events, on_failure="return")
    for _ in range(run.steps):
        loop.step()
    for _ in range(2):
        with pytest.raises(ss.ConvergenceError, match="energy is not a finite real number") as told:
            loop.step()
        assert told.value.status == run.status
        assert loop.steps == run.steps
        assert np.array_equal(loop.q, run.q[-1])


@pytest.mark.slow
@pytest.mark.plain
def test_a_loop_may_end_where_a_root_is_zero():
    """V is NaN there, where kernels take x**2 times 1/root for |x|."""
    walled = ss.MechanicalSystem(
        "walled",
        coordinates=(X,),
        kinetic=X.diff() ** 2 / 2,
        potential=X**2 / 2 + 3 * (X + sp.sqrt(X**2)) ** 2 / 8,
    )
    wall = ss.Event(X, name="wall", terminal=True)
    loop = ss.compile(walled, "gauss8").start([1.0], v0=[0.0], h=0.05, events=[wall])
    while loop.ended_by is None:
        loop.step()
    assert abs(loop.q[0]) < 1e-15
