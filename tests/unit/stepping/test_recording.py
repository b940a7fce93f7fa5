"""Runs that record several things behind their steps, in any combination, and readers of it."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.stepping.run import Run

H, STEPS = 0.05, 60
START = [0.1, -0.2]
GIVEN = {"q0": START, "v0": [0.3, 2.0], "h": H, "steps": STEPS}
WATCH = {
    "highest": ("max", "energy"),
    "latest": ("max", "x + t"),
    "lowest": ("min", "theta - x"),
    "mean": ("mean", "x"),
    "crossing": ("first", "theta - x"),
    "never": ("first", "x - 100"),
}
ALL = {"record": "work", "tangents": 2, "sensitivities": "l", "reduce": WATCH}


@pytest.fixture(scope="module")
def system():
    return ss.systems.driven_cart_pole()


@pytest.fixture(scope="module")
def stepper(system):
    return ss.compile(system)


@pytest.fixture(scope="module")
def given(stepper):
    return {**GIVEN, "inputs": dict.fromkeys(stepper.inputs, 0.4)}


@pytest.fixture(scope="module")
def plain(stepper, given):
    return stepper.integrate(**given)


@pytest.fixture(scope="module")
def whole(stepper, given):
    return stepper.integrate(**given, **ALL)


def expected(run, reductions):
    """The values that stored states come to, found by numpy."""
    t, (x, theta) = run.t, run.q.T
    values = {"energy": run.energy, "x + t": x + t, "x": x, "theta - x": theta - x}
    values["x - 100"] = x - 100
    return {
        name: first_crossing(t, values[text]) if kind == "first" else getattr(values[text], kind)()
        for name, (kind, text) in reductions.items()
    }


def first_crossing(t, value):
    """When it becomes positive, by a line between two states."""
    after = int(np.argmax(value > 0))
    if not (value > 0).any():
        return np.nan
    before = max(after - 1, 0)
    return np.interp(0.0, value[[before, after]], t[[before, after]])


def test_what_is_recorded_changes_no_state(plain, whole):
    assert np.array_equal(plain.q, whole.q)
    assert np.array_equal(plain.p, whole.p)


def test_work_is_that_of_steps_taken_again(plain, whole):
    assert set(whole.work) == set(plain.work) == {"motor", "dissipation", "total"}
    for name, values in plain.work.items():
        assert np.abs(whole.work[name] - values).max() < 1e-14
    assert np.abs(whole.energy_balance).max() < 1e-4 < np.abs(whole.work["motor"]).max()


def test_values_are_reduced_over_all_states(plain, whole):
    for name, value in expected(plain, WATCH).items():
        assert whole.reduced[name] == pytest.approx(value, rel=1e-14, nan_ok=True)
    assert np.isnan(whole.reduced["never"])
    assert 0 < whole.reduced["crossing"] < plain.t[-1]


def test_derivatives_are_those_of_a_run_that_records_nothing_else(stepper, given, whole):
    alone = stepper.integrate(**given, tangents=2, sensitivities="l")
    assert np.array_equal(alone.tangent, whole.tangent)
    assert np.array_equal(alone.sensitivity["l"], whole.sensitivity["l"])


@pytest.mark.parametrize("every", [7, None])
def test_runs_that_store_few_states_record_every_step(stepper, given, whole, every):
    run = stepper.integrate(**given, **ALL, every=every)
    places = slice(None, None, every) if every else slice(-1, None)
    assert run.reduced == pytest.approx(whole.reduced, nan_ok=True, rel=0, abs=0)
    assert np.array_equal(run.work["total"], whole.work["total"][places])
    assert np.array_equal(run.tangent, whole.tangent[places])


def test_without_a_record_the_last_state_does_not_tell_work(stepper, given):
    with pytest.raises(ss.InputError, match="Record it: record='work'"):
        _ = stepper.integrate(**given, every=None).work


@pytest.mark.parametrize("stop", [30, 41])
def test_it_is_resumed_to_the_same_bits(stepper, given, whole, tmp_path, monkeypatch, stop):
    path, advance = tmp_path / "run.ckpt", Run.advance

    def interrupted(self, until):
        advance(self, min(until, stop))
        if self.step >= stop:
            raise KeyboardInterrupt

    monkeypatch.setattr(Run, "advance", interrupted)
    with pytest.raises(ss.Interrupted):
        stepper.integrate(**given, **ALL, checkpoint=path, checkpoint_every=10)
    monkeypatch.undo()
    run = ss.resume(path, inputs=given["inputs"])
    assert run.reduced == pytest.approx(whole.reduced, nan_ok=True, rel=0, abs=0)
    for name in ("q", "p", "tangent"):
        assert np.array_equal(getattr(run, name), getattr(whole, name))
    assert np.array_equal(run.recorded["work"], whole.recorded["work"])
    assert np.array_equal(run.sensitivity["l"], whole.sensitivity["l"])


def test_another_record_is_another_run(stepper, given, tmp_path):
    path = tmp_path / "run.ckpt"
    stepper.integrate(**given, record="work", checkpoint=path)
    with pytest.raises(ss.InputError, match="contains another run"):
        stepper.integrate(**given, checkpoint=path)


def test_files_keep_it(whole, tmp_path):
    pytest.importorskip("netCDF4")
    whole.save(tmp_path / "run.nc")
    again = ss.open_trajectory(tmp_path / "run.nc")
    assert again.reduced == pytest.approx(whole.reduced, nan_ok=True, rel=0, abs=0)
    assert np.array_equal(again.work["total"], whole.work["total"])


def test_members_of_ensembles_record_all_at_once(stepper, given, whole, tmp_path):
    starts = np.array(START) + 0.01 * np.arange(3)[:, None]
    asked = {**given, "q0": starts, **ALL}
    many = stepper.ensemble(**asked, every=20)
    for name, value in whole.reduced.items():
        assert many.reduced[name][0] == pytest.approx(value, rel=1e-14, nan_ok=True)
    assert np.allclose(many.work["total"][0], whole.work["total"][::20], rtol=1e-14)
    assert np.allclose(many.tangent[0], whole.tangent[::20], rtol=1e-13)
    assert len(np.unique(many.work["motor"][:, -1])) == 3
    pytest.importorskip("zarr")
    stored = stepper.ensemble(**asked, every=20, store=tmp_path / "store")
    assert np.array_equal(np.asarray(stored.tangent), many.tangent)
    assert np.array_equal(stored.work["total"], many.work["total"])


def test_members_of_later_blocks_begin_with_nothing_recorded(stepper, given):
    starts = np.array(START) + 0.001 * np.arange(100)[:, None]
    asked = {**given, "steps": 2, "record": "work", "reduce": {"x": ("max", "x")}}
    many = stepper.ensemble(**{**asked, "q0": starts}, threads=1)
    for member in (0, 9, 23, 99):
        run = stepper.integrate(**{**asked, "q0": starts[member]})
        assert many.work["total"][member] == pytest.approx(run.work["total"][-1], rel=1e-13)
        assert many.reduced["x"][member] == run.reduced["x"]


def test_work_that_an_ensemble_did_not_record_is_asked_for(stepper, given):
    many = stepper.ensemble(**{**given, "q0": [START]})
    with pytest.raises(ss.InputError, match=r"record='work'"):
        _ = many.work


def test_nothing_works_on_what_is_conservative():
    pendulum = ss.compile(ss.systems.pendulum())
    run = pendulum.integrate([1.0], v0=[0.0], h=H, steps=10, record="work", every=None)
    assert run.work["total"] == [0.0]
    many = pendulum.ensemble([[1.0], [2.0]], v0=[0.0], h=H, steps=10, record="work")
    assert many.work["total"].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("digits", [30])
def test_many_digits_record_work(digits):
    system = ss.systems.damped_pendulum()
    exact = ss.compile(system, precision=digits).integrate(
        [1.0], v0=[0.0], h=0.1, steps=5, every=None, record="work"
    )
    run = ss.compile(system).integrate([1.0], v0=[0.0], h=0.1, steps=5)
    assert abs(float(exact.work["total"][-1]) - run.work["total"][-1]) < 1e-15


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"record": "wrok"}, "Did you mean work"),
        ({"reduce": {"l": "lyapunov"}}, r"stepper\.lyapunov"),
        ({"reduce": {"l": ("max", "nothing")}}, "nothing"),
        ({"record": "work", "t_eval": [0.1]}, "record needs the states of all steps"),
    ],
)
def test_what_makes_no_sense_is_refused(stepper, given, more, message):
    with pytest.raises(ss.InputError, match=message):
        stepper.integrate(**given, **more)


def test_explicit_steps_have_no_nodes_for_work():
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "pushed", coordinates=(x,), kinetic=x.diff() ** 2 / 2, potential=x**2, forces={x: x**2}
    )
    with pytest.raises(ss.InputError, match="is explicit: its steps have no nodes"):
        ss.compile(system, "blanes_moan6").integrate([0.1], v0=[0.0], h=0.1, steps=5, record="work")


def test_a_relation_is_reduced_as_the_difference_of_its_sides():
    pendulum = ss.systems.pendulum()
    (q,) = pendulum.coordinates
    relation, difference = {"a": ("max", q < 0.5)}, {"a": ("max", q - 0.5)}
    reduced = [
        ss.compile(pendulum).integrate([1.0], v0=[0.5], h=0.01, steps=50, reduce=one).reduced["a"]
        for one in (relation, difference)
    ]
    assert reduced[0] == reduced[1] > 0.5
