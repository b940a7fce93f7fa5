"""Events that act on a run: when and where they do, and what comes behind."""

import numpy as np
import pytest
import sympy as sp
from support.impacts import BALL, FALL, PLANE, drop, floor, x, y, z
from support.rods import ROD

import symsimpson as ss


def test_a_ball_bounces_where_it_should():
    run = drop(floor())
    hits = run.events("floor")
    assert isinstance(hits, ss.Actions)
    times = FALL * np.array([1, 1 + 2 * 0.8, 1 + 2 * 0.8 + 2 * 0.64])
    assert np.abs(hits.t - times).max() < 1e-14
    assert hits.direction.tolist() == [-1, -1, -1]
    assert np.abs(hits.after.v[:, 0] + 0.8 * hits.v[:, 0]).max() < 1e-14
    assert np.abs(hits.impulse - 1.8 * np.abs(hits.v[:, 0])).max() < 1e-13
    assert not hits.simultaneous.any()
    assert np.array_equal(run.t, 0.01 * np.arange(201))  # the grid of times is kept
    assert (run.q >= 0).all()


def test_energy_is_told_apart_from_what_impacts_take():
    run = drop(floor())
    assert np.abs(run.energy_error).max() < 1e-13
    hits = run.events("floor")
    lost = hits.energy - hits.after.energy
    assert np.abs(lost - (1 - 0.64) * hits.kinetic_energy).max() < 1e-13
    assert np.ptp(run.energy) > 5
    with pytest.raises(ss.InputError, match=r"has no shadow energy\. Events acted"):
        run.shadow_energy  # noqa: B018


def test_states_between_steps_are_those_behind_events():
    run = drop(floor())
    t1 = float(run.events("floor").t[0])
    later = np.array([1e-9, 1e-3, 0.013, 0.4])
    speed = 0.8 * 9.81 * t1
    truth = speed * later - 9.81 / 2 * later**2
    assert np.abs(run.at(t1 + later)["z"] - truth).max() < 1e-13
    assert abs(run.at([t1 - 1e-3])["z"][0] - (9.81 * t1 * 1e-3 - 9.81 / 2e6)) < 1e-13
    assert np.abs(run.sol(run.t) - run.y).max() < 1e-12
    sparse = drop(floor(), every=25)
    assert np.abs(sparse.at(t1 + later)["z"] - truth).max() < 1e-13
    # where it turns: between two impacts
    tops = run.events("v_z", direction=-1)
    assert np.abs(tops.t - t1 * np.array([1.8, 3.24, 4.392])).max() < 1e-12


def test_terminal_events_end_a_run_inside_a_step():
    half = ss.Event(z - 0.5, name="half", terminal=True)
    run = drop(half)
    assert run.success
    assert run.ended_by == "half"
    assert abs(run.t[-1] - np.sqrt(1 / 9.81)) < 1e-14
    assert abs(run.q[-1, 0] - 0.5) < 1e-14
    assert run.steps == 31
    assert "ended the run" in run.message
    assert abs(run.at([run.t[-1]])["z"][0] - 0.5) < 1e-14
    last = drop(half, every=None)
    assert last.q.shape == (1, 1)
    assert last.t[-1] == run.t[-1]
    third = drop(floor(terminal=3))
    assert len(third.events("floor")) == 3
    assert third["v_z"][-1] > 0  # behind the action


