"""Members side by side, or one by one, as a trial tells."""

import signal

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.run.ensemble import lanes as trial
from symsimpson.run.ensemble.members import read_ensemble_spec
from symsimpson.stepping.request import Request

STARTS = np.linspace([0.1, 0.2], [2.0, 1.0], 40)
ASKED = {"p0": [0.0, 0.0], "h": 0.05, "steps": 20}


@pytest.fixture
def tried(monkeypatch):
    """Let any task be worth a trial, and say how long members take by their lanes."""
    seconds, found = {}, []

    def told(program, task, rounds):
        found.append(task.lanes)
        return seconds.get(task.lanes, 1.0)

    monkeypatch.setattr(trial, "FEWEST_STEPS_OF_TRIAL", 0)
    monkeypatch.setattr(trial, "measure_member_time", told)
    return seconds, found


@pytest.fixture
def lanes(monkeypatch):
    """The lanes of tasks that are run."""
    found = []

    def run(program, task, count):
        found.append(task.lanes)
        return plain(program, task, count)

    plain = trial.run_blocks
    monkeypatch.setattr("symsimpson.run.ensemble.dispatch.run_blocks", run)
    return found


def test_the_faster_way_is_taken_and_leaves_the_same(tried, lanes):
    seconds, asked = tried
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss8")
    ends = []
    for single, taken in ((0.5, 1), (0.95, lanes)):
        stepper.program.findings.lanes.clear()
        seconds[1] = single
        ends += [stepper.ensemble(STARTS, **ASKED) for _ in range(2)]
        assert lanes[-1] == lanes[-2]
        assert (lanes[-1] == 1) == (taken == 1)
    assert len(asked) == 4  # two for each trial, which is remembered
    for end in ends:
        assert np.array_equal(end.q, ends[0].q)
        assert np.array_equal(end.p, ends[0].p)
        assert np.array_equal(end.newton_iterations, ends[0].newton_iterations)


@pytest.mark.parametrize("scheme", ["simpson", "gauss4"])  # members by Newton's method
def test_where_bits_would_differ_there_is_no_trial(tried, lanes, scheme):
    ss.compile(ss.systems.double_pendulum(), scheme).ensemble(STARTS, **ASKED)
    assert not tried[1]
    assert lanes[0] > 1


def test_short_tasks_are_not_tried(monkeypatch):
    monkeypatch.setattr(trial, "measure_member_time", None)
    ss.compile(ss.systems.double_pendulum(), "gauss8").ensemble(STARTS, **ASKED)


def test_a_trial_takes_time_and_leaves_the_task_alone():
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss8")
    task = read_ensemble_spec(stepper.program, Request(STARTS, **ASKED), 1, False, on_disk=False)
    assert trial.measure_member_time(stepper.program, task) > 0
    assert task.members == 40
    assert task.steps == 20


@pytest.mark.parametrize(("members", "steps"), [(40, 5000), (9, 40_000), (1000, 200), (2000, 9000)])
def test_a_trial_takes_a_small_part_of_the_task(monkeypatch, members, steps):
    taken = []

    def run(program, task, count):
        taken.append(task.members * task.steps)
        return None, False

    monkeypatch.setattr(trial, "run_blocks", run)
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss8")
    starts = np.linspace([0.1, 0.2], [2.0, 1.0], members)
    request = Request(starts, p0=[0.0, 0.0], h=0.05, steps=steps)
    task = read_ensemble_spec(stepper.program, request, 1, False, on_disk=False)
    trial.choose_lanes(stepper.program, task)
    assert len(taken) == 2 * (1 + trial.ROUNDS)
    assert 0 < sum(taken) <= trial.TRIAL_PART * members * steps


def test_ctrl_c_in_a_trial_is_heard(monkeypatch):
    def run(program, task, count):
        return plain(program, task, lambda done: signal.raise_signal(signal.SIGINT))

    plain = trial.run_blocks
    monkeypatch.setattr(trial, "FEWEST_STEPS_OF_TRIAL", 0)
    monkeypatch.setattr(trial, "run_blocks", run)
    stepper = ss.compile(ss.systems.double_pendulum(), "gauss8")
    with pytest.raises(KeyboardInterrupt):
        stepper.ensemble(STARTS, **ASKED)
    assert not stepper.program.findings.lanes
