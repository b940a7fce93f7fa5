"""What depends on inputs at states: pulls of constraints, and power, with those of each state."""

import numpy as np
import pytest
import sympy as sp
from support.rolling import allowed_state, carried_by_time

import symsimpson as ss

H, STEPS = 0.02, 40
X, Y = ss.coordinates("x y")
U = sp.Symbol("u")
BEAD = ss.MechanicalSystem(
    "bead",
    coordinates=(X, Y),
    kinetic=(X.diff() ** 2 + Y.diff() ** 2) / 2,
    potential=10 * Y,
    forces={"push": {X: U}},
    inputs=(U,),
    constraints={"wire": X**2 + Y**2 - 1},
)
START = {"q0": [1.0, 0.0], "v0": [0.0, 0.0], "h": H}


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(BEAD)


def slope(t):
    return 2 + 3 * t


def pull(states, u):
    """Return lambda, from the acceleration that stays on the circle."""
    x, y = np.moveaxis(states.q, -1, 0)
    return (x * u - 10 * y + (states.v**2).sum(axis=-1)) / 2


def at_nodes(stepper, t0=0.0):
    return {"u": slope(stepper.node_times(h=H, steps=STEPS, t0=t0))}


def check(states, u):
    np.testing.assert_allclose(states.multipliers[..., 0], pull(states, u), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        states.constraint_forces, -2 * states.q * states.multipliers, rtol=0, atol=1e-9
    )


def test_multipliers_are_those_of_the_inputs_at_the_states(stepper):
    run = stepper.integrate(**START, steps=STEPS, inputs={"u": 5.0})
    check(run, 5.0)
    assert (run["lambda_wire"] == run.multipliers[:, 0]).all()
    assert (run[3:7].multipliers == run.multipliers[3:7]).all()
    assert (run[::2][1:3]["lambda_wire"] == run["lambda_wire"][[2, 4]]).all()
    check(run.at([0.01, 0.333]), 5.0)


@pytest.mark.parametrize("t0", [0.0, 1e6])
def test_inputs_at_nodes_are_taken_at_the_time_of_a_state(stepper, t0):
    inputs = {"u": slope(stepper.node_times(h=H, steps=STEPS, t0=t0) - t0)}
    for every in (1, 8, None):
        run = stepper.integrate(**START, t0=t0, steps=STEPS, inputs=inputs, every=every)
        check(run, slope(run.t - t0))
        power = slope(run.t - t0) * run["v_x"]
        np.testing.assert_allclose(run.power["push"], power, rtol=1e-7, atol=1e-7)
        if every:
            times = t0 + np.array([0.011, 0.02, 0.333])
            check(run.at(times), slope(times - t0))


def test_inputs_that_are_held_belong_to_the_step_that_begins(stepper):
    values = np.where(np.arange(STEPS) < 20, 1.0, -2.0)
    run = stepper.integrate(**START, steps=STEPS, inputs={"u": values})
    check(run, np.append(values, values[-1]))


def test_chosen_states_and_quantities_have_those_of_their_times(stepper):
    times = np.array([0.03, 0.4, 0.8])
    kept = stepper.integrate(**START, steps=STEPS, t_eval=times, inputs=at_nodes(stepper))
    check(kept, slope(times))
    run = stepper.integrate(**START, steps=STEPS, inputs=at_nodes(stepper))
    saved = stepper.integrate(
        **START, steps=STEPS, save=["lambda_wire"], every=4, inputs=at_nodes(stepper)
    )
    np.testing.assert_allclose(saved["lambda_wire"], run["lambda_wire"][::4], rtol=1e-12)


def test_zeros_and_ends_within_a_step_have_those_of_their_times(stepper):
    run = stepper.integrate(**START, steps=STEPS, inputs=at_nodes(stepper))
    zeros = run.events("y + 1/2")
    assert len(zeros) > 0
    check(zeros, slope(zeros.t))
    end = ss.Event("y + 1/2", name="low", terminal=True)
    for every in (1, None):
        run = stepper.integrate(
            **START, steps=STEPS, inputs=at_nodes(stepper), events=[end], every=every
        )
        assert run.ended_by == "low"
        check(run, slope(run.t))
        np.testing.assert_allclose(run.power["push"], slope(run.t) * run["v_x"], atol=1e-9)
        check(run.events("low"), slope(run.t[-1:]))


