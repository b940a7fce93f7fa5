"""Short runs leave the bits, and the errors, of any others."""

import threading

import numpy as np
import pytest
from support.cases import sweep

import symsimpson as ss
from symsimpson.run import short_runs
from symsimpson.study.analysis.stability import passages

KINDS = [
    ("double_pendulum", "simpson"),
    ("double_pendulum", "gauss8"),
    ("lagrange_top", "simpson"),
    ("henon_heiles", "kahan_li8"),
    ("kepler", "midpoint"),
]


@pytest.fixture
def taken(monkeypatch):
    """Count the runs that are taken briefly."""
    found = []

    def counted(*arguments):
        run = plain(*arguments)
        found.append(run is not None)
        return run

    plain = short_runs.try_short_run
    monkeypatch.setattr("symsimpson.run.requested.try_short_run", counted)
    return found


def equal(run, other):
    same = [
        np.array_equal(getattr(run, name), getattr(other, name))
        for name in ("t", "q", "p", "newton_iterations")
    ]
    about = [
        (one.h, one.steps, one.every, one.status, one.message, one.parameters)
        for one in (run, other)
    ]
    return all(same) and about[0] == about[1]


@pytest.mark.parametrize(("name", "scheme"), sweep(KINDS))
def test_the_same_bits(name, scheme, taken):
    system = getattr(ss.systems, name)()
    stepper, state = ss.compile(system, scheme), system.reference_state
    q0, (kind, second) = state["q0"], next((k, x) for k, x in state.items() if k != "q0")
    starts = [{kind: second}, {kind: [0.9 * x for x in second]}]
    for more in (
        {"steps": 3},
        {"t_end": 0.5},
        {"steps": 40},
        {"steps": 40, "every": None},
        {"steps": 41, "every": 3},
        {"steps": 5, "every": None, "t0": 2.0},
    ):
        for start in starts:
            asked = {"q0": q0, **start, "h": 0.01, **more}
            stepper.integrate(**asked)  # the first one of a step is looked at
            del taken[:]
            again = stepper.integrate(**asked)
            assert taken == [True]
            assert equal(again, stepper.integrate(**asked, progress=False))
    assert len(stepper.program.findings.prepared) == 1


def test_states_as_people_write_them(taken):
    stepper = ss.compile(ss.systems.double_pendulum())
    asked = {"h": 0.01, "steps": 20}
    expected = stepper.integrate([1.0, 2.0], v0=[0.0, 0.0], **asked)
    del taken[:]
    for q0, v0 in (
        ([1, 2], [0, 0]),
        ((1.0, 2), np.zeros(2, dtype=np.float32)),
        ({"q2": 2, "q1": 1.0}, {"q1": 0, "q2": 0.0}),
        (np.array([1, 2]), (0.0, 0.0)),
    ):
        assert equal(stepper.integrate(q0, v0=v0, **asked), expected)
    assert taken == [True] * 4


def test_states_that_make_no_sense(taken):
    stepper = ss.compile(ss.systems.double_pendulum())
    stepper.integrate([1.0, 2.0], v0=[0.0, 0.0], h=0.01, steps=20)
    for q0, message in (
        ([1.0], r"q0 has shape \(1,\)"),
        ([1.0, float("nan")], "q0 is not finite for q2"),
        (np.zeros((1, 2)), r"q0 has shape \(1, 2\)"),
        ({"q1": 1.0}, "q0 has no number for q2"),
        (["a", 1.0], "q0 is"),
    ):
        with pytest.raises(ss.InputError, match=message):
            stepper.integrate(q0, v0=[0.0, 0.0], h=0.01, steps=20)


def test_a_step_at_once(taken):
    stepper = ss.compile(ss.systems.double_pendulum())
    run = stepper.integrate([1.0, 2.0], v0=[0.1, 0.2], h=0.01, steps=1, every=None)
    q, p = stepper.step([1.0, 2.0], [0.1, 0.2], h=0.01)
    assert taken == [False, True]
    assert np.array_equal(q, run.q[0])
    assert np.array_equal(p, run.p[0])


def test_results_are_not_overwritten_by_later_runs():
    stepper = ss.compile(ss.systems.double_pendulum())
    for every in (1, None):
        runs = [
            stepper.integrate([1.0 + k, 2.0], v0=[0.1, 0.2], h=0.01, steps=20, every=every)
            for k in range(3)
        ]
        kept = [run.q.copy() for run in runs]
        stepper.integrate([0.5, 0.1], v0=[0.0, 0.0], h=0.01, steps=20, every=every)
        assert all(np.array_equal(run.q, q) for run, q in zip(runs, kept, strict=True))


