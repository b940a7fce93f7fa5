"""Runs through modes: what they record, and how they work with events, inputs and files."""

import pickle

import numpy as np
import pytest
import sympy as sp
from support.friction import ball, brake, x, z

import symsimpson as ss

START = {"v0": [0.0], "h": 0.1, "t_end": 10.0}
u = sp.Symbol("u")


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(brake(), "simpson")


@pytest.fixture(scope="module")
def run(stepper):
    return stepper.integrate([2.0], **START, record="work")


@pytest.fixture(scope="module")
def bounce():
    return ss.compile(ball(), "simpson")


def test_a_brake_stops_a_spring(run):
    """Half periods of pi shorten the amplitude by 0.6: 2, 1.4, 0.8, 0.2."""
    hits = run.events("pad")
    assert hits.kind == ["slip+", "slip-", "stick"]
    assert np.abs(hits.t - np.pi * np.arange(1, 4)).max() < 1e-6
    assert run.q[-1, 0] == pytest.approx(-0.2, abs=1e-6)
    assert run.modes.states == [(-1,), (1,), (-1,), (0,)]
    assert run.modes.at(4.0) == {"pad": 1}
    assert run["friction_pad"][[1, -1]] == pytest.approx([-0.3, 0.2], abs=1e-6)


def test_friction_has_its_own_work(run):
    assert run.work["pad"][-1] == pytest.approx(0.02 - 2.0, abs=1e-5)
    assert np.abs(run.energy_balance).max() < 1e-5
    assert run.power["pad"].max() <= 0
    with pytest.raises(ss.InputError, match="friction"):
        _ = run.energy_error


def test_work_needs_a_record(stepper):
    with pytest.raises(ss.InputError, match="record='work'"):
        _ = stepper.integrate([2.0], **START).work


def test_every_way_to_store_gives_the_same_states(stepper, run):
    last = stepper.integrate([2.0], **START, every=None)
    assert last.q[-1] == run.q[-1]
    assert np.array_equal(stepper.integrate([2.0], **START, every=7).q, run.q[::7])
    times = [0.33, 3.2, 9.7]
    chosen = stepper.integrate([2.0], v0=[0.0], h=0.1, t_end=10.0, t_eval=times)
    assert np.array_equal(chosen.q, run.at(times).q)
    saved = stepper.integrate([2.0], **START, save=("x", "friction_pad"))
    assert np.array_equal(saved["friction_pad"], run["friction_pad"])


def test_reductions_go_on_through_changes(stepper, run):
    wanted = {"low": ("min", "x"), "changes": ("count", "pad")}
    found = stepper.integrate([2.0], **START, every=None, reduce=wanted).reduced
    assert found == {"low": run["x"].min(), "changes": 3}


def test_dense_output_knows_the_modes(stepper, run):
    zeros = run.events("x").t
    acted = stepper.integrate([2.0], **START, events=[ss.Event(x, name="zero")])
    assert acted.events("zero").t == pytest.approx(zeros, abs=1e-6)
    early = stepper.integrate([2.0], v0=[0.0], h=0.1, t_end=2.0, events=[ss.Event(x, name="zero")])
    assert len(early.events("zero")) == 1  # also where the mode does not change


def test_events_of_the_user_act(stepper):
    kick = ss.Event(ss.time - 9.55, name="kick", action=ss.Change(velocities={x: 2.0}))
    kicked = stepper.integrate([2.0], **START, events=[kick])
    assert kicked.events("kick").t == pytest.approx([9.55])
    assert kicked.modes.states[-1] == (1,)
    wall = ss.Event(x + 1, name="wall", action=ss.Impact(0.9))
    hit = stepper.integrate([2.0], **START, events=[wall])
    assert hit.q.min() > -1.001
    assert len(hit.events("wall")) == 1
    ends = stepper.integrate([2.0], **START, events=[ss.Event(x, name="zero", terminal=2)])
    assert (ends.ended_by, len(ends.events("zero"))) == ("zero", 2)


def test_a_name_of_an_element_is_taken(stepper):
    with pytest.raises(ss.InputError, match="name of a contact"):
        stepper.integrate([2.0], **START, events=[ss.Event(x, name="pad")])


def test_a_ball_comes_to_rest(bounce):
    fall = bounce.integrate([1.0], v0=[0.0], h=0.01, t_end=2.0)
    rest = fall.events("floor")
    assert rest.kind[-1] == "rest"
    assert rest.t[-1] == pytest.approx(3 / np.sqrt(5), abs=1e-9)
    assert fall["normal_floor"][[0, -1]] == pytest.approx([0.0, 10.0])
    assert np.abs(fall.q[-20:]).max() < 1e-14
    assert np.abs(fall.energy_error).max() < 1e-12  # impacts are subtracted