def test_conditions_directions_and_changes():
    """A gate that sends what comes from below to the other side, in one half of the plane."""
    stepper = ss.compile(PLANE)
    gate = ss.Event(
        y - 1,
        name="gate",
        direction=1,
        when=x,
        action=ss.Change(positions={y: -1}, velocities={x: -x.diff(), y: 2 * y.diff()}),
    )
    start = {"h": 0.25, "steps": 7, "events": [gate]}
    run = stepper.integrate([0.5, 0.0], v0=[0.1, 1.0], **start)
    (hit,) = run.events("gate").t
    assert abs(hit - 1.0) < 1e-14
    assert np.allclose(run.events("gate").q_after, [[0.6, -1.0]])
    assert np.allclose(run.v[-1], [-0.1, 2.0])
    assert np.allclose(run.q[-1], [0.525, 0.5])
    assert len(stepper.integrate([-0.5, 0.0], v0=[0.1, 1.0], **start).events("gate")) == 0
    assert len(stepper.integrate([0.5, 2.0], v0=[0.1, -1.0], **start).events("gate")) == 0


def test_a_wall_that_moves_and_a_restitution_of_the_speed():
    wall = ss.Event(z - ss.time / 10, name="wall", action=ss.Impact(sp.exp(-ss.approach / 10)))
    run = drop(wall, t_end=1.0)
    hits = run.events("wall")
    speed = 0.1 - hits.v[0, 0]
    assert abs(hits.q[0, 0] - hits.t[0] / 10) < 1e-14
    assert abs(hits.after.v[0, 0] - 0.1 - np.exp(-speed / 10) * speed) < 1e-13


def test_two_zeros_within_a_step_are_found_by_the_rates():
    """A ball that hardly touches, between two states that are both off the ground."""
    run = drop(floor(1.0), h=0.25, t_end=2.0)
    assert len(run.events("floor")) == 2
    assert abs(run.events("floor").t[0] - FALL) < 1e-14


def test_a_start_on_a_wall():
    run = ss.compile(BALL).integrate([0.0], v0=[-1.0], h=0.01, steps=3, events=[floor(0.5)])
    assert run.events("floor").t.tolist() == [0.0]
    assert run["v_z"][0] == 0.5
    away = ss.compile(BALL).integrate([0.0], v0=[1.0], h=0.01, steps=3, events=[floor(0.5)])
    assert len(away.events("floor")) == 0


def test_a_run_goes_on_from_where_it_met_a_wall():
    """Rounding may have the gap behind it, and there is nothing else to tell its size."""
    stepper, given = ss.compile(BALL), {"h": 0.01, "steps": 20, "events": [floor()]}
    for gap in (-1e-18, -1e-17, -1e-13):
        assert stepper.integrate([gap], [3.0], **given).q[1:].min() > 0
    with pytest.raises(ss.InputError, match="violates the gap 'floor'"):
        stepper.integrate([-1e-9], [3.0], **given)


@pytest.mark.slow
def test_impacts_with_constraints_keep_to_them():
    """A pendulum of Cartesian coordinates against a wall: M v jumps along what the rod allows."""
    wall = ss.Event(x, name="wall", action=ss.Impact(0.5))
    run = ss.compile(ROD).integrate([0.8, -0.6], v0=[0, 0], h=0.02, steps=60, events=[wall])
    hits = run.events("wall")
    assert np.abs(hits.after.v + 0.5 * hits.v).max() < 1e-13
    assert np.abs(run.constraint_error).max() < 1e-15
    assert np.abs(run.energy_error).max() < 1e-4
    aside = ss.Event(x - 0.3, name="aside", action=ss.Impact(0.5))  # the rod holds a part of n
    hits = ss.compile(ROD).integrate([0.8, -0.6], v0=[0, 0], h=0.02, steps=60, events=[aside])
    behind = hits.events("aside").after
    assert len(behind.p) >= 2
    assert np.abs((behind.q * behind.p).sum(axis=1)).max() < 1e-14  # momenta are M v of the rod's