def test_parameters_and_steps_that_are_new_are_looked_at(taken):
    stepper = ss.compile(ss.systems.pendulum())
    start = {"q0": [1.0], "v0": [0.0], "steps": 10}
    for h, length in ((0.1, 1.0), (0.1, 1.0), (0.2, 1.0), (0.1, 2.0), (0.1, 2.0)):
        stepper.integrate(**start, h=h, parameters={"l": length})
    assert taken == [False, True, False, False, True]
    with pytest.warns(ss.StabilityWarning):
        stepper.step([1.0], [0.0], h=2.0)
    stepper.step([1.0], [0.0], h=2.0)  # it is said once


def test_what_is_wrong_is_said_as_ever():
    stepper = ss.compile(ss.systems.double_pendulum())
    good = {"q0": [1.0, 2.0], "p0": [0.0, 0.0], "h": 0.01, "steps": 4}
    for _ in range(2):
        stepper.integrate(**good)
    wrong = (
        {"q0": [np.nan, 1.0]},
        {"q0": [1.0]},
        {"p0": None},
        {"v0": [0.0, 0.0]},
        {"steps": -1},
        {"steps": 1.5},
        {"t_end": 1.0},
        {"every": 0},
        {"every": True},
        {"h": 0.0},
        {"on_failure": "stop"},
        {"parameters": {"nothing": 1.0}},
        {"t0": np.inf},
        {"q0": np.ma.array([1.0, 2.0], mask=[True, False])},
        {"q0": "here"},
        {"q0": [[1.0], [2.0, 3.0]]},
    )
    for change in wrong:
        with pytest.raises(ss.InputError) as told:
            stepper.integrate(**good | change)
        with pytest.raises(ss.InputError) as general:
            stepper.integrate(**good | {"progress": False} | change)
        assert str(told.value) == str(general.value)


@pytest.mark.slow
def test_a_step_that_fails_is_told_of_as_ever():
    stepper = ss.compile(ss.systems.kepler(), "gauss8")
    asked = {"q0": [1e-3, 0.0], "v0": [0.0, 0.0], "h": 0.05, "steps": 50}
    messages = []
    for _ in range(2):
        with pytest.raises(ss.ConvergenceError) as caught:
            stepper.integrate(**asked)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


@pytest.mark.slow
def test_threads_do_not_meet():
    stepper = ss.compile(ss.systems.double_pendulum())
    starts = [[0.1 * k, 1.0] for k in range(8)]

    def last(q0):
        return stepper.integrate(q0, v0=[0.0, 0.0], h=0.01, steps=200, every=None).q[0].tolist()

    alone, found = [last(q0) for q0 in starts], [[] for _ in starts]
    threads = [
        threading.Thread(target=lambda k=k: found[k].extend(last(starts[k]) for _ in range(50)))
        for k in range(len(starts))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [[end] * 50 for end in alone]


def test_what_a_long_run_refuses_a_short_one_does_not_take(taken):
    stepper = ss.compile(ss.systems.pendulum())
    start = {"q0": [1.0], "v0": [0.0], "h": 0.01}
    stepper.integrate(**start, steps=4)
    with pytest.raises(ss.InputError, match="every is"):
        stepper.integrate(**start, steps=4, every=2**60)


@pytest.fixture
def calls(monkeypatch):
    """Count short runs that begin, and states that are searched for singular points."""
    found = {"begun": 0, "searched": 0}

    def counted(name, function):
        def call(*arguments):
            found[name] += 1
            return function(*arguments)

        return call

    for name, place, attribute in (
        ("begun", short_runs.BriefRunner, "run"),
        ("searched", passages, "unresolved_pole"),
    ):
        monkeypatch.setattr(place, attribute, counted(name, getattr(place, attribute)))
    return found


def test_states_are_searched_for_singular_points_until_none_are_known_to_be_there(calls):
    stepper = ss.compile(ss.systems.double_pendulum())
    asked = {"v0": [0.0, 0.0], "h": 0.01, "progress": False}
    for q1, steps, searched in ((1.0, 40, 1), (1.0, 40, 1), (1.0, 20, 1), (1.2, 40, 2)):
        stepper.integrate([q1, 1.5], steps=steps, **asked)
        assert calls["searched"] == searched


def test_where_singular_points_may_be_no_run_is_taken_twice(calls):
    system = ss.systems.spherical_pendulum()
    stepper = ss.compile(system)
    for _ in range(5):  # along a meridian, through the lowest point, there again in finer steps
        stepper.integrate([0.5, 0.0], v0=[0.0, 0.0], h=0.01, steps=100)
    assert calls == {"begun": 0, "searched": 10}