def test_starts_at_a_wall(bounce):
    given = {"h": 0.01, "t_end": 0.1}
    assert bounce.integrate([0.0], v0=[-1.0], **given).events("floor").kind[0] == "impact"
    assert bounce.integrate([1e-18], v0=[0.0], **given).modes.states == [("rest",)]
    with pytest.raises(ss.InputError, match="violates the gap"):
        bounce.integrate([-1.0], v0=[0.0], **given)


def test_a_motion_that_loses_energy_has_no_past(stepper, bounce):
    for one in (stepper, bounce):
        with pytest.raises(ss.InputError, match="cannot be undone"):
            one.integrate([1.0], v0=[0.0], h=-0.01, steps=3)
    elastic = ss.compile(ball(1), "simpson")
    assert elastic.integrate([1.0], v0=[0.0], h=-0.01, steps=100).q[-1, 0] > 0


def test_a_moving_gap_throws():
    """The throw begins where the acceleration of the table is -g."""
    table = ss.MechanicalSystem(
        "table",
        coordinates=(z,),
        kinetic=z.diff() ** 2 / 2,
        potential=10 * z,
        contacts={"table": ss.Contact(z - 0.02 * sp.sin(30 * ss.time))},
    )
    thrown = ss.compile(table, "simpson").integrate([0.0], v0=[0.6], h=0.002, t_end=0.03)
    assert thrown.events("table").kind == ["lift"]
    assert thrown.events("table").t == pytest.approx(np.arcsin(10 / 18) / 30, abs=1e-9)


def driven(**more):
    return ss.compile(
        ss.MechanicalSystem(
            "driven",
            coordinates=(x,),
            kinetic=x.diff() ** 2 / 2,
            potential=0 * x,
            inputs=(u,),
            **more,
        ),
        "simpson",
    )


def test_inputs_move_the_bounds():
    pushed = driven(forces={x: u}, friction={"pad": ss.Friction(x.diff(), limit=0.3)})
    steps = {"h": 0.1, "steps": 40, "v0": [0.0]}
    jumps = np.repeat([0.2, 0.5, 0.1], [10, 10, 20])
    found = pushed.integrate([0.0], **steps, inputs={"u": jumps}).events("pad")
    assert found.kind == ["slip+", "stick"]
    assert found.t == pytest.approx([1.0, 3.0])
    smooth = pushed.integrate([0.0], **steps, inputs={"u": lambda t: 0.5 * np.sin(t)})
    assert smooth.events("pad").t[0] == pytest.approx(np.arcsin(0.6), abs=1e-5)
    loop = pushed.start([0.0], v0=[0.0], h=0.1)
    for value in jumps:
        loop.step(value)
    assert loop.events("pad").kind == ["slip+", "stick"]
    assert loop.q == pytest.approx([0.2])


def test_a_limit_may_be_an_input():
    squeezed = driven(friction={"pad": ss.Friction(x.diff(), limit=u)})
    given = {"v0": [1.0], "h": 0.1, "steps": 40}
    jumps = np.repeat([0.2, 0.5], [10, 30])
    assert squeezed.integrate([0.0], **given, inputs={"u": jumps}).events("pad").t == pytest.approx(
        [2.6]
    )
    bad = squeezed.integrate([0.0], **given, inputs={"u": -jumps}, on_failure="return")
    assert bad.status is ss.Status.BAD_INPUT
    assert "'pad'" in bad.message


def test_a_loop_can_be_copied(stepper, run):
    loop = stepper.start([2.0], v0=[0.0], h=0.1)
    for _ in range(50):
        loop.step()
    copy = pickle.loads(pickle.dumps(loop))
    for one in (loop, copy):
        for _ in range(50):
            one.step()
        assert one.q == run.q[-1]


def test_checkpoints_are_bitwise(stepper, run, tmp_path):
    path = tmp_path / "run.ckpt"
    again = stepper.integrate([2.0], **START, checkpoint=path, checkpoint_every=33)
    assert np.array_equal(again.q, run.q)
    with pytest.raises(ss.InputError, match="Repeat the call"):
        ss.resume(path)


def test_members_run_alone(stepper, run):
    members = stepper.ensemble([[1.0], [2.0]], **START, every=1, reduce={"c": ("count", "pad")})
    assert np.array_equal(members.q[1], run.q)
    assert members.reduced["c"].tolist() == [2, 3]
    with pytest.raises(ss.InputError, match="Repeat the run"):
        members[0]["friction_pad"]


