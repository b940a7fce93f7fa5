"""Results, files, checkpoints, ensembles and records of runs in which events act."""

import itertools
import pickle
import signal

import numpy as np
import pytest
import sympy as sp
from support.impacts import BALL, FALL, drop, floor, z

import symsimpson as ss
from symsimpson.run import chosen
from symsimpson.run.ensemble import singles
from symsimpson.run.event_actions import EventActions
from symsimpson.run.event_run import EventRun


def test_results_keep_their_records():
    run = drop(floor())
    again = pickle.loads(pickle.dumps(run))
    assert np.array_equal(again.events("floor").t, run.events("floor").t)


@pytest.mark.slow
@pytest.mark.plain
def test_a_run_from_a_checkpoint_goes_on_to_the_same_bits(tmp_path):
    """With events, stopped by Ctrl-C between two of them, and resumed with what they did."""
    whole = drop(floor(), t_end=4.0)
    file = tmp_path / "run.ckpt"
    first = drop(floor(), t_end=4.0, checkpoint=file, checkpoint_every=70)
    assert np.array_equal(first.q, whole.q)
    again = ss.resume(file, events=[floor()])
    assert np.array_equal(again.q, whole.q)
    assert np.array_equal(again.events("floor").t, whole.events("floor").t)
    with pytest.raises(ss.InputError, match="contains a run with other events"):
        ss.resume(file)
    with pytest.raises(ss.InputError, match="contains a run with other events"):
        ss.resume(file, events=[floor(0.5)])


