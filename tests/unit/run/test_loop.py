"""Quantities of control loops: those of a run that takes the same steps, to the bit."""

import pickle

import numpy as np
import pytest
import sympy as sp

import symsimpson as ss

x, y = ss.coordinates("x y")
m, g, u, w = sp.symbols("m g u w", positive=True)


def rod(**more):
    """A point on a circle, pushed by inputs."""
    return ss.MechanicalSystem(
        "rod",
        coordinates=(x, y),
        kinetic=m * (x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=m * g * y,
        constraints={"rod": (x**2 + y**2 - 1) / 2},
        parameters={m: 2.0, g: 9.81},
        **more,
    )


PUSHED = {"forces": {x: u - x.diff() / 3, y: w * x}, "inputs": (u, w)}
BOTTOM = {"q0": [0.0, -1.0], "v0": [1.0, 0.0], "h": 0.02}


def assert_same(loop, run, k=-1):
    for name in ("multipliers", "constraint_forces", "v"):
        value, expected = getattr(loop, name), getattr(run, name)[k]
        assert value.shape == expected.shape
        assert np.array_equal(value, expected), name
    assert loop.energy == run.energy[k]
    assert isinstance(loop.energy, float)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("pendulum", "kapitza", "four_bar")]


@pytest.mark.parametrize("h", [0.02, pytest.param(-0.02, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["cartesian_pendulum", "chaplygin_sleigh", *SLOW])
def test_a_loop_has_multipliers_and_energy_as_a_run_has(name, h):
    system = ss.systems.EVERY[name]()
    stepper, state = ss.compile(system, "midpoint"), system.reference_state
    run, loop = stepper.integrate(**state, h=h, steps=3), stepper.start(**state, h=h)
    for k in range(4):
        assert_same(loop, run, k)
        if k < 3:
            loop.step()


@pytest.mark.parametrize("scheme", ["gauss4", pytest.param("simpson", marks=pytest.mark.slow)])
def test_multipliers_of_a_loop_have_the_inputs_of_its_last_step(scheme):
    """The run has steps with equal inputs at all nodes, and others."""
    stepper = ss.compile(rod(**PUSHED), scheme)
    times = stepper.node_times(BOTTOM["h"], 3)
    values = np.stack([np.sin(40 * times), np.cos(30 * times)], axis=-1)
    values[2] = [0.3, -0.7]
    loop, rest = (
        stepper.start(**BOTTOM),
        stepper.integrate(**BOTTOM, steps=1, inputs=np.zeros((1, 2))),
    )
    assert_same(loop, rest, 0)
    for k in range(3):
        loop.step(values[k])
        named = {"u": values[: k + 1, :, 0], "w": values[: k + 1, :, 1]}
        run = stepper.integrate(**BOTTOM, steps=k + 1, inputs=named)
        assert_same(loop, run)
        assert_same(pickle.loads(pickle.dumps(loop)), run)
    before = loop.multipliers
    for bad, error in (([np.nan, 0.0], ss.InputError), ([1e300, 1e300], ss.ConvergenceError)):
        with pytest.raises(error):
            loop.step(bad)
        assert np.array_equal(loop.multipliers, before)


def test_multipliers_tell_the_force_of_a_rod():
    """-m (v^2 + g) at the lowest point, where the rod pulls up."""
    loop = ss.compile(rod()).start(**BOTTOM)
    assert abs(loop.multipliers - 2 * (1 + 9.81)) < 1e-12
    assert np.abs(loop.constraint_forces - [0, 2 * (1 + 9.81)]).max() < 1e-12


def test_a_loop_that_an_event_ended_has_the_multipliers_there():
    stepper = ss.compile(rod(**PUSHED))
    end = ss.Event(ss.time - 0.03, name="end", terminal=True)
    run = stepper.integrate(**BOTTOM, steps=5, inputs=[[1.0, 2.0]] * 5, events=[end])
    loop = stepper.start(**BOTTOM, events=[end])
    while loop.ended_by is None:
        loop.step([1.0, 2.0])
    assert_same(loop, run)
    with pytest.raises(ss.InputError, match=r"the loop is at its end"):
        loop.step([5.0, 5.0])
    assert_same(loop, run)


@pytest.mark.slow
def test_a_retimed_loop_has_the_energy_of_a_run():
    system = ss.systems.kepler()
    stepper = ss.compile(system.retimed("encounters"), "midpoint")
    run = stepper.integrate(**system.reference_state, h=0.02, steps=2)
    loop = stepper.start(**system.reference_state, h=0.02)
    for k in range(3):
        assert_same(loop, run, k)
        if k < 2:
            loop.step()


def test_a_loop_does_not_say_that_its_inputs_were_zero():
    loop = ss.compile(rod(**PUSHED)).start(**BOTTOM)
    loop.step([1.0, 2.0])
    with pytest.raises(ss.ConvergenceError) as caught:
        loop.step([1e300, 1e300])
    with pytest.raises(ss.InputError, match="the inputs u, w at these states are unknown"):
        caught.value.trajectory.multipliers  # noqa: B018


def test_several_inputs_are_one_list():
    loop = ss.compile(rod(**PUSHED)).start(**BOTTOM)
    with pytest.raises(ss.InputError, match=r"Pass several inputs as one list: u=\[a, b\]"):
        loop.step(1.0, 2.0)


@pytest.mark.slow
def test_a_leg_lands_by_a_projection_of_its_momentum_and_stands():
    """The state after the impact ends the run; in stance the foot is not accelerated."""
    z, a = ss.coordinates("z a")
    foot = z - sp.cos(a)
    about = {
        "coordinates": (z, a),
        "kinetic": 3 * z.diff() ** 2 + sp.cos(a) ** 2 * a.diff() ** 2 + foot.diff(ss.time) ** 2 / 2,
        "potential": 9.81 * (6 * z + foot) + 40 * (a - 0.6) ** 2,
        "forces": {a: -u},
        "inputs": (u,),
        "parameters": {},
    }
    flight = ss.MechanicalSystem("flight", **about)
    stance = ss.MechanicalSystem("stance", **about, constraints=[foot])
    landing = ss.Event(foot, name="landing", action=ss.Impact(0), terminal=True)
    given = {"h": 1e-3, "events": [landing], "inputs": {"u": 0.5}}
    run = ss.compile(flight).integrate([0.9, 0.6], v0=[-2.0, 0.4], steps=100, **given)
    (q,), (v,) = run.events("landing").q, run.events("landing").v
    there = dict(zip((z, a), q, strict=True))
    M = np.array(flight.mass_matrix.subs(there), dtype=float)
    J = np.array([[1.0, np.sin(q[1])]])
    onto = np.linalg.solve(M, J.T) @ np.linalg.inv(J @ np.linalg.solve(M, J.T))
    assert np.abs(run.v[-1] - (v - onto @ (J @ v))).max() < 1e-13
    assert np.abs(run.v[-1] - stance.consistent(q, v)[1]).max() < 1e-12
    assert abs(J @ v) > 0.5

    loop = ss.compile(stance).start(run.q[-1], v0=run.v[-1], h=1e-3)
    loop.step(2.0)
    (force,) = -loop.multipliers
    assert np.abs(loop.constraint_forces - force * np.array([1.0, np.sin(loop.q[1])])).max() < 1e-12
    # the same by the equations of motion: M q'' = f + J^T force, J q'' = -J' v
    (angle, rate), (z_rate, _) = (loop.q[1], loop.v[1]), loop.v
    there = {a: angle, z: loop.q[0]}
    M = np.array(flight.mass_matrix.subs(there), dtype=float)
    J = np.array([1.0, np.sin(angle)])
    bend = np.sin(angle) * np.cos(angle) * rate**2
    along_a = bend - 9.81 * np.sin(angle) - 80 * (angle - 0.6) - 2.0
    f = [-9.81 * 7 - np.cos(angle) * rate**2, along_a]
    free = J @ np.linalg.solve(M, f) + np.cos(angle) * rate**2
    assert abs(force + free / (J @ np.linalg.solve(M, J))) < 1e-9 * abs(force)
    assert z_rate == pytest.approx(-np.sin(angle) * rate)