EXCLUDED = {
    "gradient": lambda s: s.gradient([2.0], v0=[0.0], h=0.1, steps=3, cost=x**2, wrt="q0"),
    "lyapunov": lambda s: s.lyapunov([2.0], v0=[0.0], h=0.1, t_end=1.0),
    "certificate": lambda s: s.certify(),
    "C": lambda s: s.export_c("firmware/top"),
    "digits": lambda s: ss.compile(brake(), precision=30),
    "choice": lambda s: ss.integrate(brake(), [2.0], v0=[0.0], t_end=1.0, error=1e-6),
    "file": lambda s: ss.generate(brake()),
    "control": lambda s: ss.OptimalControl(brake()),
}


@pytest.mark.parametrize("what", EXCLUDED)
def test_what_does_not_know_contacts_says_so(stepper, what):
    with pytest.raises(ss.SymsimpsonError, match="contacts or dry friction") as error:
        EXCLUDED[what](stepper)
    assert "system.mode" in str(error.value)


def test_impacts_that_slide_warn_once():
    y = ss.coordinates("y")[0]
    contact = ss.Contact(y, restitution=0.5, friction=0.2, slip=x.diff())
    thrown = ss.MechanicalSystem(
        "thrown",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=10 * y,
        contacts={"floor": contact},
    )
    with pytest.warns(ss.ModelWarning, match="collides while it slides") as caught:
        ss.compile(thrown, "simpson").integrate([0, 0.1], v0=[1, 0], h=0.02, t_end=0.4)
    assert len(caught) == 1


def test_a_lift_off_may_fall_on_the_time_grid():
    """The normal force 1 - t/2 - 0.1 vanishes at 1.8 = 20 h."""
    lifted = ss.MechanicalSystem(
        "lifted",
        coordinates=(z,),
        kinetic=z.diff() ** 2 / 2,
        potential=z,
        forces={z: ss.time / 2 + 0.1},
        contacts={"floor": ss.Contact(z)},
    )
    run = ss.compile(lifted, "simpson").integrate([0.0], v0=[0.0], h=0.09, steps=22)
    assert run.events("floor").kind == ["lift"]
    assert run.events("floor").t == pytest.approx([1.8])


def hopper(**more):
    """A mass on a spring above a foot: the forces on the foot cancel where it lifts off."""
    y = ss.coordinates("y")[0]
    return ss.compile(
        ss.MechanicalSystem(
            "hopper",
            coordinates=(x, y),
            kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
            potential=10 * x + 10 * y + 200 * (x - y - 0.5) ** 2,
            contacts={"floor": ss.Contact(y)},
            **more,
        ),
        "simpson",
    )


def test_forces_that_cancel_have_a_size():
    run = hopper().integrate([0.2, 0.0], v0=[0.0, 0.0], h=0.005, t_end=0.7)
    assert run.events("floor").kind[:2] == ["lift", "impact"]


def test_a_loop_with_inputs_finds_the_same_events():
    pushed = hopper(inputs=(u,), forces={x: u})
    given = {"v0": [0.0, 0.0], "h": 0.01}
    run = pushed.integrate([0.2, 0.0], **given, steps=90, inputs={"u": 3.0})
    loop = pushed.start([0.2, 0.0], **given)
    for _ in range(90):
        loop.step(3.0)
    assert loop.events("floor").kind == run.events("floor").kind
    assert loop.events("floor").t == pytest.approx(run.events("floor").t, abs=1e-9)


def test_a_table_rests_on_three_of_its_four_feet():
    height, roll, pitch = ss.coordinates("height roll pitch")
    feet = {
        f"{i}{j}": ss.Contact(height + i * sp.sin(roll) + j * sp.sin(pitch), restitution=0.2)
        for i in (-1, 1)
        for j in (-1, 1)
    }
    table = ss.compile(
        ss.MechanicalSystem(
            "table",
            coordinates=(height, roll, pitch),
            kinetic=(height.diff() ** 2 + roll.diff() ** 2 / 3 + pitch.diff() ** 2 / 3) / 2,
            potential=10 * height,
            contacts=feet,
        ),
        "simpson",
    )
    stands = table.integrate([0.0, 0.0, 0.0], v0=[0, 0, 0], h=0.01, t_end=0.1)
    forces = sum(stands[f"normal_{name}"] for name in feet)
    assert forces == pytest.approx(10.0 * np.ones(11))
    assert np.abs(stands.q).max() < 1e-14
    drop = table.integrate([0.02, 0.01, 0.0], v0=[0, 0, 0], h=0.005, t_end=0.3)
    assert drop.modes.states[-1].count("rest") in (2, 3)
    assert np.abs(drop.q[-1]).max() < 1e-9