def test_inputs_go_on_through_an_event():
    """Held ones and those at nodes stay those of the step in which it is."""
    u = sp.Symbol("u")
    pushed = ss.MechanicalSystem(
        "pushed",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=0 * x,
        forces={x: u},
        inputs=(u,),
    )
    stepper = ss.compile(pushed, "gauss4")
    t = stepper.node_times(0.1, 20)
    nothing = ss.Event(x - 0.05, name="mark", action=ss.Switch())
    given = {"h": 0.1, "steps": 20, "inputs": {"u": np.cos(t)}}
    plain = stepper.integrate([0.0], v0=[0.0], **given)
    run = stepper.integrate([0.0], v0=[0.0], **given, events=[nothing])
    assert len(run.events("mark")) == 1
    assert np.abs(run.q - plain.q).max() < 1e-6
    assert abs(run.q[-1, 0] - (1 - np.cos(2.0))) < 1e-6


@pytest.mark.slow
def test_impacts_that_accumulate_keep_what_was_computed():
    run = drop(floor(0.5), t_end=3.0, on_failure="return")
    assert run.status is ss.Status.EVENTS_ACCUMULATE
    end = FALL * (1 + 0.5) / (1 - 0.5)
    assert abs(float(run.message.split("up to t=")[1].split(". ")[0]) - end) < 1e-12
    assert run.t[-1] < end < run.t[-1] + 0.01


def test_a_body_that_stays_on_its_floor_is_told_at_once():
    with pytest.raises(ss.ConvergenceError, match=r"The state rests on 'floor' at t=.*Contact"):
        drop(floor(0.0), t_end=3.0)


def test_elastic_impacts_are_undone_backwards():
    """And others are not: a run backwards would have to give what they take."""
    stepper = ss.compile(BALL)
    run = drop(floor(1.0), t_end=3.0)
    given = {"p0": run.p[-1], "h": -0.01, "steps": 300, "t0": run.t[-1]}
    back = stepper.integrate(run.q[-1], **given, events=[floor(1.0)])
    assert np.abs(back.events("floor").t[::-1] - run.events("floor").t).max() < 1e-13
    assert abs(back.q[-1, 0] - 1.0) < 1e-13
    with pytest.raises(
        ss.ConvergenceError, match="dissipates energy, so it cannot act in a backward run"
    ):
        stepper.integrate(run.q[-1], **given, events=[floor(0.5)])


@pytest.mark.slow
@pytest.mark.plain
def test_elastic_impacts_do_not_accumulate():
    """A light ball between two heavy ones that come near each other: few impacts, and an end."""
    u, v, w = ss.coordinates("u v w")
    masses = {u: 1, v: sp.Rational(1, 100), w: 1}
    system = ss.MechanicalSystem(
        "squeezed",
        coordinates=(u, v, w),
        kinetic=sum(m * q.diff() ** 2 / 2 for q, m in masses.items()),
        potential=0 * u,
    )
    gaps = [ss.Event(b - a, name=n, action=ss.Impact()) for n, a, b in (("l", u, v), ("r", v, w))]
    for near in (1e-3, 1e-6):
        run = ss.compile(system).integrate(
            [-near, 0, near / 3], v0=[1, 0, -1], h=0.1, steps=5, events=gaps
        )
        assert len(run.records) == 22
        assert np.abs(run.energy_error).max() < 1e-14


def test_a_zero_at_an_end():
    """At the start it is none, at the last state it is one."""
    stepper = ss.compile(BALL)
    for expression in (z, -z, z.diff() - 1, 1 - z.diff()):
        mark = ss.Event(expression, name="mark")
        run = stepper.integrate([0.0], v0=[1.0], h=0.01, steps=3, events=[mark])
        assert len(run.events("mark")) == 0, expression
    end = ss.Event(ss.time - 1, name="end", terminal=True)
    assert stepper.integrate([9.0], v0=[0.0], h=0.25, t_end=1.0, events=[end]).ended_by == "end"
    free = ss.compile(PLANE)
    wall = ss.Event(x, name="wall", action=ss.Impact())
    run = free.integrate([1.0, 0.0], v0=[-1.0, 0.0], h=0.25, t_end=1.0, events=[wall])
    assert run["v_x"][-1] == 1.0
    late = ss.Event(x, name="wall", action=ss.Impact(), when=ss.time - 3)
    assert free.integrate([-1.0, 0.0], v0=[0, 0], h=0.25, steps=4, events=[late]).success


