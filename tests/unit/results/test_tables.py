"""Tables of runs and of ensembles, in files of every kind."""

import numpy as np
import pytest

import symsimpson as ss
from symsimpson.results.tables import NEEDS

pandas = pytest.importorskip("pandas")


def run_of():
    system = ss.systems.double_pendulum()
    return ss.compile(system).integrate(**system.reference_state, h=0.01, steps=20)


def many_of(every=10):
    stepper = ss.compile(ss.systems.pendulum())
    return stepper.ensemble(
        [[1.0], [2.0], [0.5]],
        v0=[0.0],
        h=0.1,
        steps=50,
        every=every,
        parameters={"l": [1.0, 2.0, 3.0]},
        reduce={"top": ("max", "theta")},
    )


def read(path):
    if path.suffix == ".csv":
        return pandas.read_csv(path, dtype=str).map(float)
    return pandas.read_parquet(path)


#: Kinds of files for tables; where one needs a package of its own, it is for those who have that.
TABLES = [".csv", pytest.param(".parquet", marks=pytest.mark.slow)]


@pytest.mark.parametrize("kind", TABLES)
def test_tables_have_the_columns_of_a_dataframe(tmp_path, kind):
    for some in (run_of(), many_of(), many_of(None)):
        some.save(tmp_path / f"table{kind}")
        found, told = read(tmp_path / f"table{kind}"), some.to_pandas().reset_index()
        assert list(found.columns) == list(told.columns)
        assert np.array_equal(found.to_numpy(), told.to_numpy())


def test_rows_of_an_ensemble_are_members_at_times():
    many = many_of()
    frame = many.to_pandas()
    assert len(frame) == 3 * 6
    own = frame.loc[1]
    assert (own["t"] == many.t).all()
    assert (own["theta"] == many[1]["theta"]).all()
    assert (own["l"] == 2.0).all()
    assert (own["top"] == many.reduced["top"][1]).all()
    assert np.allclose(own["bob_x"], 2.0 * np.sin(own["theta"]))