def test_powers_of_forces_are_by_velocities_where_constraints_move():
    system = carried_by_time()
    run = ss.compile(system).integrate(**allowed_state(system), h=H, steps=4)
    forces = run.power["total"] - run.power["constraints"]
    expected = np.sin(3 * run.t) / 10 * run["v_z"] - run["v_x"] ** 2 / 5
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-14)


def test_chosen_states_before_an_end_have_those_of_the_step_that_was_ended(stepper):
    how = {**START, "steps": STEPS, "inputs": {"u": np.linspace(-3, 3, STEPS)}}
    how["events"] = [ss.Event("y + 1/2", name="low", terminal=True)]
    run = stepper.integrate(**how)
    times = run.t[-1] - np.array([0.5, 0.05]) * (run.t[-1] - run.t[-2])
    kept = stepper.integrate(**how, t_eval=times)
    np.testing.assert_allclose(kept.p, run.at(times).p, rtol=1e-13)
    np.testing.assert_allclose(kept.multipliers, run.at(times).multipliers, rtol=1e-12)


@pytest.mark.parametrize("every", [1, None])
def test_a_run_that_left_its_domain_ends_with_those_of_its_last_step(every):
    system = ss.MechanicalSystem(
        "well",
        coordinates=(X,),
        kinetic=X.diff() ** 2 / 2,
        potential=sp.log(X) / 50,  # of which the force is real beyond, too
        forces={"push": {X: U}},
        inputs=(U,),
    )
    inputs = {"u": np.linspace(0.1, 0.3, STEPS)}
    how = {"h": 0.125, "steps": STEPS, "inputs": inputs, "every": every, "on_failure": "return"}
    run = ss.compile(system).integrate([0.31], v0=[-0.9], **how)
    assert run.status == ss.Status.NOT_FINITE
    assert 0 < run.steps < 4
    assert run.power["push"][-1] == inputs["u"][run.steps - 1] * run["v_x"][-1]


def test_members_have_those_of_their_own(stepper):
    inputs = np.array([0.0, 4.0, -3.0])
    many = stepper.ensemble(
        [START["q0"]] * 3,
        v0=START["v0"],
        h=H,
        steps=STEPS,
        every=10,
        inputs={"u": np.broadcast_to(inputs[:, None], (3, STEPS))},
    )
    check(many, inputs[:, None])
    check(many[1], 4.0)
    last = stepper.ensemble(
        [START["q0"]] * 2, v0=START["v0"], h=H, steps=STEPS, inputs=at_nodes(stepper)
    )
    check(last, slope(H * STEPS))


def test_a_state_alone_has_those_of_its_time(stepper):
    check(stepper.integrate(**START, steps=0, inputs={"u": 5.0}), 5.0)


def test_a_file_keeps_them(stepper, tmp_path):
    end = ss.Event("y + 1/2", name="low", terminal=True)
    for number, events in enumerate([None, [end]]):
        path = tmp_path / f"run{number}.nc"
        run = stepper.integrate(**START, steps=STEPS, inputs=at_nodes(stepper), events=events)
        run.save(path)
        again = ss.open_trajectory(path)
        assert (again.ended_by is None) == (events is None)
        assert (again.multipliers == run.multipliers).all()


def test_where_a_run_ended_within_a_step_may_not_be_known_from_its_file(stepper, tmp_path):
    end = ss.Event("y + 1/2", name="low", terminal=True)
    more = {"events": [end], "every": None}
    run = stepper.integrate(**START, steps=STEPS, inputs=at_nodes(stepper), **more)
    run.save(tmp_path / "run.nc")
    with pytest.raises(ss.InputError, match="the inputs u at these states are unknown"):
        _ = ss.open_trajectory(tmp_path / "run.nc").multipliers


def test_states_of_which_they_are_not_known_are_refused(stepper):
    run = stepper.integrate(**START, steps=STEPS, inputs={"u": 1.0})
    facts = {"program": run.program, "parameter_values": run.parameter_values}
    states = type(run.at(0.1))(t=run.t, q=run.q, p=run.p, driven=None, **facts)
    assert states.constraint_error.shape == (STEPS + 1, 1)
    for name in ("multipliers", "constraint_forces"):
        with pytest.raises(ss.InputError, match="the inputs u at these states are unknown"):
            getattr(states, name)