@pytest.mark.slow
@pytest.mark.plain
def test_a_bumper_and_a_recorder_beside_a_wall():
    """What is changed to the other way is looked at anew; a recorder sees one change of sign."""
    kick = ss.Change(velocities={z: -1.1 * z.diff()})
    bumper = ss.Event(z, name="bumper", direction=-1, action=kick)
    run = ss.compile(BALL).integrate([0.002], v0=[0.0], h=0.1, t_end=1.0, events=[bumper])
    assert run["z"].min() > -1e-12
    assert len(run.events("bumper")) > 3
    seen = ss.Event(z, name="seen", direction=1)
    run = drop(floor(1.0), seen)
    assert len(run.events("floor")) == 2
    assert len(run.events("seen")) == 0


def test_a_gap_that_closes_shortly_before_a_state():
    off = 0.015
    speed = 9.81 * (0.5 + off)
    high = speed**2 / 19.62 - 0.8 * 9.81 * off**2 / 2
    ceiling = ss.Event(high - z, name="ceiling", action=ss.Impact())
    run = ss.compile(BALL).integrate([0.0], v0=[speed], h=0.5, steps=3, events=[ceiling])
    assert len(run.events("ceiling")) == 1


@pytest.mark.slow
def test_changes_keep_to_constraints():
    stepper = ss.compile(ROD)
    for change in ({"positions": {x: 0.5}}, {"velocities": {y: 1}}):
        event = ss.Event(x, name="mark", action=ss.Change(**change))
        with pytest.raises(ss.ConvergenceError, match="a state that violates the constraints"):
            stepper.integrate([0.8, -0.6], v0=[0, 0], h=0.02, steps=60, events=[event])


def test_no_events_are_a_plain_run():
    run = ss.compile(BALL).integrate([1.0], v0=[0.0], h=0.01, steps=5, events=[])
    assert run.success
    assert not run.records


def test_conditions_may_be_inequalities():
    assert len(drop(floor(when=ss.time < 1), t_end=1.0).events("floor")) == 1
    assert len(drop(floor(when=ss.time > 1), t_end=1.0).events("floor")) == 0
    assert len(drop(floor(when=z.diff() <= 100)).events("floor")) == 3
    with pytest.raises(ss.InputError, match="holds only at isolated points"):
        drop(floor(when=sp.Eq(z, 0)))


@pytest.mark.slow
@pytest.mark.plain
def test_jumps_are_no_zeros():
    """As for zeros of a run: neither that of a rest, nor a pole."""
    free = ss.compile(
        ss.MechanicalSystem("free", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0)
    )
    for text in ("Mod(x, 2*pi) - pi", "tan(x)", "1/(x - pi)"):
        end = ss.Event(text, name="jump", direction=-1, terminal=True)
        run = free.integrate([0.3], v0=[1.0], h=0.1, steps=80, events=[end])
        assert run.ended_by is None, text
        assert len(run.events(text, direction=-1)) == 0


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize(
    ("gap", "potential", "hits"),
    [(y - x, -x, 1), (y - x, (y - 3) ** 2, 2), (y + 1 - x**2 / 20, 0 * x, 1)],
)
def test_plastic_bodies_that_move_on_together_are_at_rest(gap, potential, hits):
    """A rate of rounding lifts them by rounding: they have not parted, and hit each other once."""
    pair = ss.MechanicalSystem(
        "pair",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + 2 * y.diff() ** 2) / 2,
        potential=potential,
    )
    plastic = ss.Event(gap, name="plastic", action=ss.Impact(0))
    run = ss.compile(pair).integrate(
        [0.0, 1.0], v0=[2.0, -1.0], h=0.05, t_end=5, events=[plastic], on_failure="return"
    )
    assert run.status is ss.Status.EVENTS_ACCUMULATE
    assert "The state rests on 'plastic'" in run.message
    assert len(run.events("plastic")) == hits