def test_a_run_that_was_cut_off_is_resumed(tmp_path, monkeypatch):
    whole, file = drop(floor(), t_end=2.0), tmp_path / "run.ckpt"
    advance = EventRun.advance

    def cut(run, stop):
        advance(run, stop)
        if run.step >= 120:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(EventRun, "advance", cut)
        part = drop(floor(), t_end=2.0, checkpoint=file, checkpoint_every=60, on_failure="return")
    assert part.status is ss.Status.INTERRUPTED
    assert 0 < len(part.events("floor")) < len(whole.events("floor"))
    again = drop(floor(), t_end=2.0, checkpoint=file)
    assert np.array_equal(again.q, whole.q)
    assert np.array_equal(again.p, whole.p)
    assert [one.t for one in again.records] == [one.t for one in whole.records]


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("place", ["apply", "may_act", "rates"])
def test_ctrl_c_while_an_event_acts_is_heard_behind_the_step(tmp_path, monkeypatch, place):
    swung = ss.Event(z - 0.5, name="turn", action=ss.Change(velocities={z: z.diff() * 0.9}))
    events, file = [floor(), swung], tmp_path / "run.ckpt"
    whole = drop(*events, tangents=2)
    plain, calls = getattr(EventActions, place), itertools.count(1)

    def disturbed(*given):
        if next(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return plain(*given)

    with monkeypatch.context() as patched:
        patched.setattr(EventActions, place, disturbed)
        with pytest.raises(ss.Interrupted) as caught:
            drop(*events, tangents=2, checkpoint=file)
    assert 0 < caught.value.trajectory.steps < whole.steps
    again = drop(*events, tangents=2, checkpoint=file)
    assert np.array_equal(again.q, whole.q)
    assert np.array_equal(again.tangent, whole.tangent)
    assert [one.t for one in again.records] == [one.t for one in whole.records]


@pytest.mark.slow
@pytest.mark.plain
def test_a_loop_with_inputs_has_the_bits_of_a_run():
    x, u = ss.coordinates("x")[0], sp.Symbol("u")
    system = ss.MechanicalSystem(
        "cart",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=x**4 / 4,
        forces={x: u},
        inputs=(u,),
    )
    wall = ss.Event(sp.Rational(1, 2) - x, name="wall", action=ss.Impact(1))
    given = {"h": 0.1, "events": [wall]}
    stepper = ss.compile(system)
    run = stepper.integrate([0.1], [3.0], steps=200, inputs={"u": 0.3}, **given)
    loop = stepper.start([0.1], [3.0], **given)
    for _ in range(200):
        loop.step(0.3)
    assert len(run.events("wall")) > 5
    assert (loop.q == run.q[-1]).all()
    assert (loop.p == run.p[-1]).all()


def test_observed_values_and_counts():
    reduce = {"high": ("max", "z"), "hits": ("count", "floor"), "end": ("max", "t")}
    run = drop(floor(), reduce=reduce, every=None)
    whole = drop(floor())
    assert run.reduced["hits"] == len(whole.records) == 3
    assert run.reduced["high"] == whole.q.max()
    assert run.reduced["end"] == 2.0
    assert np.array_equal(run.q[-1], whole.q[-1])
    with pytest.raises(ss.InputError, match="counts 'wall', but no event"):
        drop(floor(), reduce={"hits": ("count", "wall")})
    with pytest.raises(ss.InputError, match="This call has no events: pass events="):
        ss.compile(BALL).integrate([1.0], v0=[0.0], h=0.01, steps=3, reduce={"a": ("count", "b")})


@pytest.mark.slow
@pytest.mark.plain
def test_members_of_an_ensemble_do_what_single_runs_do(monkeypatch):
    """Some meet the floor, others do not: these stay in their blocks."""
    alone, real = [], singles.run

    def run_alone(program, asked, **how):
        alone.append(asked.q0.tolist())
        return real(program, asked, **how)

    monkeypatch.setattr(singles, "run", run_alone)
    stepper, heights = ss.compile(BALL), np.array([[0.5], [1.0], [40.0], [0.3], [50.0], [30.0]])
    given = {"v0": [0.0], "h": 0.01, "steps": 150}
    reduce = {"hits": ("count", "floor"), "low": ("min", "z")}
    many = stepper.ensemble(heights, events=[floor()], reduce=reduce, every=50, **given)
    assert (many.status == 0).all()
    for k, height in enumerate(heights):
        one = stepper.integrate(height, events=[floor()], every=50, **given)
        assert np.array_equal(many.q[k], one.q), k
        assert many.reduced["hits"][k] == len(one.records)
    assert many.reduced["hits"].tolist() == [3, 2, 0, 5, 0, 0]
    assert alone == [[0.5], [1.0], [0.3]]
    behind = stepper.ensemble([[1.0], [-1.0]], events=[floor()], **given)
    assert behind.status.tolist() == [0, ss.Status.BAD_INPUT]
    with pytest.raises(ss.InputError, match="A store does not save events"):
        stepper.ensemble(heights, events=[floor()], store="somewhere", **given)


def test_a_loop_bounces_as_a_run_does():
    loop = ss.compile(BALL).start([1.0], v0=[0.0], h=0.01, events=[floor()])
    for _ in range(200):
        loop.step()
    run = drop(floor())
    assert np.array_equal(loop.q, run.q[-1])
    again = pickle.loads(pickle.dumps(loop))
    again.step()
    loop.step()
    assert np.array_equal(loop.q, again.q)
    assert loop.events("floor").t.tolist() == run.events("floor").t.tolist()
    last = ss.compile(BALL).start(
        [1.0], v0=[0.0], h=0.01, events=[ss.Event(z, name="down", terminal=np.True_)]
    )
    while last.ended_by is None:
        last.step()
    assert abs(last.t - FALL) < 1e-14
    assert abs(last.q[0]) < 1e-15
    assert abs(last.v[0] + 9.81 * FALL) < 1e-13
    with pytest.raises(ss.InputError, match=r"the loop is at its end\. 'down' ended the run"):
        last.step()


@pytest.mark.parametrize("step", [1, 2])
def test_an_event_at_a_time_of_the_grid_acts_in_a_loop_as_in_a_run(step):
    braked = ss.Change(velocities={z: z.diff() / 2})
    given = {"h": 0.125, "events": [ss.Event(ss.time - 0.125 * step, name="b", action=braked)]}
    stepper = ss.compile(BALL)
    run = stepper.integrate([1.0], v0=[0.0], steps=4, **given)
    loop = stepper.start([1.0], v0=[0.0], **given)
    for k in range(1, 5):
        loop.step()
        assert np.array_equal(loop.p, run.p[k])
    assert loop.events("b").t.tolist() == run.events("b").t.tolist() == [0.125 * step]


def test_events_without_a_name_are_found_by_their_expression():
    """A bounce is no change of sign: zeros of the run afterwards are none."""
    hits = [*drop(floor(), t_end=1.5).events("floor").t]
    bare = ss.Event(z, action=ss.Impact(0.8))
    for more in ({}, {"t_eval": [0.5, 1.0]}):
        run = drop(bare, t_end=1.5, **more)
        assert [*run.events(z).t] == [*run.events("z(t)").t] == hits
    assert len(drop(floor(), t_end=1.5).events(z)) == 0


def test_inequalities_as_gaps_hold_where_a_body_is_free():
    hits = drop(floor(), t_end=1.5).events("floor").t.tolist()
    for gap in (z >= 0, z > 0, -z <= 0, sp.Eq(z, 0)):
        bounce = ss.Event(gap, name="floor", action=ss.Impact(0.8))
        assert drop(bounce, t_end=1.5).events("floor").t.tolist() == hits
    with pytest.raises(ss.InputError, match="violates the gap"):
        drop(ss.Event(z <= 0, name="floor", action=ss.Impact(0.8)), t_end=1.5)


@pytest.mark.slow
@pytest.mark.plain
def test_tables_have_what_events_did():
    pytest.importorskip("pandas")
    hits = drop(floor(), t_end=1.5).events("floor")
    table = hits.to_pandas()
    assert table.index.tolist() == hits.t.tolist()
    for name in ("direction", "impulse", "simultaneous"):
        assert table[name].tolist() == getattr(hits, name).tolist()
    crossings = drop(t_end=1.5).events(z - 0.5).to_pandas()
    assert crossings["direction"].tolist() == [-1]
    assert "impulse" not in crossings.columns


@pytest.mark.slow
@pytest.mark.plain
def test_files_keep_what_events_did(tmp_path):
    pytest.importorskip("netCDF4")
    end = ss.Event(z, name="down", direction=-1, terminal=2)
    for number, events in enumerate(([floor()], [end])):
        run = drop(*events, t_end=1.5)
        path = tmp_path / f"{number}.nc"
        run.save(path)
        again = ss.open_trajectory(path)
        name = events[0].name
        assert np.array_equal(again.t, run.t)
        assert again.ended_by == run.ended_by
        assert np.array_equal(again.events(name).q_after, run.events(name).q_after)
        assert np.array_equal(again.energy_error, run.energy_error)
        assert again.at(0.47).q == run.at(0.47).q


@pytest.mark.slow
@pytest.mark.plain
def test_chosen_states_and_sections_of_long_runs(monkeypatch):
    """Whose pieces are looked at one after the other, each with the events in it."""
    run = drop(floor(1.0), t_end=4.0)
    times = np.linspace(0, 4, 23)
    monkeypatch.setattr(chosen, "PIECE", 30)
    some = drop(floor(1.0), t_end=4.0, t_eval=times)
    assert np.abs(some.q - run.at(times).q).max() < 1e-15
    saved = drop(floor(1.0), t_end=4.0, save=("z", "energy"), every=7)
    assert np.array_equal(saved["z"], run["z"][::7])
    end = ss.Event(z, name="down", direction=-1, terminal=True)
    short = drop(end, t_end=4.0, save="z", every=7)
    assert abs(short.t[-1] - FALL) < 1e-14
    assert abs(short["z"][-1]) < 1e-14
    given = {"v0": [0.0], "h": 0.01, "t_end": 4.0, "events": [floor(1.0)]}
    tops = ss.compile(BALL).poincare(z.diff(), [1.0], direction=-1, **given)
    assert np.abs(np.diff(tops.t) - 2 * FALL).max() < 1e-13
    assert np.abs(tops.q - 1).max() < 1e-13


@pytest.mark.parametrize("how", [{"t_eval": [0.0, 0.7, 3.0]}, {"save": ["z"]}])
def test_what_is_kept_of_a_run_knows_its_events(how):
    whole, kept = drop(floor(0.8), t_end=3.0), drop(floor(0.8), t_end=3.0, **how)
    hits = kept.events("floor")
    assert hits.t.tolist() == whole.events("floor").t.tolist()
    assert hits.after.energy.tolist() == whole.events("floor").after.energy.tolist()
    with pytest.raises(ss.InputError, match=r"no event 'wall'\. Its events are floor"):
        kept.events("wall")


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize(("scheme", "order"), [("gauss6", 6), ("simpson", 4)])
def test_work_is_recorded_through_events(scheme, order):
    """Of friction and of an input that varies within steps: energies tell the same."""
    u = sp.Symbol("u")
    driven = ss.MechanicalSystem(
        "driven_ball",
        coordinates=(z,),
        kinetic=z.diff() ** 2 / 2,
        potential=10 * z,
        forces={z: u * sp.cos(3 * z) - z.diff() / 2},
        inputs=(u,),
    )
    stepper, off = ss.compile(driven, scheme), []
    for steps in (50, 100):
        times = stepper.node_times(2 / steps, steps)
        given = {"h": 2 / steps, "steps": steps, "inputs": {u: np.sin(3 * times)}}
        run = stepper.integrate([1.0], v0=[0.0], **given, record="work", events=[floor(0.9)])
        assert len(run.records) >= 2
        off.append(np.abs(run.energy_balance).max())
    assert off[1] < {6: 1e-11, 4: 1e-7}[order]
    assert off[1] < off[0] / 2 ** (order - 0.7) or off[1] < 1e-13
    hits = run.events("floor")
    lost = (hits.after.energy - hits.energy).sum()
    assert abs(run.energy[-1] - run.energy[0] - run.work["total"][-1] - lost) < 1e-7
    with pytest.raises(ss.InputError, match="Record it: record='work'"):
        stepper.integrate([1.0], v0=[0.0], **given, events=[floor(0.9)]).work  # noqa: B018
    many = stepper.ensemble([[1.0], [5.0]], v0=[0.0], **given, record="work", events=[floor(0.9)])
    assert abs(many.recorded["work"][0][-1] - run.recorded["work"][-1]).max() < 1e-13


@pytest.mark.slow
@pytest.mark.plain
def test_work_of_a_step_that_is_not_taken_is_not_counted():
    drag = ss.MechanicalSystem(
        "drag",
        coordinates=(z,),
        kinetic=z.diff() ** 2 / 2,
        potential=9.81 * z,
        forces={z: -0.3 * z.diff()},
    )
    stepper, found = ss.compile(drag, "lobatto6"), []
    for every in (1, None):
        given = {"h": 0.13, "steps": 60, "every": every, "on_failure": "return"}
        run = stepper.integrate([1.0], v0=[0.0], **given, record="work", events=[floor(0.5)])
        assert run.status is ss.Status.EVENTS_ACCUMULATE
        found.append((run.t[-1], run.work["total"][-1]))
    assert found[0] == found[1]


def kick(t=0.5, **more):
    action = ss.Change(velocities={z: z.diff() + 1})
    return ss.Event(ss.time - t, name="kick", action=action, **more)


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("every", [1, 2, 3, 7])
def test_energies_of_a_state_where_an_event_acts_are_told_apart(every):
    for t, h in ((0.5, 0.0625), (1.0, 0.0625), (-0.5, -0.0625)):
        run = drop(kick(t), h=h, t_end=np.sign(h) * 1.0, every=every)
        assert len(run.events("kick")) == 1
        assert np.abs(run.energy_error).max() < 1e-13
    run = drop(kick(terminal=True), h=0.0625, t_end=1.0, every=every)
    assert np.abs(run.energy_error).max() < 1e-13


def test_a_stored_state_where_an_event_acts_is_given_as_it_is():
    run = drop(kick(), h=0.0625, t_end=1.0)
    assert (run.sol(run.t) == run.y).all()
    before, behind = run.at([0.5 - 1e-9, 0.5 + 1e-9])["v_z"]
    assert abs(behind - before - 1) < 1e-7
    chosen = drop(kick(), h=0.0625, t_end=1.0, t_eval=run.t)
    assert np.abs(chosen.q - run.q).max() < 1e-15
    assert np.abs(chosen.p - run.p).max() < 1e-15


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("every", [1, 3, 8, None])
@pytest.mark.parametrize("t_end", [0.5, 1.0])
def test_quantities_of_a_run_that_ends_at_a_stored_state_have_that_once(every, t_end):
    for end in (kick(terminal=True), ss.Event(ss.time - 0.5, name="end", terminal=True)):
        how = {"h": 0.0625, "t_end": t_end, "every": every}
        run, kept = drop(end, **how), drop(end, **how, save=["t", "p_z"])
        assert np.array_equal(kept["t"], run.t)
        assert np.array_equal(kept["p_z"], run["p_z"])
        how["every"] = 1
        assert drop(end, **how, t_eval=[0.25, 0.5])["p_z"][-1] == run["p_z"][-1]


@pytest.mark.parametrize("every", [1, 4, 7, 100])
def test_zeros_of_a_run_that_was_ended_are_there_once(every):
    end = ss.Event(z, name="floor", terminal=True)
    run = drop(end, h=0.05, t_end=1.0, every=every)
    assert run.t[-1] == pytest.approx(FALL)
    for height in (0.003, 0.02, 0.5):
        zeros = run.events(z - height)
        assert zeros.t == pytest.approx([FALL * np.sqrt(1 - height)])
        assert zeros.direction.tolist() == [-1]


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("every", [2, 3, None])
@pytest.mark.parametrize("retimed", [False, True], ids=["event", "retimed"])
def test_an_end_within_a_step_has_its_newton_iterations(every, retimed):
    system = ss.systems.double_pendulum()
    stepper = ss.compile(system.retimed(sp.Integer(1)) if retimed else system)
    asked = {"q0": [1.0, 1.0], "v0": [0.0, 0.0], "h": 0.1, "t_end": 0.75 if retimed else 0.8}
    if not retimed:
        asked["events"] = [ss.Event(ss.time - 0.75, name="late", terminal=True)]
    whole = stepper.integrate(**asked)
    rough = stepper.integrate(**asked, every=every)
    assert whole.newton_iterations[1:].min() > 0
    assert rough.newton_iterations[-1] > 0
    assert rough.newton_iterations.sum() == whole.newton_iterations.sum()


@pytest.mark.slow
@pytest.mark.plain
@pytest.mark.parametrize("every", [1, 3, None])
def test_inputs_are_those_of_the_steps_that_were_taken(every):
    stepper = ss.compile(ss.systems.driven_cart_pole())
    given = np.linspace(0.0, 0.1, 20)
    for end, rows in ((0.105, 11), (0.1, 10), (1.0, 20)):  # in a step, at its end, behind all
        run = stepper.integrate(
            **stepper.reference_state,
            h=0.01,
            steps=20,
            every=every,
            inputs={"u": given},
            events=[ss.Event(ss.time - end, name="stop", terminal=True)],
        )
        assert np.array_equal(run.inputs["u"], given[:rows])