def test_arrays_keep_their_shapes(tmp_path):
    run, many = run_of(), many_of()
    run.save(tmp_path / "run.npz")
    many.save(tmp_path / "many.npz")
    with np.load(tmp_path / "run.npz") as found:
        assert np.array_equal(found["v"], run.v)
        assert found["point_bob"].shape == (21, 2) if "bob" in run.points else True
    with np.load(tmp_path / "many.npz") as found:
        assert np.array_equal(found["q"], many.q)
        assert np.array_equal(found["parameter_l"], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("kind", [".nc", ".zarr"])
def test_ensembles_are_datasets(tmp_path, kind):
    xarray = pytest.importorskip("xarray")
    many = many_of()
    many.save(tmp_path / f"many{kind}")
    engine = {".nc": "netcdf4", ".zarr": "zarr"}[kind]
    with xarray.open_dataset(tmp_path / f"many{kind}", engine=engine) as found:
        assert np.array_equal(found["q"], many.q)
        assert np.array_equal(found["l"], [1.0, 2.0, 3.0])


def test_tables_are_no_runs(tmp_path):
    run_of().save(tmp_path / "run.csv")
    with pytest.raises(ss.InputError, match=r"is a table[\s\S]*pandas.read_csv"):
        ss.open_trajectory(tmp_path / "run.csv")
    for some in (run_of(), many_of()):
        with pytest.raises(ss.InputError, match="unsupported file extension") as said:
            some.save(tmp_path / "run.xls")
        assert all(kind in str(said.value) for kind in NEEDS)


def two_of_a_name(**positions):
    x, y = ss.coordinates("bob_x bob_y")
    kinetic, potential = (x.diff() ** 2 + y.diff() ** 2) / 2, (x**2 + y**2) / 2
    return ss.MechanicalSystem(
        "marble",
        coordinates=(x, y),
        kinetic=kinetic,
        potential=potential,
        positions={"bob": (x + 5, y - 5), **positions},
    )


def test_no_column_hides_another():
    stepper, start = ss.compile(two_of_a_name()), {"v0": [0.0, 0.0], "h": 0.1, "steps": 3}
    run = stepper.integrate([1.0, 2.0], **start)
    frame = run.to_pandas()
    assert np.array_equal(frame["bob_x"], run.q[:, 0])
    assert np.array_equal(frame[["point_bob_x", "point_bob_y"]], run.points["bob"])
    for names in (("bob", "q"), ("q", "bob"), ("bob_x", "bob")):
        kept = stepper.integrate([1.0, 2.0], **start, save=names).to_pandas()
        assert np.array_equal(kept["bob_x"], run.q[:, 0])
        assert np.array_equal(kept["point_bob_x"], run.points["bob"][:, 0])
    many = stepper.ensemble([[1.0, 2.0]], **start, every=1)
    assert np.array_equal(many.to_pandas()["bob_x"], many.q[0, :, 0])


@pytest.mark.parametrize("kind", [".nc", pytest.param(".zarr", marks=pytest.mark.slow)])
def test_names_with_a_slash_are_saved(tmp_path, kind):
    xarray = pytest.importorskip("xarray")
    name, path = "left/foot", tmp_path / f"run{kind}"
    stepper = ss.compile(two_of_a_name(**{name: (3, 4)}))
    start = {"v0": [0.0, 0.0], "h": 0.1, "steps": 3}
    stepper.integrate([1.0, 2.0], **start).save(path)
    assert (ss.open_trajectory(path).q[0] == [1, 2]).all()
    how = {} if kind == ".nc" else {"engine": "zarr", "consolidated": False}
    with xarray.open_dataset(path, **how) as data:
        assert data["point_1"].attrs["long_name"] == "place of left/foot"
    stepper.integrate([1.0, 2.0], **start, save=("q", name)).save(path)
    with xarray.open_dataset(path, **how) as data:
        assert data["quantity_1"].attrs["long_name"] == name
        assert (data["quantity_1"][2] == [3, 4]).all()


def test_points_are_those_of_the_system_at_hand():
    start = {"v0": [0.0, 0.0], "h": 0.1, "steps": 1}
    first, other = two_of_a_name(top=(0, 0)), two_of_a_name(top=(1, 2))
    assert first == other  # points change no equation
    for system, top in ((first, [0, 0]), (other, [1, 2])):
        run = ss.compile(system).integrate([1.0, 2.0], **start)
        assert run["top"].tolist() == [top, top]
    assert ss.compile(two_of_a_name()).integrate([1.0, 2.0], **start).points.keys() == {"bob"}


def test_points_by_name():
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=5)
    assert run["bob"].shape == (6, 2)
    assert np.allclose(run["bob"], np.stack([np.sin(run["theta"]), -np.cos(run["theta"])], axis=1))
    assert np.array_equal(run[2:4]["bob"], run["bob"][2:4])
    assert np.array_equal(run.points["bob"], run["bob"])
    many = many_of()
    assert np.array_equal(many["bob"][1], many.points["bob"][1])
    with pytest.raises(ss.InputError, match="Did you mean bob"):
        run["bobb"]


def test_members_are_drawn():
    plt = pytest.importorskip("matplotlib.pyplot")
    ax = many_of().plot("energy", most=3)
    assert len(ax.lines) == 3
    assert many_of(None).plot().get_ylabel() == "members"
    plt.close("all")


@pytest.mark.parametrize("kind", TABLES)
def test_many_digits_are_refused_by_every_kind(tmp_path, kind):
    run = ss.compile(ss.systems.pendulum(), precision=30).integrate([1], v0=[0], h="0.1", steps=2)
    with pytest.raises(ss.InputError, match="many digits"):
        run.save(tmp_path / f"run{kind}")


def test_files_of_similar_names_are_left_alone(tmp_path):
    for name in ("run.new.csv", "run.csv.new"):
        (tmp_path / name).write_text("mine")
    run_of().save(tmp_path / "run.csv")
    assert {one.read_text() for one in tmp_path.glob("*new*")} == {"mine"}