def test_a_gap_without_a_value_beyond_its_wall_ends_the_run():
    run = drop(ss.Event(sp.sqrt(z), name="w", action=ss.Impact(0.8)), on_failure="return")
    assert run.status is ss.Status.NOT_FINITE
    assert "A gap has no finite value beyond its wall" in run.message
    assert run.steps == 45


def test_a_terminal_event_at_the_start_acts():
    end = floor(0.8, terminal=True)
    run = ss.compile(BALL).integrate([0.0], v0=[-1.0], h=0.01, t_end=1, events=[end])
    assert run.ended_by == "floor"
    assert run.p[-1, 0] == pytest.approx(0.8)


def test_an_impact_that_is_not_allowed_lets_a_run_pass_on_a_time_of_its_grid():
    (a,) = ss.coordinates("a")
    free = ss.MechanicalSystem("free", coordinates=(a,), kinetic=a.diff() ** 2 / 2, potential=0 * a)
    later = ss.Event(1 - a, name="later", action=ss.Impact(), when=ss.time - 2)
    run = ss.compile(free).integrate([0.0], v0=[1.0], h=0.1, steps=30, events=[later])
    assert run.success
    assert abs(run.q[-1, 0] - 3) < 1e-12


KINKED = ss.MechanicalSystem(
    "kinked",
    coordinates=(x,),
    kinetic=x.diff() ** 2 / 2,
    potential=x**2 + sp.Rational(5, 4) * x * sp.sqrt(x**2),  # its derivative has no value at 0
)


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("scheme", ["lobatto2", "simpson"])
def test_an_event_at_a_kink_of_a_force_is_found(scheme):
    stepper = ss.compile(KINKED, scheme)
    for steps in (57, 67, 80):
        given = {"v0": [0.3], "h": 2 / steps, "steps": steps}
        end = stepper.integrate([1.0], events=[ss.Event(x, name="end", terminal=True)], **given)
        assert end.ended_by == "end"
        wall = ss.Event(x, name="wall", action=ss.Impact(0.8))
        bounced = stepper.integrate([1.0], events=[wall], **given)
        assert len(bounced.events("wall").t) == 1
        assert bounced.q.min() > -1e-12
        kink = ss.Event(x, name="kink", action=ss.Switch())
        passed = stepper.integrate([1.0], events=[kink], **given)
        assert passed.events("kink").t == pytest.approx(end.t[-1:], abs=1e-12)


@pytest.mark.slow
@pytest.mark.plain
def test_energies_of_events_at_the_zero_of_a_root():
    """V is NaN at zero, where kernels take x**2 times 1/root for |x|: so was what walls take."""
    system = ss.MechanicalSystem(
        "stiffer",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=x**2 / 2 + 3 * (x + sp.sqrt(x**2)) ** 2 / 8,
    )
    for action in (ss.Switch(), ss.Impact(1), ss.Impact(0.5)):
        wall = ss.Event(x, name="wall", action=action)
        run = ss.compile(system, "gauss8").integrate(
            [1.0], v0=[0.0], h=0.05, steps=40, events=[wall]
        )
        assert len(run.events("wall").t) == 1
        assert np.abs(run.energy_error).max() < 1e-12


def test_two_walls_may_be_one_gap():
    ball = ss.compile(
        ss.MechanicalSystem("free", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=0 * x)
    )
    walls = ss.Event(0.5 - sp.Abs(x - 0.2), name="walls", action=ss.Impact(1))
    run = ball.integrate([0.2], v0=[1.0], h=0.03, t_end=3, events=[walls])
    assert run.events("walls").t == pytest.approx([0.5, 1.5, 2.5], abs=1e-12)
