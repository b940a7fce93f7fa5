"""Chosen times and chosen quantities of a run."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.run import chosen

GIVEN = {"q0": [0.8, 1.0], "p0": [0.0, 0.0], "h": 0.01}
TIMES = np.array([0.0, 0.003, 0.5, 0.50001, 2.0])


@pytest.fixture(scope="module")
def stepper():
    return ss.compile(ss.systems.double_pendulum())


@pytest.fixture(params=[8192, 7])
def piece(request, monkeypatch):
    monkeypatch.setattr(chosen, "PIECE", request.param)


def test_states_at_chosen_times_are_those_of_the_dense_output(stepper, piece):
    run = stepper.integrate(**GIVEN, steps=200)
    found = stepper.integrate(**GIVEN, steps=200, t_eval=TIMES)
    assert (found.q == run.at(TIMES).q).all()
    assert (found.p == run.at(TIMES).p).all()
    assert (found.t == TIMES).all()
    assert (found.energy == run.at(TIMES).energy).all()
    assert found.success
    assert found.steps == 200
    assert found.h == 0.01
    assert "bob" in found.points


def test_every_step_is_observed_however_few_states_are_kept(stepper, piece):
    asked = {"reduce": {"highest": ("max", "q1"), "mean": ("mean", "energy")}, "steps": 200}
    whole = stepper.integrate(**GIVEN, **asked).reduced
    assert stepper.integrate(**GIVEN, **asked, t_eval=TIMES).reduced == whole
    assert stepper.integrate(**GIVEN, **asked, save="q1").reduced == whole
    assert stepper.integrate(**GIVEN, steps=200, save="q1").reduced == {}


def test_without_an_end_the_run_goes_as_far_as_the_last_time(stepper):
    assert stepper.integrate(**GIVEN, t_eval=[0.1, 0.234]).steps == 24
    assert stepper.integrate(**GIVEN, t_eval=[0.3]).steps == 30  # 0.3 / 0.01 is a little less
    assert stepper.integrate(**GIVEN, t_eval=[]).steps == 0
    back = stepper.integrate(**(GIVEN | {"h": -0.01}), t_eval=[0.0, -0.25])
    assert back.steps == 25
    assert back.t.tolist() == [0.0, -0.25]


@pytest.mark.slow
def test_a_retimed_run_ends_at_the_last_time():
    system = ss.systems.kepler().retimed("encounters")
    stepper = ss.compile(system, "gauss8")
    start = stepper.reference_state
    found = stepper.integrate(**start, h=0.05, t_eval=[0.5, 2.0, 7.0])
    run = stepper.integrate(**start, h=0.05, t_end=7.0)
    assert np.abs(found.q - run.at([0.5, 2.0, 7.0]).q).max() < 1e-13
    kept = stepper.integrate(**start, h=0.05, t_end=7.0, save="energy")
    assert (kept.t == run.t).all()
    assert (kept["energy"] == run.energy).all()


@pytest.mark.parametrize("every", [1, 2, None])
def test_a_retimed_run_that_ends_where_it_begins_has_one_state(every):
    stepper = ss.compile(ss.systems.kepler().retimed("encounters"), "midpoint")
    asked = {**stepper.reference_state, "h": 0.05, "t0": 0.5}
    kept = stepper.integrate(**asked, t_end=0.5, save=("t", "q"), every=every)
    assert kept["t"].tolist() == [0.5]
    assert kept["q"].shape == (1, 2)
    assert stepper.integrate(**asked, t_eval=[0.5, 0.5]).t.tolist() == [0.5, 0.5]


@pytest.mark.parametrize("every", [1, 3, 50, None])
def test_chosen_quantities_are_those_of_the_whole_run(stepper, piece, every):
    names = ("q", "p", "v", "energy", "q1", "v_q2", "bob")
    run = stepper.integrate(**GIVEN, steps=100, every=every)
    kept = stepper.integrate(**GIVEN, steps=100, every=every, save=names)
    assert list(kept.values) == list(names)
    assert (kept.t == run.t).all()
    for name in ("q", "p", "v", "energy"):
        assert (kept[name] == getattr(run, name)).all()
    for name in ("q1", "v_q2", "bob"):
        assert (kept[name] == run[name]).all()


def test_quantities_at_chosen_times(stepper):
    kept = stepper.integrate(**GIVEN, t_eval=TIMES, save=["energy"])
    assert (kept["energy"] == stepper.integrate(**GIVEN, t_eval=TIMES).energy).all()


def test_a_run_that_fails_keeps_what_it_reached():
    falling = ss.compile(ss.systems.kepler(), "simpson")
    start = {"q0": [1.0, 0.0], "v0": [0.0, 0.0], "h": 0.01}  # into the centre, at t = 1.11
    times = [0.5, 1.0, 2.0]
    with pytest.raises(ss.ConvergenceError) as caught:
        falling.integrate(**start, t_eval=times)
    assert caught.value.trajectory.t.tolist() == [0.5, 1.0]
    kept = falling.integrate(**start, steps=200, save="energy", on_failure="return")
    assert not kept.success
    assert 50 < kept.t.size < 120
    assert "failed" in kept.message


def test_tables_of_chosen_multipliers_have_them_all_by_name():
    pytest.importorskip("pandas")
    chain = ss.systems.hanging_chain()
    asked = {**chain.reference_state, "h": 0.001, "steps": 2}
    run = ss.compile(chain).integrate(**asked)
    table = ss.compile(chain).integrate(**asked, save=["multipliers", "p"]).to_pandas()
    names = [f"lambda_{name}" for name in chain.constraints]
    assert list(table)[: len(names)] == names
    for name in table:
        assert (table[name].to_numpy() == run[name]).all()


def test_data_of_a_chosen_body_have_its_corners_before_their_places():
    pytest.importorskip("xarray")
    top = ss.systems.lagrange_top()
    asked = {**top.reference_state, "h": 0.001, "steps": 2}
    run = ss.compile(top).integrate(**asked).to_xarray()
    names = ["disc", "centre of mass", "theta"]
    kept = ss.compile(top).integrate(**asked, save=names).to_xarray()
    assert kept["disc"].sizes == run["point_disc"].sizes
    assert kept["centre of mass"].sizes == run["point_centre of mass"].sizes
    assert kept["theta"].dims == ("time",)


def test_many_digits():
    precise = ss.compile(ss.systems.pendulum(), precision=30)
    found = precise.integrate(["1"], v0=[0], h="0.1", t_eval=["0.25"])
    rough = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, t_eval=[0.25])
    assert abs(float(found.q[0, 0]) - rough.q[0, 0]) < 1e-15


def test_files(stepper, tmp_path):
    xarray = pytest.importorskip("xarray")
    found = stepper.integrate(**GIVEN, t_eval=TIMES)
    kept = stepper.integrate(**GIVEN, steps=10, save=("q", "energy", "bob"))
    for result in (found, kept):
        for kind in ("npz", "csv", "nc"):
            result.save(tmp_path / f"run.{kind}")
        assert len(np.load(tmp_path / "run.npz")["t"]) == len(result.t)
        table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
        assert (table["energy"] == result["energy"]).all()
        with xarray.open_dataset(tmp_path / "run.nc") as data:
            assert data.attrs["status"] == "SUCCESS"
        with pytest.raises(ss.InputError, match="unsupported file extension"):
            result.save(tmp_path / "run.txt")
    assert {"q1", "q2", "bob_x", "bob_y"} < set(kept.to_pandas().columns)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"t_eval": [0.5, 0.2]}, "are not in increasing order"),
        ({"t_eval": [0.5, 3.0], "steps": 100}, "but the run goes from 0 to 1"),
        ({"t_eval": [-0.1, 0.5]}, "contains t = -0.1, but the run"),
        ({"t_eval": [[0.5]]}, "Pass a list of times"),
        ({"t_eval": "soon"}, "t_eval"),
        ({"t_eval": [float("nan")]}, "not finite"),
        ({"t_eval": [0.5], "every": 10}, "Pass one of them"),
        ({"t_eval": [0.5], "tangents": 1}, "needs the states of all steps"),
        ({"save": "q", "steps": 1, "checkpoint": "run.ckpt"}, "needs the states of all steps"),
        ({"save": "enregy", "steps": 1}, "Did you mean energy"),
        ({"save": "run.zz", "steps": 1}, r"To write a file, use run\.save"),
        ({"save": (), "steps": 1}, "contains no names"),
        ({"save": 3, "steps": 1}, "not a list of names"),
        ({"save": "q"}, "exactly one of t_end and steps"),
    ],
)
def test_bad_input(stepper, asked, message):
    with pytest.raises(ss.InputError, match=message):
        stepper.integrate(**GIVEN, **asked)


def test_what_was_not_saved_is_named(stepper):
    kept = stepper.integrate(**GIVEN, steps=10, save="energy")
    with pytest.raises(ss.UnknownNameError, match="The saved quantities are t, energy"):
        kept["q1"]
